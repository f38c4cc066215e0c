"""Learning without driving: updates on a stored record of transitions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from steerkit._support.errors import require
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.learner_state import untrained
from steerkit.learning.nfq.update import Learned, update
from steerkit.learning.settings import Setting


def offline(record: Transitions, setting: Setting, updates: int, *, seed: int = 0) -> Iterator[NfqPolicy]:
    """The policies after each of `updates` updates on the same recorded transitions.

    record: of one run or of several, whatever steered. Policies are ready to drive, or to `save`. The same numbers for
    the same arguments. Raises ValueError as `nfq.iterate` does, or for updates < 1.
    """
    require(updates >= 1, "offline", f"updates = {updates}, expected >= 1")
    policy = untrained(setting, seed)
    description = setting.description()
    learned = Learned()
    for number in range(updates):
        learned = update(
            record, setting.actions, setting.cost, setting.fit, description, learned, seed=seed * 100_003 + number
        )
        yield replace(policy, nets=learned.nets, forecast=learned.forecast)
