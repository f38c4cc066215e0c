"""The experiment on a real car: transitions while engaged, training in the background, Stanley in between.

The story is that of a run in simulation (`steerkit.learning.learner_state`); what a car's human decides (when to
engage, how far to drive) is not repeatable, so there is no checkpoint of the loop. The run directory holds::

    car.json            the setting
    transitions.db      the transition store
    nets/net-NNNN.npz   the policy after update NNNN (0: the untrained net); never changed, as recordings refer to them
"""

import contextlib
import json
import math
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.clock import Clock
from steerkit._support.errors import require
from steerkit._support.files import write_text
from steerkit._support.plugins import fingerprints
from steerkit.car.client import CarClient
from steerkit.car.config import CarConfig
from steerkit.car.loop import RUN_FORMAT, Follow, Steers, car_loop, design_model_of, filtered_in, setting_of
from steerkit.car.protocol import Remark
from steerkit.controllers.fail_safe import FAULTS
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.loop import Loop
from steerkit.diagram.realtime import Run, run
from steerkit.learning import rundir
from steerkit.learning.data.store import TransitionStore
from steerkit.learning.learner_state import LearnerState, untrained
from steerkit.learning.nfq.iterate import NOTHING_LEARNED, Learned
from steerkit.learning.rundir import held, is_free
from steerkit.learning.settings import Setting
from steerkit.learning.trainer import Trainer
from steerkit.scenario.assembly import with_controller
from steerkit.scenario.catalogue import AUTO

RUN = "car"


class CarLearner(contextlib.ExitStack):
    """A learning run on a real car, behind `link`: `run` it, in a `with`.

    setting: how. place: run directory; a run there is continued with all its transitions and its newest net. config:
    the car and its course. seed: of the nets. recovery: the name of the recovery controller. clock: see
    `steerkit.car.loop.car_loop`. trainer: what trains the nets (default: a process of its own).

    While the car is ENGAGED, every sample is recorded, and whether the policy steered. When the recovery controller has
    to take it (the car leaves the path; the policy answers NaN, or raises), or `retrain_every_m` are driven, a process
    of its own trains on what is committed; driving goes on, and the new nets are taken over between two samples; the
    recording notes it each time. Raises ValueError for a directory that holds something else, or a run with another
    setting, while another process learns there, and for a setting of simulations only: a car put back on the path.
    """

    def __init__(
        self,
        setting: Setting,
        place: FilePath,
        config: CarConfig,
        link: CarClient,
        *,
        seed: int = 0,
        recovery: str = AUTO,
        clock: Callable[[], float] | None = time.perf_counter,
        trainer: Trainer | None = None,
    ):
        where = f"setting '{setting.name}' on a car"
        after = f"after_failure = '{setting.after_failure}', expected 'recovery'; the other is for simulations"
        require(setting.after_failure == "recovery", where, after)
        self.setting, self.place, self.link, self.recovery = setting, place, link, recovery
        what = f"{place} is not empty and holds no run of a car (no car.json); choose a new directory"
        require(not place.exists() or is_free(place) or (place / "car.json").exists(), where, what)
        place.mkdir(parents=True, exist_ok=True)
        super().__init__()
        with contextlib.ExitStack() as stack:
            stack.push(self)
            self.enter_context(held(place))
            _claim(place, setting)
            self.store = TransitionStore(place / "transitions.db", run=RUN, names=setting.recorded())
            self.callback(self.store.close)
            saved = sorted((place / "nets").glob("net-*.npz"))
            net = int(saved[-1].stem.split("-")[1]) if saved else 0
            policy = NfqPolicy.load(saved[-1]) if saved else untrained(setting, seed)
            if not saved:
                policy.save(rundir.net_file(place, 0))
            self.trainer = trainer or Trainer(
                learned=Learned(policy.nets or (), policy.forecast) if net else NOTHING_LEARNED
            )
            self.callback(self.trainer.close)
            design_model = design_model_of(config)
            self.learner_state = LearnerState(
                setting=setting,
                seed=seed,
                policy=policy,
                net=net,
                trainer=self.trainer,
                element=setting.element(design_model.vehicle),
                transitions=self.store.transitions(),
                also=self.store.append,
            )
            self._believed, self._variant = design_model.delay, ""
            how: dict[str, Any] = {"recovery": self.recovery, "safe": setting.safe, "clock": clock}
            resting = replace(policy, ready_from=math.inf)
            self._idle = car_loop(config, self.link, resting, doe=self.learner_state.element, **how)
            self.filter_faults: Counter[str] = Counter()
            """What went wrong in the safety filter, and how often."""
            trusted = self.learner_state.trusted
            self.follow = Follow(link=self.link, resting=self._idle, driving=self._with(policy), trusted=trusted)
            self.learner_state.wire(self._idle.inputs_of("controller"))
            stack.pop_all()

    def run(self, duration: float, *, clock: Clock | None = None, watch: Callable[[Run], bool] | None = None) -> Run:
        """Drive and learn for `duration` [s]; the human engages when it is time."""

        def follow(live: Run) -> bool:
            self.step(live)
            return bool(watch and watch(live))

        self.remark()

        def late(live: Run) -> None:
            self.link.misses = live.timing.misses
            self.learner_state.forget()  # the next sample is not one period later

        return run(self._idle, duration, timer=clock, watch=follow, on_miss=late)

    def step(self, live: Run) -> None:
        """After every control sample."""
        learner_state = self.learner_state
        if self.follow.begin(live):
            learner_state.forget()
        engaged, t, sample = self.follow.engaged, live.k * self._idle.dt, live.sample
        learning = engaged and sample["supervisor.learning"] > 0.5
        fault = engaged and sample["supervisor.fault"] > 0.5  # a NaN, or an exception in the policy
        given_up = self.setting.safe and self._filtered(live, learning=learning, engaged=engaged)
        failed = fault or (engaged and sample["supervisor.tripped"] > 0.5)
        ended = learner_state.sample(live.k, t, sample.__getitem__, learning=learning, failed=failed, engaged=engaged)
        if given_up:
            learner_state.counts.ended(t, failed=True)
        if given_up or (ended and ended.failed) or (fault and learner_state.trusted):
            learner_state.train(t, trusted=False)
        elif learning and learner_state.due():
            learner_state.train(t, trusted=True)
        result = learner_state.take_over(t, **learner_state.seen(sample.__getitem__))
        taken = result is not None and result.number == learner_state.net
        late = self.setting.safe and learner_state.arrives(sample["safety.late"], self._believed)
        if taken:
            learner_state.counts.corrected = 0
        if taken or late:
            self._variant = f"-dead{learner_state.policy.forecast.samples}" if late else ""
            learner_state.policy.save(self.net_file, durable=False)  # the next sample does not wait for the disk
            self.follow.exchange(live, self._with(learner_state.policy))
        if taken or late or self.follow.trusted != learner_state.trusted:
            self.follow.trusted = learner_state.trusted
            self.remark()
        self.follow.choose(live)

    def _filtered(self, live: Run, *, learning: bool, engaged: bool) -> bool:
        """Note what the safety filter did; must the policy lose the wheel for it, or because the filter failed?"""
        message = filtered_in(live)
        self.link.note(message)
        broken = FAULTS.get(message.reason, "") if engaged else ""
        if broken:
            self.filter_faults[broken] += 1
        return learning and (self.learner_state.corrected(message.share) or bool(broken))

    def figures(self) -> dict[str, Any]:
        """The numbers of a run that a program would read."""
        counts = self.learner_state.counts
        return {
            "updates": counts.updates,
            "transitions": len(self.learner_state.transitions),
            "driven_by_learner_m": counts.driven,
            "failures": counts.failures,
            "stuck": list(counts.stuck),
            "training_faults": list(self.trainer.faults),
            "filter_faults": dict(self.filter_faults),
        }

    def status(self) -> str:
        """One line for the panel."""
        learner_state, counts = self.learner_state, self.learner_state.counts
        training = "training" if self.trainer.busy else "idle"
        fault = f", {learner_state.faults[-1]}" if learner_state.faults else ""
        fault += "".join([f", {count} x {what}" for what, count in self.filter_faults.items()])
        if counts.recovery and counts.recovery.report:
            fault += f", {counts.recovery.report}"
        return (
            f"net {counts.updates}, {len(learner_state.transitions)} transitions, "
            f"{counts.driven:.0f} m by the learner, {counts.failures} failures, trainer {training}{fault}"
        )

    @property
    def net_file(self) -> FilePath:
        """The file of the newest net that has taken over, or of that with the dead time that the filter found."""
        file = rundir.net_file(self.place, self.learner_state.net)
        return file.with_stem(file.stem + self._variant)

    def remark(self) -> None:
        """Note, for the recording, who steers from here on."""
        how: dict[str, Any] = {"trusted": self.learner_state.trusted, "safe": self.setting.safe}
        steers = Steers.by_policy(self.net_file, self.setting.doe, recovery=self.recovery, **how)
        self.link.note(Remark(steers.text()))

    def _with(self, policy: NfqPolicy) -> Loop:
        return with_controller(self._idle, policy)


def _claim(place: FilePath, setting: Setting) -> None:
    """Make `place` a run directory of this setting, or see that it is one."""
    file = place / "car.json"
    (place / "nets").mkdir(exist_ok=True)
    if not file.exists():
        kept = {"format": RUN_FORMAT, "setting": (table := rundir.plain(setting)), "code": fingerprints(table)}
        write_text(file, json.dumps(kept, indent=1))
    other = setting_of(place)
    why = f"learned with the setting '{other.name}', which differs from '{setting.name}'"
    hint = f"continue it with --setting {other.name}, or choose a new directory"
    require(rundir.plain(other) == rundir.plain(setting), f"{place}", f"{why}; {hint}")
