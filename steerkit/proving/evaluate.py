"""What a manoeuvre's runs tell of a car: gains, times, loops, gradients, with intervals over repeats; the verdict."""

import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy  # its parts load when they are first used

from steerkit._support.files import toml_of
from steerkit.logs.channels import Array
from steerkit.metrics.signals import rms
from steerkit.metrics.table import r79_acceleration, r79_jerk
from steerkit.proving.manoeuvre import SIDES, Limit, Manoeuvre
from steerkit.proving.runs import Run, checked, prepared
from steerkit.vehicles import Vehicle

PLATEAU = 2.0
"""Length of a stretch that counts as steady [s]."""
ANSWERS = (("yaw", "r"), ("a_y", "a_y"))
COHERENCE = 0.8
"""From which on a frequency counts."""
BEYOND = "not determined: no second-order answer within the frequencies of the input"
UNTOLD = "not determined: its interval is wider than twice its value"
WORDS = toml_of(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"), "words.toml")
"""Units of quantities, where they are no pure numbers, and how people call quantities and settings."""


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
        """Its unit."""
        return str(WORDS["units"].get(self.quantity, "1"))

    def facts(self) -> dict[str, Any]:
        """As JSON: null for what there is none of."""
        value, low, high = (None if math.isnan(x) else x for x in self[1:4])
        return {"value": value, "low": low, "high": high, "unit": self.unit, "n": self.n, "note": self.note}


class Verdict(NamedTuple):
    """A limit, and whether it is kept: None where it is not known, as the quantity was not evaluated."""

    limit: Limit
    passed: bool | None


@dataclass(frozen=True, eq=False)
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
    notes: tuple[str, ...]
    """What could not be evaluated, and why."""
    curves: Mapping[str, Array]
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
            "results": {r.quantity: r.facts() for r in self.results},
            "limits": [
                {"quantity": v.limit.quantity, "limit": v.limit.text(), "source": v.limit.source, "passed": v.passed}
                for v in self.verdicts
            ],
            "runs": [{"number": run.number, "side": run.side, "invalid": run.invalid} for run in self.runs],
            "unverified": list(self.manoeuvre.unverified),
            "notes": list(self.notes),
        }


class Found(NamedTuple):
    """What all runs together tell: results that have an interval of their own, what could not be found, and curves."""

    results: list[Result] = []
    notes: list[str] = []
    curves: dict[str, Array] = {}


Row = dict[str, float]
"""What one repeat tells: values by quantity."""


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
    found, kind = Found(notes=[] if good else ["no valid run"]), manoeuvre.evaluation
    if good and kind in OF_ALL:
        found = OF_ALL[kind](manoeuvre, good, vehicle)
    results = found.results
    if kind in OF_EACH:
        rows = [row for run in good for row in OF_EACH[kind](manoeuvre, run, vehicle)]
        quantities = dict.fromkeys(name for row in rows for name in row)
        results = [of_repeats(name, [row[name] for row in rows if name in row]) for name in quantities]
        if good and manoeuvre.course and "max_e" not in quantities:
            found.notes.append("cross-track error: there is no course")
    results = [r._replace(note=UNTOLD) if r.high - r.low > 2.0 * abs(r.value) else r for r in results]
    values = {result.quantity: result.value for result in results if not math.isnan(result.value)}
    verdicts = list[Verdict]()
    for limit in limits or manoeuvre.limits:
        value = values.get(limit.quantity)
        verdicts.append(Verdict(limit, None if value is None else limit.low <= value <= limit.high))
        if value is None:
            found.notes.append(f"{limit.quantity}: not evaluated, so its limit is not judged")
    told = (*notes, *found.notes)
    return Evaluation(manoeuvre, who, vehicle, runs, tuple(results), tuple(verdicts), told, found.curves)


def result(quantity: str, value: float, half: float, n: int, note: str = "") -> Result:
    """One with an interval of this half-width."""
    return Result(quantity, value, value - half, value + half, n, note)


def of_repeats(quantity: str, values: Sequence[float]) -> Result:
    """The mean of repeats that told the quantity, and its interval; of one repeat no interval."""
    told = np.array([value for value in values if math.isfinite(value)])
    if not len(told):
        return result(quantity, math.nan, math.nan, 0, "in no run")
    half = math.nan
    if len(told) > 1:
        half = float(scipy.special.stdtrit(len(told) - 1, 0.975) * np.std(told, ddof=1) / math.sqrt(len(told)))
    missed = f"in {len(told)} of {len(values)} runs" if len(told) < len(values) else ""
    return result(quantity, float(told.mean()), half, len(told), missed)


def _slope(x: Array, y: Array) -> tuple[float, float]:
    """Of the least-squares line through y over x (n,), n > 2, and the half-width of its 95 % interval, Student's t."""
    x, y = x - x.mean(), y - y.mean()
    slope, free = float(x @ y / (x @ x)), len(x) - 2
    rest = y - slope * x
    return slope, float(scipy.special.stdtrit(free, 0.975) * np.sqrt(rest @ rest / free / (x @ x)))


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
    rows = np.full((0, 5), math.nan)
    for run in runs:
        signs = SIDES[run.side] * np.ones(5)
        signs[1] = 1.0
        rows = np.vstack((rows, *(signs * [*row, math.nan][:5] for row in plateaus(run, manoeuvre))))
    if len(rows) < 4 or np.ptp(rows[:, 3]) < 0.5:
        span = float(np.ptp(rows[:, 3])) if len(rows) else 0.0
        few = f"{len(rows)} steady stretches of {PLATEAU:g} s over {span:.1f} m/s^2"
        return Found([], [f"steady driving: {few}, expected 4 or more over 0.5 m/s^2"])
    wheel, v, r, a_y, beta = rows.T
    n, ratio, length = len(rows), float(vehicle.steer_ratio), float(vehicle.wheelbase)
    slope, half = _slope(a_y, wheel / ratio - length * r / v)
    results, notes = [result("understeer_gradient", slope, half, n)], []
    if np.ptp(v) < 0.1 * v.mean():
        for name, y in (("yaw_gain", r), ("a_y_gain", a_y)):
            gain, wide = _slope(wheel, y)
            results.append(result(name, gain, wide, n, f"at {v.mean():.1f} m/s"))
    else:
        notes.append("gains: the speed differs by more than a tenth between stretches")
    if np.isfinite(beta).all():
        l_f, l_r = float(vehicle.l_f), float(vehicle.l_r)
        slip, wide = _slope(a_y, beta - l_r * r / v)
        results.append(result("rear_compliance", -slip, wide, n))
        margin = []
        for gradient, d_r in ((slope, -slip), (slope + half, -slip), (slope, wide - slip)):
            c_f, c_r = l_r / (gradient + d_r), l_f / d_r
            margin.append((c_r * l_r - c_f * l_f) / ((c_f + c_r) * (l_f + l_r)))
        results.append(result("static_margin", margin[0], math.hypot(margin[1] - margin[0], margin[2] - margin[0]), n))
    else:
        notes.append("rear compliance, static margin: no sideslip angle was measured")
    return Found(results, notes, {"wheel": wheel, "a_y": a_y, "v": v, "r": r})


def crossing(t: Array, x: Array, level: float) -> float:
    """The first time at which x comes up to the level, linear between samples; NaN if never [s]."""
    above = x >= level
    if not above.any():
        return math.nan
    k = int(np.argmax(above))
    return float(t[0]) if k == 0 else float(t[k - 1] + (level - x[k - 1]) / (x[k] - x[k - 1]) * (t[k] - t[k - 1]))


def _step(manoeuvre: Manoeuvre, run: Run, vehicle: Vehicle) -> Iterator[Row]:
    """Of yaw rate and lateral acceleration: gain, delay (50 % of the angle to 50 % of the answer), response time (to
    90 %), time of the peak, overshoot over the steady value, all from 50 % of the angle. Source: ISO 7401, step input.
    """
    row = Row()
    after = run.between(0.0, manoeuvre.seconds)
    last = run.between(manoeuvre.seconds - 1.0, manoeuvre.seconds)
    t, wheel = run.t[after], run.about("delta_sw")
    size = wheel[last].mean()
    begin = crossing(t, wheel[after] / size, 0.5)
    for name, of in ANSWERS:
        answer = run.about(of)
        steady = answer[last].mean()
        x = answer[after] / steady
        top = int(np.argmax(x))
        row |= {
            f"{name}_gain": float(steady / size),
            f"{name}_delay": crossing(t, x, 0.5) - begin,
            f"{name}_response_time": crossing(t, x, 0.9) - begin,
            f"{name}_peak_time": float(t[top]) - begin if x[top] > 1.005 else math.nan,
            f"{name}_overshoot": max(float(x[top]) - 1.0, 0.0),
        }
    yield row


def _sine(manoeuvre: Manoeuvre, run: Run, vehicle: Vehicle) -> Iterator[Row]:
    """Gain of the first peaks and lag between them. Source: ISO 7401, one period of a sine."""
    use = run.between(0.0, 0.75 / manoeuvre.required.frequency)
    at = {of: peak(run.t[use], run.about(of)[use]) for of in ("delta_sw", "r", "a_y")}
    (begin, wheel), row = at["delta_sw"], Row()
    for name, of in ANSWERS:
        row |= {f"{name}_peak_gain": at[of][1] / wheel, f"{name}_lag": at[of][0] - begin}
    yield row


def peak(t: Array, x: Array) -> tuple[float, float]:
    """Time and value of the largest sample, by the parabola through it and its neighbours."""
    k = int(np.argmax(x))
    if not 0 < k < len(x) - 1:
        return float(t[k]), float(x[k])
    a, b, c = x[k - 1 : k + 2]
    bend = a - 2.0 * b + c
    shift = 0.5 * (a - c) / bend if bend else 0.0
    return float(t[k] + shift * (t[1] - t[0])), float(b - 0.25 * (a - c) * shift)


def _request(manoeuvre: Manoeuvre, run: Run, vehicle: Vehicle) -> Iterator[Row]:
    """From the request's beginning until the lateral acceleration is at 50 % of its first peak, and at the peak.

    Source: openpilot, tools/lateral_maneuvers (README; delay at 50 %, crossing time), to one sample.
    """
    use, level = run.between(0.0, manoeuvre.seconds), manoeuvre.required.a_y
    if not (level and "delta_sw_cmd" in run.signals):  # as in a log: what the wheel's angle asks
        level = float(np.abs(run.about("delta_sw")[use]).max() / vehicle.wheel_per_a_y(run["v"].mean()))
    t, x = run.t[use], run.about("a_y")[use] / level
    reached = lambda share: float(t[np.argmax(x >= share)]) if (x >= share).any() else math.nan  # noqa: E731
    yield {"delay_50": reached(0.5), "crossing": reached(1.0)}


def turned(run: Run) -> tuple[float, float]:
    """When the wheel is turned, and when it is straight again: a twentieth of its largest angle [s]."""
    wheel = np.abs(run.about("delta_sw"))
    times = run.t[wheel > 0.05 * wheel.max()]
    return float(times[0]), float(times[-1])


def _dwell(manoeuvre: Manoeuvre, run: Run, vehicle: Vehicle) -> Iterator[Row]:
    """Yaw rate 1.00 and 1.75 s after the wheel is straight again over its second peak; displacement 1.07 s after it is
    turned: both where the wheel passes a twentieth of its largest angle.

    The displacement is that of the centre of gravity, by twice integrating a_y where no position is known.
    Source: 49 CFR 571.126, S5.2, S7.11 (which takes 5 degrees of the wheel).
    """
    r, (begin, end) = run.about("r"), turned(run)
    second = -float(r[run.between(begin, end + 0.2)].min())
    at = lambda time, x: float(np.interp(time, run.t, x))  # noqa: E731
    if {"x", "y", "psi"} <= run.signals.keys():
        x, y = (at(begin + 1.07, run[name]) - at(begin, run[name]) for name in ("x", "y"))
        psi = at(begin, run["psi"])
        moved = y * math.cos(psi) - x * math.sin(psi)
    else:
        a_y = np.where(run.t >= begin, run.about("a_y"), 0.0)
        speed = scipy.integrate.cumulative_trapezoid(a_y, dx=run.dt, initial=0.0)
        moved = at(begin + 1.07, scipy.integrate.cumulative_trapezoid(speed, dx=run.dt, initial=0.0))
    ratios = {f"yaw_ratio_{late:.2f}": -at(end + late, r) / second for late in (1.0, 1.75)}
    yield {"peak_yaw_rate": second, **ratios, "lateral_displacement": moved}


def _on_centre(manoeuvre: Manoeuvre, run: Run, vehicle: Vehicle) -> Iterator[Row]:
    """The loop of a_y over the angle: half its width at a_y = 0 and at angle 0, its slope there, lag of the yaw rate.

    Every period but the first and the last half is a repeat. Source: ISO 13674-1 (weave); Norman 1984.
    """
    f = manoeuvre.required.frequency
    for k in range(1, int(manoeuvre.required.periods) - 1):
        use = run.between(k / f, (k + 1) / f - run.dt)
        wheel, a_y, r = (run[name][use] - run[name][use].mean() for name in ("delta_sw", "a_y", "r"))
        near = np.abs(wheel) < 0.2 * np.abs(wheel).max()
        turn = np.exp(-2j * np.pi * f * run.t[use])
        yield {
            "sensitivity": float(np.polyfit(wheel[near], a_y[near], 1)[0]),
            "hysteresis_angle": 0.5 * _zeros(a_y, wheel),
            "hysteresis_a_y": 0.5 * _zeros(wheel, a_y),
            "yaw_lag": -float(np.angle((r @ turn) / (wheel @ turn))) / (2.0 * np.pi * f),
            "a_y_lag": -float(np.angle((a_y @ turn) / (wheel @ turn))) / (2.0 * np.pi * f),
        }


def _zeros(x: Array, of: Array) -> float:
    """|of where x rises through 0 - of where it falls through it|, linear between samples; NaN where it does not."""
    found = list[float]()
    for sign in (1.0, -1.0):
        rows = np.flatnonzero((sign * x[:-1] < 0.0) & (sign * x[1:] >= 0.0))
        share = x[rows] / (x[rows] - x[rows + 1])
        found.append(float(np.mean(of[rows] + share * (of[rows + 1] - of[rows]))) if len(rows) else math.nan)
    return abs(found[0] - found[1])


def _transition(manoeuvre: Manoeuvre, run: Run, vehicle: Vehicle) -> Iterator[Row]:
    """Gain beyond the centre, and the dead band: twice the angle at which a line through a_y of 0.5 to 1.5 m/s^2 has
    none; what the yaw rate's lag adds to it is in it. Source: ISO 13674-2 (transition)."""
    use = run.between(0.0, manoeuvre.required.rise)
    wheel, a_y = run.about("delta_sw")[use], run.about("a_y")[use]
    inside = (a_y >= 0.5) & (a_y <= 1.5)
    gain, at = np.polyfit(wheel[inside], a_y[inside], 1) if inside.sum() > 10 else (math.nan, math.nan)
    yield {"a_y_gain": float(gain), "dead_band": float(-2.0 * at / gain)}


class Spectra(NamedTuple):
    """Fourier transforms of each segment (m, f) over the frequencies f [Hz]."""

    f: Array
    delta_sw: Array
    r: Array
    a_y: Array

    def response(self, answer: Array, keep: Any = slice(None)) -> tuple[Array, Array]:
        """H1 = S_wy/S_ww and the coherence, over the segments to keep; answer: r or a_y."""
        wheel, answer = self.delta_sw[keep], answer[keep]
        s_ww, s_wy = (np.abs(wheel) ** 2).sum(axis=0), (np.conj(wheel) * answer).sum(axis=0)
        return s_wy / s_ww, np.abs(s_wy) ** 2 / (s_ww * (np.abs(answer) ** 2).sum(axis=0))


def spectra(manoeuvre: Manoeuvre, runs: list[Run]) -> Spectra:
    """Segments of the runs: of a random input its periods but the first and the last, else whole runs.

    A whole run of another input is at rest at both ends, and a period of an input that repeats goes on as it began:
    neither needs a window. Periods of what does not repeat, as in a log, get Hann's.
    """
    wanted, parts, dt = manoeuvre.required, list[Array](), runs[0].dt
    low, high, random = 0.2, 3.0, wanted.form == "random"
    for run in runs:
        signals = np.array([run.about(name) for name in ("delta_sw", "r", "a_y")])
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
    return Spectra(np.asarray(f[use]), *spectrum.swapaxes(0, 1))


def model(theta: Sequence[float] | Array, f: Any) -> Any:
    """H(s) = G (1 + T s)/(1 + 2 D s/w + (s/w)^2) exp(-tau s) at s = 2 pi i f.

    The linear single track's yaw rate over the angle; theta: (G, T [s], w [rad/s], D, tau [s]), f (n,) [Hz].
    Source: Mitschke, Wallentowitz 2004, section 18.
    """
    gain, lead, natural, damping, delay = theta
    s = 2j * np.pi * f
    return gain * (1.0 + lead * s) / (1.0 + 2.0 * damping * s / natural + (s / natural) ** 2) * np.exp(-delay * s)


def second_order(f: Array, response: Array, weight: Array, start: Any = None) -> Array:
    """The theta of `model` by weighted least squares.

    f (n,) [Hz]; response (n,), complex; weight (n,), per relative error. Source: Ljung 1999, section 7.
    """

    def misses(theta: Array) -> Array:
        gain, lead, natural, damping, delay = theta
        error = weight * (model((gain, lead, max(natural, 0.1), damping, delay), f) / response - 1.0)
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
    m = len(found.r)
    if not m:
        return Found([], ["frequency response: no stretch is long enough for it"])
    response, coherence = found.response(found.r)
    use = np.asarray(coherence >= COHERENCE)
    use &= m > 1 or manoeuvre.required.form != "random"  # of one segment it is 1, whatever it says
    if use.sum() < 8:
        return Found([], [f"frequency response: {use.sum()} frequencies of coherence {COHERENCE:g}, expected 8"])
    weight = np.abs(response[use]) * np.sqrt((np.abs(found.delta_sw) ** 2).mean(axis=0)[use])  # as of white noise in r
    weight /= weight.mean()
    whole = second_order(found.f[use], response[use], weight)
    values, left_out = _read(whole), list[Row]()
    for k in range(m if m > 1 else 0):
        part, _ = found.response(found.r, np.arange(m) != k)
        left_out.append(_read(second_order(found.f[use], part[use], weight, whole)))
    results = []
    for name, value in values.items():
        half = math.nan
        if m > 1:
            without = np.array([row[name] for row in left_out])
            spread = math.sqrt((m - 1) / m * float(np.sum((without - np.mean(without)) ** 2)))
            half = float(scipy.special.stdtrit(m - 1, 0.975)) * spread
            value = m * value - (m - 1) * float(np.mean(without))  # less its bias
        beyond = name in ("natural_frequency", "damping") and values["natural_frequency"] > 2.0 * found.f[-1]
        results.append(result(name, value, half, m, BEYOND if beyond else ""))
    curves = {"f": found.f, "response": response, "coherence": coherence, "response_a_y": found.response(found.a_y)[0]}
    curves["model"] = model(whole, found.f)
    return Found(results, [] if m > 1 else ["frequency response: one repeat, so no interval"], curves)


def _read(theta: Array) -> Row:
    """What a fitted response is known by."""
    gain, lead, natural, damping, delay = (float(value) for value in theta)
    of_one = (1.0, lead, natural, damping, delay)
    f = np.linspace(0.01, 10.0, 2000)
    bandwidth = crossing(f, -np.abs(model(of_one, f)), -math.sqrt(0.5))
    return {
        "yaw_gain": gain,
        "natural_frequency": natural / (2.0 * math.pi),
        "damping": damping,
        "delay": delay,
        "bandwidth": bandwidth,
        "phase_1_hz": float(np.angle(model(of_one, 1.0))),
        "phase_bandwidth": float(np.angle(model(of_one, bandwidth))),
    }


def _course(manoeuvre: Manoeuvre, run: Run, vehicle: Vehicle) -> Iterator[Row]:
    """Cross-track error, lateral acceleration and jerk as UN R79 filters them, rate of the wheel."""
    row = {
        "max_a_y": float(np.abs(r79_acceleration(run.t, run["a_y"])).max()),
        "max_jerk": float(np.abs(r79_jerk(run.t, run["a_y"])).max()),
        "max_wheel_rate": float(np.abs(np.diff(run["delta_sw"])).max() / run.dt),
    }
    if "e" in run.signals:
        row |= {"max_e": float(np.abs(run["e"]).max()), "rms_e": rms(run["e"])}
    yield row


OF_EACH: Mapping[str, Callable[[Manoeuvre, Run, Vehicle], Iterator[Row]]] = {
    "step": _step,
    "sine": _sine,
    "on-centre": _on_centre,
    "transition": _transition,
    "dwell": _dwell,
    "request": _request,
    "course": _course,
}
"""Evaluations of one run, whose repeats make the interval ..."""
OF_ALL: Mapping[str, Callable[[Manoeuvre, list[Run], Vehicle], Found]] = {"steady": _steady, "frequency": _frequency}
"""... and of all runs together."""
