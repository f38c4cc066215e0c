"""Totals over driving time, and any stretch as a difference of two."""

from __future__ import annotations

import math

import numpy as np
import pytest

from steerkit.learning.curve import Curve


def filled(seconds: int = 40) -> tuple[Curve, np.ndarray, np.ndarray, np.ndarray]:
    """A curve with a total a second, and what it was made of: e and who steered at 20 Hz, failures a second."""
    rng = np.random.default_rng(3)
    e, learns = rng.normal(size=20 * seconds), rng.random(20 * seconds) < 0.7
    failures = rng.integers(0, 2, seconds)
    curve = Curve(period=0.05)
    for second in range(1, seconds + 1):
        so_far = slice(0, 20 * second)
        sum_e2 = float((e[so_far] ** 2 * learns[so_far]).sum())
        curve.add(second, samples=int(learns[so_far].sum()), sum_e2=sum_e2, failures=int(failures[:second].sum()))
    return curve, e, learns, failures


def test_a_stretch_is_what_happened_in_it() -> None:
    curve, e, learns, failures = filled()
    edges = np.array([0.0, 3.0, 10.0, 40.0])
    rms, share, failed = curve.over(edges)
    for k, (began, ended) in enumerate(((0, 3), (3, 10), (10, 40))):
        part = slice(20 * began, 20 * ended)
        assert rms[k] == pytest.approx(math.sqrt((e[part] ** 2)[learns[part]].mean()))
        assert share[k] == pytest.approx(learns[part].mean())
        assert failed[k] == failures[began:ended].sum()


def test_every_failure_counts_once_however_fine_the_stretches() -> None:
    curve, _, _, failures = filled()
    for pieces in (7, 40, 333):
        counted = curve.over(np.linspace(0.0, 40.0, pieces + 1)).failures
        assert counted.sum() == failures.sum()
        assert np.array_equal(counted, np.round(counted))


def test_where_nobody_drove_and_where_the_learner_did_not_there_is_no_number() -> None:
    curve = Curve()
    curve.add(1.0, samples=20, sum_e2=0.2, failures=0)
    curve.add(2.0, samples=20, sum_e2=0.2, failures=1)
    rms, share, failures = curve.over([0.0, 1.0, 2.0, 3.0])
    assert rms[0] == pytest.approx(0.1)
    assert np.isnan(rms[1:]).all()
    assert share[:2].tolist() == [1.0, 0.0]
    assert math.isnan(share[2])
    assert failures.tolist() == [0.0, 1.0, 0.0]


def test_half_driven_stretches_count_the_driven_half() -> None:
    curve = Curve()
    curve.add(1.0, samples=20, sum_e2=0.2, failures=0)
    assert curve.over([0.0, 4.0]).share.tolist() == [1.0]


def test_time_goes_on() -> None:
    curve = Curve()
    curve.add(1.0, samples=0, sum_e2=0.0, failures=0)
    with pytest.raises(ValueError, match="t = 1 s, expected > 1 s"):
        curve.add(1.0, samples=0, sum_e2=0.0, failures=0)
