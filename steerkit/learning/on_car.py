"""The experiment on a real car: transitions while engaged, training in the background, Stanley in between.

Of `LearningRun` it keeps the story and leaves the bookkeeping: what a car's human decides (when to engage, how far to
drive) is not repeatable, so the run directory holds a transition store, the nets, and nothing that has to be replayed.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath
from types import TracebackType
from typing import Any, Protocol, Self

from steerkit.block import Block
from steerkit.clock import Clock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.recovery import Guarded
from steerkit.learning import nfq
from steerkit.learning.settings import Setting
from steerkit.learning.store import TransitionStore
from steerkit.learning.trainer import Job, Trainer
from steerkit.loop import Loop
from steerkit.realtime import Run, run

RUN = "car"


class Car(Protocol):
    """What the learner needs of the line to the driver process: see `DriverLink`."""

    last: Any
    misses: int


class CarLearner:
    """Learns on a car behind `link`: `run` it, in a `with`.

    setting: how. place: run directory; a run there is continued with all its transitions and its newest net.
    build: makes the loop of a policy and an output element (`steerkit.car.car_loop`). seed: of the nets.

    While the car is ENGAGED and the policy has the wheel, every sample is recorded. When the recovery controller has
    to take it, or `retrain_every_m` are driven, a process of its own trains on what is committed; driving goes on, and
    the new nets are taken over between two samples. Raises ValueError for a directory that holds something else.
    """

    def __init__(
        self, setting: Setting, place: FilePath, build: Callable[[Block, Block], Loop], link: Car, *, seed: int = 0
    ):
        self.setting, self.place, self.link, self.seed = setting, place, link, seed
        if place.exists() and any(place.iterdir()) and not (place / "transitions.db").exists():
            raise ValueError(f"{place} is not empty and holds no run of a car; choose a new directory")
        (place / "nets").mkdir(parents=True, exist_ok=True)
        self.description = setting.description()
        self.store = TransitionStore(place / "transitions.db", run=RUN, names=self.description.names)
        self.transitions = self.store.transitions(RUN)
        self.episode = self.store.next_episode()
        saved = sorted((place / "nets").glob("net-*.npz"))
        if saved:
            policy = NfqPolicy.load(saved[-1])
            self.updates = int(saved[-1].stem.split("-")[1])
        else:
            nets = nfq.fresh_nets(setting.fit, self.description, seed=seed)
            policy = NfqPolicy(
                nets=nets, actions=setting.actions, description=self.description, combine=setting.fit.combine
            )
            self.updates = 0
        self.policy = policy
        self.trainer = Trainer(nets=policy.nets or () if saved else ())
        self.trusted = True
        self.failures, self.faults = 0, list[str]()
        self.driven, self.trained_at, self._progress = 0.0, 0.0, math.nan
        self._before: tuple[Any, float, int] | None = None
        self._element = setting.element()
        self._idle = build(replace(policy, ready_from=math.inf), self._element)
        self._steering = self._with(policy)
        self._places = -1.0
        controller = self._idle.names.index("controller")
        self._inputs = [self._idle.source[controller, name] for name in self.description.names]
        self._at = {n: self._idle.locate(n) for n in ("supervisor.learning", "supervisor.tripped", "controller.action",
                                                      "path.progress", "path.e")}  # fmt: skip

    def run(self, duration: float, *, clock: Clock | None = None, watch: Callable[[Run], bool] | None = None) -> Run:
        """Drive and learn for `duration` [s]; the human engages when it is time."""

        def follow(live: Run) -> bool:
            self.step(live)
            return bool(watch and watch(live))

        def late(live: Run) -> None:
            self.link.misses = live.timing.misses
            self._before = None  # the next sample is not one period later

        return run(self._idle, duration, timer=clock, watch=follow, on_miss=late)

    def step(self, live: Run) -> None:
        """After every control sample."""
        snapshot = self.link.last
        engaged = str(snapshot.mode) == "ENGAGED"
        if snapshot.places != self._places:
            if not engaged and self._places >= 0.0:
                live.restart(self._idle.init())
                self._before = None
            self._places = snapshot.places
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
        live.loop = self._steering if engaged and self.trusted else self._idle

    def status(self) -> str:
        """One line for the panel."""
        training = "training" if self.trainer.busy else "idle"
        fault = f", {self.faults[-1]}" if self.faults else ""
        return (f"net {self.updates}, {len(self.transitions)} transitions, {self.driven:.0f} m by the learner, "
                f"{self.failures} failures, trainer {training}{fault}")  # fmt: skip

    def _record(self, live: Run, learning: bool) -> None:
        s = tuple([live.y[i][j] for i, j in self._inputs])
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
        self.trusted = self.trusted and trusted
        self.trained_at = self.driven
        if not len(self.transitions):
            return
        setting = self.setting
        self.updates += 1
        self.trainer.submit(
            Job(number=self.updates, transitions=self.transitions, actions=setting.actions, cost=setting.cost,
                fit=setting.fit, description=self.description, seed=self.seed * 100_003 + self.updates)
        )  # fmt: skip

    def _take_over(self) -> None:
        result = self.trainer.poll()
        if result is None:
            return
        if result.fault:
            self.faults.append(result.fault)
        if result.nets is not None:
            self.policy = replace(self.policy, nets=result.nets, ready_from=0.0)
            self._steering = self._with(self.policy)
            self.policy.save(self.place / "nets" / f"net-{result.number:04d}.npz")
            self.trusted = True
        elif not self.trusted and len(self.transitions):
            self._train(trusted=False)  # try again: without it nobody but the recovery controller would ever drive

    def _with(self, policy: NfqPolicy) -> Loop:
        return self._idle.with_block("controller", Guarded(block=policy))

    def _value(self, live: Run, signal: str) -> float:
        i, j = self._at[signal]
        return live.y[i][j]

    def close(self) -> None:
        """End the training process and write what is left."""
        self.trainer.close()
        self.store.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()
