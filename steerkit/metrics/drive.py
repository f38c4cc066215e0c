"""The few metrics of a drive that say whether it was good."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of
from steerkit.metrics.signals import largest, lateral_jerk, rates, rms, share_within
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
    same_shapes("summary", {"t": t, "e": e, "delta_sw": delta_sw, "a_y": a_y})
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


def of_log(log: Log) -> Summary:
    """The metrics of a log with the signal names of `steering_loop`; raises KeyError for a signal not recorded."""
    return summary(t=log.t, e=log["path.e"], delta_sw=log["car.delta_sw"], a_y=log["car.a_y"])


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """What a drive of so many rounds has to keep to be called good; the bounds themselves are outside."""

    rounds: float = 1.0
    """Rounds of the course to complete [1]."""
    max_e: float = 0.25
    """Bound of the largest |e| [m]."""
    rms_e: float = 0.10
    """Bound of RMS e [m]."""
    max_jerk: float = 5.0
    """Bound of the 0.5 s-averaged lateral jerk [m/s^3]; source: ISO 11270:2014."""

    def met(self, drive: Summary) -> bool:
        """Is every figure below its bound? A NaN is not."""
        return all(getattr(drive, name) < getattr(self, name) for name in ("max_e", "rms_e", "max_jerk"))


GOOD = Criterion()
"""A good drive: a whole round with |e| < 0.25 m, RMS e < 0.10 m and lateral jerk < 5 m/s^3."""


def same_shapes(where: str, signals: dict[str, ArrayLike]) -> None:
    """Raise ValueError unless all signals have one shape."""
    shapes = {name: np.shape(signal) for name, signal in signals.items()}
    if len(set(shapes.values())) > 1:
        raise ValueError(f"{where}: shapes {shapes} differ, expected (T,) each; take one car of a batch at a time")
