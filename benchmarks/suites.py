"""The suites: which controllers drive which scenarios, and what has to be learned before."""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path as FilePath
from typing import Any

from benchmarks.entries import ORACLE, TELLABLE, WRONG, controller
from benchmarks.foreign_cars import foreign_scenarios
from benchmarks.run.results import case_id
from benchmarks.run.trainings import TRAININGS
from benchmarks.scenarios import MULTI_BODY, scene, unlike_the_data_sheet
from steerkit._support.errors import known
from steerkit.proving.manoeuvre import some
from steerkit.scenario import Scenario, tables

TRAINING = "training"
"""The suite that trainings are filed under, so that suites in one directory share them."""
ANALYTIC = ("stanley", "stanley-textbook", "stanley-delay", "pure-pursuit", "lqr", "mpc", "nonlinear-mpc")
LEARNED = ("nfq-idoe", "nfq-low-pass", "nfq-bang-bang")
AS_PUBLISHED = ("nfq-paper-idoe", "nfq-paper-bang-bang")


@dataclass(frozen=True, kw_only=True)
class Suite:
    """Scenarios, and the controllers that drive all of them."""

    name: str = ""
    """What it is called; a suite of `SUITES` as there."""
    about: str
    """One line for `list` and the report."""
    scenarios: tuple[Scenario, ...]
    """What is driven; none: only trainings."""
    controllers: tuple[str, ...]
    """Who drives, in the order in which they are shown; learned ones are trained first."""
    seeds: int = 10
    """How many seeds, by default."""
    timed_steps: int = 0
    """Samples over which computing time is measured; 0: not at all."""
    alone: bool = False
    """Are its drives made one at a time, nothing beside them? For timing."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One case to carry out."""

    suite: str
    scenario: str
    controller: str
    seed: int
    kind: str = "drive"
    taught_on: str = ""
    """The scenario that a training is made for, where each has one of its own."""

    @property
    def id(self) -> str:
        """The name of its files."""
        return case_id(self.suite, self.scenario, self.controller, self.seed)

    @property
    def training(self) -> str:
        """Id of the training that a learned controller's drive needs."""
        return _training(self).id


PAPER_ROUND = scene(name="paper-round")
_MB: Any = dict(vehicle={"name": "bmw-320i", "plant": MULTI_BODY}, driver={"v_min": 7.0, "v_max": 7.0})


@cache
def _tracking_scenarios() -> tuple[Scenario, ...]:
    return (
        PAPER_ROUND,
        scene(name="paper-fast", driver={"v_max": 9.0}),
        scene(name="paper-linear", vehicle={"plant": "linear"}),
        scene(name="paper-hard", steering={"lag": 0.15}, sensors={"noise": 1.0, "latency": 0.05}),
        scene(name="genesis-recorded", course="genesis", driver={"speed": "recorded", "v_max": 9.0}),
        scene(name="genesis-rfs-recorded", course="genesis-rfs", driver={"speed": "recorded", "v_max": 9.0}),
        scene(name="iso3888-1-9", course="iso3888-1", driver={"v_min": 9.0, "v_max": 9.0}),
        scene(name="iso3888-1-5", course="iso3888-1", driver={"v_min": 5.0, "v_max": 5.0}),
        scene(name="iso3888-2-9", course="iso3888-2", driver={"v_min": 9.0, "v_max": 9.0}),
        scene(name="circle-6", course="circle", driver={"v_min": 6.0, "v_max": 6.0}),
        scene(name="slalom-9", course="slalom", driver={"v_min": 9.0, "v_max": 9.0}),
        scene(name="curvature-step-7", course="curvature-step", driver={"v_min": 7.0, "v_max": 7.0}),
        scene(name="iso3888-1-multi-body", course="iso3888-1", **_MB),
        scene(name="slalom-multi-body", course="slalom", **_MB),
    )


def _of_tracking(*names: str) -> tuple[Scenario, ...]:
    return tuple(scenario for scenario in _tracking_scenarios() if scenario.name in names)


def _grid(kind: str, first: tuple[str, Sequence[float]], second: tuple[str, Sequence[float]]) -> Iterable[Scenario]:
    """One scenario for every pair of values; controllers do not know what is wrong."""
    for a, b in itertools.product(first[1], second[1]):
        values = {first[0]: a, second[0]: b}
        label = "-".join(f"{key.partition('.')[2]}{value:g}" for key, value in values.items())
        if "driver.v_max" in values:
            values["driver.v_min"] = values["driver.v_max"]
        yield scene(name=f"{kind}-{label}", knowledge={"delay": 0.0, "lag": 0.12}, **tables(values))


_ADAPT = ("stanley", *TELLABLE, *(name + ORACLE for name in TELLABLE), "nfq-same-car-1", "nfq-same-car-5")

SUITES: dict[str, Callable[[], Suite]] = {
    "paper": lambda: Suite(
        about="figures 3 to 6 of the paper: learning on the 800 m course, the final nets' round, beside its values",
        scenarios=(PAPER_ROUND,),
        controllers=("stanley", "stanley-textbook", *LEARNED, *AS_PUBLISHED, "nfq-paper-120"),
    ),
    "tracking": lambda: Suite(
        about="every controller on courses, lane changes, slalom, steps and three plants; nets of the 800 m course",
        scenarios=_tracking_scenarios(),
        controllers=(*ANALYTIC, *LEARNED),
    ),
    "manoeuvres": lambda: Suite(  # as `steerkit prove` has them; bounds of the norms stand in the report
        about="ISO 3888 lane changes and lane keeping of ISO 11270 and UN R79 at 60 and 80 km/h",
        scenarios=tuple(
            scene(name=one.name, course=one.course, driver={"v_min": one.conditions.v, "v_max": one.conditions.v})
            for one in some(["all"])
            if one.course
        ),
        controllers=(*ANALYTIC, *LEARNED),
        seeds=3,
    ),
    "robustness": lambda: Suite(
        about="grids of what no controller knows: delay, lag, tyres, friction, ratio, offset, noise, wind, bank",
        scenarios=(
            *_grid(
                "delay",
                ("steering.delay", (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)),
                ("driver.v_max", (5.0, 6.0, 7.0, 8.0, 9.0)),
            ),
            *_grid("lag", ("steering.lag", (0.05, 0.12, 0.2, 0.3, 0.4)), ("driver.v_max", (5.0, 7.0, 9.0))),
            *_grid(
                "tyres",
                ("vehicle.tyres", (0.5, 0.7, 0.85, 1.0, 1.2, 1.5)),
                ("vehicle.friction", (0.3, 0.45, 0.6, 0.8, 1.0)),
            ),
            *_grid(
                "steering",
                ("vehicle.ratio", (0.8, 0.9, 1.0, 1.1, 1.2)),
                ("steering.offset_deg", (-8.0, -4.0, 0.0, 4.0, 8.0)),
            ),
            *_grid("pose", ("sensors.noise", (0.0, 1.0, 2.0, 4.0)), ("sensors.latency", (0.0, 0.05, 0.1, 0.15, 0.2))),
            *_grid(
                "wind", ("disturbances.wind", (0.0, 0.2, 0.4, 0.8)), ("disturbances.bank_deg", (0.0, 2.0, 4.0, 6.0))
            ),
        ),
        controllers=("stanley", "stanley-textbook", "stanley-delay", "pure-pursuit", "lqr", "mpc", "nfq-idoe"),
        seeds=3,
    ),
    "generalise": lambda: Suite(
        about="nets taught on one course and car, driven on others",
        scenarios=(
            *_of_tracking("paper-round", "paper-linear", "paper-hard", "genesis-recorded", "genesis-rfs-recorded"),
            *(scene(name=f"random-{n}", course=f"random-{n}") for n in range(1, 6)),
            scene(name="paper-bmw", vehicle="bmw-320i"),
            scene(name="paper-ford", vehicle="ford-escort"),
            scene(name="paper-multi-body", vehicle={"plant": MULTI_BODY, "name": "bmw-320i"}),
        ),
        controllers=("stanley", "lqr", *LEARNED, "nfq-idoe-genesis", "nfq-idoe-linear", "nfq-idoe-hard"),
        seeds=5,
    ),
    "learning-curve": lambda: Suite(
        about="driving time against performance, offline iterations, 70 and 120 episodes",
        scenarios=(),
        controllers=(*LEARNED, *AS_PUBLISHED, "nfq-paper-120", "nfq-idoe-offline"),
    ),
    "peers": lambda: Suite(
        about="controllers that nobody here wrote: agents of Stable-Baselines3, do-mpc, CommonRoad's car",
        scenarios=_of_tracking("paper-round", "iso3888-1-9", "slalom-9", "curvature-step-7", "slalom-multi-body"),
        controllers=("stanley", "mpc", "nfq-idoe", "sb3-dqn", "sb3-sac", "do-mpc"),
        seeds=3,
    ),
    "adapt": lambda: Suite(
        about="cars unlike their data sheet: learned on that car; analytic with the data sheet or true parameters",
        scenarios=unlike_the_data_sheet(),
        controllers=_ADAPT,
        seeds=3,
    ),
    "adapt-quick": lambda: Suite(
        about="one car of adapt, one minute of learning",
        scenarios=tuple(s for s in unlike_the_data_sheet() if s.name == "passat-ratio-tyres"),
        controllers=_ADAPT[:-1],
        seeds=1,
    ),
    "foreign": lambda: Suite(
        about="cars that no one here wrote: learned on that car; analytic untold, told wrongly, truly, adapting",
        scenarios=foreign_scenarios(),
        controllers=(
            "stanley",
            *(name + told for name in TELLABLE for told in ("", WRONG, ORACLE)),
            "stanley-adaptive",
            "lqr-adaptive",
            "nfq-same-car-1",
            "nfq-same-car-5",
        ),
        seeds=2,
    ),
    "compute": lambda: Suite(
        about="computing time a step, one drive at a time",
        scenarios=(scene(name="paper-steady", driver={"v_min": 6.0, "v_max": 6.0}),),
        controllers=(*ANALYTIC, "do-mpc", "nfq-idoe-quick", "nfq-bang-bang-quick"),
        seeds=1,
        timed_steps=2000,
        alone=True,
    ),
    "quick": lambda: Suite(
        about="a selection of some minutes of paper and tracking, nets after 3 minutes of driving (make bench)",
        scenarios=_of_tracking(
            *("paper-round", "paper-hard", "genesis-rfs-recorded", "iso3888-1-9", "slalom-9", "curvature-step-7"),
            "slalom-multi-body",
        ),
        controllers=(*ANALYTIC, "nfq-idoe-quick", "nfq-bang-bang-quick"),
        seeds=6,  # with fewer nothing can be told apart
        timed_steps=200,
    ),
    "golden": lambda: Suite(
        about="a small one whose numbers the tests hold",
        scenarios=(
            scene(
                name="slalom-hard",
                course="slalom",
                driver={"v_max": 9.0},
                steering={"lag": 0.15},
                sensors={"noise": 1.0, "latency": 0.05},
                disturbances={"wind": 0.2, "gust": 0.1},
            ),
            *_of_tracking("curvature-step-7"),
        ),
        controllers=("stanley", "stanley-textbook", "pure-pursuit"),
        seeds=2,
    ),
}
"""What makes each suite, by name; a suite's courses take long, so it is made when it is asked for."""


def suite(name: str) -> Suite:
    """The suite of that name; raises ValueError with the nearest and the valid names."""
    return replace(SUITES[known(name, SUITES, "suite")](), name=name)


def elsewhere(one: Suite, *, course: str = "", vehicle: str = "", controllers: Sequence[str] = ()) -> Suite:
    """The suite on another course, with another car, and with controllers of a user's own beside its own.

    Scenarios on the 800 m course go to `course`, those with the Passat get `vehicle` (names or files; the steering
    stays the scenario's), and their names say so; those with a course or a car of their own keep it. Raises ValueError
    where that leaves all as they are.
    """
    plain = Scenario()
    moved = []
    for scenario in one.scenarios:
        changes: dict[str, str] = {}
        if course and scenario.course.name == plain.course.name:
            changes |= {"course": course, "name": f"{scenario.name}-on-{_stem(course)}"}
        if vehicle and scenario.vehicle.name == plain.vehicle.name:
            changes |= {"vehicle": vehicle, "name": f"{changes.get('name', scenario.name)}-with-{_stem(vehicle)}"}
        moved.append(scenario.with_(**changes))
    if (course or vehicle) and moved == [*one.scenarios]:
        raise ValueError(f"suite '{one.name}': every scenario has a course and a car of its own, which it keeps")
    names = tuple(dict.fromkeys((*one.controllers, *controllers)))
    return replace(one, scenarios=tuple(moved), controllers=names)


def _stem(name: str) -> str:
    return FilePath(name.partition("#")[0]).stem.replace("--", "-")


def jobs(suites: Sequence[Suite], seeds: int | None = None, only: Sequence[str] = ()) -> list[Job]:
    """All cases of the suites, trainings first, each once; a drive without chance in it has seed 0 only.

    only: words; a case is kept if one of them is in `scenario` or `controller`. Raises ValueError for one in none.
    """
    drives: list[Job] = []
    trainings: dict[str, Job] = {}
    for one in suites:
        for place, name in itertools.product(one.scenarios, one.controllers):
            chance = place.random or controller(name).learns
            count = (seeds or one.seeds) if chance else 1
            drives += [Job(suite=one.name, scenario=place.name, controller=name, seed=n) for n in range(count)]
        if not one.scenarios:
            learners = [
                Job(suite=one.name, scenario="", controller=name, seed=n)
                for name in one.controllers
                for n in range(seeds or one.seeds)
            ]
            trainings |= {job.training: _training(job) for job in _kept(learners, only)}
    drives = _kept(drives, only)
    for job in drives:
        if controller(job.controller).learns:
            trainings.setdefault(job.training, _training(job))
    for word in only:
        if not any(_matches(job, word) for job in (*drives, *trainings.values())):
            known = dict.fromkeys(n for one in suites for n in (*(s.name for s in one.scenarios), *one.controllers))
            raise ValueError(f"--only {word}: no scenario or controller of these suites; there are {', '.join(known)}")
    return [*trainings.values(), *drives]


def _training(job: Job) -> Job:
    training = TRAININGS[controller(job.controller).training]
    taught_on = job.scenario if training.scenario is None else ""
    name = f"train-{training.name}" + (f"-on-{taught_on}" if taught_on else "")
    return Job(
        suite=TRAINING, scenario=name, controller=job.controller, seed=job.seed, kind="learn", taught_on=taught_on
    )


def _kept(cases: Sequence[Job], only: Sequence[str]) -> list[Job]:
    return [job for job in cases if not only or any(_matches(job, word) for word in only)]


def _matches(job: Job, word: str) -> bool:
    return word in job.scenario or word in job.controller
