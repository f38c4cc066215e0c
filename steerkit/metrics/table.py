"""The list of all metrics: what each is called, its unit, its source, and which way is better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from steerkit.task import A_Y_MAX, TRIP

Group = Literal["tracking", "steering", "comfort", "computing", "learning"]


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One metric, as reports and documents speak of it."""

    name: str
    """Its key in results."""
    label: str
    """Its heading, short."""
    unit: str
    """SI, or degrees where the name ends in _deg; "1" is a pure number."""
    group: Group
    what: str
    """How it is measured, one line."""
    source: str
    lower_is_better: bool = True
    limit: float | None = None
    """The bound that the source sets, in the unit; None where it sets none."""


_PAPER = "Riedmiller, Montemerlo, Dahlkamp 2007"
_J2944 = "Markkula, Engström 2006; SAE J2944:2015"
_ISO_11270 = "ISO 11270:2014"
_R79 = "UN R79, 03 series, annex 8"
_PEER = "usual practice; autoware_control_evaluator has its signal"

TABLE: tuple[Metric, ...] = (
    Metric(
        name="rms_e",
        label="RMS e",
        unit="m",
        group="tracking",
        what="root mean square of the cross-track error e",
        source="usual practice",
    ),
    Metric(
        name="p95_e",
        label="95 % |e|",
        unit="m",
        group="tracking",
        what="the |e| that 95 % of the samples do not exceed",
        source="Hyndman, Fan 1996, definition 7",
    ),
    Metric(
        name="max_e",
        label="max |e|",
        unit="m",
        group="tracking",
        what="largest cross-track error",
        source=_PAPER,
        limit=TRIP,
    ),
    Metric(
        name="share_within_5cm",
        label="|e| < 0.05 m",
        unit="1",
        group="tracking",
        lower_is_better=False,
        what="share of the samples with |e| < 0.05 m, the goal band",
        source=_PAPER,
    ),
    Metric(
        name="share_within_25cm",
        label="|e| < 0.25 m",
        unit="1",
        group="tracking",
        lower_is_better=False,
        what="share of the samples with |e| < 0.25 m",
        source="the band of the paper's simulations, " + _PAPER,
    ),
    Metric(
        name="time_over_50cm",
        label="|e| > 0.5 m",
        unit="s",
        group="tracking",
        what="time with |e| > 0.5 m, where an episode fails",
        source=_PAPER,
    ),
    Metric(
        name="rms_psi_e_deg",
        label="RMS heading error",
        unit="deg",
        group="tracking",
        what="root mean square of psi_e; at the front axle a perfect drive has some in bends",
        source=_PEER,
    ),
    Metric(
        name="max_psi_e_deg",
        label="max heading error",
        unit="deg",
        group="tracking",
        what="largest |psi_e|",
        source=_PEER,
    ),
    Metric(
        name="rms_wheel_rate_deg",
        label="RMS wheel rate",
        unit="deg/s",
        group="steering",
        what="root mean square of the steering wheel's rate between samples",
        source=_PEER,
    ),
    Metric(
        name="rms_wheel_acceleration_deg",
        label="RMS wheel acceleration",
        unit="deg/s^2",
        group="steering",
        what="root mean square of the steering wheel's acceleration, second differences",
        source=_PEER,
    ),
    Metric(
        name="max_wheel_acceleration_deg",
        label="max wheel acceleration",
        unit="deg/s^2",
        group="steering",
        what="largest acceleration of the steering wheel",
        source=_PEER,
    ),
    Metric(
        name="large_reversals",
        label="reversals > 3°",
        unit="1/min",
        group="steering",
        what="steering reversals of more than 3 deg a minute, angle low-passed at 0.6 Hz",
        source=_J2944,
    ),
    Metric(
        name="small_reversals",
        label="reversals > 0.1°",
        unit="1/min",
        group="steering",
        what="steering reversals of more than 0.1 deg a minute, angle low-passed at 2 Hz",
        source=_J2944,
    ),
    Metric(
        name="max_a_y",
        label="max |a_y|",
        unit="m/s^2",
        group="comfort",
        what="largest lateral acceleration, unfiltered",
        source=_ISO_11270,
        limit=A_Y_MAX,
    ),
    Metric(
        name="max_a_y_r79",
        label="max |a_y|, R79",
        unit="m/s^2",
        group="comfort",
        what="largest lateral acceleration after a 4th-order Butterworth at 0.5 Hz",
        source=_R79,
        limit=A_Y_MAX,
    ),
    Metric(
        name="rms_jerk",
        label="RMS jerk",
        unit="m/s^3",
        group="comfort",
        what="root mean square of the lateral jerk averaged over 0.5 s",
        source=_ISO_11270,
    ),
    Metric(
        name="max_jerk",
        label="max jerk, ISO 11270",
        unit="m/s^3",
        group="comfort",
        what="largest lateral jerk averaged over 0.5 s",
        source=_ISO_11270,
        limit=5.0,
    ),
    Metric(
        name="max_jerk_r79",
        label="max jerk, R79",
        unit="m/s^3",
        group="comfort",
        what="largest 0.5 s average of the rate of the filtered lateral acceleration",
        source=_R79,
        limit=5.0,
    ),
    Metric(
        name="weighted_a_y",
        label="weighted a_y, ISO 2631-1",
        unit="m/s^2",
        group="comfort",
        limit=0.315,
        what="RMS of lateral acceleration through the weighting W_d; below 0.315 is not uncomfortable",
        source="ISO 2631-1:1997, equation 1, annexes A and C",
    ),
    Metric(
        name="step_p50_us",
        label="step time, median",
        unit="us",
        group="computing",
        what="median computing time of a control step",
        source="measured",
    ),
    Metric(
        name="step_p99_us",
        label="step time, 99 %",
        unit="us",
        group="computing",
        what="the computing time that 99 % of the control steps do not exceed",
        source="measured",
    ),
    Metric(
        name="round_minutes",
        label="driving to the first round",
        unit="min",
        group="learning",
        what="driving time until the first whole round was done, recovery and waiting included",
        source=_PAPER,
    ),
    Metric(
        name="round_episodes",
        label="episodes to the first round",
        unit="1",
        group="learning",
        what="episodes until the first whole round was done",
        source=_PAPER,
    ),
    Metric(
        name="good_minutes",
        label="driving to a good controller",
        unit="min",
        group="learning",
        what="driving time until a controller took the wheel that drives a good round (steerkit.metrics.GOOD)",
        source=_ISO_11270 + " (its jerk bound); ours",
    ),
    Metric(
        name="good_episodes",
        label="episodes to a good controller",
        unit="1",
        group="learning",
        what="episodes until then",
        source="ours",
    ),
    Metric(
        name="transitions",
        label="transitions",
        unit="1",
        group="learning",
        what="transitions recorded in the run",
        source=_PAPER,
    ),
    Metric(
        name="round_share",
        label="seeds with a round",
        unit="1",
        group="learning",
        lower_is_better=False,
        what="share of the seeds that drove a whole round, with Wilson's interval",
        source="Wilson 1927",
    ),
    Metric(
        name="good_share",
        label="seeds that became good",
        unit="1",
        group="learning",
        lower_is_better=False,
        what="share of the seeds that came to a good controller, with Wilson's interval",
        source="Wilson 1927",
    ),
)
"""Every metric, in the order in which reports show them."""

BY_NAME = {metric.name: metric for metric in TABLE}


def metric(name: str) -> Metric:
    """The metric of that name; raises KeyError with the valid names."""
    if name not in BY_NAME:
        raise KeyError(f"metric '{name}' is not known; valid: {', '.join(BY_NAME)}")
    return BY_NAME[name]


def as_markdown() -> str:
    """The table in Markdown, which docs/metrics.md holds."""
    rows = ["| name | unit | better | what | source | limit |", "|---|---|---|---|---|---|"]
    for m in TABLE:
        better = "lower" if m.lower_is_better else "higher"
        limit = "" if m.limit is None else f"{m.limit:g}"
        meaning = m.what.replace("|e|", "\\|e\\|").replace("|psi_e|", "\\|psi_e\\|")
        rows.append(f"| `{m.name}` | {m.unit} | {better} | {meaning} | {m.source} | {limit} |")
    return "\n".join(rows) + "\n"
