"""Updates from a record alone, without driving."""

from dataclasses import replace

import numpy as np
import pytest

from steerkit.learning.learn import offline
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import DEFAULT
from tests.support.modelled_car import driven


@pytest.mark.parametrize("imagined", [0, 100])
def test_offline_updates_are_chained_and_repeatable(imagined: int) -> None:
    setting = replace(DEFAULT, fit=FitSetting(epochs=10, nets=1, imagined=imagined))
    one, two = ([p.nets for p in offline(driven(), setting, 2, seed=4)] for _ in range(2))
    assert all(np.array_equal(a[0][0], b[0][0]) for a, b in zip(one, two, strict=True))
    assert imagined or not np.array_equal(one[0][0][0], one[1][0][0])  # of imagined driving the better net stays
    with pytest.raises(ValueError, match="updates = 0"):
        next(offline(driven(), setting, 0))


def test_offline_updates_start_from_the_nets_before() -> None:
    setting = replace(DEFAULT, fit=FitSetting(epochs=30, nets=1, hints=0, discount=0.95))
    first, second = (policy.nets for policy in offline(driven(), setting, 2, seed=4))
    alone = nfq.iterate(driven(), setting.problem, first or (), seed=4 * 100_003 + 1)
    assert np.array_equal(second[0][0], alone[0][0])
