"""The learning curve is the share of seeds that are good by then."""

import math

import numpy as np
import pytest

from benchmarks.report import learning
from benchmarks.run.results import Results, good_nets


def test_the_learning_curve_is_the_share_of_seeds_that_are_good_by_then(known: Results) -> None:
    """Seed k is good from minute 1 + k/2 on, the last one never."""
    (curves,) = learning.learning(known, known.cases, points=59)
    good, low, high = curves.good["nfq-idoe"]
    for minute, share in ((0.5, 0.0), (1.3, 1.0 / 6.0), (2.3, 0.5), (4.8, 5.0 / 6.0)):
        at = int(np.searchsorted(curves.x, minute))
        assert good[at] == pytest.approx(share)
        assert low[at] <= good[at] <= high[at]
    rms_e = curves.rms_e["nfq-idoe"][0]
    assert rms_e[0] == np.inf
    assert rms_e[-1] == 0.02


@pytest.mark.parametrize(
    "flaw",
    [("held", 0.0), ("rounds", 0.99), ("max_e", 0.25), ("rms_e", 0.1), ("max_jerk", 5.0), ("max_jerk", math.nan)],
)
def test_only_a_net_that_meets_the_whole_criterion_is_drawn_as_good(flaw: tuple[str, float]) -> None:
    name, value = flaw
    curve = {"held": 1.0, "rounds": 1.0, "max_e": 0.24, "rms_e": 0.09, "max_jerk": 4.9}
    columns = {key: np.array([number, value if key == name else number]) for key, number in curve.items()}
    assert good_nets(columns).tolist() == [True, False]
