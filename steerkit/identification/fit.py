"""Least squares of the yaw rate over a recorded drive, with priors, and intervals that allow for correlated errors."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from steerkit._support.errors import require, require_within
from steerkit.identification.identified import Estimate, Identified, Simulator, predict, stiffnesses
from steerkit.logs.drive import Array, Drive, moments
from steerkit.vehicles import Vehicle, vehicle

BLOCK, BLOCKS = 2.0, 8
"""Length of the blocks, in times after which the residual's autocorrelation has died out; and how many at least."""


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
    scores over blocks longer than that correlation; intervals are 95 % of Student's t with (blocks - 1) degrees.

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
    covariance, blocks = problem.covariance(theta, sigma)
    values = problem.held | dict(zip(problem.free, theta.tolist()))
    estimates = problem.estimates(values, covariance, blocks)
    c_f, c_r = map(float, stiffnesses(base, values["d_f"], values["d_r"]))
    found = {"name": name or f"{base.name}-identified", "steer_ratio": values["steer_ratio"], "c_f": c_f, "c_r": c_r}
    return Identified(
        vehicle=replace(base, **found),
        estimates=estimates,
        drive=drive,
        base=base,
        theta=values,
        covariance=covariance,
        free=problem.free,
        fit=predict(problem.simulator, values),
        correlation_time=correlation,
        notes=problem.notes(values, covariance, estimates),
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
            correlation, _ = self._correlation_times(error)
            sigma = max(moments(error)[0], 1e-7) * math.sqrt(correlation / dt)
            if abs(sigma / before - 1.0) < 0.02:
                break
        return theta, sigma, correlation

    def _correlation_times(self, error: Array) -> tuple[float, float]:
        """dt (1 + 2 sum of autocorrelations until they have died out), and when they have, below 0.05 [s].

        Gaps count for nothing.
        """
        drive = self.simulator.drive
        full, mask = np.zeros(len(drive.v)), np.zeros(len(drive.v))
        full[self.use], mask[self.use] = error, 1.0
        size = 2 ** math.ceil(math.log2(2 * len(full)))
        products, counts = (np.fft.irfft(np.abs(np.fft.rfft(a, size)) ** 2)[: len(full) // 2] for a in (full, mask))
        rho = products / np.maximum(counts, 1.0) / max(products[0] / counts[0], 1e-300)
        crossing = int(np.argmax(rho <= 0.05)) or len(rho)
        return float(drive.dt * (1.0 + 2.0 * np.sum(rho[1:crossing]))), drive.dt * crossing

    def covariance(self, theta: Array, sigma: float) -> tuple[Array, int]:
        """(sandwich covariance (p, p), number of blocks)."""
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
        length = int(min(max(1.0, BLOCK * self._correlation_times(error)[1]) / dt, n / BLOCKS))
        label = np.minimum(np.arange(n) // length, n // length - 1)
        scores = np.zeros((label[-1] + 1, len(theta)))
        np.add.at(scores, label, slopes * error[:, None] / sigma**2)
        blocks = len(scores)
        scores -= scores.mean(axis=0)
        meat = scores.T @ scores * (blocks / (blocks - 1)) + prior
        return bread @ meat @ bread, blocks

    def estimates(self, values: dict[str, float], covariance: Array, blocks: int) -> tuple[Estimate, ...]:
        """Each parameter and what follows from them, linearised."""
        base, table, free = self.simulator.base, self.table, self.free
        factor = float(stdtrit(blocks - 1, 0.975))
        before = np.diag([table[n].deviation ** 2 for n in free])
        c_f, c_r = stiffnesses(base, values["d_f"], values["d_r"])
        length = base.wheelbase
        understeer, given = values["d_f"] - values["d_r"], f"given L = {length:g} m"
        rows: list[tuple[str, float, str, dict[str, float], str]] = [
            ("steer_ratio", values["steer_ratio"], "1", {"steer_ratio": 1.0}, given),
            (
                "ratio_wheelbase",
                values["steer_ratio"] * length,
                "m",
                {"steer_ratio": length},
                "what the log determines",
            ),
            ("offset", values["offset"], "rad", {"offset": 1.0}, "at the wheel, of this log"),
            ("delay", values["delay"], "s", {"delay": 1.0}, ""),
            ("lag", values["lag"], "s", {"lag": 1.0}, ""),
            ("delay_lag", values["delay"] + values["lag"], "s", {"delay": 1.0, "lag": 1.0}, "delay + lag"),
            ("understeer_gradient", understeer, "rad s^2/m", {"d_f": 1.0, "d_r": -1.0}, given),
            ("c_f", c_f, "N/rad", {"d_f": -c_f / values["d_f"]}, f"given mass {base.m:g} kg"),
            ("c_r", c_r, "N/rad", {"d_r": -c_r / values["d_r"]}, f"given mass {base.m:g} kg"),
            ("rate_zero", values["rate_zero"], "rad/s", {"rate_zero": 1.0}, "zero of the recorded yaw rate"),
        ]
        estimates = []
        for name, value, unit, slopes, note in rows:
            g = np.array([slopes.get(n, 0.0) for n in free])
            deviation, prior = (math.sqrt(g @ m @ g) for m in (covariance, before))
            learned = max(0.0, 1.0 - (deviation / prior) ** 2) if prior > 0.0 else math.nan
            if name == "rate_zero" and math.isnan(learned):
                continue
            low, high = value - factor * deviation, value + factor * deviation
            if name in ("c_f", "c_r"):  # the interval of the compliance, turned over: it stays positive
                key = "d_f" if name == "c_f" else "d_r"
                half = factor * deviation * values[key] / value
                ends = np.clip([values[key] + half, values[key] - half], table[key].low, table[key].high)
                low, high = value * values[key] / ends
            elif name == "lag":
                low = max(low, 0.0)
            for key in slopes.keys() & set(free):
                if not table[key].low < values[key] < table[key].high:
                    note = f"{note}; {key} is at its bound".lstrip("; ")
            estimates.append(Estimate(name, float(value), float(low), float(high), unit, learned, note))
        return tuple(estimates)

    def notes(self, values: dict[str, float], covariance: Array, estimates: tuple[Estimate, ...]) -> tuple[str, ...]:
        """What this log cannot determine, in words."""
        drive, base, free = self.simulator.drive, self.simulator.base, self.free
        notes = [
            f"the yaw rate determines ratio times wheelbase and stiffness over mass; wheelbase {base.wheelbase:g} m, "
            f"mass {base.m:g} kg and the rest of {base.name} are given"
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
        if values["delay"] < -0.02:
            notes.append("the delay is negative: the yaw rate's clock runs ahead of the steering's, or it was smoothed")
        if max(values["delay"], values["lag"]) > 0.5:
            notes.append("a delay or lag above 0.5 s: do the columns share one clock?")
        return tuple(notes)
