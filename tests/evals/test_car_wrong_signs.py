"""A car whose motor, wheel sensor or gyro has the wrong sign from the start: named, before the true car is 1 m off."""

import math
from dataclasses import replace

import pytest

from steerkit.car import loop as loops
from steerkit.car.simulated import Fault
from steerkit.car.state_machine import Mode, Order
from steerkit.paths.courses import course
from tests.support.car_world import CONFIG, World

NAMED = {
    "motor_sign": "check the sign of the command",
    "wheel_sign": "check the sign of",
    "gyro_sign": "check the sign of the yaw rate",
}
CLEAR = 0.05
"""So far off, or so much of the heading, is clear evidence [m, rad]."""


class Swapped(World):
    """And how it went."""

    worst = 0.0
    """Largest |e| of the true car once it was engaged [m]."""
    clear = math.inf
    """When there was clear evidence [s]."""


def swapped(kind: str, name: str, s: float, v: float, controller: str = "stanley", **untold: float) -> Swapped:
    """Half a second by hand, then engaged; until it let go or 6 s have passed."""
    config = replace(CONFIG, course=course(name))
    block = loops.controller_named(controller, config, in_time=True).block
    world = Swapped(s=s, v=(v, v + 0.3), config=config, controller=block, **untold)
    if kind:
        world.car.faults.append(Fault(kind=kind, target="report", start=0.0))
    world.order(Order.ARM)
    engaged, psi = False, world.car.now.psi
    while world.t < 6.0:
        world.until(world.t + 0.02)
        if abs(world.car.on_path.e) > CLEAR or abs(world.car.now.psi - psi) > CLEAR:
            world.clear = min(world.clear, world.t)
        if not engaged and world.mode is Mode.READY and world.t > 0.5:
            world.order(Order.ENGAGE)
        engaged |= world.mode is Mode.ENGAGED
        if engaged:
            world.worst = max(world.worst, abs(world.car.on_path.e))
        let_go = world.mode is not Mode.ENGAGED if engaged else "reversed" in " ".join(obstacles(world))
        if let_go:
            break
    return world


def obstacles(world: World) -> list[str]:
    return [*world.core.obstacles(), world.core.machine.cause]


PLACES = [("paper", 147.0, 2.0), ("paper", 147.0, 7.0), ("genesis", 60.0, 5.0), ("figure-eight", 5.0, 4.0)]


@pytest.mark.parametrize(("name", "s", "v"), PLACES)
@pytest.mark.parametrize("kind", NAMED)
def test_a_wrong_sign_is_named_within_2_s_and_1_m(kind: str, name: str, s: float, v: float) -> None:
    world = swapped(kind, name, s, v)
    (said,) = {text for text in obstacles(world) if text.startswith("steering reversed: ")}
    assert NAMED[kind] in said
    assert world.mode in (Mode.FAULT, Mode.STANDBY)
    assert world.worst < 0.5
    assert world.t - world.clear < 2.0
    world.check_bus()


def test_whoever_steers_and_however_late_the_motor_is() -> None:
    world = swapped("motor_sign", "paper", 120.0, 6.0, "pure-pursuit", delay=0.3, lag=0.2)
    assert world.mode is Mode.FAULT
    assert world.core.machine.cause.startswith("steering reversed: the wheel turns against the command")
    assert world.worst < 1.0


@pytest.mark.parametrize(("name", "s", "v"), PLACES[::3])
def test_right_signs_are_believed(name: str, s: float, v: float) -> None:
    world = swapped("", name, s, v, delay=0.2, offset=0.05)
    assert world.mode is Mode.ENGAGED, obstacles(world)


def test_it_is_named_until_the_car_drives_right() -> None:
    world = swapped("gyro_sign", "paper", 147.0, 7.0)
    assert world.mode is Mode.STANDBY  # half a second by hand was enough
    world.until(world.t + 2.0)
    assert "sign of the yaw rate" in world.core.obstacles()[0]
    world.car.faults.clear()
    world.until(world.t + 8.0)
    assert not any("reversed" in text for text in world.core.obstacles())


def test_a_motor_is_tried_again_after_an_acknowledgement() -> None:
    world = swapped("motor_sign", "paper", 147.0, 5.0)
    for _ in range(2):
        assert world.mode is Mode.FAULT
        assert "the wheel turns against the command" in world.core.machine.cause
        world.order(Order.ACKNOWLEDGE)
        awaited(world, Mode.READY)
        world.order(Order.ENGAGE)
        awaited(world, Mode.FAULT)


def awaited(world: World, mode: Mode) -> None:
    """Drive until it is in that state, for 30 s at the most."""
    end = world.t + 30.0
    while world.mode is not mode:
        world.until(world.t + 0.05)
        assert world.t < end, world.core.obstacles()
