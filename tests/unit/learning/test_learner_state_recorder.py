"""Transitions: two samples that follow each other, the first of them the learner's, and nothing else."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.learning.learner_state import Before, State, TransitionRecorder

Kept = list[tuple[State, float, State, int]]


def recorder() -> tuple[TransitionRecorder, Kept]:
    kept: Kept = []
    return TransitionRecorder(lambda *row: kept.append(row)), kept


def test_samples_of_the_learner_become_pairs_up_to_the_one_in_which_it_lost_the_wheel() -> None:
    takes, kept = recorder()
    for number, learning in enumerate([False, True, True, False, False, True, False]):
        takes.sample(number, (float(number),), 0.1 * number, learning=learning, episode=number)
    assert kept == [((1.0,), 0.1, (2.0,), 2), ((2.0,), 0.2, (3.0,), 3), ((5.0,), 0.5, (6.0,), 6)]


def test_a_sample_that_was_left_out_breaks_the_pair() -> None:
    takes, kept = recorder()
    for number in (4, 5, 7, 8, 0, 1):  # one missed; then the loop began anew
        takes.sample(number, (float(number),), 0.0, learning=True, episode=1)
    assert [(s, s_next) for s, _, s_next, _ in kept] == [((4.0,), (5.0,)), ((7.0,), (8.0,)), ((0.0,), (1.0,))]


def test_nothing_is_recorded_across_a_place_to_which_the_car_was_carried() -> None:
    takes, kept = recorder()
    takes.sample(0, (0.0,), 0.0, learning=True, episode=1)
    takes.forget()
    takes.sample(1, (900.0,), 0.0, learning=True, episode=1)
    takes.sample(2, (901.0,), 0.0, learning=True, episode=1)
    assert [(s, s_next) for s, _, s_next, _ in kept] == [((900.0,), (901.0,))]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_samples_that_are_not_finite_are_left_out(bad: float) -> None:
    takes, kept = recorder()
    for number, (e, action) in enumerate([(0.0, 0.1), (bad, 0.1), (2.0, 0.1), (3.0, bad), (4.0, 0.1), (5.0, 0.1)]):
        takes.sample(number, (e, 0.0), action, learning=True, episode=1)
    assert [(s[0], s_next[0]) for s, _, s_next, _ in kept] == [(2.0, 3.0), (4.0, 5.0)]


def test_the_half_of_a_pair_can_be_kept_and_taken_up_again() -> None:
    takes, _ = recorder()
    takes.sample(6, (0.5,), 0.1, learning=True, episode=2)
    assert takes.before == Before(6, (0.5,), 0.1)
    again, kept = recorder()
    again.before = takes.before
    again.sample(7, (0.6,), 0.0, learning=False, episode=2)
    assert kept == [((0.5,), 0.1, (0.6,), 2)]


@given(st.lists(st.tuples(st.integers(1, 2), st.booleans(), st.sampled_from([0.0, 1.0, math.nan])), max_size=30))
def test_each_pair_is_a_step_of_the_learner(samples: list[tuple[int, bool, float]]) -> None:
    takes, kept = recorder()
    number, seen = 0, {}
    for gap, learning, value in samples:
        number += gap
        seen[number] = (learning, value)
        takes.sample(number, (float(number), value), 0.0, learning=learning, episode=0)
    expected = [
        n
        for n, (learning, value) in seen.items()
        if learning and math.isfinite(value) and n + 1 in seen and math.isfinite(seen[n + 1][1])
    ]
    assert [s[0] for s, _, _, _ in kept] == expected
    assert all(s_next[0] == s[0] + 1 for s, _, s_next, _ in kept)
