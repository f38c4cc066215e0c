"""Does it learn any car there is? Cars of the fleet, or of another kind, each on a course that nothing was tuned on.

Part of the study `learning`: `python -m benchmarks study learning --fleet 40 --seeds 1 [--json]`, and `--cars KIND` for
the cars of `KINDS`. The learner knows nothing of its car. Analytic controllers drive the same test once with the true
parameters (`Knowledge.oracle`, delay and lag) and once with the data sheet (mass, tyres, ratio; nothing of the
steering's delay, lag and offset). Play and sensor noise are unknown to all. A ratio is that of the learner's final net
to the analytic controller of the least RMS e.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks.run.spread import Where, computing
from benchmarks.run.trials import Ran, Taken, TrialDrive, drive_each, over, ran, train
from benchmarks.scenarios import MULTI_BODY
from benchmarks.tables import show
from steerkit.learning.experiment import Experiment
from steerkit.learning.settings import Setting
from steerkit.metrics import Summary, of_log
from steerkit.scenario import Scenario, drive, fleet_scenario, straightest

ORACLE = ("stanley-delay", "lqr", "mpc")
"""Analytic controllers that take a believed delay."""
TOLD_DATA_SHEET = ("stanley", "lqr", "mpc")
"""Those that a data sheet is enough for."""


def of_kind(name: str, **changes: Any) -> tuple[Scenario, ...]:
    """The cars of a kind, one of `KINDS`; changes: fields that are to be others."""
    return tuple(scenario.with_(**changes) for scenario in KINDS[name]())


def of_fleet(count: int, rounds: float = 1.0) -> tuple[Scenario, ...]:
    """The first `count` cars of the fleet, on so many rounds."""
    return tuple(fleet_scenario(number, course={"rounds": rounds}) for number in range(count))


def _delays(course: str, v_min: float, v_max: float) -> tuple[Scenario, ...]:
    driven: Any = dict(course={"name": course, "start": _start(course)}, driver={"v_min": v_min, "v_max": v_max})
    return tuple(
        Scenario.under("hard", name=f"{delay:g} s", steering={"delay": delay, "lag": 0.2}, **driven) for delay in DELAYS
    )


def _multi_body() -> tuple[Scenario, ...]:
    course = "random-2000"
    return (
        Scenario.under(
            "hard",
            name="multi-body",
            course={"name": course, "start": _start(course)},
            vehicle={"name": "bmw-320i", "plant": MULTI_BODY},
            steering={"delay": 0.2, "lag": 0.2},
        ),
    )


def _start(course: str) -> float:
    """Where the course hardly bends [m], for longer where cars are fast."""
    return straightest(Scenario(course=course).path(), 60.0 if course.startswith("sweeping") else 20.0)


DELAYS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Steering delays of the kinds `delays` and `fast-delays` [s]."""
KINDS: Mapping[str, Callable[[], tuple[Scenario, ...]]] = MappingProxyType(
    {
        "delays": lambda: _delays("random-2000", 4.0, 7.5),
        "fast-delays": lambda: _delays("sweeping-2000", 12.0, 25.0),
        "multi-body": _multi_body,
    }
)
"""Cars besides the fleet's: the Passat with a delay, at 4 to 7.5 and at 12 to 25 m/s; CommonRoad's multi-body BMW with
0.2 s of delay. All with `hard` sensors."""


@dataclass(frozen=True, kw_only=True)
class FleetOutcome(Ran):
    """What one car came to, beside the best analytic controllers."""

    name: str
    seed: int
    car: str
    delay: float
    lag: float
    offset_deg: float
    play_deg: float
    best: str
    rms_x_oracle: float
    wheel_x_oracle: float
    jerk_x_oracle: float
    best_on_data_sheet: str
    rms_x_data_sheet: float


def one_car(job: tuple[Scenario, int, Setting, float]) -> FleetOutcome:
    """Let the scenario's car learn with a seed for so many minutes, and compare its final net."""
    scenario, seed, setting, minutes = job
    trained = train(Experiment(setting=setting, scenario=scenario, minutes=minutes, seed=seed))
    test = seed + 1000

    def judged(net: Taken) -> TrialDrive:
        return drive_each(scenario, setting, [net.policy], seed=test)[0]

    best, truth = best_of(scenario.with_(knowledge={"oracle": True}), ORACLE, test)
    on_sheet, sheet = best_of(scenario.with_(knowledge={"delay": 0.0, "lag": 0.0}), TOLD_DATA_SHEET, test)
    final = judged(trained.nets[-1]) if trained.nets else None
    return FleetOutcome(
        name=scenario.name,
        seed=seed,
        car=scenario.vehicle.name,
        delay=scenario.steering.delay,
        lag=scenario.steering.lag,
        offset_deg=scenario.steering.offset_deg,
        play_deg=scenario.steering.play_deg,
        **ran(trained, judged),
        best=best,
        rms_x_oracle=over(final, "rms_e", truth),
        wheel_x_oracle=over(final, "rms_wheel_rate_deg", truth),
        jerk_x_oracle=over(final, "rms_jerk", truth),
        best_on_data_sheet=on_sheet,
        rms_x_data_sheet=over(final, "rms_e", sheet),
    )


def best_of(scenario: Scenario, names: Iterable[str], seed: int) -> tuple[str, Summary]:
    """The controller of the least RMS e on a whole test drive, and its metrics; one that was lost only if all were."""
    rows = [(name, of_log(drive.drive(scenario, drive.controller(name, scenario), seed=seed))) for name in names]
    return min(rows, key=lambda row: row[1].rms_e if math.isfinite(row[1].rms_e) else math.inf)


def summarise(outcomes: list[FleetOutcome]) -> dict[str, Any]:
    """Shares, medians and worst cases over cars; one that never got there counts as infinite, and is None here."""

    def finite(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    times = [np.inf if o.good is None else o.good for o in outcomes]
    ratios = {
        name: [getattr(o, name) for o in outcomes]
        for name in ("rms_x_oracle", "wheel_x_oracle", "jerk_x_oracle", "rms_x_data_sheet")
    }
    return {
        "cars": len(outcomes),
        "good_share": float(np.mean(np.isfinite(times))),
        "good_median_s": finite(np.median(times)),
        "good_worst_s": finite(np.max(times)),
        "failures_worst": int(max(o.failures for o in outcomes)),
        "departure_median_m": float(np.median([o.departure for o in outcomes])),
        "departure_worst_m": float(np.max([o.departure for o in outcomes])),
        "held_share": float(np.mean([o.held for o in outcomes])),
        **{name: finite(np.median(values)) for name, values in ratios.items()},
        "worst_rms_x_oracle": finite(np.max(ratios["rms_x_oracle"])),
        "stuck": int(sum(o.stuck for o in outcomes)),
    }


def fleet(
    cars: Sequence[Scenario], seeds: Sequence[int], setting: Setting, minutes: float, where: Where
) -> dict[str, Any]:
    """Run all cars with all seeds, a line each as it comes, then the table in their order."""
    jobs = [(car, seed, setting, minutes) for car in cars for seed in seeds]
    with computing(where) as those:
        outcomes = those.in_order(one_car, jobs, "cars")
    show(f"{len(cars)} cars, {minutes:g} minutes", [{"name": o.name, "car": o.car} | asdict(o) for o in outcomes])
    return {**summarise(outcomes), "outcomes": [asdict(o) for o in outcomes]}
