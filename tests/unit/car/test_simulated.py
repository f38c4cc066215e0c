"""The simulated car: its kit does what a kit does."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.car.config import load, shipped
from steerkit.car.core import Frame
from steerkit.car.simulated import WATCHDOG, Fault, SimulatedCar
from steerkit.car.state_machine import Mode
from tests.support.car_world import BEND, CONFIG, World


def car(**changes: Any) -> SimulatedCar:
    return SimulatedCar(CONFIG, **{"s": 20.0, "v_min": 5.0, "v_max": 5.0, **changes})


def tell(it: SimulatedCar, angle: float, *, enable: bool = True, clear: bool = False) -> None:
    it.receive(it.t, CONFIG.writer.message.frame_id, CONFIG.writer.write(angle, enable=enable, clear=clear))


@pytest.mark.parametrize("period", [0.005, 0.015])
def test_a_pose_as_often_as_the_configuration_says_is_driven_by(tmp_path: Path, period: float) -> None:
    text = shipped("dbw-kit.toml").read_text(encoding="utf-8").replace("period = 0.01 }", f"period = {period} }}")
    (tmp_path / "car.toml").write_text(text)
    world = World(config=load(tmp_path / "car.toml")).bring_to(Mode.ENGAGED)
    world.until(3.0)
    assert world.mode is Mode.ENGAGED
    poses = [event for event, _ in world.events if isinstance(event, Frame) and event.frame_id == 0x120]
    assert len(poses) == pytest.approx(3.0 / period, abs=2)


def test_the_kit_lets_go_100_ms_after_the_last_command_and_until_it_is_cleared() -> None:
    it = car()
    tell(it, 0.1)
    it.advance(0.09)
    assert (it.enabled, it.timeout) == (True, False)
    it.advance(0.12)
    assert WATCHDOG == 0.1
    assert (it.enabled, it.timeout) == (False, True)
    tell(it, 0.1)
    assert not it.enabled
    tell(it, 0.1, clear=True)
    assert (it.enabled, it.timeout) == (True, False)


def test_an_override_lasts_until_a_frame_without_enable() -> None:
    it = car()
    tell(it, 0.1)
    it.faults.append(Fault(kind="override", target="report", start=it.t, length=0.02))
    it.advance(it.t + 0.03)
    assert (it.enabled, it.overridden) == (False, True)
    tell(it, 0.1)
    assert not it.enabled, "enable alone does not take the wheel back"
    tell(it, 0.1, enable=False)
    assert not it.overridden
    tell(it, 0.1)
    assert it.enabled


@pytest.mark.parametrize("e", [-0.8, 0.0, 0.6])
@pytest.mark.parametrize("s", [20.0, 200.0, 430.0])
def test_it_starts_where_it_is_told(s: float, e: float) -> None:
    it = car(s=s, e=e)
    psi = float(CONFIG.course.psi(s))
    away = np.array([it.now.x, it.now.y]) - CONFIG.course.point(s)
    assert away @ (math.cos(psi), math.sin(psi)) == pytest.approx(0.0, abs=1e-9)
    assert away @ (-math.sin(psi), math.cos(psi)) == pytest.approx(e, abs=1e-9)
    assert it.now.psi == pytest.approx(psi)


def test_what_nobody_is_told_of_the_car() -> None:
    """Delay and lag are the motor's and not the hands'; the offset is behind the sensor of the wheel."""
    true = replace(CONFIG.vehicle, steer_ratio=20.0)
    it = car(vehicle=true, delay=0.2, lag=0.05, offset=0.03, rate_zero=0.004)
    for k in range(300):
        tell(it, 0.5)
        it.advance(0.01 * (k + 1))
        if k < 19:
            assert it.turned == 0.0
    assert it.turned == pytest.approx(0.5, abs=0.002)
    assert it._values()["delta_sw"] == it.turned
    assert it._values()["r"] == it.now.r + 0.004
    turn = (it.turned + 0.03) / 20.0 * it.now.v / (true.wheelbase + true.understeer_gradient * it.now.v**2)
    assert it.now.r == pytest.approx(turn, rel=0.01)


def test_a_delayed_motor_goes_on_from_the_wheel_as_it_is() -> None:
    it = car(s=BEND, delay=0.2)
    it.advance(2.0)
    before = it.turned
    assert abs(before) > 0.1
    for k in range(19):
        tell(it, 0.0)
        it.advance(2.0 + 0.01 * (k + 1))
        assert it.turned == pytest.approx(before, abs=1e-9)
