"""Rounds that studies drive: what counts is the first round, and a round that was not finished is no result."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.rounds import (
    CAR,
    LAG,
    design_model,
    drive_loop,
    driven,
    interpreted,
    on_course,
    reference_of,
    rms,
    worst,
)
from steerkit.diagram.simulation import Log
from steerkit.scenario.catalogue import make_controller


def log_of(e: list[list[float]], progress: list[list[float]]) -> Log:
    """A log of cars side by side."""
    signals = {"path.e": np.array(e), "path.progress": np.array(progress)}
    return Log(np.arange(len(e)) * 0.05, signals, {"path.e": "m", "path.progress": "m"})


def test_only_the_first_round_counts() -> None:
    log = log_of([[0.3], [-0.4], [5.0], [0.0]], [[0.0], [9.0], [10.0], [9.5]])  # it rolls back over the line
    assert on_course(log, 10.0).ravel().tolist() == [True, True, False, False]
    assert worst(log, 10.0) == pytest.approx([0.4])
    assert rms(log, "path.e", 10.0) == pytest.approx([0.25**0.5 * 0.5**0.5])


def test_a_round_that_was_not_finished_is_infinitely_bad() -> None:
    e = [[0.1, 0.1, 0.1], [0.1, np.nan, 0.2], [0.1, 0.1, 0.3]]
    log = log_of(e, [[0.0, 0.0, 0.0], [5.0, 5.0, 5.0], [9.0, 11.0, 11.0]])
    assert worst(log, 10.0).tolist() == [np.inf, np.inf, 0.2]


def test_controllers_are_told_this_car_and_judged_where_they_measure() -> None:
    told = design_model(delay=0.2)
    assert (told.vehicle, told.delay, told.lag) == (CAR, 0.2, LAG)
    stanley = make_controller("stanley", told)
    assert reference_of(stanley) == pytest.approx(CAR.l_f)
    assert reference_of(make_controller("pure-pursuit", told)) == pytest.approx(-CAR.l_r)


def test_many_cars_at_once_are_driven_as_one_after_the_other() -> None:
    stanley = make_controller("stanley", design_model(delay=0.0))
    loop = drive_loop(stanley, e=0.3, v_max=6.0)
    gains = np.array([stanley.k, 1.0])  # type: ignore[attr-defined]; each car has a human of its own
    many = driven(loop, 5.0, {"controller.k": gains})
    alone = interpreted(loop, 5.0)
    assert alone["path.e"][0] == pytest.approx(0.3, abs=1e-6)
    assert many["path.e"].shape == (len(alone.t), 2)
    differences = np.abs(many["path.e"] - alone["path.e"][:, None]).max(axis=0)
    assert differences[0] < 1e-9
    assert differences[1] > 1e-3
