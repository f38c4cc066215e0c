"""The map of torque: gain, friction and offset from drives whose truth is known."""

import math
from dataclasses import replace

import pytest

from steerkit.estimators.torque_map import LateralMap, TorqueMap


def test_what_a_torque_does_is_found_while_driving() -> None:
    """Gain, friction and offset that are not the data sheet's, from a drive with a wheel that goes to and fro."""
    true, finder = LateralMap(gain=2.3, friction=0.15, offset=0.1), TorqueMap(gain=2.0, friction=0.2)
    x, a_y, before = finder.init(), 0.0, 0.0
    for k in range(6000):
        u = 0.5 * math.sin(0.3 * 0.01 * k) + 0.2 * math.sin(1.1 * 0.01 * k)
        centre, half = true.gain * u + true.offset, true.gain * true.friction
        before, a_y = a_y, max(centre - half, min(centre + half, a_y))
        x = finder.update(x, u=u, a_y=a_y, turning=(a_y - before) / 0.01, dt=0.01)
        if k == 500:
            assert finder.found(x) == (2.0, 0.2, 0.0)  # too little driving
    found = finder.found(x)
    assert found.gain == pytest.approx(true.gain, rel=0.05)
    assert found.friction == pytest.approx(true.friction, rel=0.2)
    assert found.offset == pytest.approx(true.offset, abs=0.03)
    assert finder.update(x, u=math.nan, a_y=0.0, turning=0.0, dt=0.01) is x
    assert replace(finder, gain=1.6, sure=0.1).found(x).gain == pytest.approx(
        1.3 * 1.6
    )  # no further than may be believed
    still = finder.init()
    for _ in range(6000):
        still = finder.update(still, u=0.3, a_y=0.9, turning=0.2, dt=0.01)
    assert finder.found(still) == (2.0, 0.2, 0.0)  # one torque alone does not tell a gain
