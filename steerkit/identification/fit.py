"""From a drive to a car: least squares of the yaw rate, intervals for correlated errors, and what was found.

That is: estimates, the car they make, and how well it predicts a drive.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from steerkit._support.errors import known as known_name
from steerkit._support.errors import require, require_within
from steerkit._support.files import write_text
from steerkit.compiled import compile
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Scalar
from steerkit.diagram.simulation import Log
from steerkit.estimators.estimate import NORMAL_95
from steerkit.logs.drive import Array, Drive
from steerkit.metrics import rms
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import Playback
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.plots.style import COLOURS, new_figure, style
from steerkit.vehicles import G, Vehicle, vehicle, vehicle_text

BLOCK, BLOCKS = 2.0, 8
"""Length of the blocks, in times after which the residual's autocorrelation has died out; and how many at least."""
THIRDS, CONTRADICTION = 3, 5.99
"""Stretches of the log that must agree, and the 95 % point of chi^2 for what they differ by."""
BANK = 0.02
"""Standard deviation of a road's mean bank, of which a log says nothing [rad]."""
REZERO = 15.0
"""Driving from which the wheel's zero is found again, in the second figure of a prediction [s]."""
OPEN = {
    "steer_ratio": "car.vehicle.steer_ratio",
    "delay": "drive.delay",
    "lag": "actuator.lag",
    "offset": "actuator.offset",
}
"""Parameters that are fields of blocks."""
SLOW_ENOUGH = 0.01  # [s], a step at which every car within the bounds is integrated stably
_PAUSE = 0.04  # share of the axis between the fitted and the held-out drive


def stiffnesses(base: Vehicle, d_f: Scalar, d_r: Scalar) -> tuple[Scalar, Scalar]:
    """(c_f, c_r) [N/rad] of cornering compliances d_f, d_r [rad s^2/m]: c_f = m l_r/(L d_f), c_r = m l_f/(L d_r).

    A compliance is the slip angle of an axle per lateral acceleration, and K = d_f - d_r.
    Source: Bundorf, Leffert 1976 (in degrees per g).
    """
    per = base.m / base.wheelbase
    return per * base.l_r / d_f, per * base.l_f / d_r


class Simulator:
    """Yaw rates of the model for a drive's steering and speed; compiled once, then run for any parameters.

    The delay is that of continuous time: what the sampled loop adds by holding its signals is taken off.
    steering and speed: recorded; model: `Playback`, `SteeringActuator`, `LinearSingleTrack`.
    """

    def __init__(self, drive: Drive, base: Vehicle):
        self.drive, self.base = drive, base
        play = Playback(angles=tuple(drive.delta_sw.tolist()), speeds=tuple(drive.v.tolist()), dt=drive.dt)
        # the wheel may turn as fast as it was recorded to turn: no rate limit acts
        actuator = SteeringActuator(limit=30.0, rate_limit=200.0, dt=drive.dt)
        substeps = math.ceil(drive.dt / SLOW_ENOUGH - 1e-9)
        car = LinearSingleTrack(vehicle=base, dt=drive.dt, substeps=substeps, v0=float(drive.v[0]))
        loop = Loop(
            blocks={"drive": play, "actuator": actuator, "car": car},
            wires=[(play.delta_sw, actuator.delta_sw_cmd), (actuator.delta_sw, car.delta_sw_cmd), (play.v, car.v_cmd)],
        )
        names = (*OPEN.values(), "car.vehicle.c_f", "car.vehicle.c_r")
        self._compiled = compile(loop, record=["car.r", "actuator.delta_sw"], parameters=names)

    def yaw_rates(self, sets: list[dict[str, float]]) -> Array:
        """Yaw rate (n, len(sets)) [rad/s] for each set of steer_ratio, delay, lag, offset, d_f, d_r."""
        return self._run(sets)["car.r"]

    def wheel(self, theta: dict[str, float]) -> Array:
        """Steering-wheel angle as the car has it from each sample to the next (n,) [rad]: late, its zero corrected."""
        return self._run([theta])["actuator.delta_sw"][:, 0]

    def _run(self, sets: list[dict[str, float]]) -> Log:
        each = {name: np.array([one[name] for one in sets]) for name in sets[0]}
        c_f, c_r = stiffnesses(self.base, each["d_f"], each["d_r"])
        values = {field: each[name] for name, field in OPEN.items()}
        values["drive.delay"] = each["delay"] - self.drive.dt  # actuator and car hold their inputs: dt/2 late each
        values |= {"car.vehicle.c_f": c_f, "car.vehicle.c_r": c_r}
        return self._compiled.run(len(self.drive.v) * self.drive.dt, parameters=values)


@dataclass(frozen=True)
class Estimate:
    """A parameter with its 95 % interval and its source: the log, the prior, or both."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    learned: float
    """Share of the prior's variance that the log took away, 0 to 1; NaN for a parameter that was given."""
    note: str = ""
    steady: bool = True
    """Do the log's thirds agree on it?"""

    @property
    def source(self) -> str:
        """`log` (9/10 of the prior's variance is gone), `log and prior` (1/2, or what no log tells makes most of the
        rest), `prior`, `given`; or `unsteady`: thirds of the log contradict each other, by what is not in the model."""
        if math.isnan(self.learned):
            return "given"
        if not self.steady:
            return "unsteady"
        return "log" if self.learned > 0.9 else "log and prior" if self.learned > 0.5 else "prior"


def intervals(estimates: Iterable[Estimate]) -> dict[str, dict[str, Any]]:
    """Value, 95 % interval, unit and source of each by name; None for a number that was not determined."""
    keys = ("value", "low", "high", "unit", "source")
    return {e.name: {key: None if (x := getattr(e, key)) != x else x for key in keys} for e in estimates}


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """A drive's yaw rate as the identified car has it, next to the measured one."""

    drive: Drive
    r: Array
    """Predicted yaw rate (n,) [rad/s]."""
    rms: float
    """Root mean square of measured minus predicted, all recorded samples [rad/s]."""
    rms_driving: float
    """The same at 3 m/s and above [rad/s]."""
    mean_driving: float
    """Mean of measured minus predicted at 3 m/s and above [rad/s]."""
    rms_rezeroed: float
    """With the wheel's zero found again on the first 15 s of driving, and judged on the rest [rad/s]."""
    zero_shift: float
    """By how much that zero differs, at the steering wheel [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Identified:
    """The outcome of `identify`."""

    vehicle: Vehicle
    """The car: the base's mass, inertia and geometry, with steering ratio and cornering stiffnesses as found."""
    estimates: tuple[Estimate, ...]
    drive: Drive
    base: Vehicle
    theta: dict[str, float]
    """Of the model: among them the pure delay from steering wheel to road wheels and the first-order lag after it [s],
    the offset, which must be added to the recorded angle [rad], and rate_zero, that of the yaw rate [rad/s]."""
    covariance: Array
    """Of the free parameters, in the order of `free`."""
    free: tuple[str, ...]
    fit: Prediction
    correlation_time: float
    """Integrated correlation time of the residual [s]; the log counts as so many independent samples fewer."""
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Estimate:
        by_name = {estimate.name: estimate for estimate in self.estimates}
        return by_name[known_name(name, by_name, "estimate")]

    def predict(self, drive: Drive) -> Prediction:
        """Another drive of the same car, from its steering and speed alone."""
        return predict(Simulator(drive, self.base), self.theta)

    def text(self, *, command: str = "", held_out: Prediction | None = None) -> str:
        """The vehicle file: TOML with the car, its steering, the intervals and where they come from."""
        provenance: dict[str, Any] = {
            "log": self.drive.name,
            "sha256": self.drive.digest,
            "seconds": round(len(self.drive.v) * self.drive.dt, 3),
            "repairs": list(self.drive.notes),
            "notes": list(self.notes),
            "base": f"{self.base.name}: m, i_z, l_f, l_r, mu are given, not identified",
            "fit_rms": round(self.fit.rms, 6),
        }
        if held_out is not None:
            provenance |= {
                "held_out": held_out.drive.name,
                "held_out_sha256": held_out.drive.digest,
                "held_out_rms": round(held_out.rms, 6),
            }
        provenance |= {"command": command} if command else {}
        steering = {name: self.theta[name] for name in ("delay", "lag", "offset")}
        return vehicle_text(self.vehicle, steering=steering, estimates=intervals(self.estimates), provenance=provenance)

    def save(self, file: str | Path, *, command: str = "", held_out: Prediction | None = None) -> None:
        """Write the vehicle file; `vehicle(file)` and `steering_of(file)` read it."""
        require(str(file).endswith(".toml"), "Identified.save", f"{file}: a vehicle file ends in .toml")
        write_text(file, self.text(command=command, held_out=held_out))

    def against(self, other: "Identified") -> str:
        """Whether another drive of the same car agrees: ratio, understeer gradient and delay, by their intervals."""
        apart = []
        for name in ("ratio_wheelbase", "understeer_gradient", "delay_lag"):
            one, two = self[name], other[name]
            if abs(one.value - two.value) > math.hypot(one.high - one.low, two.high - two.low) / 2.0:
                spans = (f"{e.value:.4g} [{e.low:.4g}, {e.high:.4g}]" for e in (one, two))
                apart.append(f"{name} is {' and '.join(spans)} {one.unit}")
        if apart:
            return f"The two drives contradict each other: {'; '.join(apart)}: banked, or another load or car?"
        return "The two drives agree in ratio, understeer gradient and delay, within their intervals."

    def plot(self, held_out: Prediction | None = None) -> Any:
        """Yaw rate, residual and speed over time, the held-out drive after the fitted one: a matplotlib figure."""
        parts = [(self.fit, "fitted", COLOURS["learned"])]
        if held_out is not None:
            parts.append((held_out, "held out", COLOURS["analytic"]))
        pause = _PAUSE * sum(part.drive.t[-1] for part, _, _ in parts)
        with style():
            title = f"{self.vehicle.name}: yaw rate from steering wheel and speed alone"
            figure, (rate, left, speed) = new_figure(3, title=title)
            start = 0.0
            for part, word, colour in parts:
                drive = part.drive
                t = start + drive.t
                hidden = ~drive.measured
                measured, error = np.where(hidden, np.nan, drive.r), np.where(hidden, np.nan, drive.r - part.r)
                rate.plot(t, measured, color=COLOURS["muted"], lw=2.2, alpha=0.7, label=None if start else "measured")
                rate.plot(t, part.r, color=colour, lw=0.8, label=f"predicted, {word}")
                left.plot(t, 1e3 * error, color=colour, lw=0.6, label=f"{word}: RMS {1e3 * part.rms:.2f} mrad/s")
                speed.plot(t, drive.v, color=colour, lw=1.0)
                start = t[-1] + pause
            if held_out is not None:
                again = f"zero of the wheel found again: {1e3 * held_out.rms_rezeroed:.2f} mrad/s"
                left.plot([], [], " ", label=again)
            left.axhline(0.0, color=COLOURS["ink"], lw=0.6)
            rate.set_ylabel("yaw rate [rad/s]")
            left.set_ylabel("measured - predicted\n[mrad/s]")
            speed.set(ylabel="speed [m/s]", xlabel="t [s], one drive after the other" if held_out else "t [s]")
            speed.set_ylim(bottom=0.0)
            for axis in (rate, left):
                axis.legend(loc="lower right", ncols=3, fontsize=7, handlelength=1.2, columnspacing=1.2)
                low, high = axis.get_ylim()
                axis.set_ylim(low - 0.22 * (high - low), high)
            rate.margins(x=0.01)
            return figure


def predict(simulator: Simulator, theta: dict[str, float]) -> Prediction:
    """The drive of a simulator with parameters theta."""
    drive, step = simulator.drive, 1e-3
    rates = simulator.yaw_rates([theta, theta | {"offset": theta["offset"] + step}])
    zero = 0.0 if drive.calibrated else theta["rate_zero"]
    predicted = rates[:, 0] + zero
    error = drive.r - predicted
    use = np.flatnonzero(drive.driving)
    slope = (rates[:, 1] - rates[:, 0]) / step
    first, later = np.split(use, [min(len(use) // 2, round(REZERO / drive.dt))])
    shift = float(slope[first] @ error[first] / (slope[first] @ slope[first]))
    return Prediction(
        drive=drive,
        r=predicted,
        rms=rms(error[drive.measured]),
        rms_driving=rms(error[use]),
        mean_driving=float(np.mean(error[use])),
        rms_rezeroed=rms((error - shift * slope)[later]),
        zero_shift=shift,
    )


@dataclass(frozen=True)
class Prior:
    """What is known of a parameter beforehand: normal, within bounds."""

    mean: float
    deviation: float
    low: float
    high: float
    unit: str


def priors(base: Vehicle) -> dict[str, Prior]:
    """Weak beliefs around a base car; they only matter for what a log does not show.

    steer_ratio +- 5; offset 0 +- 0.1 rad (6 degrees at the wheel); delay and lag 0.05 +- 0.05 s; the cornering
    compliances +- 50 %; the zero of a yaw rate that has no heading beside it +- 0.005 rad/s.
    """
    per = base.m / base.wheelbase
    d_f, d_r = per * base.l_r / base.c_f, per * base.l_f / base.c_r
    return {
        "steer_ratio": Prior(base.steer_ratio, 5.0, 1.0, 50.0, "1"),
        "offset": Prior(0.0, 0.1, -1.0, 1.0, "rad"),
        "delay": Prior(0.05, 0.05, -0.5, 1.0, "s"),
        "lag": Prior(0.05, 0.05, 0.0, 1.0, "s"),
        "d_f": Prior(d_f, 0.5 * d_f, 0.002, 0.05, "rad s^2/m"),
        "d_r": Prior(d_r, 0.5 * d_r, 0.002, 0.05, "rad s^2/m"),
        "rate_zero": Prior(0.0, 0.005, -0.1, 0.1, "rad/s"),
    }


def identify(
    drive: Drive,
    base: Vehicle | None = None,
    *,
    fixed: Mapping[str, float] | None = None,
    known: Mapping[str, tuple[float, float]] | None = None,
    name: str = "",
) -> Identified:
    """The linear single track's parameters from a drive.

    minimise  sum_k ((r_k - r(t_k; theta))/sigma)^2 + sum_i ((theta_i - prior mean_i)/prior deviation_i)^2,

    r(t; theta) simulated from the recorded steering and speed through `SteeringActuator` and `LinearSingleTrack`,
    theta = steer_ratio, offset, delay, lag, cornering compliances d_f and d_r (K = d_f - d_r), and the yaw rate's
    zero where no heading gives it. sigma^2 is the residual's variance times its integrated correlation time in
    samples, found by repetition. The covariance is the sandwich H^-1 S H^-1, H = J'J/sigma^2 + P, S from sums of the
    scores over blocks longer than that correlation, or from the residual's autocorrelation, whichever says more;
    intervals are 95 % of Student's t with (blocks - 1) degrees.

    base: the car whose mass, inertia and geometry are taken as given (default: vw-passat): the yaw rate determines
    ratio times wheelbase and stiffness over mass, never the two apart. fixed: parameters to hold. known: (mean,
    deviation) to replace a prior. Raises ValueError for an unknown name or a number out of bounds.

    Source: Ljung 1999, sections 7.2 (output error) and 9.4; White 1982 (sandwich).
    """
    base = base or vehicle("vw-passat")
    require(drive.turns, drive.name, "it hardly turns: a drive straight on determines nothing of the car; add bends")
    table = _believed(base, known or {}, fixed or {}, drive)
    problem = _Problem(Simulator(drive, base), table)
    theta, sigma, correlation = problem.solve()
    covariances, blocks, parts = problem.covariance(theta, sigma)
    values = problem.held | dict(zip(problem.free, theta.tolist()))
    estimates = problem.estimates(values, covariances, blocks, parts)
    c_f, c_r = map(float, stiffnesses(base, values["d_f"], values["d_r"]))
    found = {"name": name or f"{base.name}-identified", "steer_ratio": values["steer_ratio"], "c_f": c_f, "c_r": c_r}
    return Identified(
        vehicle=replace(base, **found),
        estimates=estimates,
        drive=drive,
        base=base,
        theta=values,
        covariance=covariances[1],
        free=problem.free,
        fit=predict(problem.simulator, values),
        correlation_time=correlation,
        notes=problem.notes(values, covariances[1], estimates),
    )


def _believed(
    base: Vehicle, known: Mapping[str, tuple[float, float]], fixed: Mapping[str, float], drive: Drive
) -> dict[str, Prior]:
    table = priors(base)
    if drive.calibrated:
        table["rate_zero"] = replace(table["rate_zero"], deviation=0.0)
    for key, (mean, deviation) in {**known, **{n: (v, 0.0) for n, v in fixed.items()}}.items():
        require(key in table, "identify", f"'{key}' is no parameter; valid: {', '.join(table)}")
        p = table[key]
        require_within("identify", key, mean, p.unit, p.low, p.high)
        require(deviation >= 0.0, "identify", f"{key}: standard deviation {deviation}, expected >= 0; 0 holds it")
        table[key] = replace(p, mean=mean, deviation=deviation)
    return table


class _Problem:
    """Residuals, their Jacobian, the solution, its covariance, what they say; a deviation of 0 holds a parameter."""

    def __init__(self, simulator: Simulator, table: dict[str, Prior]):
        self.simulator, self.table = simulator, table
        self.held = {n: p.mean for n, p in table.items() if p.deviation == 0.0}
        self.free = free = tuple(n for n in table if n not in self.held)
        require(free, "identify", "nothing is left to identify: all parameters are fixed")
        chosen = [table[n] for n in free]
        self.mean, self.deviation = (np.array([getattr(p, k) for p in chosen]) for k in ("mean", "deviation"))
        self.low, self.high = (np.array([getattr(p, k) for p in chosen]) for k in ("low", "high"))
        self.use = np.flatnonzero(simulator.drive.driving)
        self._last: tuple[bytes, Array, Array] | None = None

    def linearised(self, theta: Array) -> tuple[Array, Array]:
        """Residual (n,) and its Jacobian (n, p), by central differences, all in one batch of cars."""
        key = theta.tobytes()
        if self._last is None or self._last[0] != key:
            reach = 1e-3 * np.minimum(self.deviation, 0.1 * np.maximum(np.abs(self.mean), self.deviation))
            up, down = np.minimum(theta + reach, self.high), np.maximum(theta - reach, self.low)
            points = [theta]
            for i in range(len(theta)):
                for end in (up, down):
                    points.append(np.where(np.arange(len(theta)) == i, end, theta))
            sets = [self.held | dict(zip(self.free, point.tolist())) for point in points]
            rates = self.simulator.yaw_rates(sets) + np.array([values["rate_zero"] for values in sets])
            rates = rates[self.use]
            slopes = (rates[:, 1::2] - rates[:, 2::2]) / (up - down)
            self._last = key, self.simulator.drive.r[self.use] - rates[:, 0], -slopes
        return self._last[1], self._last[2]

    def solve(self) -> tuple[Array, float, float]:
        """(theta, sigma with correlation allowed for, correlation time [s])."""
        theta, sigma, correlation = np.clip(self.mean, self.low, self.high), 0.01, 0.0
        dt = self.simulator.drive.dt
        for _ in range(6):
            weight, before = 1.0 / sigma, sigma

            def fun(x: Array, weight: float = weight) -> Array:
                return np.concatenate((self.linearised(x)[0] * weight, (x - self.mean) / self.deviation))

            def jac(x: Array, weight: float = weight) -> Array:
                return np.vstack((self.linearised(x)[1] * weight, np.diag(1.0 / self.deviation)))

            solution = least_squares(
                fun, theta, jac, bounds=(self.low, self.high), x_scale=self.deviation, xtol=1e-9, ftol=1e-9
            )
            theta = solution.x
            error = self.linearised(theta)[0]
            correlation = dt * (2.0 * float(np.sum(self._autocorrelation(error))) - 1.0)
            sigma = max(rms(error), 1e-7) * math.sqrt(correlation / dt)
            if abs(sigma / before - 1.0) < 0.02:
                break
        return theta, sigma, correlation

    def _autocorrelation(self, error: Array) -> Array:
        """Of the residual by lag in samples, until it has died out, below 0.05; gaps count for nothing."""
        drive = self.simulator.drive
        full, mask = np.zeros(len(drive.v)), np.zeros(len(drive.v))
        full[self.use], mask[self.use] = error, 1.0
        size = 2 * len(full)  # by FFT in NumPy: SciPy's signal package takes a third of a second to load
        products, counts = (np.fft.irfft(np.abs(np.fft.rfft(a, size)) ** 2)[: len(full) // 2] for a in (full, mask))
        rho = products / np.maximum(counts, 1.0) / max(products[0] / counts[0], 1e-300)
        return rho[: int(np.argmax(rho <= 0.05)) or len(rho)]

    def covariance(self, theta: Array, sigma: float) -> tuple[tuple[Array, Array], int, list[tuple[Array, Array]]]:
        """(Two sandwich covariances (p, p), number of blocks, by how much each third moves theta and its covariance).

        The first has the sums of the scores over blocks, whatever errors go with; the second the residual's variance
        and autocorrelation, whose slow part blocks cut off: var(J'e) = sum_kl J_k J_l rho_|k-l| var(e).
        """
        error, slopes = self.linearised(theta)
        for i in np.flatnonzero((theta <= self.low) | (theta >= self.high)):
            # at a bound the tangent may be flat (a lag of 0): the secant to half a prior deviation inside shows more
            inside = np.where(
                np.arange(len(theta)) == i, theta + 0.5 * self.deviation * np.sign(self.mean - theta), theta
            )
            slopes = slopes.copy()
            slopes[:, i] = (self.linearised(inside)[0] - error) / (inside[i] - theta[i])
        prior = np.diag(self.deviation**-2.0)
        bread = np.linalg.inv(slopes.T @ slopes / sigma**2 + prior)
        dt, n = self.simulator.drive.dt, len(self.use)
        rho = self._autocorrelation(error)
        length = int(min(max(1.0, BLOCK * dt * len(rho)) / dt, n / BLOCKS))
        scores = np.add.reduceat(slopes * error[:, None] / sigma**2, length * np.arange(n // length))
        blocks = len(scores)
        sums, squares = scores.sum(axis=0), np.cov(scores.T).reshape(prior.shape)
        parts = []
        for rows, some in zip(np.array_split(np.arange(blocks), THIRDS), np.array_split(slopes, THIRDS)):
            own = np.linalg.inv(some.T @ some / sigma**2 + prior)
            moved = -own @ (scores[rows].sum(axis=0) - sums * len(rows) / blocks)
            parts.append((moved, own @ (squares * len(rows) + prior) @ own))
        full = np.zeros((2 * len(self.simulator.drive.v), len(theta)))
        full[self.use] = slopes / sigma**2
        spectrum = np.maximum(2.0 * np.fft.rfft(rho, len(full)).real - 1.0, 0.0)  # cut off it is below 0 in places
        near = np.fft.irfft(np.fft.rfft(full, axis=0) * spectrum[:, None], len(full), axis=0)
        together = rms(error) ** 2 * full.T @ near
        by_blocks, by_correlation = (bread @ (s + prior) @ bread for s in (squares * blocks, together))
        return (by_blocks, by_correlation), blocks, parts

    def estimates(
        self, values: dict[str, float], covariances: tuple[Array, Array], blocks: int, parts: list[tuple[Array, Array]]
    ) -> tuple[Estimate, ...]:
        """Each parameter and what follows from them, linearised, by the larger covariance; wider where thirds disagree.

        By the variance between them, as for studies that differ; source: DerSimonian, Laird 1986.
        """
        base, table, free = self.simulator.base, self.table, self.free
        factor = float(stdtrit(blocks - 1, 0.975))
        before = np.diag([table[n].deviation ** 2 for n in free])
        c_f, c_r = stiffnesses(base, values["d_f"], values["d_r"])
        length, ratio = base.wheelbase, values["steer_ratio"]
        understeer, given = values["d_f"] - values["d_r"], f"given L = {length:g} m"
        rows: list[tuple[str, float, str, dict[str, float], str]] = [
            ("steer_ratio", ratio, "1", {"steer_ratio": 1.0}, given),
            ("ratio_wheelbase", ratio * length, "m", {"steer_ratio": length}, "what the log determines"),
            ("offset", values["offset"], "rad", {"offset": 1.0}, "at the wheel, of this log"),
            ("delay", values["delay"], "s", {"delay": 1.0}, ""),
            ("lag", values["lag"], "s", {"lag": 1.0}, ""),
            ("delay_lag", values["delay"] + values["lag"], "s", {"delay": 1.0, "lag": 1.0}, "delay + lag"),
            ("understeer_gradient", understeer, "rad s^2/m", {"d_f": 1.0, "d_r": -1.0}, given),
            ("c_f", c_f, "N/rad", {"d_f": -c_f / values["d_f"]}, f"given mass {base.m:g} kg"),
            ("c_r", c_r, "N/rad", {"d_r": -c_r / values["d_r"]}, f"given mass {base.m:g} kg"),
            ("rate_zero", values["rate_zero"], "rad/s", {"rate_zero": 1.0}, "zero of the recorded yaw rate"),
        ]
        # what no log tells apart: the gyro's scale from the ratio, the road's mean bank from the offset
        scale = self.simulator.drive.scale_deviation if "steer_ratio" in free else 0.0
        bank = ratio * abs(understeer) * G * BANK if "offset" in free else 0.0
        beside = {"steer_ratio": ratio * scale, "ratio_wheelbase": ratio * length * scale, "offset": bank}
        estimates = []
        for name, value, unit, slopes, note in rows:
            g = np.array([slopes.get(n, 0.0) for n in free])
            *both, prior = (math.sqrt(g @ m @ g) for m in (*covariances, before))
            deviation = max(both)
            steady = True
            if parts and prior > 0.0:
                apart, weights = (
                    np.array([g @ moved for moved, _ in parts]),
                    np.array([1.0 / (g @ c @ g) for _, c in parts]),
                )
                apart -= weights @ apart / weights.sum()
                excess = float(weights @ apart**2) - (len(parts) - 1)
                between = max(0.0, excess) / float(weights.sum() - weights @ weights / weights.sum())
                steady = excess + len(parts) - 1 <= CONTRADICTION
                deviation = min(math.hypot(deviation, math.sqrt(between)), max(prior, deviation))
            untold = beside.get(name, 0.0)
            half = math.hypot(factor * deviation, NORMAL_95 * untold)
            learned = max(0.0, 1.0 - (deviation**2 + untold**2) / prior**2) if prior > 0.0 else math.nan
            if untold > deviation:
                learned = min(learned, 0.9)
            if name == "rate_zero" and math.isnan(learned):
                continue
            low, high = value - half, value + half
            if name in ("c_f", "c_r"):  # the interval of the compliance, turned over: it stays positive
                key = "d_f" if name == "c_f" else "d_r"
                half *= values[key] / value
                ends = np.clip([values[key] + half, values[key] - half], table[key].low, table[key].high)
                low, high = value * values[key] / ends
            elif name == "lag":
                low = max(low, 0.0)
            estimates.append(Estimate(name, float(value), float(low), float(high), unit, learned, note, steady))
        return tuple(estimates)

    def notes(self, values: dict[str, float], covariance: Array, estimates: tuple[Estimate, ...]) -> tuple[str, ...]:
        """What this log cannot determine, in words."""
        drive, base, free = self.simulator.drive, self.simulator.base, self.free
        scale = drive.scale_deviation
        cannot = "the gyro's scale cannot be told from the ratio, nor the road's mean bank from the offset"
        notes = [
            f"{cannot}: their intervals allow for {100.0 * scale:.2g} % and {100.0 * BANK:g} % (standard deviations)",
            f"the yaw rate determines ratio times wheelbase and stiffness over mass; wheelbase {base.wheelbase:g} m, "
            f"mass {base.m:g} kg and the rest of {base.name} are given",
        ]
        unseen = ", ".join(e.name for e in estimates if e.source == "prior")
        if unseen:
            use = drive.driving
            fastest = f"speed up to {drive.v[use].max():.1f} m/s"
            a_y = f"lateral acceleration up to {np.abs(drive.v * drive.r)[use].max():.1f} m/s^2"
            notes.append(f"{unseen}: hardly determined by this log ({fastest}, {a_y}); the interval is the prior's")
        deviations = np.sqrt(np.diag(covariance))
        related = covariance / np.outer(deviations, deviations)
        for j, i in combinations(range(len(free)), 2):
            if abs(related[i, j]) > 0.9:
                notes.append(f"{free[j]} and {free[i]} cannot be separated well (correlation {related[i, j]:+.2f})")
        unsteady = ", ".join(e.name for e in estimates if e.source == "unsteady")
        if unsteady:
            notes.append(f"{unsteady}: thirds of the log contradict each other; a bank, load or clock that changes?")
        bounds = ", ".join(n for n in free if not self.table[n].low < values[n] < self.table[n].high)
        if bounds:
            notes.append(f"{bounds} at a bound: the model does not fit; check columns, clocks, --wheelbase")
        if values["delay"] < -0.02:
            notes.append("the delay is negative: the yaw rate's clock runs ahead of the steering's, or it was smoothed")
        if max(values["delay"], values["lag"]) > 0.5:
            notes.append("a delay or lag above 0.5 s: do the columns share one clock?")
        return tuple(notes)
