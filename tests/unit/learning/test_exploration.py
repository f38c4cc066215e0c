"""Exploration takes the share of other actions that was asked for."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning.exploration import Exploring
from steerkit.learning.learn import learn
from steerkit.learning.nfq import iterate as nfq
from tests.support.short_run import SHORT

POLICY = NfqPolicy(nets=nfq.fresh_nets(seed=1), actions=tuple(float(a) for a in np.linspace(-0.5, 0.5, 8)))


def test_exploration_takes_the_share_of_other_actions_that_was_asked_for() -> None:
    how = replace(SHORT.setting, continuous=False)
    none = learn(replace(SHORT, setting=how, minutes=0.2))
    some = learn(replace(SHORT, setting=replace(how, exploration=0.5), minutes=0.2))
    policy = nfq.fresh_nets(SHORT.setting.fit, seed=SHORT.seed)
    for run, least, most in ((none, 0.0, 0.0), (some, 0.25, 0.75)):
        before_training = run.transitions.episode == run.transitions.episode[0]
        s, a = run.transitions.s[before_training], run.transitions.a[before_training]
        q = nfq.action_values(SHORT.setting.problem, policy, s[:, :6])
        others = np.mean(np.array(SHORT.setting.actions)[q.argmin(axis=0)] != a)
        assert least <= others <= most  # six of seven random actions are other ones


def decisions(block: Exploring, samples: int, **values: Any) -> np.ndarray:
    """Actions of 500 cars in the same state over some samples, (samples, 500)."""
    u = block.D(**{name: np.full(500, 0.1) for name in block.D._fields} | values)
    x, actions = block.init((500,)), []
    for k in range(samples):
        y = block.output(0.05 * k, x, u)
        actions.append(y.action)
        x = block.update(0.05 * k, x, u, y)
    return np.array(actions)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_share_is_that_asked_for_and_all_actions_are_equally_likely(share: float) -> None:
    actions = decisions(Exploring(block=POLICY, share=share, seed=4), 200)
    greedy = float(POLICY.output(0.0, (), POLICY.D(*[0.1] * 6)).action)
    for action in POLICY.actions:
        expected = share / 8 + (1.0 - share) * (action == greedy)
        assert np.mean(actions == action) == pytest.approx(expected, abs=0.006)  # 5 sigma of 100 000


def test_what_is_taken_does_not_tell_whether_the_next_sample_explores() -> None:
    actions = decisions(Exploring(block=POLICY, share=0.5, seed=4), 200)
    greedy = float(POLICY.output(0.0, (), POLICY.D(*[0.1] * 6)).action)
    now, then = actions[:-1], actions[1:] != greedy
    rates = [then[now == action].mean() for action in POLICY.actions if action != greedy]
    np.testing.assert_allclose(rates, 0.5 * 7 / 8, atol=0.03)


def test_a_fault_stays_a_fault() -> None:
    actions = decisions(Exploring(block=POLICY, share=1.0), 3, v=np.full(500, np.nan))
    assert np.isnan(actions).all()
