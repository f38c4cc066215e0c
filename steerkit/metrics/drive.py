"""The metrics of one drive: the few that criteria use, and all of the table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from steerkit.diagram.simulation import Log, Signal
from steerkit.diagram.units import degrees_of
from steerkit.metrics.comfort import lateral_jerk, r79_acceleration, r79_jerk, weighted_acceleration
from steerkit.metrics.signals import largest, magnitude_at, rates, rms, share_within, time_over
from steerkit.metrics.steering import accelerations, reversal_rate
from steerkit.task import GOAL


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
    _same_shapes("summary", {"t": t, "e": e, "delta_sw": delta_sw, "a_y": a_y})
    jerk = lateral_jerk(t, a_y)
    times = np.asarray(t, dtype=float)
    return Summary(
        duration=float(times[-1] - times[0]),
        rms_e=rms(e),
        max_e=largest(e),
        share_within_5cm=share_within(e, GOAL),
        rms_wheel_rate_deg=rms(degrees_of(rates(t, delta_sw))),
        max_a_y=largest(a_y),
        rms_jerk=rms(jerk),
        max_jerk=largest(jerk),
    )


def of_log(log: Log, *, e: Signal = "path.e", delta_sw: Signal = "car.delta_sw", a_y: Signal = "car.a_y") -> Summary:
    """The metrics of a log with the signal names of `steering_loop`; raises KeyError for a signal not recorded."""
    return summary(t=log.t, e=log[e], delta_sw=log[delta_sw], a_y=log[a_y])


def measures(*, t: ArrayLike, e: ArrayLike, psi_e: ArrayLike, delta_sw: ArrayLike, a_y: ArrayLike) -> dict[str, float]:
    """All metrics of one drive in `table.TABLE`, by name: of tracking, steering and comfort.

    t [s] (even), e [m], psi_e [rad], delta_sw [rad], a_y [m/s^2], each (T,). Those that `Summary` has are the same
    numbers. A metric whose signal holds a NaN is NaN (shares and times: count it as outside).
    Raises ValueError for signals of other shapes or lengths, uneven t, dt above 0.2 s or a record of about 0.5 s.
    """
    _same_shapes("measures", {"t": t, "e": e, "psi_e": psi_e, "delta_sw": delta_sw, "a_y": a_y})
    few = summary(t=t, e=e, delta_sw=delta_sw, a_y=a_y)
    wheel_acceleration = degrees_of(accelerations(t, delta_sw))
    return {
        "rms_e": few.rms_e,
        "p95_e": magnitude_at(e, 0.95),
        "max_e": few.max_e,
        "share_within_5cm": few.share_within_5cm,
        "share_within_25cm": share_within(e, 0.25),
        "time_over_50cm": time_over(t, e, 0.5),
        "rms_psi_e_deg": rms(degrees_of(np.asarray(psi_e, dtype=float))),
        "max_psi_e_deg": largest(degrees_of(np.asarray(psi_e, dtype=float))),
        "rms_wheel_rate_deg": few.rms_wheel_rate_deg,
        "rms_wheel_acceleration_deg": rms(wheel_acceleration),
        "max_wheel_acceleration_deg": largest(wheel_acceleration),
        "large_reversals": reversal_rate(t, delta_sw, gap_deg=3.0, cutoff=0.6),
        "small_reversals": reversal_rate(t, delta_sw, gap_deg=0.1, cutoff=2.0),
        "max_a_y": few.max_a_y,
        "max_a_y_r79": largest(r79_acceleration(t, a_y)),
        "rms_jerk": few.rms_jerk,
        "max_jerk": few.max_jerk,
        "max_jerk_r79": largest(r79_jerk(t, a_y)),
        "weighted_a_y": weighted_acceleration(t, a_y),
    }


def measures_of_log(
    log: Log,
    *,
    e: Signal = "path.e",
    psi_e: Signal = "path.psi_e",
    delta_sw: Signal = "car.delta_sw",
    a_y: Signal = "car.a_y",
) -> dict[str, float]:
    """`measures` of a log with the signal names of `steering_loop`; raises KeyError for a signal not recorded."""
    return measures(t=log.t, e=log[e], psi_e=log[psi_e], delta_sw=log[delta_sw], a_y=log[a_y])


def step_times(seconds: ArrayLike) -> dict[str, float]:
    """Median and 99th percentile of a controller's computing times a step [us], by their names in the table.

    seconds (n,): measured, finite, >= 0 [s]. Raises ValueError for others: a clock that was not read is no zero.
    """
    times = np.asarray(seconds, dtype=float)
    if times.ndim != 1 or not len(times) or not (np.isfinite(times) & (times >= 0.0)).all():
        raise ValueError(f"step_times: shape {times.shape}, expected (n,) with n >= 1 of finite seconds >= 0")
    median, late = np.quantile(times, [0.5, 0.99])
    return {"step_p50_us": 1e6 * float(median), "step_p99_us": 1e6 * float(late)}


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
        faults = [] if rounds >= self.rounds else [f"{rounds:.2f} rounds, expected {self.rounds:g}"]
        for name, unit in (("max_e", "m"), ("rms_e", "m"), ("max_jerk", "m/s^3")):
            value, bound = getattr(drive, name), getattr(self, name)
            if not value < bound:
                faults.append(f"{name} {value:.3g} {unit}, expected < {bound:g} {unit}")
        return tuple(faults)

    def met(self, drive: Summary, *, rounds: float) -> bool:
        """Was the drive of `rounds` rounds good?"""
        return not self.failures(drive, rounds=rounds)


GOOD = Criterion()
"""A good drive: a whole round with |e| < 0.25 m, RMS e < 0.10 m and lateral jerk < 5 m/s^3."""


def _same_shapes(where: str, signals: dict[str, ArrayLike]) -> None:
    shapes = {name: np.shape(signal) for name, signal in signals.items()}
    if len(set(shapes.values())) > 1:
        raise ValueError(f"{where}: shapes {shapes} differ, expected (T,) each; take one car of a batch at a time")
