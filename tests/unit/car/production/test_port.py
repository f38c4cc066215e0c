"""The port of a production car: when it steers, and when it does not."""

import pytest

pytest.importorskip("opendbc")

from benchmarks.run.production import PortedCar, ProductionWorld, config_of
from benchmarks.studies import production_cars as study
from steerkit.car.production.platforms import platform
from steerkit.car.production.port import OTHER, REJECTED_BUS, RELEASED, SILENCE, Frame
from steerkit.car.production.simulated import ProductionCar
from steerkit.car.simulated import Fault
from steerkit.estimators.torque_map import LateralMap
from tests.support.production import judged, ported, steered


@judged
def test_after_a_rejection_port_and_safety_code_begin_anew_together() -> None:
    car = ported("TESLA_MODEL_3")
    car.advance(1.2)
    steered(car, 0.5, 0.2)
    before = car.car.counts.rejected
    car.port.receive(car.due, Frame(0x488, b"", REJECTED_BUS))
    steered(car, 0.04, 0.2)
    assert not car.port.steering
    assert car.port.why == "a frame was rejected"
    steered(car, RELEASED + 0.1, 0.2)
    assert car.port.steering
    assert car.car.counts.rejected == before


def test_a_port_asks_for_nothing_without_a_fresh_command_and_sends_nothing_into_silence() -> None:
    car = ported("TOYOTA_COROLLA_TSS2")
    car.advance(1.2)
    steered(car, 0.4, 0.1)
    assert car.port.steering
    car.advance(car.due + 0.2)
    assert not car.port.steering
    assert "command old" in car.port.why
    heard: list[Frame] = []
    car.listen = heard.append
    car.faults.append(Fault(kind="drop", target="report", start=0.0))
    car.advance(car.due + SILENCE + 0.05)
    heard.clear()
    steered(car, 0.3, 0.1)
    assert not heard
    assert not car.port.steering


@pytest.mark.parametrize("name", ["TESLA_MODEL_3", "TOYOTA_COROLLA_TSS2", "FORD_MUSTANG_MACH_E_MK1"])
def test_another_sender_of_frames_that_steer_is_noticed_and_the_port_lets_go(name: str) -> None:
    car = ported(name)
    heard: list[Frame] = []
    car.listen = heard.append
    car.advance(1.2)
    steered(car, 0.4, 0.02)
    assert car.port.steering
    own = next(f for f in heard if f.frame_id in car.car.frames.asks)
    car.port.receive(car.due, own._replace(bus=own.bus + 2))  # the camera's, behind the relay
    steered(car, 0.04, 0.02)
    assert car.port.steering
    car.port.receive(car.due, own)
    steered(car, 0.04, 0.02)
    assert not car.port.steering
    assert car.port.why == "OTHER_SENDER"
    steered(car, OTHER + 0.1, 0.02)
    assert car.port.steering


def test_equal_frames_give_equal_frames() -> None:
    frames: list[list[Frame]] = []
    for _ in range(2):
        car = PortedCar(config_of("HYUNDAI_ELANTRA_2021"), s=10.0)
        heard: list[Frame] = []
        car.listen = heard.append
        car.advance(0.8)
        steered(car, 0.6, 0.05)
        frames.append(heard)
    assert len(frames[0]) > 100
    assert frames[0] == frames[1]


@judged
def test_a_torque_car_is_driven_with_a_map_that_is_wrong() -> None:
    true = LateralMap(gain=1.2 * platform("TOYOTA_COROLLA_TSS2").lateral.gain, friction=0.12, offset=0.15)
    world = ProductionWorld(config_of("TOYOTA_COROLLA_TSS2"), seed=2, lateral=true)
    drive = study.drive_of(world, "lqr")
    while len(drive.e) < 80 and not drive.ended:
        drive.step()
    assert not drive.ended
    assert max(map(abs, drive.e)) < 0.3


@judged
def test_the_car_s_own_watchdog_lets_go_when_the_port_no_longer_sends() -> None:
    car = ported("TESLA_MODEL_3")
    heard: list[Frame] = []
    car.listen = heard.append
    car.advance(1.2)
    steered(car, 0.3)
    made = ProductionCar(config_of("TESLA_MODEL_3"), s=10.0)
    made.hear(0.0, next(frame for frame in heard[::-1] if frame.frame_id == 0x488))
    made.advance(0.05)
    assert made.enabled
    made.advance(0.05 + SILENCE + 0.05)
    assert not made.enabled
