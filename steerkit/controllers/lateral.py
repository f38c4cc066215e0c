"""LQR and MPC of lateral acceleration: what a target asks with preview, wherever that leads."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from types import SimpleNamespace
from typing import Any

import numpy as np

from steerkit._support.errors import in_one_line, number, require, require_within
from steerkit._support.plugins import imported
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Array, Scalar

DT = 0.1
"""Sample time of the task [s]: 10 Hz."""
PREVIEW = 50
"""Samples of the target that a controller sees ahead: 5 s."""
STEER = 2.0
"""Largest command [m/s^2], as lateral acceleration by the car's data sheet."""
_E_COST = 50.0  # of (m/s^2)^2 of error, over that of (m/s^3)^2 of jerk
_SWEEPS = 30


@dataclass(frozen=True, eq=False, kw_only=True)
class LateralMpc(Block):
    """Model-predictive control of lateral acceleration by the measure itself, with a gain that it finds while driving.

    The tyres' part a = a_y - a_roll answers commands u by g sum_i p_i u_{k-i} + w; p is the change of `response`, and w
    wanders: w+ = rho w + noise, rho = exp(-dt/wander_time). g is estimated from a_k - rho a_{k-1} by recursive least
    squares. Then, over `preview`, y being a_y and z its target,

        min  sum_i 50 (y_i - z_i)^2 + ((y_i - y_{i-1})/dt)^2 + q_step g^2 (u_i - u_{i-1})^2

    by a matrix made beforehand: with moves = 1 that is the LQR with preview, cut at +-2 m/s^2; with more, the first
    `moves` commands keep that limit (sweeps over them, each the best for the others), the later ones are free.

    Inputs: a_y, a_roll [m/s^2]; preview, preview_roll [m/s^2], from one sample ahead on. Output: a_y_cmd [m/s^2].
    State: the commands on their way, oldest first [m/s^2]; g [1], its variance [1]; a, and the answer for g = 1, one
    sample ago [m/s^2]. NaN in an input gives NaN out, and leaves the state. Raises ValueError for parameters out of
    range. Source: Maciejowski 2002, ch. 2; measure: comma's controls challenge v2.
    """

    a_y = In("m/s^2")
    a_roll = In("m/s^2")
    preview = In("m/s^2", size=PREVIEW)
    preview_roll = In("m/s^2", size=PREVIEW)
    a_y_cmd = Out("m/s^2")

    response: tuple[float, ...]
    """Answer to a step of the command of 1, over its final value: 1, 2, ... samples after it."""
    gain: Scalar = number(1.0, "1", low=0.2, high=5.0)
    """g at the start."""
    gain_doubt: float = number(0.5, "1", low=0.0, high=5.0)
    """Its standard deviation then; 0: it is known, and stays."""
    gain_drift: float = number(0.03, "1", low=0.0, high=5.0)
    """Standard deviation of its change within a second."""
    noise: float = number(0.1, "m/s^2", above=0.0, high=5.0)
    """Standard deviation of w."""
    wander_time: float = number(1.5, "s", above=0.0, high=1e4)
    """Within which w is forgotten [s]."""
    q_step: float = number(100.0, "1", above=0.0, high=1e6)
    """What (m/s^2)^2 of a step of g u costs; the more, the less a wrong dead time hurts. On a car of 0.5 s, 100 holds
    where it is told 25 % wrong and swings at 50 %; 1000 holds there too, but costs a fifth more where it is right."""
    moves: int = number(1, "1", low=1, high=20)
    """Commands that keep the limit."""
    dt: float = number(DT, "s", above=0.0, high=1.0)

    def __post_init__(self) -> None:
        super().__post_init__()
        n = len(self.response)
        require(0 < n <= PREVIEW, "LateralMpc", f"response of {n} samples, expected 1 to {PREVIEW}")
        require_within("LateralMpc", "response", np.asarray(self.response), "1", -5.0, 5.0)
        require(self.response[-1] > 0.0, "LateralMpc", f"response ends at {self.response[-1]} [1], expected above 0")

    @staticmethod
    def told(delay: float, lag: float) -> tuple[float, ...]:
        """The `response` of a dead time and a first-order lag [s]."""
        after = [DT * i - delay for i in range(1, min(PREVIEW, math.ceil((delay + 4.0 * lag) / DT + 1.0)) + 1)]
        return tuple(1.0 - math.exp(-max(t, 0.0) / max(lag, 1e-6)) for t in after)

    @property
    def _kept(self) -> float:
        return math.exp(-self.dt / self.wander_time)

    @cached_property
    def _pulses(self) -> tuple[float, ...]:
        return tuple(np.diff((0.0, *self.response)).tolist())

    @cached_property
    def _plan(self) -> tuple[list[list[float]], list[list[float]]]:
        """How each move follows from what is known, (moves, n + 2 + 2 PREVIEW), and from the others, (moves, moves)."""
        n, later = len(self._pulses), slice(self.moves, None)
        p = np.concatenate((self._pulses, np.zeros(2 * PREVIEW)))
        ahead = np.arange(1, PREVIEW + 1)
        effect = np.tril(p[np.abs(ahead[:, None] - ahead)])  # of u_j on a_{i+1}
        past = p[ahead[:, None] + np.arange(n, 0, -1) - 1]
        steps = np.eye(PREVIEW) - np.eye(PREVIEW, k=-1)
        rise = steps.T @ steps / self.dt**2
        first = np.eye(PREVIEW)[:, :1]
        weight = effect.T @ (_E_COST * np.eye(PREVIEW) + rise)
        hessian = weight @ effect + self.q_step * steps.T @ steps
        of_past = weight @ past
        of_past[:, -1:] -= self.q_step * first
        fading = weight @ self._kept ** ahead[:, None]
        now = -effect.T @ first / self.dt**2
        known = np.hstack((of_past, fading, now, weight, -_E_COST * effect.T))
        # the later moves as they follow from the first ones
        inner = np.linalg.solve(hessian[later, later], hessian[later, : self.moves]).T
        known = known[: self.moves] - inner @ known[later]
        hessian = hessian[: self.moves, : self.moves] - inner @ hessian[later, : self.moves]
        among: Array = hessian / np.diag(hessian)[:, None]
        return (-np.linalg.solve(hessian, known)).tolist(), among.tolist()

    def init(self, batch: tuple[int, ...] = ()) -> State:
        start = (0.0,) * len(self._pulses)
        return tuple(m.filled(value, batch) for value in (*start, self.gain, self.gain_doubt**2, 0.0, 0.0))

    def output(self, t: Any, x: State, u: Any) -> Any:
        past = x[:-4]
        g, _, tyres, answer = self._seen(x, u)
        laws, among = self._plan
        known = (*[g * c for c in past], tyres - g * answer, u.a_y, *u.preview_roll, *u.preview)
        best = [sum([k * z for k, z in zip(law, known, strict=True)]) for law in laws]
        most = g * STEER
        moves = [m.clip(move, -most, most) for move in best]
        for _ in range(_SWEEPS if self.moves > 1 else 0):
            for i, row in enumerate(among):
                off = sum([h * (a - b) for h, a, b in zip(row, moves, best)])
                moves[i] = m.clip(moves[i] - off, -most, most)
        return self.Y(moves[0] / g)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return m.chosen(m.is_finite(y.a_y_cmd), (*x[1:-4], y.a_y_cmd, *self._seen(x, u)), x)

    def _seen(self, x: State, u: Any) -> tuple[Scalar, ...]:
        """g and its variance with this sample, the tyres' part of a_y, and the answer for g = 1 [m/s^2]."""
        *past, g, variance, tyres_before, answer_before = x
        answer = sum([p * c for p, c in zip(self._pulses, past[::-1])])
        tyres, rho = u.a_y - u.a_roll, self._kept
        moved = answer - rho * answer_before
        variance = variance + (self.gain_drift**2 * self.dt if self.gain_doubt else 0.0)
        trust = variance * moved / ((1.0 - rho * rho) * self.noise**2 + variance * moved * moved)
        found = m.clip(g + trust * (tyres - rho * tyres_before - g * moved), 0.2, 5.0)
        return found, (1.0 - trust * moved) * variance, tyres, answer


_AHEAD = ("lataccel", "roll_lataccel", "v_ego", "a_ego")


class BaseController:
    """What a file's `from . import BaseController` gives."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ChallengeController(Block):
    """Drives with an object of the challenge: `update(target_lataccel, current_lataccel, state, future_plan)`.

    Its answer is a_y_cmd [m/s^2]. The object remembers by itself, so the block is not pure: it is made anew where a
    drive begins, is asked once a sample, and can be simulated step by step only. Inputs: a_y_target, a_y, a_roll
    [m/s^2], v [m/s], a_x [m/s^2]; preview, preview_roll [m/s^2], preview_v [m/s], preview_a_x [m/s^2]. State: the
    sample's number. Raises ValueError where the object fails or answers no finite number; TypeError for a batch.
    """

    a_y_target = In("m/s^2")
    a_y = In("m/s^2")
    a_roll = In("m/s^2")
    v = In("m/s")
    a_x = In("m/s^2")
    preview = In("m/s^2", size=PREVIEW)
    preview_roll = In("m/s^2", size=PREVIEW)
    preview_v = In("m/s", size=PREVIEW)
    preview_a_x = In("m/s^2", size=PREVIEW)
    a_y_cmd = Out("m/s^2")

    pure = False
    make: Callable[[], Any]
    """Makes the object."""
    name: str = "controller"
    """What it is called in errors."""
    dt: float = number(DT, "s", above=0.0, high=1.0)
    live: dict[str, Any] = field(default_factory=dict, init=False, repr=False)
    """The object of this drive."""

    @classmethod
    def load(cls, name: str) -> "ChallengeController":
        """The class that `my_file.py:Controller` names; raises ValueError, in one line, where there is none."""
        kind, where = imported(name, "controller", parent=__name__), f"controller '{name}'"
        fits = isinstance(kind, type) and callable(getattr(kind, "update", None))
        expected = "a class with update(self, target_lataccel, current_lataccel, state, future_plan)"
        require(fits, where, f"is {kind!r:.60}, expected {expected}")
        return cls(make=kind, name=where)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        if batch:
            raise TypeError(f"{self.name}: it remembers one drive, and cannot be batched")
        return (0.0,)

    def output(self, t: Any, x: State, u: Any) -> Any:
        try:
            if x[0] == 0.0:  # asked more than once, as the loop settles
                self.live["object"] = self.make()
            now = SimpleNamespace(roll_lataccel=u.a_roll, v_ego=u.v, a_ego=u.a_x)
            ahead = SimpleNamespace(**dict(zip(_AHEAD, map(list, u[5:]))))
            given = self.live["object"].update(u.a_y_target, u.a_y, now, ahead)
            answer = np.asarray(given, dtype=float)
        except (Exception, SystemExit) as error:
            raise ValueError(f"{self.name} failed at {t:.1f} s: {in_one_line(error, foreign=True)}") from error
        said = f"answered {given!r:.60} at {t:.1f} s, expected one finite number, the steer"
        require(answer.size == 1 and np.isfinite(answer).all(), self.name, said)
        return self.Y(float(answer.reshape(-1)[0]))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (x[0] + 1.0,)
