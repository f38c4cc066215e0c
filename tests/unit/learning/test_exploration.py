"""Exploration takes the share of other actions that was asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from steerkit.learning.learn import learn
from steerkit.learning.nfq import iterate as nfq
from tests.support.short_run import SHORT


def test_exploration_takes_the_share_of_other_actions_that_was_asked_for() -> None:
    none = learn(replace(SHORT, minutes=0.2))
    some = learn(replace(SHORT, setting=replace(SHORT.setting, exploration=0.5), minutes=0.2))
    policy = nfq.fresh_nets(SHORT.setting.fit, seed=SHORT.seed)
    for run, least, most in ((none, 0.0, 0.0), (some, 0.25, 0.75)):
        before_training = run.transitions.episode == run.transitions.episode[0]
        s, a = run.transitions.s[before_training], run.transitions.a[before_training]
        actions = sorted(SHORT.setting.actions, key=abs)
        q = nfq.action_values(policy, s, actions, run.description)
        others = np.mean(np.array(actions)[q.argmin(axis=0)] != a)
        assert least <= others <= most  # six of seven random actions are other ones
