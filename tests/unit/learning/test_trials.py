"""Test drives of many policies at once give the numbers of one drive after the other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.stanley import Stanley
from steerkit.learning import trials
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import BANG_BANG, DEFAULT
from steerkit.learning.trials import TrialDrive, drive_each, drive_many
from steerkit.metrics import of_log
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate

WORLD = Scenario(course="circle")
SETTING = replace(DEFAULT, fit=FitSetting(nets=2, hidden=(5,)))


def policy(seed: int, actions: tuple[float, ...] = SETTING.actions) -> NfqPolicy:
    description = SETTING.description()
    nets = nfq.fresh_nets(SETTING.fit, description, seed=seed)
    return NfqPolicy(nets=nets, actions=actions, description=description)


@pytest.mark.parametrize("combine", ["mean", "max", "disagreement"])
def test_each_is_judged_as_if_it_drove_alone(combine: Any) -> None:
    policies = [replace(policy(seed), combine=combine) for seed in range(5)]
    results = drive_many(WORLD, SETTING, policies, seed=3)
    for one, result in zip(policies, results):
        log = evaluate.drive(WORLD, one, doe=SETTING.element(), seed=3, only_while_held=True)
        held = log["supervisor.learning"] > 0.5
        assert result.held == evaluate.held_all_along(log)
        assert result.rounds * WORLD.path().length == pytest.approx(log["path.progress"][held][-1], abs=1e-9)


def test_the_metrics_are_those_of_the_part_it_drove() -> None:
    lazy = policy(0)  # all weights zero: every action is worth the same, the gentlest wins, and the circle goes on
    zero = tuple(tuple(np.zeros_like(p) for p in net) for net in lazy.nets or ())
    scenario = Scenario(course="straight")
    (result,) = drive_many(scenario, SETTING, [replace(lazy, nets=zero)], rounds=0.2)
    log = evaluate.drive(scenario, replace(lazy, nets=zero), doe=SETTING.element(), rounds=0.2)
    assert result.held
    assert result.summary is not None
    assert result.summary.rms_e == pytest.approx(of_log(log).rms_e, abs=1e-12)


def test_policies_that_differ_in_more_than_weights_are_refused() -> None:
    with pytest.raises(ValueError, match="different layouts or actions"):
        drive_many(WORLD, SETTING, [policy(0), policy(0, BANG_BANG.actions)])
    assert drive_many(WORLD, SETTING, []) == []


def test_nets_of_different_layouts_are_judged_in_their_order() -> None:
    three = replace(SETTING, fit=FitSetting(nets=3, hidden=(5,)))
    more = NfqPolicy(
        nets=nfq.fresh_nets(three.fit, SETTING.description(), seed=9),
        actions=SETTING.actions,
        description=SETTING.description(),
    )
    policies = [policy(1), more, policy(2)]
    alone = [drive_many(WORLD, SETTING, [one], seed=3)[0] for one in policies]
    each = drive_each(WORLD, SETTING, policies, seed=3)
    assert [one.rounds for one in each] == pytest.approx([one.rounds for one in alone], rel=1e-9)
    assert len({one.rounds for one in alone}) > 1
    assert drive_each(WORLD, SETTING, []) == []


def test_what_is_no_net_drives_by_itself_to_the_same_result() -> None:
    one = policy(4)
    (net,) = drive_each(WORLD, SETTING, [one], seed=3)
    alone = trials._drive_one(WORLD, SETTING, one, 3)
    assert (alone.held, alone.good) == (net.held, net.good)
    assert alone.rounds == pytest.approx(net.rounds, abs=0.01)


def test_good_is_held_and_within_all_bounds() -> None:
    summary = of_log(evaluate.drive(Scenario(course="circle"), Stanley.of(Scenario().nominal), rounds=1.0))
    assert TrialDrive(rounds=1.0, held=True, summary=summary).good
    assert not TrialDrive(rounds=1.0, held=False, summary=summary).good
    assert not TrialDrive(rounds=1.0, held=True, summary=None).good
    assert not TrialDrive(rounds=1.0, held=True, summary=replace(summary, rms_e=0.11)).good
