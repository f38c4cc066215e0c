"""Figures of one signal of one car: size, shares, rates; and the checks that all metrics share."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from steerkit._support.errors import require
from steerkit.diagram.maths import Array
from steerkit.diagram.units import degrees_of

JERK_WINDOW = 0.5
"""Length of the moving average of lateral jerk [s]; source: ISO 11270:2014, UN R79."""


def rms(signal: ArrayLike) -> float:
    """Root mean square of all samples, in the signal's unit; NaN if any sample is NaN."""
    return float(np.sqrt(np.mean(np.square(samples("rms", signal)))))


def largest(signal: ArrayLike) -> float:
    """Largest magnitude of all samples, in the signal's unit; NaN if any sample is NaN."""
    return float(np.abs(samples("largest", signal)).max())


def magnitude_at(signal: ArrayLike, share: float = 0.95) -> float:
    """The magnitude that `share` of the samples do not exceed, in the signal's unit; NaN if any sample is NaN.

    Interpolated between samples. Raises ValueError for a share outside 0 to 1. Source: Hyndman, Fan 1996, definition 7.
    """
    values = np.abs(samples("magnitude_at", signal))
    require(0.0 <= share <= 1.0, "magnitude_at", f"share {share:g} [1], expected 0 to 1")
    return float(np.quantile(values, share))


def share_within(signal: ArrayLike, bound: float) -> float:
    """Share of the samples with |signal| < bound, 0 to 1; a NaN counts as outside.

    Source: the goal band |e| < 0.05 m of Riedmiller, Montemerlo, Dahlkamp 2007.
    """
    return float(np.mean(np.abs(samples("share_within", signal)) < bound))


def time_over(t: ArrayLike, signal: ArrayLike, bound: float) -> float:
    """Time with |signal| > bound [s]: the number of such samples, times the sample time; a NaN counts as over.

    Source: the trip |e| > 0.5 m of Riedmiller, Montemerlo, Dahlkamp 2007.
    """
    values, dt = samples("time_over", signal), step(t, "time_over", signal)
    return float(np.count_nonzero(~(np.abs(values) <= bound))) * dt


def rates(t: ArrayLike, signal: ArrayLike) -> Array:
    """Mean rate of change between neighbouring samples [unit/s], (T - 1,)."""
    values, dt = samples("rates", signal), step(t, "rates", signal)
    return np.diff(values) / dt


def accelerations(t: ArrayLike, signal: ArrayLike) -> Array:
    """Second difference of a signal over dt^2 [unit/s^2], (T - 2,). Raises ValueError for fewer than three samples."""
    values, dt = samples("accelerations", signal), step(t, "accelerations", signal)
    require(len(values) >= 3, "accelerations", f"{len(values)} samples, expected at least 3")
    return np.diff(values, 2) / dt**2


def lateral_jerk(t: ArrayLike, a_y: ArrayLike) -> Array:
    """Lateral jerk as a moving average over 0.5 s [m/s^3]: (a_y(t) - a_y(t - 0.5 s)) / 0.5 s, which that average is.

    t (T,) [s], even; a_y (T,) [m/s^2]. Returns one value for each sample that has 0.5 s before it.
    Raises ValueError for uneven t, dt above 0.25 s or a record of no more than 0.5 s.
    Source: ISO 11270:2014 (limit 5 m/s^3; a_y at most 3 m/s^2).
    """
    values, dt = samples("lateral_jerk", a_y), step(t, "lateral_jerk")
    n = round(JERK_WINDOW / dt)
    expected = f"expected dt <= 0.25 s and more than {JERK_WINDOW} s of record"
    require(2 <= n < len(values), "lateral_jerk", f"{len(values)} samples at dt = {dt:g} s, {expected}")
    return (values[n:] - values[:-n]) / (n * dt)


def reversal_rate(t: ArrayLike, delta_sw: ArrayLike, *, gap_deg: float = 3.0, cutoff: float = 0.6) -> float:
    """Steering-wheel reversals a minute [1/min]: turns back by more than `gap_deg`, either way.

    The angle passes a second-order Butterworth low-pass at `cutoff` [Hz] forwards and backwards; between its turning
    points, up from the lowest since the last reversal by more than the gap is one reversal, and down likewise.
    3 deg at 0.6 Hz counts large corrections, 0.1 deg at 2 Hz small ones; both are the authors' choices.
    t (T,) [s], even; delta_sw (T,) [rad]. NaN if any sample is NaN. Raises ValueError for uneven t, a record of ten
    samples or fewer, or a cutoff that is not below half the sample rate.
    Source: Markkula, Engstrom 2006, adopted by SAE J2944:2015.
    """
    from scipy.signal import butter, filtfilt

    angle, dt = degrees_of(samples("reversal_rate", delta_sw)), step(t, "reversal_rate", delta_sw)
    given = f"{len(angle)} samples at dt = {dt:g} s, cutoff {cutoff:g} Hz, gap {gap_deg:g} deg"
    fits = len(angle) > 10 and 0.0 < cutoff < 0.5 / dt and gap_deg > 0.0
    require(fits, "reversal_rate", f"{given}; expected more than 10 samples, 0 < cutoff < 0.5/dt and gap > 0")
    if not np.isfinite(angle).all():
        return float("nan")
    smooth = filtfilt(*butter(2, cutoff, fs=1.0 / dt), angle, padlen=6)
    slope = np.sign(np.diff(smooth))
    turning = np.flatnonzero(slope[1:] * slope[:-1] <= 0.0) + 1
    points = smooth[np.concatenate([[0], turning])]  # the record's end is none: it may still go on
    return 60.0 * (_rises(points, gap_deg) + _rises(-points, gap_deg)) / (dt * (len(angle) - 1))


def _rises(points: Array, gap: float) -> int:
    """How often the points rise by more than the gap from the lowest since the last such rise."""
    count, lowest = 0, points[0]
    for point in points[1:]:
        if point - lowest > gap:
            count, lowest = count + 1, point
        else:
            lowest = min(lowest, point)
    return count


def samples(where: str, signal: ArrayLike) -> Any:
    """The signal as floats (T,); raises ValueError for anything else."""
    values = np.asarray(signal, dtype=float)
    one = values.ndim == 1 and len(values) > 0
    require(one, where, f"signal of shape {values.shape}, expected (T,) with T >= 1: one car, one signal")
    return values


def step(t: ArrayLike, where: str, signal: ArrayLike | None = None) -> float:
    """The sample time of evenly spaced t [s]; raises ValueError for uneven t or another length than the signal's."""
    times = samples(where, t)
    if signal is not None and np.shape(signal) != times.shape:
        raise ValueError(f"{where}: signal of shape {np.shape(signal)}, expected that of t, {times.shape}")
    require(len(times) >= 2, where, f"t has {len(times)} sample, expected at least 2")
    dt = float(times[-1] - times[0]) / (len(times) - 1)
    even = math.isfinite(dt) and dt > 0.0 and float(np.abs(np.diff(times) - dt).max()) < 1e-3 * dt
    require(even, where, "t is not evenly spaced and rising; resample the signals first")
    return dt


def lateral_cost(t: ArrayLike, a_y: ArrayLike, target: ArrayLike) -> dict[str, float]:
    """How well a target of lateral acceleration is followed: lataccel_cost, jerk_cost and total_cost [1].

        lataccel_cost = 100 mean (a_y - target)^2,  jerk_cost = 100 mean (da_y/dt)^2,  total = 50 lataccel + jerk

    t (T,) [s], even; a_y, target (T,) [m/s^2]. NaN where a sample is. Raises ValueError for uneven t or other lengths.
    Source: comma's controls challenge v2.
    """
    off = samples("lateral_cost", a_y) - samples("lateral_cost", target)
    lataccel, jerk = 100.0 * rms(off) ** 2, 100.0 * rms(rates(t, a_y)) ** 2
    return {"lataccel_cost": lataccel, "jerk_cost": jerk, "total_cost": 50.0 * lataccel + jerk}
