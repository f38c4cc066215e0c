"""How well a car was steered: the few numbers that reports and criteria use, with their sources."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steerkit.simulation import Log, Signal
from steerkit.units import degrees_of

Array = NDArray[np.float64]

JERK_WINDOW = 0.5
"""Length of the moving average of lateral jerk [s]; source: ISO 11270:2014."""


def rms(signal: ArrayLike) -> float:
    """Root mean square of all samples, in the signal's unit; NaN if any sample is NaN."""
    return float(np.sqrt(np.mean(np.square(_samples("rms", signal)))))


def largest(signal: ArrayLike) -> float:
    """Largest magnitude of all samples, in the signal's unit; NaN if any sample is NaN."""
    return float(np.abs(_samples("largest", signal)).max())


def share_within(signal: ArrayLike, bound: float) -> float:
    """Share of the samples with |signal| < bound, 0 to 1; a NaN counts as outside.

    Source: the goal band |e| < 0.05 m of Riedmiller, Montemerlo, Dahlkamp 2007.
    """
    return float(np.mean(np.abs(_samples("share_within", signal)) < bound))


def rates(t: ArrayLike, signal: ArrayLike) -> Array:
    """Mean rate of change between neighbouring samples [unit/s], (T - 1,)."""
    values, dt = _samples("rates", signal), _step(t, "rates")
    return np.diff(values) / dt


def lateral_jerk(t: ArrayLike, a_y: ArrayLike) -> Array:
    """Lateral jerk as a moving average over 0.5 s [m/s^3]: (a_y(t) - a_y(t - 0.5 s)) / 0.5 s, which that average is.

    t (T,) [s], even; a_y (T,) [m/s^2]. Returns one value for each sample that has 0.5 s before it.
    Raises ValueError for uneven t, dt above 0.25 s or a record of no more than 0.5 s.
    Source: ISO 11270:2014 (limit 5 m/s^3; a_y at most 3 m/s^2); UN R79 measures jerk the same way.
    """
    values, dt = _samples("lateral_jerk", a_y), _step(t, "lateral_jerk")
    n = round(JERK_WINDOW / dt)
    if n < 2 or len(values) <= n:
        raise ValueError(
            f"lateral_jerk: {len(values)} samples at dt = {dt:g} s, expected dt <= 0.25 s and more than "
            f"{JERK_WINDOW} s of record"
        )
    return (values[n:] - values[:-n]) / (n * dt)


@dataclass(frozen=True, kw_only=True)
class Summary:
    """The metrics of one drive of one car; any of them is NaN if its signal holds a NaN (the share: counts it out)."""

    duration: float
    """From the first to the last sample [s]."""
    rms_e: float
    """RMS cross-track error [m]."""
    max_e: float
    """Largest |e| [m]."""
    share_within_5cm: float
    """Share of the samples with |e| < 0.05 m [1]."""
    rms_wheel_rate_deg: float
    """RMS rate of the steering wheel, between samples [deg/s]."""
    max_a_y: float
    """Largest |a_y| [m/s^2]."""
    rms_jerk: float
    """RMS of the 0.5 s-averaged lateral jerk [m/s^3]."""
    max_jerk: float
    """Largest magnitude of the 0.5 s-averaged lateral jerk [m/s^3]."""


def summary(*, t: ArrayLike, e: ArrayLike, delta_sw: ArrayLike, a_y: ArrayLike) -> Summary:
    """The metrics of a drive: t [s] (even), e [m], delta_sw [rad], a_y [m/s^2], each (T,).

    Raises ValueError for signals of other shapes or lengths, uneven t, or less than about 0.5 s of record.
    """
    lengths = {name: np.shape(s) for name, s in {"t": t, "e": e, "delta_sw": delta_sw, "a_y": a_y}.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"summary: shapes {lengths} differ, expected (T,) each; take one car of a batch at a time")
    jerk = lateral_jerk(t, a_y)
    times = np.asarray(t, dtype=float)
    return Summary(
        duration=float(times[-1] - times[0]),
        rms_e=rms(e),
        max_e=largest(e),
        share_within_5cm=share_within(e, 0.05),
        rms_wheel_rate_deg=rms(degrees_of(rates(t, delta_sw))),
        max_a_y=largest(a_y),
        rms_jerk=rms(jerk),
        max_jerk=largest(jerk),
    )


def of_log(log: Log, *, e: Signal = "path.e", delta_sw: Signal = "car.delta_sw", a_y: Signal = "car.a_y") -> Summary:
    """The metrics of a log with the signal names of `steering_loop`; raises KeyError for a signal not recorded."""
    return summary(t=log.t, e=log[e], delta_sw=log[delta_sw], a_y=log[a_y])


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """What a drive has to keep to be called good; the bounds themselves are outside."""

    rounds: float = 1.0
    """Rounds of the course to complete [1]."""
    max_e: float = 0.25
    """Bound of the largest |e| [m]."""
    rms_e: float = 0.10
    """Bound of RMS e [m]."""
    max_jerk: float = 5.0
    """Bound of the 0.5 s-averaged lateral jerk [m/s^3]; source: ISO 11270:2014."""

    def failures(self, drive: Summary, *, rounds: float) -> tuple[str, ...]:
        """What the drive of `rounds` rounds failed at, in words; empty if it was good. A NaN is a failure."""
        found = [] if rounds >= self.rounds else [f"{rounds:.2f} rounds, expected {self.rounds:g}"]
        for name, unit in (("max_e", "m"), ("rms_e", "m"), ("max_jerk", "m/s^3")):
            value, bound = getattr(drive, name), getattr(self, name)
            if not value < bound:
                found.append(f"{name} {value:.3g} {unit}, expected < {bound:g} {unit}")
        return tuple(found)

    def met(self, drive: Summary, *, rounds: float) -> bool:
        """Was the drive of `rounds` rounds good?"""
        return not self.failures(drive, rounds=rounds)


GOOD = Criterion()
"""A good drive: a whole round with |e| < 0.25 m, RMS e < 0.10 m and lateral jerk < 5 m/s^3."""


def _samples(where: str, signal: ArrayLike) -> Any:
    values = np.asarray(signal, dtype=float)
    if values.ndim != 1 or not len(values):
        raise ValueError(f"{where}: signal of shape {values.shape}, expected (T,) with T >= 1: one car, one signal")
    return values


def _step(t: ArrayLike, where: str) -> float:
    times = _samples(where, t)
    if len(times) < 2:
        raise ValueError(f"{where}: t has {len(times)} sample, expected at least 2")
    dt = float(times[-1] - times[0]) / (len(times) - 1)
    if not (math.isfinite(dt) and dt > 0.0 and float(np.abs(np.diff(times) - dt).max()) < 1e-3 * dt):
        raise ValueError(f"{where}: t is not evenly spaced and rising; resample the signals first")
    return dt
