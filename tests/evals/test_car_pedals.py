"""Brake and accelerator of a kit that tells of them: from the frame on the bus to the kit that lets go."""

from pathlib import Path

import pytest

from steerkit.car.config import load, shipped
from steerkit.car.simulated import Fault
from steerkit.car.state_machine import Mode, Order
from tests.support.car_world import World

PEDALS = 0x70
DBC = """VERSION ""
NS_ :
BS_:
BU_: PC CAR
BO_ 112 PEDALS: 2 CAR
 SG_ BRAKE_PRESSED : 3|1@1+ (1,0) [0|1] "" PC
 SG_ GAS : 9|2@1+ (1,0) [0|3] "" PC
"""
READ = """brake = { frame = "PEDALS", signal = "BRAKE_PRESSED" }
accelerator = { frame = "PEDALS", signal = "GAS" }

[read.faults]"""


@pytest.fixture
def world(tmp_path: Path) -> World:
    """Engaged, with the shipped configuration and a frame of the car's with both pedals, fifty times a second."""
    (tmp_path / "pedals.dbc").write_text(DBC)
    text = shipped("dbw-kit.toml").read_text(encoding="utf-8")
    text = text.replace('"pose.dbc"]', '"pose.dbc", "pedals.dbc"]').replace("[read.faults]", READ, 1)
    text = text.replace("[protect] ", "[protect]\nPEDALS = { period = 0.02 }\n#", 1)
    (tmp_path / "car.toml").write_text(text)
    world = World(config=load(tmp_path / "car.toml"))
    world.bring_to(Mode.ENGAGED)
    return world


@pytest.mark.parametrize(("pedal", "what"), [("brake", "the human brakes"), ("accelerator", "the human accelerates")])
def test_a_foot_on_it_ends_driving_at_once_and_until_it_is_up_and_acknowledged(
    world: World, pedal: str, what: str
) -> None:
    began = world.t
    world.car.faults.append(Fault(kind=pedal, target="report", start=began, length=1.5))
    world.until(began + 1.0)
    t, mode, cause = world.modes[-1]
    assert (mode, cause) == (Mode.OVERRIDE, f"{pedal}: {what}")
    assert t - began <= 0.021
    assert max(s.t for s in world.sent if s.enable) <= t
    assert [s.enable for s in world.sent if s.t > t - 1e-9] == [False] * 5
    world.order(Order.ACKNOWLEDGE)
    world.until(world.t + 0.2)
    world.order(Order.ENGAGE)
    world.until(world.t + 0.1)
    assert world.mode is Mode.STANDBY
    assert world.query().text.split("\n")[1].startswith(f"{pedal}: the human ")
    world.until(world.t + 0.5)
    assert world.mode is Mode.READY  # and not engaged by the order of before
    world.check_bus()


def test_pedals_that_say_nothing_any_more_are_a_stale_report(world: World) -> None:
    advance, began = world.car.advance, world.t
    world.car.advance = lambda t: [frame for frame in advance(t) if frame[1] != PEDALS]  # type: ignore[method-assign]
    world.until(began + 0.2)
    t, mode, cause = world.modes[-1]
    assert (mode, cause.split(":")[0]) == (Mode.FAULT, "report stale")
    assert t - began <= 0.1 + 1e-6


def test_a_code_that_means_not_available_counts_as_pressed(world: World) -> None:
    advance = world.car.advance
    world.car.advance = lambda t: [  # type: ignore[method-assign]
        (when, i, b"\0\6" if i == PEDALS else data) for when, i, data in advance(t)
    ]
    world.until(world.t + 0.05)
    assert world.modes[-1][1:] == (Mode.OVERRIDE, "accelerator: the human accelerates")
