"""A whole learning run: every net that took the wheel, and what had happened by then."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from steerkit.learning.training_run import train
from tests.support.short_run import SHORT


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
    assert 0.0 < trained.longest_training <= run.counts.train_seconds <= trained.computing
