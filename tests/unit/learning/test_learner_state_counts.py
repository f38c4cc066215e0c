"""Counting: metres, episodes, failures, rounds."""

import math

import pytest

from steerkit.learning.learner_state import Counts


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
