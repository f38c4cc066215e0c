"""How often two minutes of recorded driving alone make a good driver, or the log is refused.

A log is what sensors and command channel of a car of the fleet say (`hard` sensors; delay, lag, offset and play of its
own, of which the learner is told nothing), read by `steerkit.logs` like any other. A human-like driver (drawn; Donges
1978: the bend ahead and delayed feedback, with dead zone and noise) or an analytic controller drives random bends, the
paper's course, or wide bends. Every third log has the wheel in place of its command, and the learner is told the
steering's delay and lag. Every fifth log is real, from the laps that come with steerkit.

The policy drives a round of a random course that is in no log, with another driver, other sensors and the log's speeds.
That of a real lap drives the other lap at its recorded speeds: the car is the one identified from all of the log's own
lap, the noise `hard` and not late, as the log's sensors are a part of that car. GOOD: `steerkit.metrics.GOOD`.

    python -m benchmarks study from_logs [--logs 20] [--first 0] [--seconds 120] [--quick] [--json]
"""

import argparse
import math
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.run.trials import drive_each
from benchmarks.tables import as_line, say, show
from steerkit._support.random import normals, seed_state
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.simulation import Log, simulate
from steerkit.identification import identify
from steerkit.learning.experiment import Experiment
from steerkit.learning.learn import UPDATES, from_log
from steerkit.logs import Drive, read_drive, shipped_drives
from steerkit.scenario import Scenario, fleet_scenario, straightest
from steerkit.scenario.drive import assembled, controller
from steerkit.task import DT

CARS_FROM, COURSES_FROM = 8000, 5000
CONTROLLERS = ("stanley-delay", "lqr", "pure-pursuit", "stanley-offset-free")
COURSES = ("random-{}", "paper", "random-{}", "sweeping-{}")


@dataclass(frozen=True, eq=False, kw_only=True)
class Human(Block):
    """A human-like driver: the bend some way ahead, and what is seen of e and heading, after a reaction time.

    Inputs: e [m], psi_e [rad], preview [1/m] of the centre of gravity. Output: delta_sw [rad]. State: what was wanted,
    of the last `reaction` samples; hand, goal of the hand, noise; the generator's. Source: Donges 1978.
    """

    e = In("m", direct=False)
    psi_e = In("rad", direct=False)
    preview = In("1/m", size="preview_points", direct=False)
    delta_sw = Out("rad", direct=())

    wheelbase: float
    l_r: float
    ratio: float
    limit: float
    look: int
    """Samples ahead of the bend that is steered for."""
    reaction: int
    k_psi: float
    k_e: float
    hand: float
    """Lag of the hands [s]."""
    dead: float
    """Changes that are not made [rad]."""
    noise: float
    """Deviation of what is steered besides, correlated over 1.5 s [rad]."""
    seed: int
    preview_points: int = 21
    preview_dt: float = DT
    reference: float = 0.0

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (0.0,) * (self.reaction + 3) + seed_state(self.seed, batch, stream=77)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(m.clip(x[self.reaction], -self.limit, self.limit))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        (*queue, hand, goal, noise), random = x[: self.reaction + 3], x[self.reaction + 3 :]
        n, _, random = normals(random)
        kept = math.exp(-DT / 1.5)
        noise = kept * noise + math.sqrt(1.0 - kept**2) * self.noise * n
        off = u.psi_e + self.l_r * u.preview[0] + self.k_e / self.k_psi * u.e
        wanted = self.ratio * (math.atan(self.wheelbase * u.preview[self.look]) - self.k_psi * off) + noise
        goal = queue[0] if abs(queue[0] - goal) > self.dead else goal
        hand = hand + DT / (DT + self.hand) * (goal - hand)
        return (*queue[1:], wanted, hand, goal, noise, *random)


def human(scenario: Scenario, rng: np.random.Generator) -> Human:
    """A driver drawn for that car."""
    car = scenario.nominal
    return Human(
        wheelbase=float(car.wheelbase),
        l_r=float(car.l_r),
        ratio=float(car.steer_ratio),
        limit=float(car.delta_sw_max),
        look=int(rng.integers(8, 13)),
        reaction=int(rng.integers(2, 5)),
        k_psi=float(rng.uniform(0.3, 0.6)),
        k_e=float(rng.uniform(0.01, 0.025)),
        hand=float(rng.uniform(0.08, 0.2)),
        dead=float(rng.uniform(0.0, np.radians(4.0))),
        noise=float(rng.uniform(0.01, np.radians(3.0))),
        seed=int(rng.integers(1_000_000)),
    )


def simulated(number: int, seconds: float, folder: Path) -> tuple[Callable[[], Drive], Scenario, dict[str, Any]]:
    """What reads log `number`, the scenario of its car, and what is told of it."""
    rng = np.random.default_rng([7, number])
    course = COURSES[rng.integers(len(COURSES))].format(COURSES_FROM + number)
    start = straightest(Scenario(course=course).path())
    base = fleet_scenario(CARS_FROM + number).with_(course={"name": course, "start": start}, reference="own")
    by_human = bool(number % 2 == 0)
    name = "human" if by_human else CONTROLLERS[rng.integers(len(CONTROLLERS))]
    steering = human(base, rng) if by_human else controller(name, base)
    loop = assembled(base, steering, seed=number)
    log = simulate(loop, seconds, every=round(DT / loop.dt))
    measured = number % 3 == 0
    wheel = log["column.delta_sw_meas"] if measured else log["controller.delta_sw"]
    seen = {"delta_sw" if measured else "controller.delta_sw": wheel}
    seen |= {f"sensors.{name}": log[f"sensors.{name}"] for name in ("v", "r", "psi")}
    units = {key: {"v": "m/s", "r": "rad/s"}.get(key[8:], "rad") for key in seen}
    file = folder / f"{number}.npz"
    Log(log.t, seen, units).save(file)
    told = {"by": name, "course": course, "car": base.vehicle.name, "channel": "wheel" if measured else "command"}
    return partial(read_drive, file, dt=DT), base.with_(reference="front"), told


def real(number: int, seconds: float, folder: Path) -> tuple[Callable[[], Drive], Scenario, dict[str, Any]]:
    """A part of a real lap, the car that is identified from all of it, and what is told."""
    laps = shipped_drives()
    name, other = (laps[(number // 5 + k) % len(laps)] for k in (0, 1))
    whole = read_drive(name, dt=DT)
    begin = np.random.default_rng([8, number]).uniform(0.0, max(0.0, whole.t[-1] - seconds))
    keep = (whole.t >= begin) & (whole.t <= begin + seconds)
    part = {key: getattr(whole, key)[keep] for key in ("delta_sw", "v", "r")}
    drive = partial(Drive.of, {"t": whole.t[keep], **part}, name=f"{name} from {begin:.0f} s", dt=DT)
    file = folder / f"{number}.toml"
    identify(whole).save(file)
    test: dict[str, Any] = dict(course=other, driver={"speed": "recorded", "v_min": 3.0, "v_max": 13.0})
    scenario = Scenario.under("hard", vehicle=str(file), **test).with_(sensors={"latency": 0.0})
    return drive, scenario, {"by": "human", "course": name, "car": "identified", "channel": "wheel"}


def one_log(number: int, seconds: float, updates: int, folder: Path) -> dict[str, Any]:
    """Learn from a log and test-drive what came of it."""
    is_real = number % 5 == 4
    read, scenario, told = (real if is_real else simulated)(number, seconds, folder)
    steering = scenario.steering
    late: dict[str, Any] = {}
    if told["channel"] == "wheel" and not is_real:
        late = {"delay": steering.delay, "lag": steering.lag}
    try:
        run = from_log(read(), Experiment(scenario=scenario, seed=number), updates=updates, **late)
    except ValueError as why:
        return {"number": number, **told, "refused": str(why)}
    found = run.source or {}
    if not is_real:
        test = f"random-{COURSES_FROM + 500 + number}"
        course = {"name": test, "start": straightest(Scenario(course=test).path())}
        scenario = scenario.with_(course=course, driver={"v_min": found["v_low"], "v_max": found["v_high"]})
    (driven,) = drive_each(scenario, run.experiment.setting, [run.policy], seed=number + 1000)
    figures = {name: getattr(driven.summary, name, math.nan) for name in ("rms_e", "max_e", "max_jerk")}
    samples = run.policy.forecast.samples
    return {"number": number, **told, "refused": "", **found, "dead_samples": samples, "good": driven.good, **figures}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick is one log and one update."""
    parser.add_argument("--logs", type=int, default=20, help="how many (20)")
    parser.add_argument("--first", type=int, default=0, help="number of the first (0)")
    parser.add_argument("--seconds", type=float, default=120.0, help="length of a log (120)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All logs, and their table."""
    rows = list[dict[str, Any]]()
    count, updates = (1, 1) if options.quick else (options.logs, UPDATES)
    with tempfile.TemporaryDirectory() as folder:
        first = 2 if options.quick else options.first  # a log that is not refused
        for number in range(first, first + count):
            rows.append(one_log(number, options.seconds, updates, Path(folder)))
            say(as_line(rows[-1]))
    refused = sum(bool(row["refused"]) for row in rows)
    good = sum(row.get("good", False) for row in rows)
    shown = ("number", "by", "course", "car", "channel", "rms_e", "max_e", "refused")
    show(f"{good} GOOD", [{name: row.get(name, "") for name in shown} for row in rows])
    return {"good": good, "refused": refused, "share": (good + refused) / len(rows), "logs": rows}
