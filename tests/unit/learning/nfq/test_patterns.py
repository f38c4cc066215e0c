"""Patterns: scaling, mirroring, hints."""

from __future__ import annotations

import numpy as np

from steerkit.learning.nfq.patterns import STANDARD, goal_patterns, mirror_patterns, patterns
from tests.support.records import ACTIONS, recorded


def test_ranges_become_minus_one_and_one() -> None:
    low, high = np.array([STANDARD.low]), np.array([STANDARD.high])
    assert patterns(STANDARD, low, np.array([-0.5]), 0.5).tolist() == [[-1.0] * 7]
    assert patterns(STANDARD, high, np.array([0.5]), 0.5).tolist() == [[1.0] * 7]


def test_mirroring_patterns_is_mirroring_states() -> None:
    record = recorded(50)
    image = record.mirrored(STANDARD)
    there = patterns(STANDARD, image.s, image.a, 0.5)
    np.testing.assert_array_equal(there, mirror_patterns(STANDARD, patterns(STANDARD, record.s, record.a, 0.5)))


def test_hints_lie_in_the_goal_region_and_leave_the_wheel_alone() -> None:
    x = goal_patterns(STANDARD, ACTIONS, 500, np.random.default_rng(0))
    assert x.shape == (500, 7)
    assert np.all(np.abs(x[:, :-1]) <= STANDARD.goal)
    assert np.all(np.abs(x[:, 2]).max() > 0.9)
    assert np.all(x[:, -1] == 0.0)
    assert set(goal_patterns(STANDARD, (-6.0, 6.0), 100, np.random.default_rng(0))[:, -1]) == {-1.0, 1.0}
