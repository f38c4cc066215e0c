"""The list of all metrics: what each is called, its unit, its source, and which way is better; and all of one drive."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy  # its parts load when they are first used
from numpy.typing import ArrayLike

from steerkit.diagram.maths import Array
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of
from steerkit.metrics import signals
from steerkit.metrics.drive import same_shapes, summary

R79_CUTOFF = 0.5
"""Cut-off of the filter of lateral acceleration [Hz]; source: UN R79, 03 series, annex 8."""
WEIGHTING_RATE = 1000.0
"""Least rate at which ISO 2631-1's filter runs [Hz]; slower records are interpolated first."""


def r79_acceleration(t: ArrayLike, a_y: ArrayLike) -> Array:
    """Lateral acceleration through a fourth-order Butterworth low-pass at 0.5 Hz [m/s^2], (T,).

    One pass forward, so it lags by about 0.8 s; before the record a_y is taken to have been what it is at its start.
    t (T,) [s], even; a_y (T,) [m/s^2] at the centre of gravity. Raises ValueError for uneven t or dt above 0.25 s.
    Source: UN R79, 03 series, annex 8; it asks for at least 100 samples a second, which is not enforced.
    """
    values, dt = signals.samples("r79_acceleration", a_y), signals.step(t, "r79_acceleration", a_y)
    if dt > 0.25:
        raise ValueError(f"r79_acceleration: dt = {dt:g} s, expected <= 0.25 s for a cut-off of {R79_CUTOFF:g} Hz")
    sos = scipy.signal.butter(4, R79_CUTOFF, fs=1.0 / dt, output="sos")
    filtered: Array = scipy.signal.sosfilt(sos, values, zi=scipy.signal.sosfilt_zi(sos) * values[0])[0]
    return filtered


def r79_jerk(t: ArrayLike, a_y: ArrayLike) -> Array:
    """Lateral jerk of UN R79 [m/s^3]: the 500 ms moving average of the rate of `r79_acceleration`.

    t (T,) [s], even; a_y (T,) [m/s^2]. Returns one value for each sample that has 0.5 s before it. Raises ValueError
    as `lateral_jerk` does. Source: UN R79, 03 series, 5.6.2.1.3 (limit 5 m/s^3) and annex 8.
    """
    return signals.lateral_jerk(t, r79_acceleration(t, a_y))


def wd_filter(rate: float) -> Array:
    """ISO 2631-1's weighting W_d (horizontal, seated) as digital second-order sections at `rate` [Hz], (3, 6).

        H(s) = s^2/(s^2 + sqrt(2) w1 s + w1^2) * w2^2/(s^2 + sqrt(2) w2 s + w2^2)
               * (1 + s/w3)/(1 + s/(Q4 w4) + s^2/w4^2)
        w = 2 pi f;  f1 = 0.4 Hz, f2 = 100 Hz, f3 = f4 = 2 Hz, Q4 = 0.63

    by the bilinear transform; below rate/20 its gain is H's within 1 %. Raises ValueError for a rate below 1000 Hz.
    Source: ISO 2631-1:1997, annex A, table A.1.
    """
    if not rate > 0.999 * WEIGHTING_RATE:
        raise ValueError(f"wd_filter: rate {rate:g} Hz, expected >= {WEIGHTING_RATE:g} Hz")
    w1, w2, w3, q4 = 2.0 * math.pi * 0.4, 2.0 * math.pi * 100.0, 2.0 * math.pi * 2.0, 0.63
    stages = (
        ([1.0, 0.0, 0.0], [1.0, math.sqrt(2.0) * w1, w1**2]),
        ([w2**2], [1.0, math.sqrt(2.0) * w2, w2**2]),
        ([1.0 / w3, 1.0], [1.0 / w3**2, 1.0 / (q4 * w3), 1.0]),
    )
    return np.concatenate([scipy.signal.tf2sos(*scipy.signal.bilinear(b, a, rate)) for b, a in stages])


def weighted_acceleration(t: ArrayLike, a_y: ArrayLike) -> float:
    """Frequency-weighted RMS acceleration a_w of the whole record [m/s^2]: a_y through W_d, then the RMS.

    t (T,) [s], even; a_y (T,) [m/s^2]. Records below 1000 Hz are interpolated by a band-limited filter first, for at
    20 Hz the bilinear transform would bend W_d; what lies above half the record's own rate it cannot know. Before the
    record a_y is taken to have been what it is at its start, so a steady bend weighs nothing.
    Comfort reactions (annex C): below 0.315 not uncomfortable, 0.5 to 1 fairly uncomfortable, above 2 extremely.
    Raises ValueError for uneven t. Source: ISO 2631-1:1997, equation 1, k_d = 1.
    """
    values, dt = signals.samples("weighted_acceleration", a_y), signals.step(t, "weighted_acceleration", a_y)
    times = math.ceil((1.0 - 1e-6) * WEIGHTING_RATE * dt)
    # both ends held for 2 s: the interpolator sees no edge there, and the weighting starts at rest
    held = math.ceil(2.0 / dt)
    long = np.pad(values - values[0], held, mode="edge")
    fine = scipy.signal.resample_poly(long, times, 1, padtype="edge")
    weighted = scipy.signal.sosfilt(wd_filter(times / dt), fine)
    return signals.rms(weighted[held * times : (held + len(values)) * times])


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One metric, as reports and documents speak of it: a row of `table.csv`."""

    name: str
    """Its key in results."""
    label: str
    """Its heading, short."""
    unit: str
    """SI, or degrees where the name ends in _deg; "1" is a pure number."""
    group: str
    """tracking, steering, comfort, computing or learning."""
    what: str
    """How it is measured, one line."""
    source: str
    better: str = "lower"
    """lower or higher."""
    limit: float | None = None
    """The bound that the source sets, in the unit; None where it sets none."""

    @property
    def lower_is_better(self) -> bool:
        """Is less better?"""
        return self.better == "lower"


def _read(file: Path) -> tuple[Metric, ...]:
    with file.open(encoding="utf-8", newline="") as lines:
        rows = [*csv.DictReader(lines)]
    return tuple([Metric(**{**row, "limit": float(row["limit"]) if row["limit"] else None}) for row in rows])  # type: ignore[arg-type]


TABLE = _read(Path(__file__).with_suffix(".csv"))
"""Every metric, in the order in which reports show them."""


def measures(*, t: ArrayLike, e: ArrayLike, psi_e: ArrayLike, delta_sw: ArrayLike, a_y: ArrayLike) -> dict[str, float]:
    """All metrics of one drive in `TABLE`, by name: of tracking, steering and comfort.

    t [s] (even), e [m], psi_e [rad], delta_sw [rad], a_y [m/s^2], each (T,). Those that `Summary` has are the same
    numbers. A metric whose signal holds a NaN is NaN (shares and times: count it as outside).
    Raises ValueError for signals of other shapes or lengths, uneven t, dt above 0.2 s or a record of about 0.5 s.
    """
    same_shapes("measures", {"t": t, "e": e, "psi_e": psi_e, "delta_sw": delta_sw, "a_y": a_y})
    heading_error = degrees_of(np.asarray(psi_e, dtype=float))
    wheel_acceleration = degrees_of(signals.accelerations(t, delta_sw))
    found = vars(summary(t=t, e=e, delta_sw=delta_sw, a_y=a_y)) | {
        "p95_e": signals.magnitude_at(e, 0.95),
        "share_within_25cm": signals.share_within(e, 0.25),
        "time_over_50cm": signals.time_over(t, e, 0.5),
        "rms_psi_e_deg": signals.rms(heading_error),
        "max_psi_e_deg": signals.largest(heading_error),
        "rms_wheel_acceleration_deg": signals.rms(wheel_acceleration),
        "max_wheel_acceleration_deg": signals.largest(wheel_acceleration),
        "large_reversals": signals.reversal_rate(t, delta_sw, gap_deg=3.0, cutoff=0.6),
        "small_reversals": signals.reversal_rate(t, delta_sw, gap_deg=0.1, cutoff=2.0),
        "max_a_y_r79": signals.largest(r79_acceleration(t, a_y)),
        "max_jerk_r79": signals.largest(r79_jerk(t, a_y)),
        "weighted_a_y": weighted_acceleration(t, a_y),
    }
    return {metric.name: found[metric.name] for metric in TABLE if metric.name in found}


def measures_of_log(log: Log) -> dict[str, float]:
    """`measures` of a log with the signal names of `steering_loop`; raises KeyError for a signal not recorded."""
    return measures(t=log.t, e=log["path.e"], psi_e=log["path.psi_e"], delta_sw=log["car.delta_sw"], a_y=log["car.a_y"])
