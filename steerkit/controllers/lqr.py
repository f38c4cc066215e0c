"""LQR on the path: one Riccati solution a speed gives the feedback and the use of the curvature ahead."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from steerkit._support.errors import Checked, number, require
from steerkit.controllers.limits import LimitedLaw, limited
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, Out, State
from steerkit.diagram.maths import Array, Scalar, Table
from steerkit.task import DT
from steerkit.vehicles import Vehicle

Matrices = Callable[[float], tuple[Any, Any]]
"""v [m/s] -> A (2, 2), B (2,) of (beta, r)' = A (beta, r) + B delta; `LinearSingleTrack.matrices` is one."""

_REACH, _REACH_OF_SLEW = 0.5, 0.2
"""What a car with a slew is taken to be off at most [m], and over its slew [s^3]: seeing more, the law asks for more
than the slew gives in time, and swings ever further; with 0.4, where the slew is half of what it is told."""
_MOTION = 5  # e, theta, beta, r, delta
_SLOWEST = 1.0  # m/s: below it, the gains stay and theta is formed with this speed


def cost_to_go(a: Array, b: Array, q: Array, r: float) -> Array:
    """P (n, n) of x' P x, the sum of x' Q x + r u^2 from now on with the best feedback and without limits.

    x+ = A x + B u,  P = Q + A' P A - A' P B (r + B' P B)^-1 B' P A

    a (n, n), b (n,), q (n, n), r > 0: the matrices A, B, Q and r. Raises LinAlgError or ValueError for a system that no
    feedback makes stable. Solutions are kept within the process: controllers are made again and again for the same car,
    for every drive of a table, for every delay of an adaptive one. Source: Anderson, Moore 1990, ch. 2.
    """
    parts = [np.ascontiguousarray(part, dtype=float) for part in (a, b, q)]
    return np.frombuffer(_solution(*[part.tobytes() for part in parts], float(r))).reshape(parts[0].shape).copy()


@lru_cache(maxsize=2048)
def _solution(a: bytes, b: bytes, q: bytes, r: float) -> bytes:
    from scipy.linalg import solve_discrete_are

    column: Any = np.frombuffer(b)[:, None]
    n = len(column)
    p = solve_discrete_are(np.frombuffer(a).reshape(n, n), column, np.frombuffer(q).reshape(n, n), np.array([[r]]))
    return np.ascontiguousarray(p, dtype=float).tobytes()


@dataclass(frozen=True, kw_only=True)
class LqrDesign(Checked):
    """What an `Lqr` is designed for: the car, its steering, and what errors cost.

    cost, a sample: (e/e_size)^2 + (e'/e_dot_size)^2 + (step/step_size)^2, step = change of the road-wheel command.
    """

    matrices: Matrices
    """The car's lateral model; see `Matrices`."""
    reference: float
    """Where e is measured, metres ahead of the centre of gravity."""
    delay: float = number(0.0, "s", low=0.0, high=2.0)
    """Pure delay from command to wheel [s]."""
    lag: float = number(0.1, "s", low=0.0, high=2.0)
    """First-order time constant of the wheel [s]."""
    e_size: float = number(0.1, "m", above=0.0)
    """e that costs 1 [m]."""
    e_dot_size: float = number(0.5, "m/s", above=0.0)
    """e' that costs 1 [m/s]."""
    step_size: float = number(0.02, "rad", above=0.0)
    """Change of the road-wheel angle in a sample that costs 1 [rad]."""
    dt: float = number(DT, "s", above=0.0)
    """Sample time [s]."""

    @property
    def waiting(self) -> int:
        """Commands to remember: those that act within the delay, one at least."""
        return max(1, int(np.ceil(self.delay / self.dt - 1e-9)))

    def model(self, v: float) -> tuple[Array, Array, Array]:
        """A (n, n), B (n,), D (n,) of x+ = A x + B step + D kappa at speed v, exact for inputs held over dt.

        x = (e, theta, beta, r, delta, commands on their way, oldest first), theta the heading error psi_e:
        e' = v (theta + beta) + reference*r, theta' = r - v kappa, (beta, r)' by `matrices`, delta' = (u - delta)/lag.
        """
        from scipy.linalg import expm

        a, b = (np.array(part, dtype=float) for part in self.matrices(v))
        rate = np.zeros((7, 7))  # e, theta, beta, r, delta, held command, held kappa
        rate[0, 1:4] = v, v, self.reference
        rate[1, 3], rate[1, 6] = 1.0, -v
        rate[2:4, 2:4], rate[2:4, 4] = a, b
        lag = max(self.lag, 1e-3 * self.dt)
        rate[4, 4], rate[4, 5] = -1.0 / lag, 1.0 / lag
        n = self.waiting
        size = _MOTION + n
        whole, change = np.eye(size), np.zeros(size)
        # the oldest command acts until the next one arrives, `early` into the sample
        early = self.delay - (n - 1) * self.dt if self.delay > 0.0 else 0.0
        first, second = expm(rate * early), expm(rate * (self.dt - early))
        whole[:_MOTION, :_MOTION] = (second @ first)[:_MOTION, :_MOTION]
        whole[:_MOTION, _MOTION] = (second @ first)[:_MOTION, 5] - second[:_MOTION, 5]
        late = second[:_MOTION, 5]
        whole[:_MOTION, _MOTION + (n > 1)] += late
        if n == 1:  # the command of this sample: the one before plus the step
            change[:_MOTION] = late
        whole[_MOTION:, _MOTION:] = np.eye(n, k=1)
        whole[-1, -1] = change[-1] = 1.0
        kappa = np.zeros(size)
        kappa[:_MOTION] = (second @ first)[:_MOTION, 6]
        return whole, change, kappa

    def gains(self, v: float, preview: int) -> tuple[Array, Array]:
        """Feedback K (n,) and curvature gains g (preview,): step = -K x - sum_j g_j kappa_j.

        P from the Riccati equation, K = (R + B'P B)^-1 B'P A, F = A - B K, g_j = (R + B'P B)^-1 B'(F')^j P D; the last
        g sums all that follow, as if the curvature stayed: e = 0 in any steady bend, for the model.
        Source: Anderson, Moore 1990, ch. 3; preview: Tomizuka 1975.
        """
        a, b, d = self.model(v)
        out = np.zeros((2, len(b)))
        out[0, 0] = 1.0 / self.e_size
        out[1, 1:4] = np.array((v, v, self.reference)) / self.e_dot_size
        weight = self.step_size**-2
        p = cost_to_go(a, b, out.T @ out, weight)
        share = b / (weight + b @ p @ b)
        k = share @ p @ a
        closed, term = (a - np.outer(b, k)).T, p @ d
        g = np.zeros(preview)
        for j in range(preview - 1):
            g[j] = share @ term
            term = closed @ term
        g[-1] = share @ np.linalg.solve(np.eye(len(b)) - closed, term)
        return k, g


@dataclass(frozen=True, eq=False, kw_only=True)
class Lqr(LimitedLaw):
    """Linear-quadratic regulator with delay states, curvature preview and gains scheduled over speed.

    command = last command - steer_ratio*(K(v) x + sum_j g_j(v) kappa_j),
    x = (e, theta, beta, r, delta, commands on their way),  theta = (e_dot - reference*r)/v - beta,
    kappa_j = preview_j/sqrt(1 - ((reference + l_r) preview_j)^2).

    K and g: see `LqrDesign.gains`, tabled every v_step between v_min and v_max and interpolated. theta is psi_e for
    small angles; taken from e_dot it holds in tight bends too, as does the curvature of the rear axle's circle, and
    delta = tan(road-wheel angle). The command, and how fast it moves, stay within
    max(a_y_max, |kappa_0| v^2 + a_y_reserve) (see `limits`), +-limit and rate_limit.

    Inputs: e [m] and e_dot [m/s] at `reference`; preview [1/m], every dt of driving; v [m/s]; beta [rad]; r [rad/s];
    delta_sw_meas [rad]. Output: delta_sw [rad]. State: the commands on their way [rad], oldest first; one that is not
    finite never left, so the wheel's angle stands in for it. Valid for |e| up to about 1 m: the law is linear, and
    does not limit its approach angle. Speeds outside the table, a standstill or a negative v take its nearest row,
    whose gains fit no much faster car: with one up to 12 m/s it is metres off at 30. NaN in any input gives NaN out.
    Source: Anderson, Moore 1990; Tomizuka 1975; Rajamani 2012, ch. 3.
    """

    e = In("m")
    e_dot = In("m/s")
    preview = In("1/m", size="preview_points")
    v = In("m/s")
    beta = In("rad")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    delta_sw = Out("rad")

    table: Table
    """A row a speed: K, then g."""
    v_min: float = number(unit="m/s", above=0.0)
    """Speed of the first row [m/s]."""
    v_step: float = number(unit="m/s", above=0.0)
    """Speed between rows [m/s]."""
    reference: float
    """Where e and e_dot are measured: metres ahead of the centre of gravity."""
    preview_points: int = number(unit="1", low=1)
    """Curvatures ahead, dt apart."""
    e_reach: Scalar | None = None
    """The car is taken to be at most so far off [m], so that it comes at no steeper an angle; None: no bound."""

    def __post_init__(self) -> None:
        super().__post_init__()
        columns = self.table.rows.shape[1]
        require(self._waiting >= 1, "Lqr", f"table of {columns} columns, expected 5 + commands + preview")

    @classmethod
    def of(
        cls,
        vehicle: Vehicle,
        matrices: Matrices,
        *,
        delay: float = 0.0,
        lag: float = 0.1,
        preview_points: int = 24,
        v_min: float = 1.0,
        v_max: float = 40.0,
        v_step: float = 0.5,
        slew: float | None = None,
        a_y_limit: float | None = None,
        step_of_slew: float = 1.2,
        dt: float = DT,
        **sizes: float,
    ) -> "Lqr":
        """The regulator for a `Vehicle` whose lateral model is `matrices`, e at the front axle.

        delay, lag [s]: of the steering. v_max [m/s]: the fastest speed with gains of its own; it has to be no less
        than what will be driven. slew [m/s^3], a_y_limit [m/s^2]: of a car that is steered by torque; its steps cost
        more, so that a slew which acts is the exception, and e counts up to 0.5 m only; None: without. step_of_slew: a
        step that costs 1, over what the slew allows in one; the smaller, the slower the law. sizes: e_size,
        e_dot_size, step_size of `LqrDesign`.
        """
        geometry = cls.geometry(vehicle, "Lqr.of")
        require(preview_points >= 1, "Lqr", f"preview_points = {preview_points}, expected >= 1")
        require(0.0 < v_min < v_max and v_step > 0.0, "Lqr", f"speeds {v_min} to {v_max} by {v_step} m/s")
        design = LqrDesign(matrices=matrices, reference=vehicle.l_f, delay=delay, lag=lag, dt=dt, **sizes)
        speeds = v_min + v_step * np.arange(round((v_max - v_min) / v_step) + 1)
        rows = []
        for v in speeds.tolist():
            if slew is not None:
                fastest = slew * dt * (vehicle.wheelbase / v**2 + vehicle.understeer_gradient)
                slow = replace(design, step_size=min(design.step_size, step_of_slew * fastest))
            rows.append(np.concatenate((design if slew is None else slow).gains(v, preview_points)))
        return cls(
            table=Table(np.array(rows)),
            v_min=v_min,
            v_step=v_step,
            preview_points=preview_points,
            slew=slew,
            a_y_limit=a_y_limit,
            e_reach=None if slew is None else min(_REACH, _REACH_OF_SLEW * slew),
            **geometry,
            dt=dt,
        )

    @cached_property
    def _waiting(self) -> int:
        return int(self.table.rows.shape[1] - _MOTION - self.preview_points)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),) * self._waiting

    def settle(self, t: float, x: State, u: Any) -> State:
        return (u.delta_sw_meas + 0.0,) * self._waiting

    def output(self, t: Any, x: State, u: Any) -> Any:
        gains = self._gains(u.v)
        slow = m.maximum(u.v, _SLOWEST)
        theta = (u.e_dot - self.reference * u.r) / slow - u.beta
        wheel = [m.tan(angle / self.steer_ratio) for angle in (u.delta_sw_meas, *x)]
        lever = self.reference + self.l_r
        ahead = [kappa / m.sqrt(m.maximum(1.0 - lever * kappa * (lever * kappa), 0.1)) for kappa in u.preview]
        e = u.e if self.e_reach is None else m.clip(u.e, -self.e_reach, self.e_reach)
        step = -sum([g * z for g, z in zip(gains, (e, theta, u.beta, u.r, *wheel, *ahead), strict=True)])
        command = self.steer_ratio * m.atan(wheel[-1] + step)
        return self.Y(limited(self, command, x[-1], slow, m.absolute(ahead[0]) * slow * slow))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (*x[1:], m.where(m.is_finite(y.delta_sw), y.delta_sw, u.delta_sw_meas))

    def _gains(self, v: Scalar) -> list[Scalar]:
        """K and g at speed v, linear between the rows."""
        last = float(len(self.table) - 1)
        z = m.clip((v - self.v_min) / self.v_step, 0.0, last)
        z = m.where(m.is_finite(z), z, 0.0)  # a NaN in v shows in theta
        i = m.minimum(m.floor(z), last - 1.0)
        return [a + (z - i) * (b - a) for a, b in zip(self.table(i), self.table(i + 1.0))]
