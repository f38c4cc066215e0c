"""How often the steering wheel turns back."""

from __future__ import annotations

import numpy as np
import scipy  # its parts load when they are first used
from numpy.typing import ArrayLike

from steerkit.diagram.units import degrees_of
from steerkit.metrics.signals import Array, samples, step


def reversal_rate(t: ArrayLike, delta_sw: ArrayLike, *, gap_deg: float = 3.0, cutoff: float = 0.6) -> float:
    """Steering-wheel reversals a minute [1/min]: turns back by more than `gap_deg`, either way.

    The angle passes a second-order Butterworth low-pass at `cutoff` [Hz] forwards and backwards; between its turning
    points, up from the lowest since the last reversal by more than the gap is one reversal, and down likewise.
    3 deg at 0.6 Hz counts large corrections, 0.1 deg at 2 Hz small ones; both are the authors' choices.
    t (T,) [s], even; delta_sw (T,) [rad]. NaN if any sample is NaN. Raises ValueError for uneven t, a record of ten
    samples or fewer, or a cutoff that is not below half the sample rate.
    Source: Markkula, Engstrom 2006, adopted by SAE J2944:2015.
    """
    angle, dt = degrees_of(samples("reversal_rate", delta_sw)), step(t, "reversal_rate", delta_sw)
    if len(angle) <= 10 or not 0.0 < cutoff < 0.5 / dt or not gap_deg > 0.0:
        raise ValueError(
            f"reversal_rate: {len(angle)} samples at dt = {dt:g} s, cutoff {cutoff:g} Hz, gap {gap_deg:g} deg; "
            "expected more than 10 samples, 0 < cutoff < 0.5/dt and gap > 0"
        )
    if not np.isfinite(angle).all():
        return float("nan")
    smooth = scipy.signal.filtfilt(*scipy.signal.butter(2, cutoff, fs=1.0 / dt), angle, padlen=6)
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
