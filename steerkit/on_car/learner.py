"""The experiment on a real car: transitions while engaged, training in the background, Stanley in between.

Of `LearningRun` it keeps the story and leaves the bookkeeping: what a car's human decides (when to engage, how far to
drive) is not repeatable. The run directory holds

car.json            the setting
transitions.db      the transition store
nets/net-NNNN.npz   the policy after update NNNN (0: the untrained net); never changed, as recordings refer to them
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath
from types import TracebackType
from typing import Any, Protocol, Self

from steerkit.assembly import with_controller
from steerkit.block import Block
from steerkit.clock import Clock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.doe import Dynamic
from steerkit.errors import require
from steerkit.files import write_text
from steerkit.learning import rundir
from steerkit.learning.data.store import TransitionStore
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.settings import Setting
from steerkit.learning.trainer import Job, Trainer
from steerkit.loop import Loop
from steerkit.on_car.follow import Follow, Steers
from steerkit.realtime import Run, run

RUN = "car"
FORMAT = "steerkit car run 1"


class Car(Protocol):
    """What the learner needs of the line to the driver process: see `DriverLink`."""

    last: Any
    misses: int

    def remark(self, text: str) -> None:
        """Say, for the recording, who steers from the next request on."""
        ...


class CarLearner:
    """Learns on a car behind `link`: `run` it, in a `with`.

    setting: how. place: run directory; a run there is continued with all its transitions and its newest net.
    build: makes the loop of a policy and an output element (`steerkit.on_car.loop.car_loop`). seed: of the nets.
    recovery: the name of the controller that catches it there, for the recording.

    While the car is ENGAGED and the policy has the wheel, every sample is recorded. When the recovery controller has
    to take it, or `retrain_every_m` are driven, a process of its own trains on what is committed; driving goes on, and
    the new nets are taken over between two samples; the recording is told each time. Raises ValueError for a directory
    that holds something else, or a run with another setting, and for a setting that is for simulations only: actions
    drawn at random, a car put back by hand, a target that leaves the path.
    """

    def __init__(
        self,
        setting: Setting,
        place: FilePath,
        build: Callable[[Block, Dynamic], Loop],
        link: Car,
        *,
        seed: int = 0,
        recovery: str = "stanley",
    ):
        where = f"setting '{setting.name}' on a car"
        chance = f"exploration = {setting.exploration}, expected 0: no action at random on a real steering wheel"
        require(setting.exploration == 0.0, where, chance)
        after = f"after_failure = '{setting.after_failure}', expected 'recovery'; the others are for simulations"
        require(setting.after_failure == "recovery", where, after)
        self.setting, self.place, self.link, self.seed, self.recovery = setting, place, link, seed, recovery
        _claim(place, setting)
        self.description = setting.description()
        self.store = TransitionStore(place / "transitions.db", run=RUN, names=self.description.names)
        self.transitions = self.store.transitions(RUN)
        self.episode = self.store.next_episode()
        saved = sorted((place / "nets").glob("net-*.npz"))
        self.updates = int(saved[-1].stem.split("-")[1]) if saved else 0
        if saved:
            policy = NfqPolicy.load(saved[-1])
        else:
            nets = nfq.fresh_nets(setting.fit, self.description, seed=seed)
            policy = NfqPolicy(
                nets=nets, actions=setting.actions, description=self.description, combine=setting.fit.combine
            )
            policy.save(place / "nets" / "net-0000.npz")
        self.policy, self._net = policy, self.updates
        self.trainer = Trainer(nets=policy.nets or () if self.updates else ())
        self.failures, self.faults = 0, list[str]()
        self.driven, self.trained_at, self._progress = 0.0, 0.0, math.nan
        self._before: tuple[Any, float, int] | None = None
        self._idle = build(replace(policy, ready_from=math.inf), setting.element())
        self.follow = Follow(link=link, resting=self._idle, driving=self._with(policy))
        self._inputs = self._idle.inputs_of("controller")

    def run(self, duration: float, *, clock: Clock | None = None, watch: Callable[[Run], bool] | None = None) -> Run:
        """Drive and learn for `duration` [s]; the human engages when it is time."""

        def follow(live: Run) -> bool:
            self.step(live)
            return bool(watch and watch(live))

        self._tell()

        def late(live: Run) -> None:
            self.link.misses = live.timing.misses
            self._before = None  # the next sample is not one period later

        return run(self._idle, duration, timer=clock, watch=follow, on_miss=late)

    def step(self, live: Run) -> None:
        """After every control sample."""
        if self.follow.begin(live):
            self._before = None
        engaged = self.follow.engaged
        learning = engaged and self._value(live, "supervisor.learning") > 0.5
        self._record(live, learning)
        if learning:
            self._count(live)
        elif not math.isnan(self._progress):
            self._progress = math.nan
            self.episode += 1
            if engaged and self._value(live, "supervisor.tripped") > 0.5:
                self.failures += 1
                self._train(trusted=False)
        if learning and 0.0 < self.setting.retrain_every_m <= self.driven - self.trained_at and not self.trainer.busy:
            self._train(trusted=True)
        self._take_over()
        self.follow.choose(live)

    @property
    def trusted(self) -> bool:
        """Does the newest net get the wheel, or does the recovery controller keep it until there is a better one?"""
        return self.follow.trusted

    def figures(self) -> dict[str, Any]:
        """The numbers of a run that a program would read."""
        return {
            "updates": self.updates,
            "transitions": len(self.transitions),
            "driven_by_learner_m": self.driven,
            "failures": self.failures,
            "training_faults": list(self.trainer.faults),
        }

    def status(self) -> str:
        """One line for the panel."""
        training = "training" if self.trainer.busy else "idle"
        fault = f", {self.faults[-1]}" if self.faults else ""
        return (
            f"net {self.updates}, {len(self.transitions)} transitions, {self.driven:.0f} m by the learner, "
            f"{self.failures} failures, trainer {training}{fault}"
        )

    def _record(self, live: Run, learning: bool) -> None:
        s = tuple([self._value(live, self._inputs[name]) for name in self.description.names])
        if self._before is not None and self._before[2] == live.k - 1 and all(map(math.isfinite, s)):
            before, action, _ = self._before
            self.transitions.append(before, action, s, self.episode)
            self.store.append(before, action, s, self.episode)
        action = self._value(live, "controller.action")
        sound = all(map(math.isfinite, (*s, action)))
        self._before = (s, action, live.k) if learning and sound else None

    def _count(self, live: Run) -> None:
        progress = self._value(live, "path.progress")
        if not math.isnan(self._progress):
            self.driven += max(0.0, progress - self._progress)
        self._progress = progress

    def _train(self, *, trusted: bool) -> None:
        if self.trusted and not trusted:
            self.follow.trusted = False
            self._tell()
        self.trained_at = self.driven
        if not len(self.transitions):
            return
        setting = self.setting
        self.updates += 1
        self.trainer.submit(
            Job(
                number=self.updates,
                transitions=self.transitions,
                actions=setting.actions,
                cost=setting.cost,
                fit=setting.fit,
                description=self.description,
                seed=self.seed * 100_003 + self.updates,
            )
        )

    def _take_over(self) -> None:
        result = self.trainer.poll()
        if result is None:
            return
        if result.fault:
            self.faults.append(result.fault)
        if result.nets is not None:
            self.policy = replace(self.policy, nets=result.nets, ready_from=0.0)
            self.follow.driving, self.follow.trusted, self._net = self._with(self.policy), True, result.number
            self.policy.save(self._file, durable=False)  # the next sample does not wait for the disk
            self._tell()
        elif not self.trusted and len(self.transitions):
            self._train(trusted=False)  # try again: without it nobody but the recovery controller would ever drive

    @property
    def _file(self) -> FilePath:
        return self.place / "nets" / f"net-{self._net:04d}.npz"

    def _tell(self) -> None:
        steers = Steers.by_policy(self._file, self.setting.doe, recovery=self.recovery, trusted=self.trusted)
        self.link.remark(steers.text())

    def _with(self, policy: NfqPolicy) -> Loop:
        return with_controller(self._idle, policy)

    def _value(self, live: Run, signal: str) -> float:
        i, j = self._idle.locate(signal)
        return live.y[i][j]

    def close(self) -> None:
        """End the training process and write what is left."""
        self.trainer.close()
        self.store.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def _claim(place: FilePath, setting: Setting) -> None:
    """Make `place` a run directory of this setting, or see that it is one."""
    file = place / "car.json"
    if file.exists():
        other = setting_of(place)
        if rundir.plain(other) != rundir.plain(setting):
            raise ValueError(
                f"{place} was learned with the setting '{other.name}', which differs from '{setting.name}'; continue "
                f"it with --setting {other.name}, or choose a new directory"
            )
    elif place.exists() and any(place.iterdir()):
        raise ValueError(f"{place} is not empty and holds no run of a car (no car.json); choose a new directory")
    (place / "nets").mkdir(parents=True, exist_ok=True)
    if not file.exists():
        write_text(file, json.dumps({"format": FORMAT, "setting": rundir.plain(setting)}, indent=1))


def setting_of(place: FilePath) -> Setting:
    """How a run on a car learns; raises ValueError for a directory that holds none."""
    file = place / "car.json"
    try:
        data = json.loads(file.read_text())
    except (OSError, ValueError) as error:
        raise ValueError(f"{file}: no run of a car ({error}); make one with `steerkit learn --car FILE`") from error
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        raise ValueError(f"{file}: not of the format {FORMAT!r}")
    return rundir.from_plain(data["setting"], str(file), Setting)
