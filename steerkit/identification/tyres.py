"""Pacejka tyres of a car from a drive: a nonlinear single track fitted by simulation."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.special import stdtrit

from steerkit._support.errors import known as known_name
from steerkit._support.errors import require, require_within
from steerkit.identification.ahead import arm_of, measured_way
from steerkit.identification.fit import Estimate, Prior
from steerkit.logs.drive import Array, Drive
from steerkit.vehicles import G, Vehicle, vehicle
from steerkit.vehicles.rollout import Rollout

PIECE, PIECES = 2.0, 200
"""Length of the pieces that are simulated, each from a start of its own [s], and how many at most."""
STEP = 0.02
"""Longest integration step [s]: Runge-Kutta is stable with every car from 3 m/s on."""
_FEW, _ITERATIONS, _SETTLED = 40, 30, 0.01  # pieces to come near with; at most; drop of chi^2 at which a fit ends
_LOGS = ("c_", "mu")  # of these the logarithm is fitted
_FINEST = 1e-3  # no signal is better than so much of itself: what the model leaves then is not noise
Slopes = Callable[[Any, Any, Any, Any], tuple[Any, Any]]
"""(v_x, delta, v_y, r) to (v_y', r')."""


def pacejka(alpha: Any, c: Any, peak: Any, shape: Any, curvature: Any) -> Any:
    """Lateral force [N] at slip angle alpha [rad]: D sin(C atan(B alpha - E (B alpha - atan(B alpha)))), B = c/(C D).

    c: cornering stiffness [N/rad]; peak: D = mu F_z [N]; shape: C; curvature: E. Source: Pacejka 2012, section 4.3.
    """
    slip = c / (shape * peak) * alpha
    return peak * np.sin(shape * np.arctan(slip - curvature * (slip - np.arctan(slip))))


def accelerations(base: Vehicle, theta: Mapping[str, Any], v_x: Any, delta: Any, v_y: Any, r: Any) -> tuple[Any, Any]:
    """(v_y', r') of the single track with `pacejka` tyres, loads as at rest; delta: the road wheels' angle [rad].

    m (v_y' + v_x r) = F_f cos(delta) + F_r,  i_z r' = l_f F_f cos(delta) - l_r F_r.
    """
    load_f, load_r = (base.m * G * arm / base.wheelbase for arm in (base.l_r, base.l_f))
    alpha_f, alpha_r = delta - np.arctan2(v_y + base.l_f * r, v_x), -np.arctan2(v_y - base.l_r * r, v_x)
    front = pacejka(alpha_f, theta["c_f"], theta["mu_f"] * load_f, theta["C_f"], theta["E_f"]) * np.cos(delta)
    rear = pacejka(alpha_r, theta["c_r"], theta["mu_r"] * load_r, theta["C_r"], theta["E_r"])
    return (front + rear) / base.m - v_x * r, (base.l_f * front - base.l_r * rear) / base.i_z


def rolled(slopes: Slopes, dt: float, v_x: Any, delta: Any, start: Array) -> Array:
    """(v_y, r) (2, n + 1, ...) by slopes, from the start (2, ...) on; Runge-Kutta.

    v_x, delta: (n + 1, ...), linear between samples.
    """
    parts = math.ceil(dt / STEP - 1e-9)
    h, x, states = dt / parts, start, [start]
    for k in range(len(v_x) - 1):
        for part in range(parts):
            u = [
                (v_x[k] + s * (v_x[k + 1] - v_x[k]), delta[k] + s * (delta[k + 1] - delta[k]))
                for s in np.array([part, part + 0.5, part + 1.0]) / parts
            ]
            k1 = np.array(slopes(*u[0], *x))
            k2 = np.array(slopes(*u[1], *(x + 0.5 * h * k1)))
            k3 = np.array(slopes(*u[1], *(x + 0.5 * h * k2)))
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + np.array(slopes(*u[2], *(x + h * k3))))
        states.append(x)
    return np.stack(states, axis=1)


class Scene(NamedTuple):
    """What a model of tyres needs of a drive."""

    dt: float
    v_x: Array
    """(n,) [m/s]"""
    delta: Array
    """Road wheels' angle as the car has it at each sample: late, its zero corrected (n,) [rad]."""
    motion: Array
    """v_y of the centre of gravity, where no log says it the steady one, NaN where it is not known, and r (2, n)."""
    arm: float
    """How far ahead of the centre of gravity v_y was measured [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Tyres:
    """The outcome of `identify_tyres`."""

    vehicle: Vehicle
    """The base with steering ratio, stiffnesses and the lower of the two mu as found, where the log determines them."""
    theta: dict[str, float]
    """Of the model: c, mu, C, E of each axle (`c_f`), and of the log steer_ratio, offset, delay, rate_zero, arm [m] by
    which v_y was measured ahead of the centre of gravity, and slip_zero [rad], v_y/v_x where there is none."""
    estimates: tuple[Estimate, ...]
    drive: Drive
    notes: tuple[str, ...]
    """What this log cannot determine, in words."""

    def __getitem__(self, name: str) -> Estimate:
        by_name = {estimate.name: estimate for estimate in self.estimates}
        return by_name[known_name(name, by_name, "estimate")]

    def scene(self, drive: Drive) -> Scene:
        """Any drive of this car. By position v_y is measured where its steady part fits on average, as `look_ahead`."""
        rate = drive.r - (0.0 if drive.calibrated else self.theta["rate_zero"])
        v_y = measured_way(drive, rate)[2]
        slides = self.vehicle.l_r - Rollout.of(self.vehicle).rear_slip * drive.v**2
        side, arm = slides * rate if v_y is None else v_y, 0.0
        if v_y is not None and drive.v_y is None:
            arm = arm_of(drive, rate, v_y - slides * rate)
        v_x = forward(drive, v_y)
        return Scene(drive.dt, v_x, _delta(drive, self.theta), np.stack((side - arm * rate, rate)), arm)

    def ahead(self, scene: Scene, starts: NDArray[np.intp], n: int) -> Array:
        """(v_y, r) (2, n + 1, N) from the measured starts on, v_x staying what it is."""
        slopes = partial(accelerations, self.vehicle, self.theta)
        at = starts + np.arange(n + 1)[:, None]
        v_x = np.broadcast_to(scene.v_x[starts], at.shape)
        return rolled(slopes, scene.dt, v_x, scene.delta[at], scene.motion[:, starts])


def identify_tyres(drive: Drive, base: Vehicle | None = None, *, fixed: Mapping[str, float] | None = None) -> Tyres:
    """Pacejka tyres and steering of a car from 20 s of driving or more, with 95 % intervals.

    The drive is cut into pieces of 2 s; each is simulated from a start of its own, v_y and r, which is found too:

        minimise  sum_k ((v_y - v_y(t_k; theta))/sigma_v)^2 + ((r - r(t_k; theta))/sigma_r)^2 + priors,

    by Levenberg-Marquardt, sigma from what is left, its correlation allowed for. The model is that of
    `accelerations`; measured are v_y + arm r + slip_zero v_x and r + rate_zero. So noise in v_y and r biases nothing,
    which it does where forces are computed from them. Intervals: the larger of the model's covariance and the sandwich
    over pieces.

    base: mass, inertia, geometry as given (default: vw-passat). v_y is the log's, or by position and
    heading; without either the yaw rate tells alone. fixed: parameters to hold, in SI. A mu of which the log tells
    less than half is NaN: "not determined". Raises ValueError for a drive that is too short or straight.

    Source: Bock 1983 (multiple shooting); Ljung 1999, section 7.2; Pacejka 2012, section 4.3.
    """
    base = base or vehicle("vw-passat")
    for name in ("delta_sw", "v", "r"):
        lost = int(np.sum(~np.isfinite(getattr(drive, name))))
        require(lost == 0, drive.name, f"{name} is not finite in {lost} samples; Drive.of leaves them out")
    require(drive.turns, drive.name, "it hardly turns: a drive straight on determines nothing of the tyres; add bends")
    v_y = measured_way(drive, drive.r)[2]
    table = priors(base, drive, v_y)
    for name, value in (fixed or {}).items():
        known_name(name, table, "parameter of identify_tyres")
        kept = math.log(value) if name[:2] in _LOGS else value
        require_within(
            "identify_tyres",
            name,
            value,
            table[name].unit,
            *_named({name: np.array([table[name].low, table[name].high])})[name],
        )
        table[name] = replace(table[name], mean=kept, deviation=0.0)
    # before it fits, errors go together, and would count for nothing; few pieces are enough to come near
    few = _Pieces(drive, base, table, v_y, _FEW)
    near, _ = few.solve(few.mean, correlated=False)
    pieces = _Pieces(drive, base, table, v_y, PIECES)
    x, covariances = pieces.solve(near, correlated=True)
    theta = {name: float(value) for name, value in pieces.named(x).items()}
    factor = float(stdtrit(pieces.at.shape[1] - 1, 0.975))
    deviations = np.sqrt(np.maximum(*map(np.diag, covariances)))
    used = float(np.quantile(np.abs(pieces.v_x * pieces.measured[1]), 0.99)) / G
    rows, unknown = [], []
    for name, at, deviation, prior in zip(pieces.free, x, deviations, pieces.deviation):
        span = np.clip(at + factor * deviation * np.array([0.0, -1.0, 1.0]), table[name].low, table[name].high)
        ends = _named({name: span})[name]
        learned, note = max(0.0, 1.0 - float(deviation / prior) ** 2), ""
        if name[:3] == "mu_":
            note = f"the log used {used:.2f}"
            if learned < 0.5:
                ends, note = np.full(3, np.nan), f"not determined: {note}, hardly beyond the linear range"
                unknown.append(name)
        value, low, high = map(float, ends)
        rows.append(Estimate(name, value, low, high, table[name].unit, learned, note))
    notes = [f"{', '.join(unknown)}: not determined, slip stays in the tyres' linear range; drive harder"] * bool(
        unknown
    )
    if v_y is None:
        notes.append("v_y is not in the log: front and rear are told apart by the yaw rate alone")
    grips = [theta[name] for name in ("mu_f", "mu_r") if name not in unknown]
    found = {name: theta[name] for name in ("steer_ratio", "c_f", "c_r")} | ({"mu": min(grips)} if grips else {})
    car = replace(base, name=f"{base.name}-identified", **found)
    return Tyres(vehicle=car, theta=theta, estimates=tuple(rows), drive=drive, notes=tuple(notes))


def priors(base: Vehicle, drive: Drive, v_y: Array | None) -> dict[str, Prior]:
    """Weak beliefs around a base car, of c and mu about their logarithm; a deviation of 0 holds a parameter.

    c +- 0.5, mu +- 0.3 (of the logarithm); C 1.4 +- 0.2; E -0.5 +- 1; ratio +- 30 %; offset 0 +- 0.1 rad; delay
    0.05 +- 0.1 s; rate_zero as in `identify`; arm +- l_r where v_y is not the log's own; slip_zero +- 0.02 rad.
    """
    table = {}
    for axle, c, arm in (("f", base.c_f, base.l_r), ("r", base.c_r, base.l_f)):
        load = float(base.m * G * arm / base.wheelbase)
        table[f"c_{axle}"] = Prior(math.log(c), 0.5, math.log(2.01 * load), math.log(99.0 * load), "N/rad")
        table[f"mu_{axle}"] = Prior(math.log(base.mu), 0.3, math.log(0.05), math.log(3.0), "1")
        table[f"C_{axle}"] = Prior(1.4, 0.2, 1.0, 2.0, "1")
        table[f"E_{axle}"] = Prior(-0.5, 1.0, -5.0, 0.99, "1")
    ratio = float(base.steer_ratio)
    table["steer_ratio"] = Prior(ratio, 0.3 * ratio, max(1.0, 0.3 * ratio), min(50.0, 3.0 * ratio), "1")
    table["offset"] = Prior(0.0, 0.1, -1.0, 1.0, "rad")
    table["delay"] = Prior(0.05, 0.1, -0.5, 1.0, "s")
    table["rate_zero"] = Prior(0.0, 0.0 if drive.calibrated else 0.005, -0.1, 0.1, "rad/s")
    table["arm"] = Prior(0.0, 0.0 if v_y is None or v_y is drive.v_y else float(base.l_r), -5.0, 5.0, "m")
    table["slip_zero"] = Prior(0.0, 0.0 if v_y is None else 0.02, -0.2, 0.2, "rad")
    return table


def _named(x: Mapping[str, Any]) -> dict[str, Any]:
    return {name: np.exp(value) if name[:2] in _LOGS else value for name, value in x.items()}


def _delta(drive: Drive, theta: Mapping[str, Any]) -> Array:
    """Road wheels' angle as the car has it at each sample (n,) [rad]: late, its zero corrected."""
    return (np.interp(drive.t - theta["delay"], drive.t, drive.delta_sw) + theta["offset"]) / theta["steer_ratio"]


def forward(drive: Drive, v_y: Array | None) -> Array:
    """v_x (n,) [m/s]: what v_y leaves of the speed, mean over 0.1 s."""
    side = np.zeros(len(drive.v)) if v_y is None else np.nan_to_num(v_y)
    return uniform_filter1d(np.sqrt(np.maximum(drive.v**2 - side**2, 0.0)), max(1, round(0.1 / drive.dt)))


class _Pieces:
    """The drive cut into pieces, their residuals for parameters and starts, and the fit."""

    def __init__(self, drive: Drive, base: Vehicle, table: Mapping[str, Prior], v_y: Array | None, most: int):
        self.drive, self.base, self.table = drive, base, table
        n = round(PIECE / drive.dt)
        free = np.convolve(drive.driving, np.ones(n + 1), mode="valid") > n + 0.5
        starts, at = list[int](), 0
        while at < len(free):
            at = at + int(np.argmax(free[at:]))
            if not free[at]:
                break
            starts.append(at)
            at += n
        require(
            len(starts) >= 10,
            drive.name,
            f"{len(starts) * PIECE:g} s in pieces of {PIECE:g} s at 3 m/s or faster, expected 20 s or more",
        )
        starts = [starts[i] for i in np.linspace(0, len(starts) - 1, min(most, len(starts))).round().astype(int)]
        self.at = np.array(starts) + np.arange(n + 1)[:, None]
        seen = np.full(len(drive.v), np.nan) if v_y is None else v_y
        self.v_x = forward(drive, v_y)[self.at]
        self.measured = np.stack((seen[self.at], drive.r[self.at]))  # (2, n + 1, N)
        self.known = np.isfinite(self.measured)
        self.measured[~self.known] = 0.0
        self.free = [name for name, prior in table.items() if prior.deviation > 0.0]
        self.mean, self.deviation, self.low, self.high = (
            np.array([getattr(table[name], key) for name in self.free]) for key in ("mean", "deviation", "low", "high")
        )

    def named(self, x: Array) -> dict[str, Any]:
        """Values by name, from coordinates (p, ...) of those that are free."""
        theta: dict[str, Any] = {name: prior.mean for name, prior in self.table.items()}
        return _named(theta | dict(zip(self.free, x)))

    def errors(self, x: Array, starts: Array) -> Array:
        """Measured less simulated (2, n + 1, N, M) for coordinates (p, M) and starts (2, N, M)."""
        theta = self.named(x)
        delta = np.stack([_delta(self.drive, self.named(one))[self.at] for one in x.T], axis=-1)
        slopes = partial(accelerations, self.base, theta)
        way = rolled(slopes, self.drive.dt, self.v_x[..., None], delta, starts)
        said = np.stack(
            (way[0] + theta["arm"] * way[1] + theta["slip_zero"] * self.v_x[..., None], way[1] + theta["rate_zero"])
        )
        return np.where(self.known[..., None], self.measured[..., None] - said, 0.0)

    def linearised(self, x: Array, starts: Array) -> tuple[Array, Array, Array]:
        """Errors (N, m), and their slopes in the coordinates (N, m, p) and in the starts (N, m, 2)."""
        p, step = len(x), 1e-4
        points = np.repeat(x[:, None], p + 3, axis=1)
        points[:, 1 : p + 1] += np.diag(step * self.deviation)
        begun = np.repeat(starts[..., None], p + 3, axis=-1)
        begun[0, :, p + 1] += step
        begun[1, :, p + 2] += step
        error = self.errors(points, begun)
        slopes = (error[..., 1:] - error[..., :1]) / np.append(step * self.deviation, (step, step))
        flat = [np.moveaxis(a, 2, 0).reshape(self.at.shape[1], -1, a.shape[-1]) for a in (error[..., :1], slopes)]
        return flat[0][..., 0], flat[1][..., :p], flat[1][..., p:]

    def scales(self, error: Array, correlated: bool) -> Array:
        """Standard deviation of each row (m,), by signal; with the errors' correlation in time allowed for, or not."""
        rows = error.reshape(len(error), 2, -1)
        out = []
        for some, signal, known in zip(np.moveaxis(rows, 1, 0), self.measured, self.known):
            deviation = math.sqrt(float(np.sum(some**2)) / max(int(known.sum()), 1))
            spectrum = np.abs(np.fft.rfft(some, 2 * some.shape[1], axis=1)) ** 2
            rho = np.fft.irfft(spectrum.sum(axis=0))[: some.shape[1]]
            rho /= max(rho[0], 1e-300)
            end = int(np.argmax(rho <= 0.05)) or len(rho)
            samples = max(1.0, 2.0 * float(rho[:end].sum()) - 1.0) if correlated else 1.0
            out.append(max(deviation, _FINEST * float(np.std(signal)), 1e-9) * math.sqrt(samples))
        return np.repeat(out, rows.shape[2])

    def solve(self, x: Array, *, correlated: bool) -> tuple[Array, tuple[Array, Array]]:
        """Coordinates (p,), two covariances (p, p): Levenberg-Marquardt from x, the starts projected out."""
        starts, damping = self.measured[:, 0].copy(), 1e-2
        for _ in range(_ITERATIONS):
            error, slopes, begun = self.linearised(x, starts)
            sigma = self.scales(error, correlated)
            error, slopes, begun = error / sigma, slopes / sigma[:, None], begun / sigma[:, None]
            q = np.linalg.qr(begun)[0]
            e, j = ((a - q @ (np.swapaxes(q, 1, 2) @ a)) for a in (error[..., None], slopes))
            pull = (x - self.mean) / self.deviation
            bread = np.einsum("nmi,nmj->ij", j, j) + np.diag(self.deviation**-2.0)
            score = np.einsum("nmi,nm->i", j, e[..., 0]) + pull / self.deviation
            for _ in range(8):
                step = -np.linalg.solve(bread + damping * np.diag(np.diag(bread)), score)
                step = np.clip(x + np.clip(step, -self.deviation, self.deviation), self.low, self.high) - x
                shift = -np.einsum("nij,nj->in", np.linalg.pinv(begun), error + slopes @ step)
                tried = self.errors((x + step)[:, None], (starts + shift)[..., None])
                tried = np.moveaxis(tried, 2, 0).reshape(error.shape) / sigma
                after = (x + step - self.mean) / self.deviation
                better = bool(np.sum(tried**2) + after @ after <= np.sum(error**2) + pull @ pull)
                damping = max(damping / 5.0, 1e-6) if better else min(6.0 * damping, 1e6)
                if better:
                    x, starts = x + step, starts + shift
                    break
            if not better or -score @ step < _SETTLED:
                break
        scores = np.einsum("nmi,nm->ni", j, e[..., 0])
        inverse = np.linalg.inv(bread)
        meat = scores.T @ scores + np.diag(self.deviation**-2.0)
        return x, (inverse, inverse @ meat @ inverse)
