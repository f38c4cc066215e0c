"""Whatever is constantly wrong, the car ends on its path, and a car that comes back to it is not turned past it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.offset_free import CommandCompensation, OffsetFree
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.simulation import simulate
from steerkit.diagram.units import radians_of
from steerkit.doe import Integrator
from steerkit.paths.courses import straight
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario import Scenario
from steerkit.scenario.catalogue import make_controller
from steerkit.scenario.drive import controller, drive
from tests.support.straight_road import PASSAT, looped

STRAIGHT = Scenario(course={"name": "straight", "rounds": 0.5}, driver={"v_min": 6.0, "v_max": 6.0})
OFF = {"steering": {"offset_deg": 5.0}}
OTHER_CAR = {"vehicle": {"ratio": 1.25, "tyres": 0.6}}
D = radians_of(5.0)
HERE = dict(e=0.01, psi_e=0.0, kappa=0.0, v=6.0, r=0.0, delta_sw_meas=0.0)


@cache
def at_the_end(name: str, scenario: Scenario) -> float:
    """e in the last second, which has to be steady [m]."""
    e = drive(scenario, controller(name, scenario))["path.e"][-20:]
    assert np.ptp(e) < 5e-4
    return float(e[-1])


STANLEY_BESIDE = D * (Stanley.k_soft + 6.0) / (Stanley.k * PASSAT.steer_ratio)


def lqr_beside() -> float:
    """Its command is -D, and stands there: the terms of e and of the command are each other's opposite."""
    block: Any = controller("lqr", STRAIGHT)
    row = block.table.rows[round((6.0 - block.v_min) / block.v_step)]
    return float(row[5]) * math.tan(D / PASSAT.steer_ratio) / float(row[0])


@pytest.mark.parametrize(
    ("name", "beside"), [("stanley-delay", None), ("stanley", STANLEY_BESIDE), ("lqr", lqr_beside)]
)
def test_an_offset_of_the_wheel_leaves_what_the_law_says_and_nothing_with_it(
    name: str, beside: float | Callable[[], float] | None
) -> None:
    off = STRAIGHT.with_(**OFF)
    without = at_the_end(name, off)
    assert without > 0.008
    if beside is not None:
        assert without == pytest.approx(beside() if callable(beside) else beside, rel=0.02)
    if name != "stanley":
        assert abs(at_the_end(f"{name.removesuffix('-delay')}-offset-free", off)) < 1e-3


@pytest.mark.parametrize(
    ("name", "wrong"), [("stanley", OFF | OTHER_CAR), ("lqr", {"disturbances": {"bank_deg": 3.0}})]
)
def test_in_a_steady_bend_neither_offset_nor_bank_nor_ratio_leaves_an_error(name: str, wrong: dict[str, Any]) -> None:
    bent = STRAIGHT.with_(course={"name": "circle", "rounds": 0.8}, **wrong)
    assert abs(at_the_end("stanley-delay" if name == "stanley" else name, bent)) > 5e-3
    assert abs(at_the_end(f"{name}-offset-free", bent)) < 1e-3


def driven(block: Any, e: float) -> np.ndarray:
    """e at the front axle of a car that starts so far beside a straight, at 6 m/s."""
    car = NonlinearSingleTrack(vehicle=PASSAT, v0=6.0)
    loop = looped(block, straight(200.0), 6.0, 0.0, car=car, actuator=None, s=5.0, e=e)
    return np.asarray(simulate(loop, 12.0)["path.e"])


def test_the_disturbance_is_found_within_the_time_that_is_stated() -> None:
    """Behind the law's own transient e = v d/n exp(-t/tau)/(1/T - 1/tau), T = (k_soft + v)/(k v)."""
    law = replace(Stanley.of(PASSAT), k_d_yaw=0.0, k_d_steer=0.0)
    T, tau, n = (law.k_soft + 6.0) / (law.k * 6.0), 4.0, PASSAT.steer_ratio
    off = STRAIGHT.with_(steering={"offset_deg": 5.0, "lag": 0.0})
    e = drive(off, OffsetFree.around(law, PASSAT, approach=T, time=tau))["path.e"]
    assert e[180] / e[100] == pytest.approx(math.exp(-1.0), rel=0.03)
    assert e[100] == pytest.approx(6.0 * D / n * math.exp(-5.0 / tau) / (1.0 / T - 1.0 / tau), rel=0.05)


@pytest.mark.parametrize(("name", "start"), [("stanley", 0.45), ("lqr", 3.0), ("mpc", 0.45)])
def test_a_car_that_starts_beside_its_path_is_turned_past_it_by_no_more_than_2_cm(name: str, start: float) -> None:
    bare = make_controller(
        "stanley-delay" if name == "stanley" else name, STRAIGHT.with_(steering={"lag": 0.0}).design_model()
    )
    e, before = driven(OffsetFree.around(bare, PASSAT), start), driven(bare, start)
    assert abs(e[-1]) < 0.01
    assert e.min() > min(before.min(), 0.0) - 0.02


def z_after(block: OffsetFree, state: Any, **u: float) -> float:
    values = block.U(**HERE | u)
    y = block.output(0.0, state, block.D(**HERE | u))
    return float(block.update(0.0, state, values, y)[-5])


def test_a_constant_that_is_known_is_moved_less() -> None:
    """tau is `time` at first, then half of the time for which z has moved, at most `time_late`."""
    block = OffsetFree.around(Stanley.of(PASSAT), PASSAT, time=3.0, time_late=20.0)
    inner = block.settle(0.0, block.init(), block.U(**HERE))[:-5]

    def moved(clock: float) -> float:
        return z_after(block, (*inner, 0.0, clock, 0.0, 0.01, 0.1))

    assert moved(5.0) == moved(0.0) != 0.0
    assert moved(24.0) == pytest.approx(moved(0.0) * 3.0 / 12.0)
    assert moved(1000.0) == pytest.approx(moved(0.0) * 3.0 / 20.0)
    settled = replace(block, time_late=0.0)
    assert z_after(settled, (*inner, 0.0, 1000.0, 0.0, 0.01, 0.1)) == moved(0.0)


def test_where_the_law_is_slower_both_times_grow_with_it() -> None:
    """z' = -n/(v T tau) (e + T e'), T and tau each twice as long at twice v_full; below it nothing changes."""
    law = OffsetFree.around(Stanley.of(PASSAT), PASSAT)
    slower = replace(law, v_full=3.0)
    twice = replace(law, approach=2.0 * law.approach, time=2.0 * law.time)
    at_rest = law.init()
    moving = (*at_rest[:-2], 0.004, at_rest[-1])  # e' counts, too
    assert z_after(slower, moving) == pytest.approx(z_after(twice, moving), rel=1e-12)
    assert z_after(slower, moving) != pytest.approx(z_after(law, moving), rel=0.1)
    assert z_after(slower, moving, v=2.5) == z_after(law, moving, v=2.5)


def after(block: OffsetFree, *pieces: tuple[float, float]) -> Any:
    """The state after e [m] was measured for so long [s], each piece in turn, by a wheel that follows at once."""
    x = block.settle(0.0, block.init(), block.U(**HERE | {"e": 0.0}))
    for seconds, e in pieces:
        for _ in range(round(seconds / block.dt)):
            y = block.output(0.0, x, block.D(**HERE | {"e": e}))
            x = block.update(0.0, x, block.U(**HERE | {"e": e}), y)
    return x


def test_a_constant_that_turns_out_to_be_another_one_is_found_as_fast_as_the_first() -> None:
    """3 cm that stay for seconds are no noise, 10 cm in a short bend and 1 cm all the time are no reason."""
    block = OffsetFree.around(Stanley.of(PASSAT), PASSAT, time=5.0, time_late=30.0)
    assert after(block, (60.0, 0.0))[-4] == pytest.approx(60.0)
    for e in (0.03, -0.03):
        assert after(block, (60.0, 0.0), (4.0, e))[-4] == 0.0
        assert after(block, (60.0, 0.0), (3.0, 3.0 * e), (4.0, 0.0))[-4] > 60.0
    assert after(block, (60.0, 0.01))[-4] == pytest.approx(60.0)


def test_where_it_stands_still() -> None:
    block = OffsetFree.around(Stanley.of(PASSAT), PASSAT)
    u = block.U(**HERE)
    x = block.settle(0.0, block.init(), u)
    assert z_after(block, x) == pytest.approx(-block.steer_ratio / (6.0 * 0.5 * 3.0) * 0.05 * 0.01)
    assert z_after(block, x, e=-0.01) == pytest.approx(block.steer_ratio / 9.0 * (0.05 * 0.01 + 0.5 * 0.02))
    stood = (*x[:-5], 0.2, 0.0, 0.0, 0.01, 0.1)
    for wrong in ({"e": 0.6}, {"e": -0.6}, {"v": 0.5}, {"v": -3.0}, {"e": math.nan}, {"v": math.nan}):
        assert z_after(block, stood, **wrong) == 0.2
    for right in ({"e": 0.5}, {"e": -0.5}, {"v": 1.0}):
        assert z_after(replace(block, rate_limit=200.0), stood, **right) != 0.2
    y = block.output(0.0, stood, block.D(**HERE)).delta_sw
    for share, moves in ((0.985, True), (0.995, False)):  # of the fastest command
        before = y - share * radians_of(550.0) * 0.05
        assert (z_after(block, (*stood[:-1], before)) != 0.2) is moves
    assert z_after(block, (*stood[:-5], -1.2, 0.0, 0.0, 0.01, y - 1.4)) == -radians_of(60.0)
    assert z_after(replace(block, limit=1e-3), stood) == 0.2
    assert z_after(replace(block, rate_limit=1e-3), stood) == 0.2
    assert abs(z_after(replace(block, most=0.2), (*x[:-5], -0.2, 0.0, 0.0, 0.01, -0.3))) == 0.2


@dataclass(frozen=True, eq=False, kw_only=True)
class Blind(Block):
    """A law that does not look at the wheel."""

    e = In("m")
    v = In("m/s")
    delta_sw = Out("rad")

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(0.0 * u.e)


def test_a_law_that_does_not_see_the_wheel_begins_with_a_straight_one() -> None:
    block = OffsetFree(block=Blind())
    assert block.settle(0.0, block.init(), block.U(e=0.3, v=5.0)) == (0.0, 0.0, 0.0, 0.3, 0.0)


# ---- a known offset -----------------------------------------------------------------------------------------------


def test_a_known_offset_and_gain_are_compensated() -> None:
    block = CommandCompensation(block=Stanley.of(PASSAT), offset=0.1, gain=1.25)
    u = dict(e=0.2, psi_e=0.01, kappa=0.0, v=6.0, r=0.0, delta_sw_meas=0.0)
    inner = block.block.output(0.0, block.init(), block.D(**u)).delta_sw
    y = block.output(0.0, block.init(), block.D(**u))
    assert 1.25 * y.delta_sw + 0.1 == pytest.approx(inner)
    assert block.update(0.0, block.init(), block.U(**u), y) == pytest.approx(
        block.block.update(0.0, block.init(), block.U(**u), block.Y(inner))
    )


def test_what_they_are_not_made_for() -> None:
    with pytest.raises(ValueError, match="expected among them e, v"):
        OffsetFree(block=Integrator())
    for kind in (OffsetFree, CommandCompensation):
        with pytest.raises(ValueError, match="expected among them delta_sw"):
            kind(block=ConstantSpeed())
