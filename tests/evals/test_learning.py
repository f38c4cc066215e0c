"""Learning, end to end: both action sets learn on the same code, and the integrating element is smoother."""

from __future__ import annotations

from functools import cache

import pytest

from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.settings import BANG_BANG, DEFAULT
from steerkit.metrics import of_log
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from steerkit.simulation import Log

SCENARIO = Scenario()


@cache
def learned(name: str) -> tuple[LearningRun, Log]:
    """A run until its first complete round (at most 11 minutes of driving), and a drive of the policy it ended with."""
    setting = {"i-doe": DEFAULT, "bang-bang": BANG_BANG}[name]
    run = learn(Experiment(setting=setting, scenario=SCENARIO, minutes=11.0, rounds=1))
    return run, evaluate.drive(SCENARIO, run.policy, doe=setting.element(), seed=7, only_while_held=True)


@pytest.mark.parametrize("name", ["i-doe", "bang-bang"])
def test_it_learns_a_whole_round_from_nothing(name: str) -> None:
    run, _ = learned(name)
    first = run.counts.episodes[0]
    assert first.failed
    assert first.ended is not None
    assert first.ended - first.began < 5.0  # it knew nothing
    assert run.counts.first_round_done is not None
    assert run.counts.episodes[-1].distance >= SCENARIO.path().length


def test_the_integrating_element_is_smoother() -> None:
    smooth, rough = of_log(learned("i-doe")[1]), of_log(learned("bang-bang")[1])
    assert smooth.rms_wheel_rate_deg < 0.5 * rough.rms_wheel_rate_deg
    assert smooth.rms_jerk < rough.rms_jerk


def test_every_failure_was_caught_and_the_learner_has_the_wheel_at_the_end() -> None:
    run, _ = learned("i-doe")
    assert run.counts.failures == len(run.counts.episodes) - 1 > 0
