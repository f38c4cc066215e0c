"""The adversary's net is one car as many, and the search finds what it is asked for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.run.safety_adversary import SIZE, NetAdversary, searched
from steerkit.task import STOP

SEEN = {"e": 0.2, "psi_e": -0.05, "r": 0.1, "v": 6.0, "delta_sw_meas": 0.4}


def test_many_cars_are_each_its_own() -> None:
    drawn = np.random.default_rng(0).normal(size=(SIZE, 3))
    many: Any = NetAdversary(weights=tuple(drawn))
    u = {name: np.full(3, value) for name, value in SEEN.items()}
    x = many.update(0.0, many.init((3,)), many.U(**u), many.output(0.0, many.init((3,)), many.D(**u)))
    angles = many.output(0.05, x, many.D(**u)).delta_sw
    for n in range(3):
        one: Any = NetAdversary(weights=tuple(map(float, drawn[:, n])))
        x = one.update(0.0, one.init(), one.U(**SEEN), one.output(0.0, one.init(), one.D(**SEEN)))
        assert one.output(0.05, x, one.D(**SEEN)).delta_sw == pytest.approx(angles[n], abs=1e-12)
    assert np.ptp(angles) > 0.1
    assert np.abs(angles).max() <= STOP


def test_the_search_finds_the_net_that_turns_most() -> None:
    def turned(net: NetAdversary) -> Any:
        u = {name: np.full(16, value) for name, value in SEEN.items()}
        return net.output(0.0, net.init((16,)), net.D(**u)).delta_sw - 0.01 * sum(w * w for w in net.weights)

    net, course = searched(turned, population=16, generations=12)
    assert course[-1] == max(course) > course[0]
    assert net.output(0.0, net.init(), net.D(**SEEN)).delta_sw > 0.9 * STOP
