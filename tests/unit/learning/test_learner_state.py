"""The learner's story: when it is trained, on what, who may steer; what is counted on the way."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.controllers.delay_compensator import PREVIEW, DelayCompensator
from steerkit.controllers.policy import COLUMNS
from steerkit.diagram.units import radians_of
from steerkit.learning.learner_state import Counts, LearnerState, untrained
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import DEFAULT, Setting
from steerkit.learning.trainer import Job, Result

HOW = replace(DEFAULT, fit=FitSetting(nets=1), retrain_every_m=5.0, calm=0.3)
MODELS = replace(HOW, fit=FitSetting(nets=1, imagined=10))
BETTER = untrained(HOW, seed=9).nets


class InHand:
    """A trainer whose jobs and results a test can see and set."""

    def __init__(self) -> None:
        self.jobs: list[Job] = []
        self.result: Result | None = None
        self.busy = False

    def idle(self, t: float) -> bool:
        return not self.busy or self.result is not None

    def submit(self, job: Job, t: float) -> None:
        self.jobs.append(job)
        self.busy = True

    def poll(self, t: float) -> Result | None:
        result, self.result = self.result, None
        self.busy = self.busy and result is None
        return result

    def done(self, **result: Any) -> None:
        """The newest job is done."""
        self.result = Result(self.jobs[-1].number, result.pop("nets", BETTER), 1.5, **result)


def sampled(s: Sequence[float], action: float, *, progress: float = 0.0, e: float = 0.0) -> Callable[[str], float]:
    """A sample of the loop: the learner's state and its action, and where the car truly is."""
    true = {"path.progress": progress, "path.e": e, "supervisor.within": 0.1, "controller.action": action}
    return (dict(zip(COLUMNS, s)) | true).__getitem__


class Fed:
    """A story, and a car that goes a metre in each sample."""

    def __init__(self, **options: Any):
        self.trainer, self.number, self.progress = InHand(), 0, 0.0
        given: dict[str, Any] = {"setting": HOW, "seed": 2, "policy": untrained(HOW, 2), "trainer": self.trainer}
        given["element"] = HOW.element()
        self.learner_state = LearnerState(**given | options)
        self.learner_state.wire({name: name for name in COLUMNS})

    def drive(
        self, samples: int, *, learning: bool = True, failed: bool = False, psi_e: float = 0.0, engaged: bool = True
    ) -> Any:
        for _ in range(samples):
            self.number += 1
            self.progress += 1.0
            s, steers = (0.01 * self.number, 0.0, 5.0, psi_e, 0.0, 0.0), {"learning": learning, "engaged": engaged}
            value = sampled(s, 0.1, progress=self.progress, e=0.2)
            ended = self.learner_state.sample(self.number, 0.05 * self.number, value, failed=failed, **steers)
        return ended

    def take_over(self, e: float = 0.0, e_dot: float = 0.0) -> Result | None:
        return self.learner_state.take_over(0.0, e=e, e_dot=e_dot)


def test_where_a_model_is_learned_driving_under_recovery_is_recorded_for_it_and_not_what_a_human_does() -> None:
    also: list[Any] = []
    fed = Fed(setting=MODELS, also=lambda *row: also.append(row))
    fed.drive(2, learning=False)
    fed.drive(3)
    fed.drive(2, learning=False, failed=True)
    fed.drive(1, learning=False, psi_e=0.5)  # so far turned that no linear model holds
    fed.drive(3, learning=False)
    fed.drive(2, learning=False, engaged=False)
    fed.drive(2)
    record = fed.learner_state.transitions
    assert record.episode.tolist() == [1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 4]  # a stretch without a break, or of the learner
    assert record.own.tolist() == [False] * 2 + [True] * 3 + [False] * 5 + [True] == [row[4] for row in also]
    follows = record.episode[1:] == record.episode[:-1]
    np.testing.assert_array_equal(record.s[1:][follows], record.s_next[:-1][follows])


@pytest.mark.parametrize(
    ("turn_deg", "v", "samples"), [(0.31, 5.0, 80), (0.29, 5.0, 400), (0.08, 16.0, 80), (0.0, 5.0, 400)]
)
def test_where_a_model_is_learned_recovery_drives_first_and_the_first_net_is_learned_from_that(
    turn_deg: float, v: float, samples: int
) -> None:
    """80 samples, 4 s, in which the wheel turns, which a fast car's has to less; five times as many of any."""
    fed = Fed(setting=MODELS)
    learner_state = fed.learner_state
    assert learner_state.steering.ready_from == math.inf
    fed.drive(300, engaged=False, learning=False)  # a human steers
    for number in range(1000, 1000 + samples + 1):
        assert not fed.trainer.jobs
        value = sampled((0.0, 0.0, v, 0.0, 0.0, radians_of(turn_deg) * number), math.nan)
        learner_state.sample(number, 0.05 * number, value, learning=False, failed=False)
    (job,) = fed.trainer.jobs
    assert len(job.transitions) == samples
    assert not job.transitions.own.any()
    fed.trainer.done()
    fed.take_over(e=0.0)
    assert learner_state.trusted


@pytest.mark.parametrize("setting", [HOW, replace(MODELS, warm_up_seconds=0.0)])
def test_without_a_warm_up_a_net_drawn_at_random_steers_first(setting: Setting) -> None:
    assert Fed(setting=setting).learner_state.steering.ready_from == 0.0


def test_a_net_that_was_learned_before_steers_at_once() -> None:
    assert Fed(setting=MODELS, net=3).learner_state.trusted


def test_what_recovery_did_is_told_by_the_wheel_and_left_out_where_no_learner_would() -> None:
    """A motor may not follow larger steps than the learner's, of 25 degrees; that would look like dead time."""
    learner_state = Fed(setting=MODELS).learner_state
    for number, doe in enumerate((0.0, 0.2, 0.5, 1.0, 0.9, 0.8)):  # from 0.5 on by 0.5 rad
        value = sampled((0.0, 0.0, 5.0, 0.0, 0.0, doe), math.nan)
        learner_state.sample(number, 0.0, value, learning=False, failed=False)
    record = learner_state.transitions
    np.testing.assert_allclose(record.a, [0.2, 0.3, -0.1, -0.1], atol=1e-12)
    assert record.episode.tolist() == [1, 1, 2, 2]


def test_while_recovery_steers_it_is_trained_every_ten_seconds() -> None:
    """And not on a record to which nothing is added."""
    for setting, jobs in ((MODELS, 4), (HOW, 1)):
        fed = Fed(setting=setting)
        fed.drive(2)
        fed.learner_state.train(0.1, trusted=False)
        for k in range(1, 800):
            fed.drive(1, learning=False)
            if k in (150, 250, 500):  # the second training takes 2.5 s, the third 15
                fed.trainer.done()
        assert len(fed.trainer.jobs) == jobs
        assert not fed.learner_state.trusted


def test_the_further_off_it_may_take_over_the_faster_the_car_may_be() -> None:
    """And then only on its way to the path."""
    within = ((0.29, -0.89, True), (-0.29, 0.89, True), (0.09, 0.89, True), (0.29, 0.0, True))
    for e, e_dot, taken in (*within, (0.29, 0.1, False), (-0.29, -0.1, False), (0.31, 0.0, False), (0.0, 0.91, False)):
        fed = Fed()
        fed.drive(2)
        fed.learner_state.train(0.0, trusted=False)
        fed.trainer.done()
        fed.learner_state.take_over(0.0, e=e, e_dot=e_dot, within=0.3)
        assert fed.learner_state.trusted is taken


def test_while_it_drives_it_is_trained_every_so_many_metres_and_one_training_at_a_time() -> None:
    fed = Fed()
    fed.drive(5)
    assert not fed.learner_state.due()  # four metres
    fed.drive(1)
    assert fed.learner_state.due()
    fed.learner_state.train(0.0, trusted=True)
    fed.drive(6)
    assert not fed.learner_state.due()  # busy
    fed.trainer.done()
    fed.take_over()
    assert fed.learner_state.due()
    fed.learner_state.train(0.0, trusted=True)
    fed.trainer.busy = False
    assert not fed.learner_state.due()  # no metre since
    fed.learner_state.setting = replace(HOW, retrain_every_m=0.0)
    fed.drive(100)
    assert not fed.learner_state.due()  # at failures only


def test_a_policy_that_failed_keeps_its_hands_off_until_a_newer_one_takes_over() -> None:
    fed = Fed()
    first = fed.learner_state.policy
    assert fed.learner_state.steering is first
    fed.drive(2)
    fed.learner_state.train(0.0, trusted=False)
    assert not fed.learner_state.trusted
    assert fed.learner_state.steering.ready_from == math.inf
    fed.learner_state.train(0.0, trusted=True)  # a training asked for by another reason does not bring it back
    assert not fed.learner_state.trusted
    assert fed.take_over() is None
    assert not fed.learner_state.trusted
    fed.trainer.done()
    assert fed.take_over() is not None
    assert fed.learner_state.trusted
    assert fed.learner_state.net == 2
    assert fed.learner_state.steering.ready_from == 0.0
    np.testing.assert_array_equal(fed.learner_state.steering.nets[0][0], BETTER[0][0])  # type: ignore[index]
    assert fed.learner_state.counts.train_seconds == 1.5


@pytest.mark.parametrize(
    ("calm", "e", "e_dot", "taken"),
    [
        (0.3, 0.09, 0.29, True),
        (0.3, -0.11, 0.0, False),
        (0.3, 0.0, -0.31, False),
        (0.3, math.nan, 0.0, False),
        (0.3, 0.0, math.nan, False),
        (math.inf, 3.0, 5.0, True),  # the supervisor judges |e|
    ],
)
def test_after_a_failure_a_new_policy_waits_until_the_car_is_calm(
    calm: float, e: float, e_dot: float, taken: bool
) -> None:
    fed = Fed(setting=replace(HOW, calm=calm))
    fed.drive(2)
    fed.learner_state.train(0.0, trusted=False)
    fed.trainer.done()
    fed.take_over(e, e_dot)
    assert fed.learner_state.trusted is taken
    if not taken:  # it is not lost
        fed.take_over()
        assert fed.learner_state.trusted


def test_a_training_without_a_result_is_repeated_where_nobody_else_would_drive() -> None:
    fed = Fed()
    fed.drive(2)
    fed.learner_state.train(0.0, trusted=False)
    fed.trainer.done(nets=None, fault="killed")
    assert fed.take_over() == (1, None, 1.5, "killed", None)
    assert [job.number for job in fed.trainer.jobs] == [1, 2]
    assert not fed.learner_state.trusted
    assert fed.learner_state.faults == ["killed"]
    fed.trainer.done(fault="restarted")
    fed.take_over()
    assert fed.learner_state.trusted
    assert fed.learner_state.faults == ["killed", "restarted"]


def test_else_the_next_training_comes_when_it_is_due() -> None:
    fed = Fed()
    fed.drive(2)
    fed.learner_state.train(0.0, trusted=True)
    fed.trainer.done(nets=None, fault="killed")
    fed.take_over(e=0.4, e_dot=1.0)  # while the policy drives, nobody waits for calm
    assert len(fed.trainer.jobs) == 1
    assert fed.learner_state.trusted
    assert fed.learner_state.net == 0
    fed.drive(5)
    assert fed.learner_state.due()


def test_the_dead_time_that_a_filter_finds_counts_at_once_and_from_then_on_the_car_since_then() -> None:
    forecast = DelayCompensator(samples=3)
    fed = Fed(policy=replace(untrained(HOW, 2), preview_points=PREVIEW, forecast=forecast))
    state = fed.learner_state
    fed.drive(150)
    assert not state.arrives(0.3, 0.1)  # at the beginning its own record tells
    assert not state.arrives(0.0, 0.1)
    fed.drive(100)
    assert not state.arrives(math.nan, 0.1)
    assert not state.arrives(0.05, 0.2), "two samples more are the lag"
    state.train(0.0, trusted=True)
    assert state.arrives(0.3, 0.1)
    assert not state.arrives(0.3, 0.1)
    assert state.steering.forecast.samples == 8
    assert state.counts.changed == 249 - 40
    fed.trainer.done(forecast=replace(forecast, samples=4))
    fed.take_over()
    assert state.steering.forecast.samples == 8, "trained before it was found"
    state.train(0.0, trusted=True)
    assert len(fed.trainer.jobs[-1].transitions) == 209, "few are of the new car"
    fed.drive(10)
    assert state.arrives(0.5, 0.1)
    assert (state.counts.changed, state.steering.forecast.samples) == (209, 12)
    fed.trainer.done(forecast=replace(forecast, samples=4))
    fed.take_over()
    assert state.steering.forecast.samples == 12
    fed.drive(150)
    state.train(0.0, trusted=True)
    np.testing.assert_array_equal(fed.trainer.jobs[-1].transitions.s, state.transitions.s[209:])
    fed.trainer.done(forecast=replace(forecast, samples=11))
    fed.take_over()
    assert state.steering.forecast.samples == 11
    fed.drive(1)
    assert state.arrives(0.0, 0.1)
    assert (state.counts.changed, state.steering.forecast.samples) == (410 - 40, 2)


def test_without_a_transition_there_is_nothing_to_train_on() -> None:
    fed = Fed()
    fed.learner_state.train(0.0, trusted=False)
    assert fed.trainer.jobs == []
    assert fed.learner_state.counts.updates == 0
    assert not fed.learner_state.trusted


def test_a_car_that_was_put_elsewhere_ends_the_episode_and_makes_no_transition() -> None:
    fed = Fed()
    fed.drive(3)
    fed.learner_state.relocated(1.0)
    fed.drive(2)
    first, second = fed.learner_state.counts.episodes
    assert (first.ended, first.failed, second.ended) == (1.0, False, None)
    assert fed.learner_state.transitions.episode.tolist() == [1, 1, 2]
    assert fed.learner_state.counts.driven == 3.0


@given(
    st.lists(
        st.tuples(st.integers(1, 2), st.booleans(), *[st.sampled_from([0.0, 1.0, math.nan, math.inf])] * 2), max_size=30
    )
)
def test_a_transition_is_a_step_of_the_learner(samples: list[tuple[int, bool, float, float]]) -> None:
    """Two samples that follow each other, both finite, in the first of which the learner steered."""
    learner_state, number, seen = Fed().learner_state, 0, {}
    for gap, learning, value, action in samples:
        number += gap
        seen[number] = (learning, value, action)
        sample = sampled((float(number), value, 5.0, 0.0, 0.0, 0.0), action)
        learner_state.sample(number, 0.0, sample, learning=learning, failed=False)
    expected = [
        (n, action)
        for n, (learning, value, action) in seen.items()
        if learning and math.isfinite(value + action) and n + 1 in seen and math.isfinite(seen[n + 1][1])
    ]
    record = learner_state.transitions
    assert list(zip(record.s[:, 0], record.a)) == expected
    assert (record.s_next[:, 0] == record.s[:, 0] + 1.0).all()


# ---- counting


def driven(counts: Counts, *progress: float, t: float = 0.0, round_length: float = math.inf) -> list[int]:
    """The rounds after each of the learner's samples, half a second apart."""
    rounds = []
    for k, s in enumerate(progress):
        counts.steered(t + 0.5 * k, progress=s, e=0.3 if k % 2 else -0.1, round_length=round_length)
        rounds.append(counts.rounds)
    return rounds


def test_an_episode_lasts_from_the_take_over_to_the_loss_of_the_wheel() -> None:
    counts = Counts(updates=7)
    driven(counts, 100.0, 101.0, 103.0, t=2.0)
    episode = counts.episode
    assert episode is not None
    assert (episode.began, episode.progress, episode.net) == (2.0, 100.0, 7)
    assert (episode.distance, episode.samples) == (3.0, 3)
    assert episode.rms_e == pytest.approx(math.sqrt((0.01 + 0.09 + 0.01) / 3))
    assert counts.ended(3.5, failed=True) is episode
    assert (episode.ended, episode.failed, counts.failures, counts.episode) == (3.5, True, 1, None)


def test_only_the_loss_of_the_wheel_is_a_failure() -> None:
    counts = Counts()
    assert counts.ended(0.0, failed=True) is None  # nobody had it
    for t, failed in ((1.0, False), (2.0, True), (3.0, False)):
        driven(counts, 0.0, 1.0, t=t)
        assert counts.ended(t + 0.9, failed=failed).failed is failed  # type: ignore[union-attr]
        assert counts.ended(t + 0.95, failed=True) is None  # it ends once
    assert len(counts.episodes) == 3
    assert counts.failures == 1


def test_metres_count_forward_once_and_under_the_learner_only() -> None:
    counts = Counts()
    driven(counts, 10.0, 12.0, 11.0, 13.0)  # the tracker went back a metre
    assert counts.driven == pytest.approx(4.0)
    counts.ended(9.0, failed=True)
    driven(counts, 500.0, 501.5)  # the recovery controller drove the rest
    assert counts.driven == pytest.approx(5.5)


def test_a_round_is_driven_within_one_episode() -> None:
    counts = Counts()
    assert driven(counts, 0.0, 60.0, round_length=100.0) == [0, 0]
    counts.ended(5.0, failed=True)
    assert driven(counts, 60.0, 159.0, 160.0, 200.0, 260.0, t=10.0, round_length=100.0) == [0, 0, 1, 1, 2]
    assert (counts.first_round_begun, counts.first_round_done, counts.failures_to_round) == (10.0, 11.0, 1)


def recovery(counts: Counts, seconds: float, *, e: float, e_dot: float, busy: bool = False) -> list[str]:
    """What is said while recovery steers for so long from t = 100 s on, 20 samples a second."""
    lines = [
        counts.recovering(100.0 + 0.05 * k, e=e, e_dot=e_dot, within=0.1, calm=0.3, busy=busy)
        for k in range(round(20 * seconds) + 1)
    ]
    return [line for line in lines if line]


def test_a_recovery_that_lasts_says_why_it_does_not_hand_over() -> None:
    assert recovery(Counts(), 19.9, e=1.0, e_dot=0.0) == []
    (far,) = recovery(Counts(), 20.1, e=-0.31, e_dot=0.0)
    assert far == (
        "at 120 s: recovery has steered for 20 s and cannot hand over: "
        "it came no nearer to the path than 0.31 m, and hands over below 0.1 m"
    )
    assert "crosses the path at 0.50 m/s at least" in recovery(Counts(), 20.1, e=0.05, e_dot=-0.5)[0]
    assert "the training of the next policy is not done" in recovery(Counts(), 20.1, e=0.05, e_dot=0.0, busy=True)[0]
    counts = Counts()
    assert len(recovery(counts, 61.0, e=0.05, e_dot=0.0)) == len(counts.stuck) == 3
    assert "no policy is ready" in counts.stuck[0]


def test_a_learner_that_steers_ends_the_recovery() -> None:
    counts = Counts()
    assert recovery(counts, 15.0, e=1.0, e_dot=0.0) == []
    driven(counts, 0.0, t=115.0)
    assert counts.recovery is None
    assert counts.recovering(116.0, e=1.0, e_dot=0.0, within=0.1, calm=0.3, busy=False) is None
    assert counts.recovering(130.0, e=1.0, e_dot=0.0, within=0.1, calm=0.3, busy=False) is None
