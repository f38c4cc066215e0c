"""The list of all metrics: what each is called, its unit, its source, and which way is better; and all of one drive."""

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of
from steerkit.metrics.comfort import r79_acceleration, r79_jerk, weighted_acceleration
from steerkit.metrics.drive import same_shapes, summary
from steerkit.metrics.signals import accelerations, largest, magnitude_at, reversal_rate, rms, share_within, time_over


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


def as_markdown() -> str:
    """The table in Markdown, which docs/metrics.md holds."""
    rows = ["| name | unit | better | what | source | limit |", "|---|---|---|---|---|---|"]
    for m in TABLE:
        limit = "" if m.limit is None else f"{m.limit:g}"
        meaning = m.what.replace("|", "\\|")
        rows.append(f"| `{m.name}` | {m.unit} | {m.better} | {meaning} | {m.source} | {limit} |")
    return "\n".join(rows) + "\n"


def measures(*, t: ArrayLike, e: ArrayLike, psi_e: ArrayLike, delta_sw: ArrayLike, a_y: ArrayLike) -> dict[str, float]:
    """All metrics of one drive in `TABLE`, by name: of tracking, steering and comfort.

    t [s] (even), e [m], psi_e [rad], delta_sw [rad], a_y [m/s^2], each (T,). Those that `Summary` has are the same
    numbers. A metric whose signal holds a NaN is NaN (shares and times: count it as outside).
    Raises ValueError for signals of other shapes or lengths, uneven t, dt above 0.2 s or a record of about 0.5 s.
    """
    same_shapes("measures", {"t": t, "e": e, "psi_e": psi_e, "delta_sw": delta_sw, "a_y": a_y})
    heading_error = degrees_of(np.asarray(psi_e, dtype=float))
    wheel_acceleration = degrees_of(accelerations(t, delta_sw))
    found = vars(summary(t=t, e=e, delta_sw=delta_sw, a_y=a_y)) | {
        "p95_e": magnitude_at(e, 0.95),
        "share_within_25cm": share_within(e, 0.25),
        "time_over_50cm": time_over(t, e, 0.5),
        "rms_psi_e_deg": rms(heading_error),
        "max_psi_e_deg": largest(heading_error),
        "rms_wheel_acceleration_deg": rms(wheel_acceleration),
        "max_wheel_acceleration_deg": largest(wheel_acceleration),
        "large_reversals": reversal_rate(t, delta_sw, gap_deg=3.0, cutoff=0.6),
        "small_reversals": reversal_rate(t, delta_sw, gap_deg=0.1, cutoff=2.0),
        "max_a_y_r79": largest(r79_acceleration(t, a_y)),
        "max_jerk_r79": largest(r79_jerk(t, a_y)),
        "weighted_a_y": weighted_acceleration(t, a_y),
    }
    return {metric.name: found[metric.name] for metric in TABLE if metric.name in found}


def measures_of_log(log: Log) -> dict[str, float]:
    """`measures` of a log with the signal names of `steering_loop`; raises KeyError for a signal not recorded."""
    return measures(t=log.t, e=log["path.e"], psi_e=log["path.psi_e"], delta_sw=log["car.delta_sw"], a_y=log["car.a_y"])
