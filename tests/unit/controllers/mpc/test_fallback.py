"""The law that steers without a plan is asked at its own point, and goes on from the wheel as it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.mpc.fallback import asked
from steerkit.diagram.block import Block, In, Out
from steerkit.paths.courses import circle
from steerkit.paths.tracker import PathTracker
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.scenario.assembly import placed
from steerkit.vehicles import VW_PASSAT


@dataclass(frozen=True, eq=False, kw_only=True)
class Seen(Block):
    """Shows, as its command, what it was asked with; it remembers the wheel at which it settled."""

    e = In("m")
    psi_e = In("rad")
    kappa = In("1/m")
    v = In("m/s")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    delta_sw = Out("rad")

    shown: str = "e"
    reference: float = 1.2

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (0.0,)

    def settle(self, t: Any, x: Any, u: Any) -> Any:
        return (u.delta_sw_meas,)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0] if self.shown == "settled" else getattr(u, self.shown))

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return x


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("ahead", [1.2, -1.4, 0.0])
def test_its_errors_are_those_of_its_own_point(ahead: float, side: float) -> None:
    """Compared with what a tracker measures there, on a circle to the left, and its mirror image; the rest is of third
    order."""
    path, kappa = circle(20.0), 0.05
    s, psi_e, e = 2.0, 0.03, 0.04
    car = placed(LinearSingleTrack(vehicle=VW_PASSAT), path, s=s, e=e, psi_e=psi_e)

    def measured(reference: float) -> Any:
        tracker = PathTracker(path=path, reference=reference)
        u = tracker.U(x=car.x0, y=car.y0, psi=car.psi0, v=5.0, beta=0.0, r=0.0)
        return tracker.output(0.0, tracker.settle(0.0, tracker.init(), u), u)

    at_cg, there = measured(0.0), measured(ahead)
    assert (at_cg.e, at_cg.psi_e) == pytest.approx((e, psi_e), abs=1e-3)
    state = side * np.array([e, psi_e, 0.0, 0.3, 0.5, 0.0])

    def told(name: str) -> float:
        return asked(Seen(shown=name, reference=ahead), 0.0, state, side * kappa, 5.0)

    assert told("e") == pytest.approx(side * there.e, abs=0.002)
    assert told("psi_e") == pytest.approx(side * there.psi_e, abs=0.002)
    assert (told("kappa"), told("r"), told("delta_sw_meas")) == (side * kappa, side * 0.3, side * 0.5)
    assert told("v") == 5.0


def test_it_begins_with_the_wheel_as_it_is() -> None:
    assert asked(Seen(shown="settled"), 1.2, np.array([0.1, 0.0, 0.0, 0.0, 0.7, 0.0]), 0.0, 5.0) == 0.7


def test_one_without_a_point_of_its_own_is_asked_at_the_plans() -> None:
    seen = Seen(shown="e", reference=1.2)
    assert asked(seen, 1.2, np.array([0.1, 0.2, 0.0, 0.0, 0.7, 0.0]), 0.05, 5.0) == 0.1
