"""The model-based rival: steers by an optimal gain for the learned model of the car, in the same experiment as NFQ."""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import Policy
from steerkit.controllers.riccati import cost_to_go
from steerkit.diagram import maths as m
from steerkit.learning.experiment import Experiment, LearningRun, Watcher
from steerkit.learning.learner_state import untrained
from steerkit.learning.nfq.model import CarModel
from steerkit.learning.trainer import Job, Pending, Result

FASTEST = 15
"""Speed up to which gains are tabled, one a metre per second; faster cars are steered as at this speed [m/s]."""


class BeforeState(NamedTuple):
    """The dynamic output element's angle one sample before [rad]."""

    doe: Any


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelPolicy(Policy):
    """Steps of the steering wheel by linear-quadratic regulation of a learned `CarModel`.

    With the model's numbers, and nothing changing in a steady bend, z' = A(v) z + B a for

        z = (e, c, r_e, q, d),  c = e_dot/v,  q = (now + before + earlier)*doe - back*(c - psi_e),  d = doe - doe(t-dt);
        action = sat(-K(v) z),  K minimises the sum of (e/e_unit)^2 + (r_e/r_unit)^2 + (a/a_unit)^2.

    Inputs, as for `NfqPolicy`: e [m], e_dot [m/s], v [m/s], psi_e [rad], r_e [rad/s], doe [rad]. Outputs: action [rad];
    q [1], always 0; ready [1]. State: doe one sample before. Valid for an integrating dynamic
    output element; K is tabled for 1, 2, ... FASTEST m/s and interpolated. Raises ValueError for a model with which
    the wheel does not move the car (too few transitions). Source: Kwakernaak and Sivan 1972, section 6.4.
    """

    model: CarModel
    """The learned car."""
    limit: float = math.radians(25.0)
    """Largest |action| [rad]."""
    e_unit: float = 0.1
    """Cross-track error that costs 1 [m]."""
    r_unit: float = 0.3
    """Yaw-rate error that costs 1 [rad/s]."""
    a_unit: float = math.radians(10.0)
    """Step of the steering wheel that costs 1 [rad]."""
    ready_from: float = 0.0
    """Time from which it is to be trusted [s]."""

    def __post_init__(self) -> None:
        units = (self.limit, self.e_unit, self.r_unit, self.a_unit)
        require(min(units) > 0.0, "ModelPolicy", f"limit and units {units}, expected > 0")
        _ = self._gains

    @cached_property
    def _gains(self) -> m.Table:
        rows = np.array([self._gain(float(v)) for v in range(1, FASTEST + 1)])
        return m.Table(np.hstack((rows, np.vstack((np.diff(rows, axis=0), 0.0 * rows[:1])))))

    def _gain(self, v: float) -> NDArray[np.float64]:
        """K at the speed v (5,)."""
        o, dt = self.model, self.model.dt
        p, b = np.array([0.0, 0.0, 0.0, 1.0, -o.earlier]), o.now  # turn of the wheels: p @ z + b*a
        r_e, c, e = np.eye(5)[[2, 1, 0]]
        yaw, turn = o.yaw * v * p, dt * (r_e + 0.5 * o.yaw * v * p)
        yaw_b, turn_b = o.yaw * v * b, 0.5 * dt * o.yaw * v * b
        a_c, b_c = c + p + turn, b + turn_b
        total = o.now + o.before + o.earlier
        a_matrix = np.array([e + 0.5 * dt * v * (c + a_c), a_c, r_e + yaw, np.eye(5)[3] - o.back * p, np.zeros(5)])
        column = np.array([0.5 * dt * v * b_c, b_c, yaw_b, total - o.back * b, 1.0])
        cost = np.diag([self.e_unit**-2, 0.0, self.r_unit**-2, 0.0, 0.0])
        try:
            x = cost_to_go(a_matrix, column, cost, self.a_unit**-2)
        except (np.linalg.LinAlgError, ValueError) as why:
            raise ValueError(f"ModelPolicy: the model cannot be steered at {v} m/s ({why}): {o}") from why
        b_matrix, effort = column[:, None], np.array([[self.a_unit**-2]])
        return np.linalg.solve(effort + b_matrix.T @ x @ b_matrix, b_matrix.T @ x @ a_matrix)[0]

    def init(self, batch: tuple[int, ...] = ()) -> BeforeState:
        return BeforeState(m.filled(0.0, batch))

    def settle(self, t: float, x: BeforeState, u: Any) -> BeforeState:
        return BeforeState(u.doe)

    def output(self, t: Any, x: BeforeState, u: Any) -> Any:
        o = self.model
        c = u.e_dot / m.maximum(u.v, 1.0)
        v = m.clip(u.v, 1.0, float(FASTEST))
        q = (o.now + o.before + o.earlier) * u.doe - o.back * (c - u.psi_e)
        z = (u.e, c, u.r_e, q, u.doe - x.doe)
        i = m.minimum(m.where(m.is_finite(v), m.floor(v) - 1.0, 0.0), FASTEST - 1.0)
        row = self._gains(i)
        action: Any = 0.0
        for value, gain, rise in zip(z, row[:5], row[5:], strict=True):
            action = action - (gain + (v - 1.0 - i) * rise) * value
        ready = m.where(t >= self.ready_from, 1.0, 0.0)
        return self.Y(m.clip(action, -self.limit, self.limit), 0.0 * action, ready)

    def update(self, t: Any, x: BeforeState, u: Any, y: Any) -> BeforeState:
        return BeforeState(u.doe)


class ModelTrainer:
    """Makes a `ModelPolicy` of recorded transitions, in the place of the trainer of nets: see `Training`.

    seconds: driving time charged for one update [s]. policy: handed out while the car is not known well enough.
    """

    def __init__(self, *, seconds: float, policy: NfqPolicy):
        self.seconds = seconds
        self._policy: Any = policy
        self._result: tuple[float, Result] | None = None

    def submit(self, job: Job, t: float) -> None:
        """Fit the car model now; the policy is there `seconds` after t, in the place of one that still waited."""
        began = time.perf_counter()
        with contextlib.suppress(ValueError):  # too few transitions to know the car: go on with what there is
            model = CarModel.fit(job.record(), job.description)
            self._policy = ModelPolicy(model=model, limit=max(job.actions))
        seconds = time.perf_counter() - began + (self._result[1].seconds if self._result else 0.0)
        self._result = (t + self.seconds, Result(job.number, None, seconds, policy=self._policy))

    def poll(self, t: float) -> Result | None:
        """The newest policy, once, if it would be ready at driving time t [s]."""
        if self._result is None or t < self._result[0]:
            return None
        (_, result), self._result = self._result, None
        return result

    @property
    def busy(self) -> bool:
        """Is there a policy still to come?"""
        return self._result is not None

    @property
    def pending(self) -> Pending | None:
        """None: a run of the rival is not kept."""
        return None

    def close(self) -> None:
        """Nothing to end."""


def model_based(experiment: Experiment, watch: Watcher | None = None) -> LearningRun:
    """A learning run whose policy is `ModelPolicy`: the same car, first failure, recovery, hand-over and counting.

    It begins with an untrained net as NFQ does, and is charged the same `fit_seconds`. It knows no dead time. It cannot
    be kept in a directory.
    """
    setting = replace(experiment.setting, fit=replace(experiment.setting.fit, dead_time=0.0))
    experiment = replace(experiment, setting=setting)
    trainer = ModelTrainer(seconds=setting.fit_seconds, policy=untrained(setting, experiment.seed))
    return LearningRun(experiment, watch, trainer)
