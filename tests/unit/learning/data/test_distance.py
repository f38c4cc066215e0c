"""How far from its data a drive is: zero on them, in closed form beside them."""

import numpy as np
import pytest

from steerkit.controllers.policy import StateDescription
from steerkit.diagram.simulation import Log
from steerkit.learning.data.distance import SIGNALS, Distance, states_of
from steerkit.learning.data.transitions import Transitions
from tests.support.modelled_car import driven

STANDARD = StateDescription()
RECORD = driven()


def test_on_the_data_and_in_their_mirror_it_is_zero() -> None:
    for s in (RECORD.s, RECORD.s * np.array(STANDARD.mirror_signs)):
        apart = Distance.of(s, RECORD, STANDARD)
        assert apart.d.max() == pytest.approx(0.0, abs=1e-12)
        assert apart.far == 0.0
        assert set(apart.outside.values()) == {0.0}


def test_beside_them_it_is_the_largest_difference_in_half_ranges() -> None:
    s = RECORD.s[:1] + np.array([[0.0, 0.0, 20.0, 0.0, 0.0, 0.0]])
    apart = Distance.of(s, RECORD, STANDARD)
    assert apart.d[0] == pytest.approx((s[0, 2] - RECORD.s[:, 2].max()) / 5.0, rel=0.2)
    assert apart.far == 1.0
    assert apart.outside["v"] == 1.0
    assert apart.outside["e"] == 0.0
    assert "mostly by v" in str(apart)
    assert apart.figures()["share_far"] == 1.0


def test_what_is_no_drive_of_a_policy_is_refused() -> None:
    log = Log(np.zeros(3), {signal: np.zeros(3) for signal in SIGNALS.values()}, {})
    assert states_of(log, "here").shape == (3, 6)
    with pytest.raises(ValueError, match=r"here: has no doe\.state"):
        states_of(Log(log.t, {k: v for k, v in log.items() if k != "doe.state"}, {}), "here")
    with pytest.raises(ValueError, match="no transitions"):
        Distance.of(RECORD.s, Transitions(), STANDARD)
