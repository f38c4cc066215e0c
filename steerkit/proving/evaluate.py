"""What a manoeuvre's runs tell of a car: gains, times, loops, gradients, with intervals over repeats; the verdict."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts load when they are first used

from steerkit.logs.channels import Array
from steerkit.metrics.comfort import r79_acceleration, r79_jerk
from steerkit.metrics.signals import rms
from steerkit.proving.manoeuvre import SIDES, Limit, Manoeuvre
from steerkit.proving.runs import Run, checked, prepared
from steerkit.vehicles import Vehicle

PLATEAU = 2.0
"""Length of a stretch that counts as steady [s]."""
COHERENCE = 0.8
"""From which on a frequency counts."""
BEYOND = "not determined: no second-order answer within the frequencies of the input"
UNTOLD = "not determined: its interval is wider than twice its value"
UNITS = {
    "understeer_gradient": "rad s^2/m",
    "yaw_gain": "1/s",
    "yaw_peak_gain": "1/s",
    "a_y_peak_gain": "m/s^2/rad",
    "a_y_gain": "m/s^2/rad",
    "rear_compliance": "rad s^2/m",
    "static_margin": "1",
    "natural_frequency": "Hz",
    "bandwidth": "Hz",
    "phase_1_hz": "rad",
    "phase_bandwidth": "rad",
    "damping": "1",
    "delay": "s",
    "peak_yaw_rate": "rad/s",
    "lateral_displacement": "m",
    "dead_band": "rad",
    "hysteresis_angle": "rad",
    "hysteresis_a_y": "m/s^2",
    "sensitivity": "m/s^2/rad",
    "max_e": "m",
    "rms_e": "m",
    "max_a_y": "m/s^2",
    "max_jerk": "m/s^3",
    "max_wheel_rate": "rad/s",
}
"""Of the quantities that do not end in their unit."""


class Result(NamedTuple):
    """A quantity with its 95 % interval over repeats; NaN where there is none."""

    quantity: str
    value: float
    low: float
    high: float
    n: int
    """Repeats that it is of."""
    note: str = ""

    @property
    def unit(self) -> str:
        """Its unit; times in [s], shares in [1]."""
        times = ("_time", "_delay", "_lag", "crossing", "delay_50")
        return UNITS.get(self.quantity, "s" if any(word in self.quantity for word in times) else "1")


class Verdict(NamedTuple):
    """A limit, and whether it is kept: None where it is not known, as the quantity was not evaluated."""

    limit: Limit
    passed: bool | None


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation:
    """A manoeuvre that was driven, in simulation, by a log or by a car, and what it shows."""

    manoeuvre: Manoeuvre
    who: str
    """Which car, driven how."""
    vehicle: Vehicle
    runs: tuple[Run, ...]
    """All, also those that do not count."""
    results: tuple[Result, ...]
    verdicts: tuple[Verdict, ...]
    notes: tuple[str, ...] = ()
    """What could not be evaluated, and why."""
    curves: Mapping[str, Array] = field(default_factory=dict)
    """What is drawn besides the runs, such as the frequency response over `f`."""

    @property
    def valid(self) -> tuple[Run, ...]:
        """The runs that count."""
        return tuple(run for run in self.runs if not run.invalid)

    @property
    def passed(self) -> bool | None:
        """Are all limits kept? None where there is none, or one is not known."""
        kept = [verdict.passed for verdict in self.verdicts]
        return False if False in kept else None if None in kept or not kept else True

    def __getitem__(self, quantity: str) -> Result:
        return {result.quantity: result for result in self.results}[quantity]

    def facts(self) -> dict[str, Any]:
        """As JSON: results, verdicts, runs."""
        return {
            "manoeuvre": self.manoeuvre.name,
            "norm": self.manoeuvre.norm,
            "car": self.who,
            "passed": self.passed,
            "results": {
                r.quantity: {"value": r.value, "low": r.low, "high": r.high, "unit": r.unit, "n": r.n, "note": r.note}
                for r in self.results
            },
            "limits": [
                {"quantity": v.limit.quantity, "limit": v.limit.text(), "source": v.limit.source, "passed": v.passed}
                for v in self.verdicts
            ],
            "runs": [{"number": run.number, "side": run.side, "invalid": run.invalid} for run in self.runs],
            "unverified": list(self.manoeuvre.unverified),
            "notes": list(self.notes),
        }


class Found(NamedTuple):
    """What an evaluation finds: each repeat's value of each quantity, results that have an interval of their own, what
    it could not find, and curves."""

    repeats: dict[str, list[float]]
    results: list[Result] = []
    notes: list[str] = []
    curves: dict[str, Array] = {}


def evaluate(
    manoeuvre: Manoeuvre,
    runs: Iterable[Run],
    vehicle: Vehicle,
    *,
    who: str = "",
    limits: Sequence[Limit] = (),
    notes: Sequence[str] = (),
) -> Evaluation:
    """What a manoeuvre's runs tell, and whether its limits, or others in their place, are kept.

    The interval of a quantity over n repeats is its mean +- t s/sqrt(n), t of Student with n - 1 degrees, 95 %; gains
    and gradients of `steady`, and the frequency response, have their own: see there. Runs that do not count are kept,
    with the reason. A quantity that no run tells is left out and a note says so. limits: instead of the manoeuvre's.
    notes: on how the runs were come by.
    """
    runs = tuple(checked(run, manoeuvre) for run in runs)
    good = [prepared(run, manoeuvre) for run in runs if not run.invalid]
    found = _EVALUATED[manoeuvre.evaluation](manoeuvre, good, vehicle) if good else Found({}, notes=["no valid run"])
    results = [*found.results, *(of_repeats(name, values) for name, values in found.repeats.items() if values)]
    results = [r._replace(note=UNTOLD) if r.high - r.low > 2.0 * abs(r.value) else r for r in results]
    known = {result.quantity: result for result in results}
    kept = [Verdict(limit, _keeps(known.get(limit.quantity), limit)) for limit in limits or manoeuvre.limits]
    told = [
        *notes,
        *found.notes,
        *(f"{v.limit.quantity}: not evaluated, so its limit is not judged" for v in kept if v[1] is None),
    ]
    return Evaluation(
        manoeuvre=manoeuvre,
        who=who,
        vehicle=vehicle,
        runs=runs,
        results=tuple(results),
        verdicts=tuple(kept),
        notes=tuple(told),
        curves=found.curves,
    )


def _keeps(result: Result | None, limit: Limit) -> bool | None:
    return None if result is None or math.isnan(result.value) else limit.low <= result.value <= limit.high


def of_repeats(quantity: str, values: Sequence[float], note: str = "") -> Result:
    """The mean of repeats that told the quantity, and its interval; of one repeat no interval."""
    told = np.array([value for value in values if math.isfinite(value)])
    if not len(told):
        return Result(quantity, math.nan, math.nan, math.nan, 0, note or "in no run")
    half = math.nan
    if len(told) > 1:
        half = float(scipy.special.stdtrit(len(told) - 1, 0.975) * np.std(told, ddof=1) / math.sqrt(len(told)))
    mean = float(told.mean())
    missed = f"in {len(told)} of {len(values)} runs" if len(told) < len(values) else ""
    return Result(quantity, mean, mean - half, mean + half, len(told), note or missed)


def line(x: Array, y: Array) -> tuple[Array, Array]:
    """Least squares of y = x b: b (k,) and the half-widths of its 95 % intervals, by Student's t. x (n, k)."""
    b, _, rank, _ = np.linalg.lstsq(x, y, rcond=None)
    free = len(y) - x.shape[1]
    if free < 1 or rank < x.shape[1]:
        return np.asarray(b), np.full(x.shape[1], math.nan)
    variance = float(np.sum((y - x @ b) ** 2)) / free * np.diag(np.linalg.inv(x.T @ x))
    return np.asarray(b), np.asarray(scipy.special.stdtrit(free, 0.975) * np.sqrt(variance))


# ---- steady driving -----------------------------------------------------------------------------------------------


def plateaus(run: Run, manoeuvre: Manoeuvre) -> list[tuple[float, ...]]:
    """Means of delta_sw, v, r, a_y, beta (NaN where unknown) over stretches of 2 s in which nothing changes.

    Of a run by the manoeuvre's own input those before each of its levels ends, a second after its beginning at least;
    of a whole drive those in which angle and yaw rate stay within a hundredth.
    """
    n, found = round(PLATEAU / run.dt), list[tuple[float, ...]]()
    names = ("delta_sw", "v", "r", "a_y", *(["beta"] if "beta" in run.signals else []))
    signals = np.array([run[name] for name in names])
    if not run.whole:
        wanted = manoeuvre.required
        lasts = np.cumsum(wanted.seconds or (wanted.rise + wanted.hold,) * max(1, len(wanted.levels)))
        for last in lasts:
            end = int(np.searchsorted(run.t, last - 1e-9))
            for k in range(int((wanted.hold - 1.0) / PLATEAU + 1e-9)):
                part = signals[:, max(end - (k + 1) * n, 0) : end - k * n]
                found += [tuple(part.mean(axis=1).tolist())] if part.shape[1] == n else []
        return found
    k = 0
    while n >= 8 and k + n <= len(run.t):
        part = signals[:, k : k + n]
        mean, half = part.mean(axis=1), n // 2
        change = np.abs(part[:, half:].mean(axis=1) - part[:, :half].mean(axis=1))
        still = change[0] <= 0.004 + 0.01 * abs(mean[0]) and change[2] <= 0.002 + 0.01 * abs(mean[2])
        if still and np.ptp(part[1]) <= 1.0 and part[1].min() >= 3.0 and abs(mean[2]) > 0.005:
            found.append(tuple(mean.tolist()))
            k += n
        else:
            k += max(1, n // 8)
    return found


def _steady(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """delta_sw - i L r/v = i (K a_y + offset), and r, a_y, beta over it, by least squares over steady stretches.

    Source: ISO 4138; Rajamani 2012, section 3.3. i L is taken from the car's data: K at a constant speed cannot be told
    apart from it. The rear axle's compliance d_r is the slope of l_r r/v - beta over a_y, the front one's K + d_r; of
    both the static margin (c_r l_r - c_f l_f)/((c_f + c_r) L), with c_f = m l_r/(L d_f), c_r = m l_f/(L d_r).
    """
    mirror = np.array([1.0, 0.0, 1.0, 1.0, 1.0])
    rows = np.full((0, 5), math.nan)
    for run in runs:
        for row in plateaus(run, manoeuvre):
            whole = np.array([*row, math.nan][:5])
            rows = np.vstack((rows, np.where(mirror, SIDES[run.side], 1.0) * whole))
    if len(rows) < 4 or np.ptp(rows[:, 3]) < 0.5:
        span = float(np.ptp(rows[:, 3])) if len(rows) else 0.0
        few = f"{len(rows)} steady stretches of {PLATEAU:g} s over {span:.1f} m/s^2"
        return Found({}, notes=[f"steady driving: {few}, expected 4 or more over 0.5 m/s^2"])
    wheel, v, r, a_y, beta = rows.T
    one, ratio, length = np.ones(len(rows)), float(vehicle.steer_ratio), float(vehicle.wheelbase)
    results = []
    (slope, _), (half, _) = line(np.column_stack((a_y, one)), wheel / ratio - length * r / v)
    results.append(Result("understeer_gradient", slope, slope - half, slope + half, len(rows)))
    notes = []
    if np.ptp(v) < 0.1 * v.mean():
        for name, y in (("yaw_gain", r), ("a_y_gain", a_y)):
            (gain, _), (wide, _) = line(np.column_stack((wheel, one)), y)
            results.append(Result(name, gain, gain - wide, gain + wide, len(rows), f"at {v.mean():.1f} m/s"))
    else:
        notes.append("gains: the speed differs by more than a tenth between stretches")
    if np.isfinite(beta).all():
        (slip, _), (wide, _) = line(np.column_stack((a_y, one)), beta - float(vehicle.l_r) * r / v)
        results.append(Result("rear_compliance", -slip, -slip - wide, -slip + wide, len(rows)))
        margin = [_margin(slope + d, -slip + e, vehicle) for d, e in ((0, 0), (half, 0), (0, wide))]
        wide = math.hypot(margin[1] - margin[0], margin[2] - margin[0])
        results.append(Result("static_margin", margin[0], margin[0] - wide, margin[0] + wide, len(rows)))
    else:
        notes.append("rear compliance, static margin: no sideslip angle was measured")
    return Found({}, results, notes, {"wheel": wheel, "a_y": a_y, "v": v, "r": r})


def _margin(gradient: float, d_r: float, vehicle: Vehicle) -> float:
    """(c_r l_r - c_f l_f)/((c_f + c_r) L) of the axles' compliances."""
    d_f, l_f, l_r = gradient + d_r, float(vehicle.l_f), float(vehicle.l_r)
    c_f, c_r = l_r / d_f, l_f / d_r
    return (c_r * l_r - c_f * l_f) / ((c_f + c_r) * (l_f + l_r))


# ---- transient answers --------------------------------------------------------------------------------------------


def crossing(t: Array, x: Array, level: float) -> float:
    """The first time at which x comes up to the level, linear between samples; NaN if never [s]."""
    above = x >= level
    if not above.any():
        return math.nan
    k = int(np.argmax(above))
    return float(t[0]) if k == 0 else float(t[k - 1] + (level - x[k - 1]) / (x[k] - x[k - 1]) * (t[k] - t[k - 1]))


def _about(run: Run, name: str) -> Array:
    """A signal less its mean before the input."""
    before = run.between(-1.0, -run.dt)
    return run[name] - (run[name][before].mean() if before.any() else 0.0)


def _step(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """Of yaw rate and lateral acceleration: gain, delay (50 % of the angle to 50 % of the answer), response time (to
    90 %), time of the peak, overshoot over the steady value, all from 50 % of the angle. Source: ISO 7401, step input.
    """
    repeats: dict[str, list[float]] = {}
    for run in runs:
        after = run.between(0.0, manoeuvre.seconds)
        last = run.between(manoeuvre.seconds - 1.0, manoeuvre.seconds)
        t, wheel = run.t[after], _about(run, "delta_sw")
        size = wheel[last].mean()
        begin = crossing(t, wheel[after] / size, 0.5)
        for name, of in (("yaw", "r"), ("a_y", "a_y")):
            answer = _about(run, of)
            steady = answer[last].mean()
            x = answer[after] / steady
            peak = int(np.argmax(x))
            row = {
                f"{name}_gain": steady / size,
                f"{name}_delay": crossing(t, x, 0.5) - begin,
                f"{name}_response_time": crossing(t, x, 0.9) - begin,
                f"{name}_peak_time": float(t[peak]) - begin if x[peak] > 1.005 else math.nan,
                f"{name}_overshoot": max(float(x[peak]) - 1.0, 0.0),
            }
            for quantity, value in row.items():
                repeats.setdefault(quantity, []).append(float(value))
    return Found(repeats)


def _sine(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """Gain of the first peaks and lag between them. Source: ISO 7401, one period of a sine."""
    repeats: dict[str, list[float]] = {}
    half = 0.75 / manoeuvre.required.frequency
    for run in runs:
        use = run.between(0.0, half)
        t = run.t[use]
        wheel_at, wheel = peak(t, _about(run, "delta_sw")[use])
        for name, of in (("yaw", "r"), ("a_y", "a_y")):
            at, size = peak(t, _about(run, of)[use])
            repeats.setdefault(f"{name}_peak_gain", []).append(size / wheel)
            repeats.setdefault(f"{name}_lag", []).append(at - wheel_at)
    return Found(repeats)


def peak(t: Array, x: Array) -> tuple[float, float]:
    """Time and value of the largest sample, by the parabola through it and its neighbours."""
    k = int(np.argmax(x))
    if not 0 < k < len(x) - 1:
        return float(t[k]), float(x[k])
    a, b, c = x[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend else 0.0
    return float(t[k] + shift * (t[1] - t[0])), float(b - 0.25 * (a - c) * shift)


def _request(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """From the request's beginning until the lateral acceleration is at 50 % of its first peak, and at the peak.

    Source: openpilot, tools/lateral_maneuvers (README; delay at 50 %, crossing time), to one sample.
    """
    repeats: dict[str, list[float]] = {"delay_50": [], "crossing": []}
    wanted, car = manoeuvre.required, vehicle
    for run in runs:
        use, v = run.between(0.0, manoeuvre.seconds), run["v"].mean()
        per_a_y = car.steer_ratio * (car.wheelbase / v**2 + car.understeer_gradient)
        asked = wanted.a_y and "delta_sw_cmd" in run.signals  # else, as in a log, what the wheel's angle asks
        level = wanted.a_y if asked else float(np.abs(_about(run, "delta_sw")[use]).max() / per_a_y)
        t, x = run.t[use], _about(run, "a_y")[use] / level
        for name, share in (("delay_50", 0.5), ("crossing", 1.0)):
            repeats[name].append(float(t[np.argmax(x >= share)]) if (x >= share).any() else math.nan)
    return Found(repeats)


def _dwell(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """Yaw rate 1.00 and 1.75 s after the wheel is straight again over its second peak; displacement 1.07 s after it is
    turned: both where the wheel passes a twentieth of its largest angle.

    The displacement is that of the centre of gravity, by twice integrating a_y where no position is known.
    Source: 49 CFR 571.126, S5.2, S7.11 (which takes 5 degrees of the wheel).
    """
    names = ("peak_yaw_rate", "yaw_ratio_1.00", "yaw_ratio_1.75", "lateral_displacement")
    repeats: dict[str, list[float]] = {name: [] for name in names}
    for run in runs:
        r, wheel = _about(run, "r"), np.abs(_about(run, "delta_sw"))
        turned = run.t[wheel > 0.05 * wheel.max()]
        begin, end = float(turned[0]), float(turned[-1])
        second = -float(r[run.between(begin, end + 0.2)].min())
        ratios = [-float(np.interp(end + late, run.t, r)) / second for late in (1.0, 1.75)]
        a_y = np.where(run.t >= begin, _about(run, "a_y"), 0.0)
        moved = scipy.integrate.cumulative_trapezoid(a_y, dx=run.dt, initial=0.0)
        moved = scipy.integrate.cumulative_trapezoid(moved, dx=run.dt, initial=0.0)
        at = float(np.interp(begin + 1.07, run.t, moved))
        if {"x", "y", "psi"} <= run.signals.keys():
            there = [[np.interp(begin + after, run.t, run[c]) for c in ("x", "y")] for after in (0.0, 1.07)]
            psi = float(np.interp(begin, run.t, run["psi"]))
            at = float(np.subtract(there[1], there[0]) @ np.array([-math.sin(psi), math.cos(psi)]))
        for name, value in zip(names, (second, *ratios, at)):
            repeats[name].append(value)
    return Found(repeats)


# ---- on centre ----------------------------------------------------------------------------------------------------


def _on_centre(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """The loop of a_y over the angle: half its width at a_y = 0 and at angle 0, its slope there, lag of the yaw rate.

    Every period but the first and the last half is a repeat. Source: ISO 13674-1 (weave); Norman 1984.
    """
    names = ("sensitivity", "hysteresis_angle", "hysteresis_a_y", "yaw_lag", "a_y_lag")
    repeats: dict[str, list[float]] = {name: [] for name in names}
    f = manoeuvre.required.frequency
    for run in runs:
        for k in range(1, int(manoeuvre.required.periods) - 1):
            use = run.between(k / f, (k + 1) / f - run.dt)
            t, (wheel, a_y, r) = (
                run.t[use],
                (run[name][use] - run[name][use].mean() for name in ("delta_sw", "a_y", "r")),
            )
            angle = _zeros(a_y, wheel)
            answer = _zeros(wheel, a_y)
            near = np.abs(wheel) < 0.2 * np.abs(wheel).max()
            turn = np.exp(-2j * np.pi * f * t)
            phase = [float(np.angle((x @ turn) / (wheel @ turn))) for x in (r, a_y)]
            values = (float(np.polyfit(wheel[near], a_y[near], 1)[0]), 0.5 * angle, 0.5 * answer)
            for name, value in zip(names, (*values, *(-p / (2.0 * np.pi * f) for p in phase))):
                repeats[name].append(value)
    return Found(repeats)


def _zeros(x: Array, of: Array) -> float:
    """|of where x rises through 0 - of where it falls through it|, linear between samples; NaN where it does not."""
    found = list[float]()
    for sign in (1.0, -1.0):
        rows = np.flatnonzero((sign * x[:-1] < 0.0) & (sign * x[1:] >= 0.0))
        share = x[rows] / (x[rows] - x[rows + 1])
        found.append(float(np.mean(of[rows] + share * (of[rows + 1] - of[rows]))) if len(rows) else math.nan)
    return abs(found[0] - found[1])


def _transition(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """Gain beyond the centre, and the dead band: twice the angle at which a line through a_y of 0.5 to 1.5 m/s^2 has
    none; what the yaw rate's lag adds to it is in it. Source: ISO 13674-2 (transition)."""
    repeats: dict[str, list[float]] = {"a_y_gain": [], "dead_band": []}
    for run in runs:
        use = run.between(0.0, manoeuvre.required.rise)
        wheel, a_y = _about(run, "delta_sw")[use], _about(run, "a_y")[use]
        inside = (a_y >= 0.5) & (a_y <= 1.5)
        gain, at = np.polyfit(wheel[inside], a_y[inside], 1) if inside.sum() > 10 else (math.nan, math.nan)
        repeats["a_y_gain"].append(float(gain))
        repeats["dead_band"].append(float(-2.0 * at / gain))
    return Found(repeats)


# ---- frequency response -------------------------------------------------------------------------------------------


class Spectra(NamedTuple):
    """Of each segment (m, f): power of the angle, cross powers and powers of yaw rate and acceleration."""

    f: Array
    wheel: Array
    cross: Mapping[str, Array]
    power: Mapping[str, Array]

    def response(self, name: str, keep: Any = slice(None)) -> tuple[Array, Array]:
        """H1 = S_wy/S_ww and the coherence, over the segments to keep."""
        s_ww, s_wy = self.wheel[keep].sum(axis=0), self.cross[name][keep].sum(axis=0)
        return s_wy / s_ww, np.abs(s_wy) ** 2 / (s_ww * self.power[name][keep].sum(axis=0))


def spectra(manoeuvre: Manoeuvre, runs: list[Run]) -> Spectra:
    """Segments of the runs: of a random input its periods but the first and the last, else whole runs.

    A whole run of another input is at rest at both ends, and a period of an input that repeats goes on as it began:
    neither needs a window. Periods of what does not repeat, as in a log, get Hann's.
    """
    wanted, parts, dt = manoeuvre.required, list[Array](), runs[0].dt
    low, high, random = 0.2, 3.0, wanted.form == "random"
    for run in runs:
        signals = np.array([_about(run, name) for name in ("delta_sw", "r", "a_y")])
        if not random:
            parts.append(signals[:, run.t >= -1e-9])
            continue
        n, low, high = round(wanted.period / dt), wanted.low, wanted.high
        first = 0 if run.whole else int(np.searchsorted(run.t, 1e-9)) + n
        last = len(run.t) - n + 1 - (0 if run.whole else round(wanted.rise / dt))  # the end fades out
        cut = [signals[:, k : k + n] for k in range(first, last, n)]
        change = [float(np.std(b[0] - a[0])) for a, b in itertools.pairwise(cut)]
        repeats = bool(change) and not run.whole and max(change) < 0.1 * float(np.std(signals[0]))
        window = np.ones(n) if repeats else np.hanning(n + 1)[:-1]
        parts += [window * (part - part.mean(axis=1, keepdims=True)) for part in cut]
    n = min((part.shape[1] for part in parts), default=0)
    f = np.fft.rfftfreq(max(n, 2), dt)
    use = (f >= low - 1e-9) & (f <= high + 1e-9)
    spectrum = np.array([np.fft.rfft(part[:, :n])[:, use] for part in parts]).reshape(-1, 3, int(use.sum()))
    wheel = spectrum[:, 0]
    answers = {"r": spectrum[:, 1], "a_y": spectrum[:, 2]}
    cross = {name: np.conj(wheel) * answer for name, answer in answers.items()}
    power = {name: np.abs(answer) ** 2 for name, answer in answers.items()}
    return Spectra(np.asarray(f[use]), np.abs(wheel) ** 2, cross, power)


def second_order(f: Array, response: Array, weight: Array, start: Any = None) -> Array:
    """(gain, T, natural frequency [rad/s], damping, delay [s]) of the yaw rate's response, by weighted least squares.

        H(s) = G (1 + T s)/(1 + 2 D s/w + (s/w)^2) exp(-tau s)

    which the linear single track's is. f (n,) [Hz]; response (n,), complex; weight (n,), per relative error.
    Source: Mitschke, Wallentowitz 2004, section 18; Ljung 1999, section 7.
    """
    s = 2j * np.pi * f

    def misses(theta: Array) -> Array:
        gain, lead, natural, damping, delay = theta
        natural = max(natural, 0.1)
        model = gain * (1.0 + lead * s) / (1.0 + 2.0 * damping * s / natural + (s / natural) ** 2) * np.exp(-delay * s)
        error = weight * (model / response - 1.0)
        return np.concatenate((error.real, error.imag))

    first = start if start is not None else (float(np.abs(response[:3]).mean()), 0.2, 7.0, 0.7, 0.01)
    scale = np.maximum(np.abs(first), 1e-2)
    return np.asarray(scipy.optimize.least_squares(misses, first, x_scale=scale, method="lm").x)


def _frequency(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """Gain, natural frequency, damping, delay, bandwidth at -3 dB and phases of the yaw rate; gain of a_y.

    H1 estimates with coherence, then `second_order` on where that is 0.8 or more. Values less their bias, and
    intervals: delete-one jackknife over periods or runs, Student's t. Source: ISO 7401 (random, pulse); Bendat, Piersol
    2010; Efron, Tibshirani 1993.
    """
    found = spectra(manoeuvre, runs)
    if not len(found.wheel):
        return Found({}, notes=["frequency response: no stretch is long enough for it"])
    response, coherence = found.response("r")
    use = np.asarray(coherence >= COHERENCE)
    use &= len(found.wheel) > 1 or manoeuvre.required.form != "random"  # of one segment it is 1, whatever it says
    curves = {"f": found.f, "response": response, "coherence": coherence, "response_a_y": found.response("a_y")[0]}
    if use.sum() < 8:
        return Found({}, notes=[f"frequency response: {use.sum()} frequencies of coherence {COHERENCE:g}, expected 8"])
    weight = np.abs(response[use]) * np.sqrt(found.wheel.mean(axis=0)[use])  # as of white noise in the yaw rate
    weight /= weight.mean()
    whole = second_order(found.f[use], response[use], weight)
    m, values = len(found.wheel), _read(whole)
    results = []
    left_out = []
    for k in range(m if m > 1 else 0):
        part, _ = found.response("r", np.arange(m) != k)
        left_out.append(list(_read(second_order(found.f[use], part[use], weight, whole)).values()))
    for name, value, column in zip(values, values.values(), np.array(left_out).T if left_out else [()] * len(values)):
        half = math.nan
        if m > 1:
            spread = math.sqrt((m - 1) / m * float(np.sum((column - np.mean(column)) ** 2)))
            half = float(scipy.special.stdtrit(m - 1, 0.975)) * spread
            value = m * value - (m - 1) * float(np.mean(column))  # less its bias
        beyond = name in ("natural_frequency", "damping") and values["natural_frequency"] > 2.0 * found.f[-1]
        results.append(Result(name, value, value - half, value + half, m, BEYOND if beyond else ""))
    s = 2j * np.pi * found.f
    gain, lead, natural, damping, delay = whole
    curves["model"] = gain * (1 + lead * s) / (1 + 2 * damping * s / natural + (s / natural) ** 2) * np.exp(-delay * s)
    return Found({}, results, [] if m > 1 else ["frequency response: one repeat, so no interval"], curves)


def _read(theta: Array) -> dict[str, float]:
    """What a fitted response is known by."""
    gain, lead, natural, damping, delay = (float(value) for value in theta)
    f = np.linspace(0.01, 10.0, 2000)

    def at(f: Any) -> Any:
        s = 2j * np.pi * f
        return (1.0 + lead * s) / (1.0 + 2.0 * damping * s / natural + (s / natural) ** 2) * np.exp(-delay * s)

    low = np.abs(at(f)) < math.sqrt(0.5)
    bandwidth = float(f[np.argmax(low)]) if low.any() else math.nan
    if low.any() and np.argmax(low) > 0:
        k = int(np.argmax(low))
        a, b = np.abs(at(f[k - 1 : k + 1]))
        bandwidth = float(f[k - 1] + (a - math.sqrt(0.5)) / (a - b) * (f[1] - f[0]))
    return {
        "yaw_gain": gain,
        "natural_frequency": natural / (2.0 * math.pi),
        "damping": damping,
        "delay": delay,
        "bandwidth": bandwidth,
        "phase_1_hz": float(np.angle(at(1.0))),
        "phase_bandwidth": float(np.angle(at(bandwidth))),
    }


# ---- closed loop --------------------------------------------------------------------------------------------------


def _course(manoeuvre: Manoeuvre, runs: list[Run], vehicle: Vehicle) -> Found:
    """Cross-track error, lateral acceleration and jerk as UN R79 filters them, rate of the wheel."""
    repeats: dict[str, list[float]] = {}
    for run in runs:
        row = {
            "max_a_y": float(np.abs(r79_acceleration(run.t, run["a_y"])).max()),
            "max_jerk": float(np.abs(r79_jerk(run.t, run["a_y"])).max()),
            "max_wheel_rate": float(np.abs(np.diff(run["delta_sw"])).max() / run.dt),
        }
        if "e" in run.signals:
            row |= {"max_e": float(np.abs(run["e"]).max()), "rms_e": rms(run["e"])}
        for name, value in row.items():
            repeats.setdefault(name, []).append(value)
    lacking = [] if any("e" in run.signals for run in runs) else ["cross-track error: there is no course"]
    return Found(repeats, notes=lacking)


_EVALUATED: Mapping[str, Callable[[Manoeuvre, list[Run], Vehicle], Found]] = {
    "steady": _steady,
    "step": _step,
    "sine": _sine,
    "frequency": _frequency,
    "on-centre": _on_centre,
    "transition": _transition,
    "dwell": _dwell,
    "request": _request,
    "course": _course,
}
