"""The experiment: a car drives, fails, is caught, trains, re-enters, and every second of it is counted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from steerkit.assembly import steering_loop, with_controller
from steerkit.block import Block
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.target_shift import TargetShift
from steerkit.errors import require
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.exploration import Exploring
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.settings import Setting
from steerkit.learning.trainer import Job, SimulatedTrainer, Training
from steerkit.loop import LoopState
from steerkit.scenario.world import END_MARGIN, World
from steerkit.simulation import Recorder

SIGNALS = (
    "path.e",
    "path.psi_e",
    "path.progress",
    "path.s",
    "path.kappa",
    "car.x",
    "car.y",
    "car.v",
    "car.r",
    "car.a_y",
    "car.delta_sw",
    "supervisor.delta_sw",
    "supervisor.learning",
    "controller.action",
)
Watcher = Callable[[str, "LearningRun"], None]


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """All that a learning run is made of; a run with the same experiment gives the same numbers."""

    setting: Setting = field(default_factory=Setting)
    """How it learns: see `steerkit.learning.settings`."""
    world: World = field(default_factory=World)
    """Where it learns: course, car, disturbances: see `steerkit.scenario.world`."""
    minutes: float = 11.0
    """Driving time after which it ends [min]; recovery and waiting count."""
    episodes: int = 1000
    """Failures after which it ends."""
    rounds: int = 0
    """Complete rounds driven by the learner after which it ends; 0: never."""
    seed: int = 0
    """Seed of the nets, the driver and the sensors."""

    def __post_init__(self) -> None:
        require(0.0 < self.minutes < math.inf, "Experiment", f"minutes = {self.minutes}, expected > 0")
        require(self.episodes >= 1, "Experiment", f"episodes = {self.episodes}, expected >= 1")
        require(self.rounds >= 0, "Experiment", f"rounds = {self.rounds}, expected >= 0")
        require(self.seed >= 0, "Experiment", f"seed = {self.seed}, expected >= 0")


@dataclass(kw_only=True)
class Episode:
    """One time at the wheel of the learner, from take-over to failure (or to the end of the run)."""

    began: float
    """Driving time at the take-over [s]."""
    progress: float
    """Path progress there [m]."""
    net: int
    """Number of the net that took over."""
    ended: float | None = None
    """Driving time at its end [s]; None while it lasts."""
    failed: bool = False
    """Did it end because the recovery controller had to take the wheel?"""
    distance: float = 0.0
    """Path distance covered [m]."""
    sum_e2: float = 0.0
    samples: int = 0
    rounds: int = 0
    """Complete rounds within it."""

    @property
    def rms_e(self) -> float:
        """Root mean square cross-track error [m]."""
        return math.sqrt(self.sum_e2 / max(1, self.samples))


@dataclass(kw_only=True)
class Counts:
    """What has happened so far: the part of a run that is not loop state, nets or transitions."""

    k: int = 0
    """Base tick of the loop; driving time is k*dt."""
    updates: int = 0
    """Trainings so far; net number n is the product of the n-th."""
    train_seconds: float = 0.0
    """Computing time really spent in training [s]; driving time is charged `setting.fit_seconds` an update."""
    trained_at: float = 0.0
    """Distance driven at the last training [m]."""
    driven: float = 0.0
    """Distance driven by the learner [m]."""
    first_round_begun: float | None = None
    """Driving time at which the first complete round began [s]."""
    first_round_done: float | None = None
    """Driving time at which it was complete [s]."""
    failures_to_round: int | None = None
    """Failures before the first complete round."""
    episodes: list[Episode] = field(default_factory=list)

    @property
    def failures(self) -> int:
        """How often the recovery controller had to take the wheel."""
        return sum(episode.failed for episode in self.episodes)


class LearningRun:
    """A learning run in progress: the loop, its state, the transitions, the nets and the counts.

    `learning.learn` drives it to its end; it can be stepped by hand too: `drive()` one control sample at a time.
    `keep`, if set, is called at every training, to write a checkpoint.
    """

    def __init__(self, experiment: Experiment, watch: Watcher | None = None, trainer: Training | None = None):
        self.experiment, self.watch = experiment, watch
        self.keep: Callable[[LearningRun], None] | None = None
        setting, world = experiment.setting, experiment.world
        self.path = world.path()
        self.round_length = world.round_length
        self.description = setting.description()
        self.transitions = Transitions(self.description.names)
        self.counts = Counts()
        self.nets = nfq.fresh_nets(setting.fit, self.description, seed=experiment.seed)
        self.trainer: Training = trainer or SimulatedTrainer(seconds=setting.fit_seconds)
        self.policy = NfqPolicy(
            nets=self.nets, actions=setting.actions, description=self.description, combine=setting.fit.combine
        )
        self.loop = steering_loop(
            car=world.car(self.path),
            path=self.path,
            driver=world.driver(experiment.seed),
            controller=self._controller(),
            doe=setting.element(world.vehicle),
            recovery=world.recovery(),
            actuator=world.actuator(),
            sensors=world.sensors(experiment.seed),
            reference=world.ahead,
            shift=TargetShift() if setting.after_failure == "shift" else None,
        )
        start = self.loop.init()
        self.x, self.y = list(start.x), list(start.y)
        self.ticks = round(self.policy.dt / self.loop.dt)
        self.before: tuple[Any, float] | None = None
        self._inputs = self.loop.inputs_of("controller")
        self.recorder = Recorder(self.loop, SIGNALS)

    # ---- the story ------------------------------------------------------------------------------------------

    @property
    def t(self) -> float:
        """Driving time [s]."""
        return self.counts.k * self.loop.dt

    def done(self) -> bool:
        """Has the experiment come to its end?"""
        counts, experiment = self.counts, self.experiment
        rounds = sum(episode.rounds for episode in counts.episodes)
        return (
            self.t >= 60.0 * experiment.minutes
            or counts.failures >= experiment.episodes
            or 0 < experiment.rounds <= rounds
        )

    def drive(self) -> None:
        """One control sample: drive, record what the learner did, and train when it failed or when it is time."""
        self._take_over_finished_training()
        counts = self.counts
        self.loop.advance(counts.k, self.x, self.y)
        self.recorder.add(counts.k, self.y)
        learning = self._value("supervisor.learning") > 0.5
        self._record_transition(learning)
        episode = self._episode()
        if learning:
            self._count(episode or self._begin_episode())
        elif episode:
            episode.ended, episode.failed = self.t, True
        for k in range(counts.k + 1, counts.k + self.ticks):
            self.loop.advance(k, self.x, self.y)
        counts.k += self.ticks
        if episode and not learning:
            after = self.experiment.setting.after_failure
            if after != "shift":
                self._train(waiting=True)
            elif not self.trainer.busy:
                self._train(waiting=False)
            self._tell("failed")
            if after == "reset":
                self._put_back(self._value("path.s"))
                counts.k += round(self.experiment.setting.reset_seconds / self.policy.dt) * self.ticks
        elif learning and self._due():
            self._train(waiting=False)
        if not self.path.closed and self._value("path.s") > self.path.length - END_MARGIN:
            self._back_to_the_start()

    def _record_transition(self, learning: bool) -> None:
        s = tuple([self._value(self._inputs[name]) for name in self.description.names])
        if self.before is not None:
            self.transitions.append(*self.before, s, episode=len(self.counts.episodes))
        self.before = (s, self._value("controller.action")) if learning else None

    def _back_to_the_start(self) -> None:
        """At the end of an open course the car is carried back to its start."""
        self._put_back(0.0)
        episode = self._episode()
        if episode:
            episode.ended = self.t

    def _put_back(self, s: float) -> None:
        """The car stands on the path at s [m] again, with the driver's mood unchanged."""
        loop, driver = self.loop, self.loop.block_state(self.state, "driver")
        start = loop.with_block("car", self.experiment.world.car(self.path, s=s)).init()
        start = loop.with_block_state(start, "driver", driver)
        self.x, self.y = list(start.x), list(start.y)
        self.before = None

    def _train(self, *, waiting: bool) -> None:
        """One update on all transitions; the trainer hands its nets out later."""
        counts, setting = self.counts, self.experiment.setting
        counts.updates += 1
        counts.trained_at = counts.driven
        job = Job(
            number=counts.updates,
            transitions=self.transitions,
            actions=setting.actions,
            cost=setting.cost,
            fit=setting.fit,
            description=self.description,
            seed=self.experiment.seed * 100_003 + counts.updates,
        )
        self.trainer.submit(job, self.t)
        if waiting:  # the old policy is not trusted any more
            self.set_policy(replace(self.policy, ready_from=math.inf))
        self._checkpoint()

    def _due(self) -> bool:
        every = self.experiment.setting.retrain_every_m
        return every > 0.0 and not self.trainer.busy and self.counts.driven - self.counts.trained_at >= every

    def _take_over_finished_training(self) -> None:
        if not (self._trusted or self._calm()):
            return
        result = self.trainer.poll(self.t)
        if result is None:
            return
        self.counts.train_seconds += result.seconds
        if result.nets is None:  # the training process broke over it: the same data once more
            self._tell("lost")
            self._train(waiting=not self._trusted)
            return
        self.nets = result.nets
        self.set_policy(replace(self.policy, nets=self.nets, ready_from=0.0))
        self._tell("trained")

    def _calm(self) -> bool:
        """Is the car quiet enough on the path for a new driver?"""
        e, e_dot = (self._value(self._inputs[name]) for name in ("e", "e_dot"))
        return abs(e_dot) < self.experiment.setting.calm and (abs(e) < 0.1 or math.isinf(self.experiment.setting.calm))

    def set_policy(self, policy: NfqPolicy) -> None:
        """Exchange the policy between two samples; the loop's state goes on."""
        self.policy = policy
        self.loop = with_controller(self.loop, self._controller())
        self.recorder.loop = self.loop

    def _controller(self) -> Block:
        share, policy = self.experiment.setting.exploration, self.policy
        if share and isinstance(policy, NfqPolicy):
            return Exploring(policy=policy, share=share, seed=self.experiment.seed)
        return policy

    @property
    def _trusted(self) -> bool:
        return math.isfinite(self.policy.ready_from)

    # ---- counting -------------------------------------------------------------------------------------------

    def _value(self, signal: str) -> float:
        i, j = self.loop.locate(signal)
        return self.y[i][j]

    def _episode(self) -> Episode | None:
        episodes = self.counts.episodes
        return episodes[-1] if episodes and episodes[-1].ended is None else None

    def _begin_episode(self) -> Episode:
        episode = Episode(began=self.t, progress=self._value("path.progress"), net=self.counts.updates)
        self.counts.episodes.append(episode)
        return episode

    def _count(self, episode: Episode) -> None:
        distance = self._value("path.progress") - episode.progress
        self.counts.driven += max(0.0, distance - episode.distance)
        episode.distance = distance
        episode.sum_e2 += self._value("path.e") ** 2
        episode.samples += 1
        if distance >= (episode.rounds + 1) * self.round_length:
            episode.rounds += 1
            if self.counts.first_round_done is None:
                self.counts.first_round_begun, self.counts.first_round_done = episode.began, self.t
                self.counts.failures_to_round = self.counts.failures
            self._tell("round")

    def _tell(self, what: str) -> None:
        if self.watch is not None:
            self.watch(what, self)

    # ---- keeping --------------------------------------------------------------------------------------------

    def _checkpoint(self) -> None:
        if self.keep is not None:
            self.keep(self)

    @property
    def state(self) -> LoopState:
        """The loop's state at this moment."""
        return LoopState(self.counts.k, tuple(self.x), tuple(self.y))
