"""The learning experiment: a car drives, fails, recovers and trains, and every second of it is counted."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from steerkit._support.errors import check_numbers, number, require
from steerkit.controllers.safety_filter import doubted
from steerkit.diagram.loop import Sample
from steerkit.diagram.simulation import Recorder
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.learner_state import Counts, LearnerState, untrained
from steerkit.learning.settings import Setting
from steerkit.learning.trainer import SimulatedTrainer
from steerkit.scenario import END_MARGIN, Scenario
from steerkit.scenario.assembly import with_controller
from steerkit.scenario.catalogue import make_safety
from steerkit.scenario.drive import SignCheck, assembled

SIGNALS = (
    *(f"path.{name}" for name in ("e", "psi_e", "progress", "s", "kappa")),
    *(f"car.{name}" for name in ("x", "y", "v", "r", "a_y", "delta_sw")),
    *("supervisor.delta_sw", "supervisor.learning", "controller.action"),
)
SAFETY_SIGNALS = ("safety.share", "safety.correction", "safety.reason", "safety.late", "safety.widened")
"""Those of a learner with a safety filter besides."""
Watcher = Callable[[str, "LearningRun"], None]


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """All that a learning run is made of; a run with the same experiment gives the same numbers."""

    setting: Setting = field(default_factory=Setting)
    """How it learns: see `steerkit.learning.settings`."""
    scenario: Scenario = field(default_factory=Scenario)
    """Where it learns: course, car, disturbances: see `steerkit.scenario`."""
    minutes: float = number(11.0, "min", above=0.0, high=1e6)
    """Driving time after which it ends [min]; recovery and waiting count."""
    episodes: int = number(1000, low=1)
    """Failures after which it ends."""
    rounds: int = number(0, low=0)
    """Complete rounds driven by the learner after which it ends; 0: never."""
    seed: int = number(0, low=0)
    """Seed of the nets, the driver and the sensors."""

    def __post_init__(self) -> None:
        asked = (
            f"setting = {self.setting!r:.60}, expected a Setting; by name: steerkit.learning.settings.setting('paper')"
        )
        require(isinstance(self.setting, Setting), "Experiment", asked)
        asked = f"scenario = {self.scenario!r:.60}, expected a Scenario, such as Scenario(course='paper')"
        require(isinstance(self.scenario, Scenario), "Experiment", asked)
        check_numbers(self, "Experiment")


class LearningRun:
    """A learning run in progress in simulation: the loop, its state, and the learner's.

    `learning.learn` drives it to its end; it can be stepped by hand too: `drive()` one control sample at a time.
    `keep`, if set, is called after every sample with a training in it, to write a checkpoint; `each` with every sample
    that is recorded. `x` and `y`, the states and outputs of all blocks, may be changed between two samples.
    """

    def __init__(self, experiment: Experiment, watch: Watcher | None = None):
        self.experiment, self.watch = experiment, watch
        self.keep: Callable[[LearningRun], None] | None = None
        self.each: Callable[[Sample], None] | None = None
        self.source: dict[str, Any] | None = None
        """Of a run that began with a recorded drive: which, and how well it shows the car (`learn.from_log`)."""
        scenario = experiment.scenario
        setting = experiment.setting.suited(scenario.design_model())
        self.path = scenario.path()
        self.trainer = SimulatedTrainer(seconds=setting.fit_seconds)
        self.learner_state = LearnerState(
            setting=setting,
            seed=experiment.seed,
            policy=untrained(setting, experiment.seed),
            trainer=self.trainer,
            element=setting.element(scenario.nominal),
            round_length=scenario.round_length,
        )
        safety = make_safety(scenario.design_model()) if setting.safe else None
        self._believed = safety.backup.model.delay if safety else 0.0
        self.loop = assembled(
            scenario,
            self.policy,
            doe=self.learner_state.element,
            recovery=scenario.recovery_controller(),
            safety=safety,
            seed=experiment.seed,
        )
        start = self.loop.init()
        self.x, self.y = list[Any](start.x), list[Any](start.y)
        self.ticks = round(self.policy.dt / self.loop.dt)
        self.learner_state.wire(self.loop.inputs_of("controller"))
        self.safe = setting.safe
        self.doubted = ""
        """What the safety filter found of the car beyond its doubts."""
        self.recorder = Recorder(self.loop, SIGNALS + SAFETY_SIGNALS * self.safe)
        self._signs = SignCheck(scenario, self.loop, self.policy.dt)

    @property
    def counts(self) -> Counts:
        """What has happened so far."""
        return self.learner_state.counts

    @property
    def transitions(self) -> Transitions:
        """All that was recorded so far."""
        return self.learner_state.transitions

    @property
    def policy(self) -> Any:
        """The policy in the loop: the newest one that has taken over."""
        return self.learner_state.steering

    @property
    def t(self) -> float:
        """Driving time [s]."""
        return self.counts.k * self.loop.dt

    def done(self) -> bool:
        """Has the experiment come to its end?"""
        counts, experiment = self.counts, self.experiment
        return (
            self.t >= 60.0 * experiment.minutes
            or counts.failures >= experiment.episodes
            or 0 < experiment.rounds <= counts.rounds
        )

    def drive(self) -> None:
        """One control sample: drive, record what the learner did, and train when it failed or when it is time."""
        learner_state, counts, second = self.learner_state, self.counts, int(self.t)
        trainings = counts.updates
        self._take_over()
        self.loop.advance(counts.k, self.x, self.y)
        self.recorder.add(counts.k, self.y)
        sample = Sample(self.loop, self.t, self.y)
        self._signs.look(sample)
        if self.safe:
            before, self.doubted = self.doubted, doubted(sample["safety.late"], sample["safety.widened"])
            if self.doubted and not before:
                self._tell("doubted")
            if learner_state.arrives(sample["safety.late"], self._believed):
                self.steer()
        if self.each is not None:
            self.each(sample)
        self._require_finite()
        learning, rounds, stuck = self._value("supervisor.learning") > 0.5, counts.rounds, len(counts.stuck)
        number = counts.k // self.ticks
        ended = learner_state.sample(number, self.t, self._value, learning=learning, failed=not learning)
        if counts.rounds > rounds:
            self._tell("round")
        if len(counts.stuck) > stuck:
            self._tell("stuck")
        for k in range(counts.k + 1, counts.k + self.ticks):
            self.loop.advance(k, self.x, self.y)
        counts.k += self.ticks
        if ended:
            learner_state.train(self.t, trusted=False)
            self.steer()
            self._tell("failed")
            if self.experiment.setting.after_failure == "reset":
                self._put_back(self._value("path.s"))
                counts.k += round(self.experiment.setting.reset_seconds / self.policy.dt) * self.ticks
        elif learning and self.safe and learner_state.corrected(self._value("safety.share")):
            learner_state.trusted = False  # recovery steers from the next sample on, and that trains
            self.steer()
        elif learning and learner_state.due():
            learner_state.train(self.t, trusted=True)
        if not self.path.closed and self._value("path.s") > self.path.length - END_MARGIN:
            self._put_back(self.experiment.scenario.course.start)  # the end of an open course
        if counts.updates > trainings and self.keep is not None:
            self.keep(self)
        if int(self.t) > second:
            self._tell("second")

    def _take_over(self) -> None:
        result = self.learner_state.take_over(self.t, **self.learner_state.seen(self._value))
        if result is None:
            return
        taken = self.learner_state.net == result.number
        if taken:
            self.counts.corrected = 0
            self.steer()
            controller, doe, supervisor = map(self.loop.names.index, ("controller", "doe", "supervisor"))
            if len(self.policy.init()) != len(self.x[controller]):  # it begins at the element's present angle
                y: list[Any] = list(self.y)
                y[doe] = y[doe]._replace(state=self.x[doe][0])
                self.x[controller] = self.loop.settled("controller", y)
            self.x[supervisor] = self.x[supervisor]._replace(fault=0.0)  # that of the policy before
        self._tell("trained" if taken else "lost")

    def steer(self) -> None:
        """Put the learner's policy into the loop, between two samples; the loop's state goes on."""
        self.recorder.loop = self.loop = with_controller(self.loop, self.policy)

    def _put_back(self, s: float) -> None:
        """Put the car on the path at s [m]; the speed driver's state goes on."""
        loop, driver = self.loop, self.x[self.loop.names.index("driver")]
        start = loop.with_block("car", self.experiment.scenario.car(self.path, s=s, seed=self.experiment.seed)).init()
        start = loop.with_block_state(start, "driver", driver)
        self.x, self.y = list(start.x), list(start.y)
        self.learner_state.relocated(self.t)
        self._signs = SignCheck(self.experiment.scenario, loop, self.policy.dt)

    def _require_finite(self) -> None:
        s = self.learner_state.state(self._value)
        if not all(map(math.isfinite, s)):
            values = ", ".join(f"{name} = {value:g}" for name, value in zip(self.learner_state.names, s, strict=True))
            raise ValueError(f"LearningRun: at {self.t:.2f} s the learner's state is {values}; expected finite numbers")

    def _value(self, signal: str) -> float:
        i, j = self.loop.locate(signal)
        return self.y[i][j]

    def _tell(self, what: str) -> None:
        if self.watch is not None:
            self.watch(what, self)
