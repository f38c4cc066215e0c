"""Recovery on cars that no one here wrote, at several speeds, told their dead time rightly, wrongly or not at all.

Every drive starts 1 m and 5 degrees off, to either side by its seed, where a course hardly bends: `random-N` below 8
m/s, `sweeping-N` (wide bends and straights) above, N by the seed. Cars: `torque`, made from the measured answers of a
production car (`benchmarks.plants.torque_car`); `mujoco`, a free body on four suspended wheels; `commonroad-1` to
`-3`, CommonRoad's multi-body cars. The torque car has 0.5 s of dead time of its own, the others 0.2 s and a motor.

* recovery_max_e: largest |e| after 15 s, of the worst drive.
* recovery_swings: drives with a limit cycle: after 15 s, four half-periods on end or more whose durations are within a
  factor of 1.5 of their median, and whose turning points are 0.2 m apart or more (an amplitude of 0.1 m). What wind or
  wander does is not as regular.
* recovery_back_share: drives that are within 0.3 m at 15 s; recovery_stays_share: within 0.5 m from then on.

They are those of `auto`, the recovery that the catalogue picks, over all drives; `rows` has each controller, car, speed
and dead time told. A drive is lost, and ends, at |e| = 20 m. Told `none`: that there is no dead time.

    python -m benchmarks study foreign [--controllers NAME ...] [--cars CAR ...] [--seeds N] [--quick] [--json]
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.peers.commonroad import VANAGON_FILE
from benchmarks.run import spread
from benchmarks.scenarios import MULTI_BODY
from steerkit.diagram.simulation import simulate
from steerkit.diagram.units import radians_of
from steerkit.scenario import Scenario
from steerkit.scenario.assembly import placed
from steerkit.scenario.catalogue import AUTO, RECOVERIES, make_controller, make_recovery
from steerkit.scenario.drive import assembled
from steerkit.scenario.fleet import straightest
from steerkit.scenario.scenario import CONDITIONS

BACK, SETTLED, STAYS, LOST = 15.0, 0.3, 0.5, 20.0  # s, m, m, m
AMPLITUDE, HALVES, REGULAR = 0.1, 4, 1.5  # m, half-periods, factor
OFF, TURNED = 1.0, radians_of(5.0)
TOLD = ("0.5", "1", "1.5", "none")
_MOTOR = {"delay": 0.2, "lag": 0.12}


@dataclass(frozen=True)
class Foreign:
    """A foreign car: plant and data sheet, the steering in front of it or told of it, and speeds."""

    plant: str
    steering: Mapping[str, Any]
    vehicle: Mapping[str, str] = field(default_factory=lambda: {"name": "vw-passat"})
    speeds: tuple[float, ...] = (5.0, 10.0, 20.0)


CARS: Mapping[str, Foreign] = MappingProxyType(
    {
        "torque": Foreign(
            plant="benchmarks.plants.torque_car:TorqueCar",
            steering={"command": "torque", "delay": 0.5, "lag": 0.1, "slew": 5.0, "a_y_limit": 3.0},
            speeds=(8.0, 12.0, 16.0),
        ),
        "mujoco": Foreign("benchmarks.plants.mujoco_car:MujocoCar", _MOTOR),
        "commonroad-1": Foreign(MULTI_BODY, _MOTOR, {"name": "ford-escort"}),
        "commonroad-2": Foreign(MULTI_BODY, _MOTOR, {"name": "bmw-320i"}),
        "commonroad-3": Foreign(MULTI_BODY, _MOTOR, VANAGON_FILE),
    }
)


@dataclass(frozen=True)
class Job:
    """One drive."""

    car: str
    speed: float
    told: str
    controller: str
    seed: int
    seconds: float
    conditions: str


@dataclass(frozen=True)
class Recovery:
    """What became of it; after `BACK`."""

    max_e: float
    back: bool
    stays: bool
    swing: float
    """Amplitude of a limit cycle [m]; 0 without one."""
    period: float
    """Its period [s]; NaN without one."""


@lru_cache(maxsize=64)
def scene(car: str, speed: float, seed: int, conditions: str = "clean") -> Scenario:
    """That car at that speed, told the truth."""
    foreign, course = CARS[car], f"{'sweeping' if speed >= 8.0 else 'random'}-{7 + seed}"
    start = straightest(Scenario(course=course).path(), 10.0 * speed if speed >= 8.0 else 20.0)
    return Scenario.under(
        conditions,
        name=car,
        course={"name": course, "start": start},
        vehicle={**foreign.vehicle, "plant": foreign.plant},
        driver={"v_min": speed, "v_max": speed},
        steering=dict(foreign.steering),
    )


def told(scenario: Scenario, factor: str) -> Scenario:
    """The scenario with that much of its dead time told: a factor, or `none`."""
    return scenario.with_(knowledge={"delay": 0.0 if factor == "none" else float(factor) * scenario.believed_dead_time})


def one_drive(job: Job) -> Recovery:
    """Drive it."""
    scenario = told(scene(job.car, job.speed, job.seed, job.conditions), job.told)
    make = make_recovery if job.controller in RECOVERIES else make_controller
    loop = assembled(scenario, make(job.controller, scenario.design_model()), seed=job.seed)
    side, turn = (1.0 if job.seed % 2 == 0 else -1.0), (1.0 if job.seed // 2 % 2 == 0 else -1.0)
    start = placed(loop.blocks["car"], scenario.path(), s=scenario.course.start, e=side * OFF, psi_e=turn * TURNED)
    log = simulate(
        loop.with_block("car", start),
        job.seconds,
        every=5,
        until=lambda sample: not abs(sample["path.e"]) < LOST,
        allow_nonfinite=True,
    )
    return judged(log.t, log["path.e"], job.seconds)


def judged(t: Any, e: Any, seconds: float) -> Recovery:
    """What a drive's e [m] at times t [s] shows, if it should have lasted that long [s]."""
    lost = not (t[-1] >= seconds - 0.1 and np.isfinite(e).all())
    late = t >= min(BACK, 0.5 * t[-1] if lost else BACK)
    largest = math.inf if lost else float(np.abs(e[late]).max())
    amplitude, period = limit_cycle(t[late], e[late])
    back = not lost and abs(float(e[late][0])) <= SETTLED
    return Recovery(max_e=largest, back=back, stays=largest <= STAYS, swing=amplitude, period=period)


def limit_cycle(t: Any, e: Any) -> tuple[float, float]:
    """Amplitude [m] and period [s] of the swinging in e [m] over t [s]; 0 and NaN where it is none.

    A turning point is one from which e comes back by twice `AMPLITUDE`. The last half-periods count, as many of them as
    are regular.
    """
    turns, rising, at = list[tuple[float, float]](), 0, 0
    for k in range(1, len(e)):
        ahead = (e[k] - e[at]) * rising
        if rising == 0:
            moved = e[k] - e[0]
            if abs(moved) >= 2.0 * AMPLITUDE:
                rising, at = (1 if moved > 0.0 else -1), k
        elif ahead >= 0.0:
            at = k
        elif ahead <= -2.0 * AMPLITUDE:
            turns.append((float(t[at]), float(e[at])))
            rising, at = -rising, k
    times, places = np.array(turns).reshape(-1, 2).T
    for end in range(len(times), HALVES, -1):
        halves = np.diff(times[end - HALVES - 1 : end])
        middle = float(np.median(halves))
        if (halves <= REGULAR * middle).all() and (halves >= middle / REGULAR).all():
            return 0.5 * float(np.median(np.abs(np.diff(places[end - HALVES - 1 : end])))), 2.0 * middle
    return 0.0, math.nan


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick is one drive of 25 s."""
    parser.add_argument("--controllers", nargs="+", default=[], metavar="NAME", help=f"beside {AUTO}")
    parser.add_argument(
        "--cars", nargs="+", default=list(CARS), choices=list(CARS), metavar="CAR", help=", ".join(CARS)
    )
    parser.add_argument("--told", nargs="+", default=list(TOLD), metavar="X", help="times the true dead time, or none")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=40.0, help="of each drive")
    parser.add_argument("--conditions", default="clean", choices=list(CONDITIONS))
    spread.add_options(parser)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Make the drives, print a table."""
    quick = options.quick
    seeds = range(options.first_seed, options.first_seed + (1 if quick else options.seeds))
    jobs = [
        Job(car, speed, factor, name, seed, 25.0 if quick else options.seconds, options.conditions)
        for car in (options.cars[:1] if quick else options.cars)
        for name in (AUTO, *options.controllers)
        for speed in CARS[car].speeds[: 1 if quick else None]
        for factor in (("1",) if quick else options.told)
        for seed in seeds
    ]
    err = Console(stderr=True)
    with spread.computing(spread.where(options)) as those:
        made = dict(track(those.done(one_drive, jobs, say=err.print), total=len(jobs), console=err))
    drives = [(job, made[number]) for number, job in enumerate(jobs)]
    rows = [
        {"controller": name, "car": car, "speed": speed, "told": factor}
        | figures([drive for job, drive in drives if (job.controller, job.car, job.speed, job.told) == key])
        for key in dict.fromkeys((job.controller, job.car, job.speed, job.told) for job in jobs)
        for name, car, speed, factor in (key,)
    ]
    table = Table(*[name.replace("_", " ") for name in rows[0]])
    for row in rows:
        table.add_row(*[f"{value:.3g}" if isinstance(value, float) else str(value) for value in row.values()])
    Console(width=150).print(table)
    return {
        **figures([drive for job, drive in drives if job.controller == AUTO]),
        "rows": rows,
        "drives": [asdict(job) | asdict(drive) for job, drive in drives],
    }


def figures(drives: Sequence[Recovery]) -> dict[str, Any]:
    """Worst cases, counts and shares over drives."""
    return {
        "recovery_drives": len(drives),
        "recovery_max_e": max(drive.max_e for drive in drives),
        "recovery_swings": sum(drive.swing > 0.0 for drive in drives),
        "recovery_swing_worst": max(drive.swing for drive in drives),
        "recovery_lost": sum(not math.isfinite(drive.max_e) for drive in drives),
        "recovery_back_share": float(np.mean([drive.back for drive in drives])),
        "recovery_stays_share": float(np.mean([drive.stays for drive in drives])),
    }
