"""Test drives of many policies at once give the numbers of one drive after the other."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from benchmarks.run import trials
from benchmarks.run.trials import TrialDrive, drive_each, train
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.stanley import Stanley
from steerkit.learning.learner_state import untrained
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import DEFAULT
from steerkit.metrics import of_log
from steerkit.paths.courses import straight
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from tests.support.short_run import SHORT

WORLD = Scenario(course="circle")
SETTING = replace(DEFAULT, fit=FitSetting(nets=2, hidden=(5,)))


def policy(seed: int) -> NfqPolicy:
    return untrained(SETTING, seed)


def test_each_is_judged_as_if_it_drove_alone() -> None:
    """By one program, which does to the last bit what is interpreted: test_policy_drives.py."""
    policies = [policy(seed) for seed in range(5)]
    trials._drives.cache_clear()
    results = drive_each(WORLD, SETTING, policies, seed=3)
    assert trials._drives.cache_info().misses == 1
    assert len({result.rounds for result in results}) > 1
    for one, result in zip(policies, results):
        log = evaluate.drive(WORLD, one, doe=SETTING.element(), seed=3, only_while_held=True)
        held = log["supervisor.learning"] > 0.5
        assert result.held == evaluate.held_all_along(log)
        assert result.rounds * WORLD.path().length == pytest.approx(log["path.progress"][held][-1], abs=1e-9)


def test_the_metrics_are_those_of_the_part_it_drove(tmp_path: Path) -> None:
    lazy = policy(0)  # all weights zero: every action is worth the same, the gentlest wins, and the straight goes on
    zero = tuple(tuple(np.zeros_like(p) for p in net) for net in lazy.nets or ())
    straight(100.0).to_csv(tmp_path / "short.csv")
    scenario = Scenario(course=str(tmp_path / "short.csv"))
    (result,) = drive_each(scenario, SETTING, [replace(lazy, nets=zero)])
    log = evaluate.drive(scenario, replace(lazy, nets=zero), doe=SETTING.element(), rounds=1.0)
    assert result.held
    assert result.summary == of_log(log)


def test_good_is_held_and_within_all_bounds() -> None:
    summary = of_log(evaluate.drive(Scenario(course="circle"), Stanley.of(Scenario().nominal), rounds=1.0))
    assert TrialDrive(rounds=1.0, held=True, summary=summary).good
    assert not TrialDrive(rounds=1.0, held=False, summary=summary).good
    assert not TrialDrive(rounds=1.0, held=True, summary=None).good
    assert not TrialDrive(rounds=1.0, held=True, summary=replace(summary, rms_e=0.11)).good


def test_every_net_that_took_the_wheel_is_kept_in_its_order() -> None:
    trained = train(replace(SHORT, minutes=0.4))
    nets, run = trained.nets, trained.run
    assert run.t >= 0.4 * 60.0
    assert len(nets) >= 2
    assert nets[-1].policy is run.policy
    for earlier, later in pairwise(nets):
        assert earlier.t < later.t
        assert earlier.transitions <= later.transitions
        assert earlier.failures <= later.failures
    assert len({id(net.policy) for net in nets}) == len(nets)
    assert nets[-1].transitions <= len(run.transitions)
    assert 0.0 < trained.longest_training <= run.counts.train_seconds
