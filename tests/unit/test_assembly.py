"""The ready-made steering loop: the standard wires, by name, and teaching errors when a part is missing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from steerkit.assembly import placed, steering_loop
from steerkit.block import Block, In, Out
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.stanley import Stanley
from steerkit.courses import circle, course
from steerkit.doe import Integrator
from steerkit.errors import WiringError
from steerkit.loop import Loop
from steerkit.plants.careful_driver import CarefulDriver
from steerkit.plants.human_driver import ConstantSpeed, HumanDriver
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.sensors import Sensors
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.simulation import simulate
from steerkit.tracker import PathTracker
from steerkit.vehicles import VW_PASSAT

ROUND = circle(30.0)


def parts() -> dict:
    car = placed(NonlinearSingleTrack(vehicle=VW_PASSAT, v0=5.0), ROUND)
    return dict(car=car, path=ROUND, driver=ConstantSpeed(speed=5.0), controller=Stanley.of(VW_PASSAT))


def test_it_is_the_same_loop_as_one_wired_by_hand() -> None:
    p = parts()
    ready = steering_loop(**p, actuator=SteeringActuator(), reference=VW_PASSAT.l_f)
    car, driver, stanley = placed(p["car"], ROUND), ConstantSpeed(speed=5.0), Stanley.of(VW_PASSAT)
    motor = SteeringActuator()
    path = PathTracker(path=ROUND, reference=VW_PASSAT.l_f)
    wires = [(getattr(car, n), getattr(path, n)) for n in ("x", "y", "psi", "v", "beta", "r")]
    wires += [(path.e, stanley.e), (path.psi_e, stanley.psi_e), (path.kappa, stanley.kappa)]
    wires += [(car.v, stanley.v), (car.r, stanley.r), (motor.delta_sw, stanley.delta_sw_meas)]
    wires += [(stanley.delta_sw, motor.delta_sw_cmd), (motor.delta_sw, car.delta_sw_in), (driver.v, car.v_in)]
    by_hand = Loop(
        blocks={"driver": driver, "car": car, "actuator": motor, "path": path, "controller": stanley}, wires=wires
    )
    a, b = simulate(ready, 3.0), simulate(by_hand, 3.0)
    assert set(a) == set(b)
    assert all(np.array_equal(a[name], b[name]) for name in a)


def test_with_sensors_the_controller_sees_the_measured_and_the_log_keeps_the_true_error() -> None:
    loop = steering_loop(**parts(), sensors=Sensors(y_bias=0.2), reference=VW_PASSAT.l_f)
    first = simulate(loop, 0.05)
    off_axle = 30.0 - np.hypot(30.0, VW_PASSAT.l_f)  # the centre of gravity is on the circle, the front axle outside
    assert first["path.e"][0] == pytest.approx(off_axle, abs=1e-6)
    to_the_left = np.cos(first["car.psi"][0])
    assert first["seen.e"][0] - first["path.e"][0] == pytest.approx(0.2 * to_the_left, abs=1e-3)


def test_missing_parts_are_named() -> None:
    p = parts()
    with pytest.raises(WiringError, match="picks actions and needs a doe"):
        steering_loop(**{**p, "controller": NfqPolicy()})
    with pytest.raises(WiringError, match="steers by itself"):
        steering_loop(**p, doe=Integrator())
    with pytest.raises(WiringError, match="no output 'ready'"):
        steering_loop(**p, recovery=Stanley.of(VW_PASSAT))


@dataclass(frozen=True, eq=False, kw_only=True)
class Odd(Block):
    """A controller that wants something nobody offers."""

    wish = In("rad")
    delta_sw = Out("rad")


def test_an_input_of_an_unknown_name_is_told_what_there_is() -> None:
    with pytest.raises(WiringError, match=r"Odd\.wish: no signal of that name; known: s, progress, e"):
        steering_loop(**{**parts(), "controller": Odd()})


def test_placed_puts_the_car_beside_the_path() -> None:
    car = placed(NonlinearSingleTrack(vehicle=VW_PASSAT), course("paper"), s=200.0, e=0.3, psi_e=0.1)
    tracker = PathTracker(path=course("paper"))
    u = tracker.D(car.x0, car.y0, car.psi0, 0.0, 0.0, 0.0)
    y = tracker.output(0.0, tracker.settle(0.0, tracker.init(), u), u)
    assert (y.s, y.e, y.psi_e) == pytest.approx((200.0, 0.3, 0.1), abs=1e-6)


def test_a_careful_driver_keeps_both_accelerations() -> None:
    path = course("paper")
    driver = CarefulDriver(path=path, driver=HumanDriver(v_min=7.5, v_max=7.5))
    s = np.linspace(0.0, path.length, 8000)
    v = driver.output(0.0, driver.init((len(s),)), driver.D(s)).v
    assert (v**2 * np.abs(path.kappa(s))).max() < 3.1
    assert np.abs(np.diff(v**2) / (2.0 * np.diff(s))).max() < 1.6
    assert v.max() > 6.9
    assert v.min() == pytest.approx(np.sqrt(3.0 / np.abs(path.samples.kappa).max()), rel=0.02)


def test_a_careful_driver_on_an_open_course_does_not_brake_for_its_own_start() -> None:
    path = course("genesis-rfs")
    driver = CarefulDriver(path=path, driver=HumanDriver(v_min=7.0, v_max=7.5), a_y_max=3.0)
    bend = float(path.samples.s[np.abs(path.samples.kappa).argmax()])
    fast, slow = (driver.output(0.0, driver.init(), driver.D(s)).v for s in (path.length, bend))
    assert fast > 7.0 > 6.95
    assert slow < 7.5
    with pytest.raises(ValueError, match="a_y_max"):
        CarefulDriver(path=path, driver=HumanDriver(), a_y_max=0.0)
