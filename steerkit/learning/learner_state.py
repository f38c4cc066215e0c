"""A learner in simulation or on a car: what is recorded and counted, when it trains, and who may steer."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from steerkit.controllers.delay_compensator import LONGEST
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import DOE, PSI_E, V
from steerkit.diagram.units import radians_of
from steerkit.doe import OutputElement
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.settings import Setting
from steerkit.learning.trainer import Job, Result, Training
from steerkit.task import RELEASE

PATIENCE = 20.0
"""Time for which the recovery controller may steer before the run reports that it cannot hand over [s]."""
AGAIN = 10.0
"""Time after which what was recorded under the recovery controller is learned from again, while that steers [s]."""
TURNS = radians_of(0.3)
"""Action from which a sample of the recovery controller's driving counts for the warm-up [rad]: on a straight road
without noise nothing is seen of the car, and the first net leaves the path in the first bend."""
WAITS = 5.0
"""How many times longer the warm-up lasts where the wheel does not turn [1]."""
EARLY = 5
"""Trainings until which the next one comes sooner, where a model of the car is learned: the n-th after n/EARLY of
`retrain_every_m`. A record of seconds grows fast."""
ENOUGH = 200
"""Transitions of a car that is known to have changed from which on it is learned from them alone: 10 s."""
MEMORY = 2.0
"""For so long before it was noticed that commands arrive later, they have [s]."""
ALIKE = 2
"""Dead times that differ by so much are the same [samples]: a learner's has a part of the steering's lag in it."""
TURNED = 0.4
"""|psi_e| from which driving under the recovery controller is not recorded [rad]: the model of the car is linear."""


@dataclass(kw_only=True)
class Episode:
    """One stretch in which the learner steers, from its take-over to a failure (or to the end of the run)."""

    began: float
    """Driving time at the take-over [s]."""
    progress: float
    """Path progress there [m]."""
    net: int
    """Number of the net that took over."""
    ended: float | None = None
    """Driving time at its end [s]; None while it lasts."""
    failed: bool = False
    """Did it end because the recovery controller had to take over?"""
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
class Recovery:
    """The time for which the recovery controller has steered without a break."""

    began: float
    """Driving time at its begin, or at the last report that it lasts [s]."""
    nearest: float = math.inf
    """Least |e| since then [m]."""
    slowest: float = math.inf
    """Least |e_dot| since then with |e| small enough for the hand-over [m/s]."""
    report: str = ""
    """The newest line of `Counts.stuck` about it."""


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
    """Distance driven by the learner at the last training [m]."""
    trained_t: float = 0.0
    """Driving time of the last training [s]."""
    driven: float = 0.0
    """Distance driven by the learner [m]."""
    first_round_begun: float | None = None
    """Driving time at which the first complete round began [s]."""
    first_round_done: float | None = None
    """Driving time at which it was complete [s]."""
    failures_to_round: int | None = None
    """Failures before the first complete round."""
    late: float = 0.0
    """How much later than the safety filter believed at first commands arrive, as it found last [s]."""
    changed: int = 0
    """The first transition since it found another dead time than the policy had; 0: it has not."""
    guessed: int = 0
    """The newest update whose dead time does not count: it was of the car before."""
    corrected: int = 0
    """Samples in which the safety filter corrected the policy, since that took over."""
    episodes: list[Episode] = field(default_factory=list)
    recovery: Recovery | None = None
    """That of the recovery controller now; None: it does not steer."""
    stuck: list[str] = field(default_factory=list)
    """Why the recovery controller could not hand over for PATIENCE, a line for each time."""

    @property
    def failures(self) -> int:
        """How often the recovery controller had to take over."""
        return sum(episode.failed for episode in self.episodes)

    @property
    def rounds(self) -> int:
        """Complete rounds, each driven within one episode."""
        return sum(episode.rounds for episode in self.episodes)

    @property
    def episode(self) -> Episode | None:
        """The one that lasts, if one does."""
        return self.episodes[-1] if self.episodes and self.episodes[-1].ended is None else None

    def steered(self, t: float, *, progress: float, e: float, round_length: float = math.inf) -> None:
        """One sample in which the learner steers, at driving time t [s]; round_length: of a round of the course [m].

        progress: along the path [m]; e: cross-track error [m]. An episode begins with its first sample.
        """
        self.recovery, episode = None, self.episode
        if episode is None:
            episode = Episode(began=t, progress=progress, net=self.updates)
            self.episodes.append(episode)
        distance = progress - episode.progress
        self.driven += max(0.0, distance - episode.distance)
        episode.distance = distance
        episode.sum_e2 += e**2
        episode.samples += 1
        if distance >= (episode.rounds + 1) * round_length:
            episode.rounds += 1
            if self.first_round_done is None:
                self.first_round_begun, self.first_round_done = episode.began, t
                self.failures_to_round = self.failures

    def ended(self, t: float, *, failed: bool) -> Episode | None:
        """The learner does not steer at driving time t [s]: the episode that ends with that, if one lasted."""
        episode = self.episode
        if episode is not None:
            episode.ended, episode.failed = t, failed
        return episode

    def recovering(self, t: float, *, e: float, e_dot: float, within: float, calm: float, busy: bool) -> str | None:
        """The recovery controller steers at driving time t [s]: why it does not hand over, once after each PATIENCE.

        e [m], e_dot [m/s]: as the learner sees them. within, calm: |e| and |e_dot| below which it would [m, m/s]. busy:
        is the training of the policy that is to take over still going on?
        """
        recovery = self.recovery = self.recovery or Recovery(began=t)
        recovery.nearest = min(recovery.nearest, abs(e))
        if abs(e) < within:
            recovery.slowest = min(recovery.slowest, abs(e_dot))
        if t - recovery.began < PATIENCE:
            return None
        if math.isinf(recovery.slowest):
            why = f"it came no nearer to the path than {recovery.nearest:.2f} m, and hands over below {within:.2g} m"
        elif recovery.slowest >= calm:
            why = f"it crosses the path at {recovery.slowest:.2f} m/s at least, and hands over below {calm:.2g} m/s"
        else:
            why = "the training of the next policy is not done" if busy else "no policy is ready to take over"
        line = f"at {t:.0f} s: recovery has steered for {PATIENCE:g} s and cannot hand over: {why}"
        self.stuck.append(line)
        self.recovery = Recovery(began=t, report=line)
        return line


State = tuple[float, ...]
Value = Callable[[str], float]
"""Gives the value of a signal of the loop, by its name."""
Keep = Callable[[State, float, State, int, bool], object]
"""Takes a transition: s, a, s_next, number of the episode, whether the learner steered."""


class Before(NamedTuple):
    """The first half of a transition, waiting for the sample that follows it."""

    number: int
    """Of its sample; the next one's is one larger."""
    s: State
    """State of the learner (SI)."""
    action: float
    """What the learner did there [rad]."""
    episode: int
    """Its number in the record."""
    own: bool
    """Did the learner steer?"""


def untrained(setting: Setting, seed: int) -> NfqPolicy:
    """The policy that a run of this setting and seed begins with: nets drawn at random."""
    description = setting.description()
    nets = nfq.fresh_nets(setting.fit, description, seed=seed)
    return NfqPolicy(
        nets=nets,
        actions=setting.actions,
        description=description,
        continuous=setting.continuous,
        preview_points=setting.fit.preview_points,
    )


class LearnerState:
    """What a learner has recorded and counted, when it trains, and whether it may steer; updated after each sample.

    setting: how it learns. seed: of the nets. policy: to begin with, and `net` its number. trainer: makes new policies
    of what was recorded. element: the output element. transitions: recorded before (default: none). also: a second
    place that takes every transition, such as a store on disk. round_length: of a round of the course [m].

    A policy is trusted until it fails; then the recovery controller keeps the wheel until a newer one takes over, when
    the car is calm. It is trained at each failure (`train`) and, while it drives, when it is `due`; new policies
    `take_over` between two samples. Where a model of the car is learned (`fit.imagined`), driving under recovery is
    recorded for that, and the policy trained anew every AGAIN: a changed car is found while nobody can hand over. The
    first net is learned from `warm_up_seconds` of that, and nets drawn at random never steer.
    """

    def __init__(
        self,
        *,
        setting: Setting,
        seed: int,
        policy: Any,
        trainer: Training,
        element: OutputElement,
        net: int = 0,
        transitions: Transitions | None = None,
        also: Keep | None = None,
        round_length: float = math.inf,
    ):
        self.setting, self.seed, self.trainer, self.element = setting, seed, trainer, element
        self.names = setting.recorded()
        self.signals: dict[str, str] = {}
        """The signal of the loop for each of them."""
        self.policy, self.net, self.trusted = policy, net, net > 0 or not setting.warms_up
        self.transitions = Transitions(self.names) if transitions is None else transitions
        self.counts = Counts(updates=net)
        self.before: Before | None = None
        """What the next sample completes to a transition."""
        self.faults: list[str] = []
        """What went wrong in training."""
        self._also, self._round_length = also, round_length
        self._largest = max(map(abs, setting.actions))

    @property
    def steering(self) -> Any:
        """The policy for the loop: one that is not trusted never reports ready."""
        return self.policy if self.trusted else replace(self.policy, ready_from=math.inf)

    def wire(self, inputs: Mapping[str, str]) -> None:
        """Take note of the signals that drive the policy's inputs (`Loop.inputs_of`): the state is read off these.

        The path's curvature is the first of the policy's preview.
        """
        known = {**inputs, "kappa": inputs["preview"].replace(".preview", ".kappa") if "preview" in inputs else ""}
        self.signals = {name: known[name] for name in self.names}

    def sample(
        self, number: int, t: float, value: Value, *, learning: bool, failed: bool, engaged: bool = True
    ) -> Episode | None:
        """Record and count sample `number`, at driving time t [s]; returns the episode that ended with it.

        A transition (s, a, s_next) is two samples that follow each other without a gap; it is the learner's own where
        that steered in the first of them: the sample in which the recovery controller takes over ends one and never
        begins one. Nothing is recorded across a missing sample, or after `forget`; samples that are not finite are left
        out, and so is what another did with a larger action than the learner has. A new episode of the record begins at
        each such break, and where the learner takes over. Where another steers, the action is what the output element
        would have needed for the angle that came of it; while recovery steers, it is `recovering`.

        learning: does it steer? failed: if not, did recovery take over? engaged: does learner or recovery steer, and no
        human?
        """
        s, action = self.state(value), self._action(value)
        sound = all(map(math.isfinite, s))
        before = self._completed(number, s) if sound else None
        models = engaged and not learning and self.setting.models_recovery and abs(s[PSI_E]) < TURNED
        self.before = None
        if sound and (models or (learning and math.isfinite(action))):
            if before is not None and (before.own or not learning):
                episode = before.episode
            else:
                episode = int(self.transitions.episode[-1]) + 1 if len(self.transitions) else 1
            self.before = Before(number, s, action if learning else 0.0, episode, learning)
        if learning:
            progress, e = value("path.progress"), value("path.e")  # that in the state may have noise
            self.counts.steered(t, progress=progress, e=e, round_length=self._round_length)
            return None
        ended = self.counts.ended(t, failed=failed)
        if engaged:
            self.recovering(t, **self.seen(value))
        else:
            self.counts.recovery = None  # the human steers
        return ended

    def state(self, value: Value) -> State:
        """The learner's state (SI), of the columns `names`."""
        return tuple([value(signal) for signal in self.signals.values()])

    def seen(self, value: Value) -> dict[str, float]:
        """What `take_over` and `recovering` go by."""
        e, e_dot = (value(self.signals[name]) for name in ("e", "e_dot"))
        return {"e": e, "e_dot": e_dot, "within": value("supervisor.within")}

    def _completed(self, number: int, s: State) -> Before | None:
        """Record the transition that sample `number`, in state s, completes; its first half, if there is one."""
        before = self.before
        if before is None or before.number != number - 1:
            return None
        action = before.action
        if not before.own:
            action = self.element.action_for(s[DOE], before.s[DOE])
            if abs(action) > self._largest:
                return None  # the motor may not follow, and that looks like dead time
        row = (before.s, action, s, before.episode, before.own)
        self.transitions.append(*row)
        if self._also is not None:
            self._also(*row)
        return before

    def forget(self) -> None:
        """The next sample does not follow from the last one: the car was relocated, or time has passed."""
        self.before = None

    def relocated(self, t: float) -> None:
        """The car was put elsewhere: that ends the episode and the recovery, and is no transition."""
        self.forget()
        self.counts.ended(t, failed=False)
        self.counts.recovery = None

    def corrected(self, share: float) -> bool:
        """The safety filter put that share of its backup [1] into the command: was that for too long?"""
        counts, setting = self.counts, self.setting
        counts.corrected += share > 0.0
        return counts.corrected * self.policy.dt >= setting.corrected_seconds

    def _action(self, value: Value) -> float:
        """The learner's action [rad]: where the filter changed the angle, the one that makes what was sent."""
        if not self.setting.safe or value("safety.correction") == 0.0:
            return value("controller.action")
        return self.element.action_for(value("safety.delta_sw"), value("doe.state"))

    def due(self) -> bool:
        """Is it time to train anew while driving on?"""
        every, counts = self.setting.retrain_every_m, self.counts
        if self.setting.models_recovery:
            every *= min(1.0, counts.updates / EARLY)
        return every > 0.0 and not self.trainer.busy and counts.driven - counts.trained_at >= every

    def train(self, t: float, *, trusted: bool) -> None:
        """One update on all transitions, where there are any; the trainer hands its product out later.

        trusted: may the policy go on meanwhile? It does not, once it has failed.
        """
        counts = self.counts
        self.trusted = self.trusted and trusted
        counts.trained_at, counts.trained_t = counts.driven, t
        if not len(self.transitions):
            return
        counts.updates += 1
        seed = self.seed * 100_003 + counts.updates
        job = Job(number=counts.updates, transitions=self._learned_from(), problem=self.setting.problem, seed=seed)
        self.trainer.submit(job, t)

    def _learned_from(self) -> Transitions:
        """Those of the car as it is; while those are few, of the car before, which it is but for the dead time."""
        counts, all_of_them = self.counts, self.transitions
        if not counts.changed:
            return all_of_them
        if len(all_of_them) - counts.changed >= ENOUGH:
            return all_of_them.part(slice(counts.changed, None))
        counts.guessed = counts.updates
        return all_of_them.part(slice(0, counts.changed))

    def arrives(self, late: float, believed: float) -> bool:
        """The safety filter found that commands arrive `late` [s] later than `believed` [s]: a change of the policy?

        Where that is another dead time than the policy's, it forecasts over that at once, and the next updates are of
        the car since then.
        """
        counts, forecast, n = self.counts, self.policy.forecast, len(self.transitions)
        found, counts.late = late != counts.late, late
        if not found or not math.isfinite(late) or forecast is None or n < ENOUGH:
            return False
        samples = min(max(round((believed + late) / self.policy.dt), 0), LONGEST)
        if abs(samples - forecast.samples) <= ALIKE:
            return False
        self.policy = replace(self.policy, forecast=replace(forecast, samples=samples))
        if not counts.changed or n - counts.changed >= ENOUGH:
            counts.changed = max(1, n - round(MEMORY / self.policy.dt))
        counts.guessed = counts.updates
        return True

    def take_over(self, t: float, *, e: float, e_dot: float, within: float = RELEASE) -> Result | None:
        """Let a policy that is ready take over, if now is the time; returns what came of its training, if anything.

        e [m], e_dot [m/s]: as measured. within: |e| below which the supervisor hands over [m]. A training without a
        result is repeated at once while recovery steers; else the next one comes when it is due.
        """
        if not (self.trusted or self.calm(e, e_dot, within)):
            return None
        result = self.trainer.poll(t)
        if result is None:
            return None
        self.counts.train_seconds += result.seconds
        if result.fault:
            self.faults.append(result.fault)
        if result.nets is None:
            if not self.trusted:
                self.train(t, trusted=False)
            return result
        forecast = self.policy.forecast if result.number <= self.counts.guessed else result.forecast
        policy = replace(self.policy, nets=result.nets, forecast=forecast, ready_from=0.0)
        self.policy, self.net, self.trusted = policy, result.number, True
        return result

    def recovering(self, t: float, *, e: float, e_dot: float, within: float = RELEASE) -> str | None:
        """The recovery controller steers at driving time t [s]: why it does not hand over, where that takes long.

        within: |e| below which the supervisor hands over [m]. After the warm-up, and every AGAIN from then on, what was
        recorded is learned from.
        """
        waits, counts = not self.trusted and self.setting.models_recovery and self.trainer.idle(t), self.counts
        if waits and (t - counts.trained_t >= AGAIN if counts.updates else self._warmed_up()):
            self.train(t, trusted=False)
        calm = self._calm(within)
        return counts.recovering(t, e=e, e_dot=e_dot, within=within, calm=calm, busy=self.trainer.busy)

    def _warmed_up(self) -> bool:
        """Is there enough driving in which the wheel turns, which shows the car, or WAITS times as much of any?"""
        record, enough = self.transitions, self.setting.warm_up_seconds / self.policy.dt
        turns = np.abs(record.a) * self.policy.description.excess(record.s[:, V]) ** 2 >= TURNS
        return np.count_nonzero(turns) >= enough or len(record) >= WAITS * enough

    def calm(self, e: float, e_dot: float, within: float = RELEASE) -> bool:
        """Is the car quiet enough on the path for a new net, or beside it and on its way there?

        A setting without `calm` lets the supervisor judge.
        """
        limit = self._calm(within)
        near = abs(e) < within and (abs(e) < RELEASE or e * e_dot <= 0.0)
        return abs(e_dot) < limit and (near or math.isinf(limit))

    def _calm(self, within: float) -> float:
        """|e_dot| below which a new net takes over [m/s]: it grows with the |e| below which it does."""
        return self.setting.calm * within / RELEASE
