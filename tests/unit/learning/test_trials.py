"""Test drives of many policies at once give the numbers of one drive after the other."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import BANG_BANG, DEFAULT
from steerkit.learning.trials import drive_many
from steerkit.metrics import of_log
from steerkit.scenario import drive as evaluate
from steerkit.scenario.world import World

WORLD = World(course="circle")
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
    world = World(course="straight")
    (result,) = drive_many(world, SETTING, [replace(lazy, nets=zero)], rounds=0.2)
    log = evaluate.drive(world, replace(lazy, nets=zero), doe=SETTING.element(), rounds=0.2)
    assert result.held
    assert result.summary is not None
    assert result.summary.rms_e == pytest.approx(of_log(log).rms_e, abs=1e-12)


def test_policies_that_differ_in_more_than_weights_are_refused() -> None:
    with pytest.raises(ValueError, match="different layouts or actions"):
        drive_many(WORLD, SETTING, [policy(0), policy(0, BANG_BANG.actions)])
    assert drive_many(WORLD, SETTING, []) == []
