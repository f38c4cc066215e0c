"""The ready-made steering loop: the standard wires, by name, and teaching errors when a part is missing."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steerkit._support.errors import WiringError
from steerkit.car.loop import ExcursionPredictor
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.safety_filter import SafetyFilter
from steerkit.controllers.stanley import Stanley
from steerkit.controllers.supervisor import ExceptionGuard, Supervisor
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.doe import Corrected, Integrator, LowPass
from steerkit.paths.courses import circle, course
from steerkit.paths.tracker import PathTracker
from steerkit.plants.sensors import Sensors
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import controller_of, placed, steering_loop, with_controller
from steerkit.vehicles import VW_PASSAT

ROUND = circle(30.0)


def parts() -> dict:
    car = placed(NonlinearSingleTrack(vehicle=VW_PASSAT, v0=5.0), ROUND)
    return dict(car=car, path=ROUND, driver=ConstantSpeed(speed=5.0), controller=Stanley.of(VW_PASSAT))


def test_the_wires_of_an_analytic_controller_without_sensors() -> None:
    loop = steering_loop(**parts(), actuator=SteeringActuator(), reference=VW_PASSAT.l_f)
    law = {"e": "path.e", "psi_e": "path.psi_e", "kappa": "path.kappa", "v": "car.v", "r": "car.r"}
    wired = {
        "car": {"delta_sw_cmd": "actuator.delta_sw", "v_cmd": "driver.v"},
        "actuator": {"delta_sw_cmd": "controller.delta_sw"},
        "path": TRUE,
        "controller": law | {"delta_sw_meas": "actuator.delta_sw"},
    }
    assert {name: loop.inputs_of(name) for name in loop.names if name != "driver"} == wired


def learning_loop(**more: Any) -> Loop:
    p = parts() | {"controller": NfqPolicy(), "doe": Integrator()}
    return steering_loop(**p, actuator=SteeringActuator(), sensors=Sensors(), **more)


MOTION = ("x", "y", "psi", "v", "beta", "r")
SEEN = {name: f"sensors.{name}" for name in MOTION}
TRUE = {name: f"car.{name}" for name in MOTION}
STANLEY = {"e": "recovery_path.e", "psi_e": "recovery_path.psi_e", "kappa": "recovery_path.kappa"}
STANLEY |= {"v": "sensors.v", "r": "sensors.r", "delta_sw_meas": "actuator.delta_sw"}


def test_every_wire_of_a_learner_with_all_its_parts() -> None:
    """What each block hears, from the docstring: the truth for the log, the measured for who steers."""
    loop = learning_loop(recovery=Stanley.of(VW_PASSAT))
    net = {"e": "seen.e", "e_dot": "seen.e_dot", "v": "sensors.v", "psi_e": "seen.psi_e", "r_e": "seen.r_e"}
    wired = {
        "car": {"delta_sw_cmd": "actuator.delta_sw", "v_cmd": "driver.v"},
        "actuator": {"delta_sw_cmd": "supervisor.delta_sw"},
        "sensors": {f"{name}_in": signal for name, signal in TRUE.items()},
        "path": TRUE,
        "seen": SEEN,
        "recovery_path": SEEN,
        "recovery": STANLEY,
        "controller": net | {"doe": "doe.state"},
        "doe": {"action": "controller.action", "applied": "supervisor.delta_sw"},
        "supervisor": {
            "e": "seen.e",
            "learner": "doe.delta_sw",
            "recovery": "recovery.delta_sw",
            "ready": "controller.ready",
        },
    }
    assert {name: loop.inputs_of(name) for name in loop.names if name != "driver"} == wired


def test_a_safety_filter_comes_between_whoever_steers_and_the_wheel_and_foresight_before_the_supervisor() -> None:
    more = dict(safety=SafetyFilter.of(VW_PASSAT), foresight=ExcursionPredictor())
    loop = learning_loop(recovery=Stanley.of(VW_PASSAT), **more)
    assert loop.inputs_of("supervisor")["e"] == "foresight.distance"
    assert loop.inputs_of("foresight")["doe"] == "doe.state"
    ahead = {name: f"safety_path.{name}" for name in ("e", "psi_e", "preview")}
    heard = {"v": "sensors.v", "r": "sensors.r", "delta_sw_meas": "actuator.delta_sw"}
    caught = {"command": "supervisor.delta_sw", "recovery": "recovery.delta_sw"}
    assert loop.inputs_of("safety") == {**caught, **ahead, **heard}
    assert loop.inputs_of("actuator") == {"delta_sw_cmd": "safety.delta_sw"}
    assert loop.inputs_of("doe")["applied"] == "safety.delta_sw"
    tracker: Any = loop.blocks["safety_path"]
    assert tracker.reference == VW_PASSAT.l_f


def test_missing_parts_are_named() -> None:
    p = parts()
    with pytest.raises(WiringError, match="picks actions and needs a doe"):
        steering_loop(**{**p, "controller": NfqPolicy()})
    with pytest.raises(WiringError, match="steers by itself"):
        steering_loop(**p, doe=Integrator())
    with pytest.raises(WiringError, match="no output 'ready'"):
        steering_loop(**p, recovery=Stanley.of(VW_PASSAT))
    with pytest.raises(WiringError, match="foresight without a recovery controller"):
        steering_loop(**p, foresight=ExcursionPredictor())
    with pytest.raises(WiringError, match=r"SteeringActuator\.delta_sw_cmd: no signal of that name; known: s, prog"):
        steering_loop(**{**p, "controller": SteeringActuator()})


@dataclass(frozen=True, eq=False, kw_only=True)
class Failing(Block):
    """A policy whose equations break in the third sample."""

    e = In("m")
    action = Out("rad")
    ready = Out("1")

    def output(self, t: Any, x: Any, u: Any) -> Any:
        if t > 0.12:
            raise ZeroDivisionError("the net is broken")
        return self.Y(0.0, 1.0)


def test_an_exception_in_a_learned_controller_is_answered_by_the_supervisor() -> None:
    p = parts() | {"controller": Failing(), "doe": Integrator()}
    loop = steering_loop(**p, recovery=Stanley.of(VW_PASSAT))
    log = simulate(loop, 0.3, every=5, allow_nonfinite=True)
    assert log["supervisor.learning"].tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]
    np.testing.assert_array_equal(log["supervisor.delta_sw"][3:], log["recovery.delta_sw"][3:])
    with pytest.raises(ZeroDivisionError, match="the net is broken"):
        simulate(steering_loop(**p), 0.3)  # nobody is there to answer


def test_a_controller_is_exchanged_as_it_was_put_in() -> None:
    policy, better = Failing(), Failing()
    p = parts() | {"doe": Integrator()}
    caught = steering_loop(**{**p, "controller": policy}, recovery=Stanley.of(VW_PASSAT))
    guarded = steering_loop(**{**p, "controller": ExceptionGuard(block=policy)}, recovery=Stanley.of(VW_PASSAT))
    alone = steering_loop(**{**p, "controller": policy})
    for loop, guard in ((caught, True), (guarded, True), (alone, False)):
        assert controller_of(loop) is policy
        assert controller_of(with_controller(loop, better)) is better
        assert isinstance(with_controller(loop, better).blocks["controller"], ExceptionGuard) == guard


@pytest.mark.parametrize("reports", [False, True])
def test_an_angle_beyond_the_does_stops_is_a_fault(reports: bool) -> None:
    p = parts() | {"controller": NfqPolicy(), "doe": LowPass(limit=4.0)} | ({"car": Stubborn()} if reports else {})
    loop = steering_loop(**p, recovery=Stanley.of(VW_PASSAT))
    supervisor: Any = loop.blocks["supervisor"]
    assert supervisor.limit == 4.0
    own = steering_loop(**p, recovery=Stanley.of(VW_PASSAT), supervisor=Supervisor(limit=3.0)).blocks["supervisor"]
    assert getattr(own, "limit", None) == 3.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Stubborn(Block):
    """A parked car whose wheel is turned by half of what it is told, which it reports."""

    delta_sw_cmd = In("rad", direct=False)
    v_cmd = In("m/s", direct=False)
    x = Out("m")
    y = Out("m")
    psi = Out("rad")
    v = Out("m/s")
    beta = Out("rad")
    r = Out("rad/s")
    delta_sw = Out("rad")
    applied = Out("rad")

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (0.0,)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(30.0, 0.0, 0.5 * np.pi, 0.0, 0.0, 0.0, x[0], x[0])

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return (0.5 * u.delta_sw_cmd,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Steady(Block):
    """Asks for the same step again and again."""

    doe = In("rad")
    action = Out("rad")

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(0.2)


@pytest.mark.parametrize("doe", [Integrator(), Corrected(), LowPass(tau=0.1)])
def test_a_doe_goes_on_from_what_the_car_reports(doe: Block) -> None:
    loop = steering_loop(**{**parts(), "car": Stubborn(), "controller": Steady(), "doe": doe})
    log = simulate(loop, 0.5)
    assert isinstance(loop.blocks["doe"], Corrected)
    np.testing.assert_array_equal(log["doe.state"], log["car.applied"])
    np.testing.assert_allclose(log["car.applied"][1:], 0.5 * log["doe.delta_sw"][:-1])
    if isinstance(doe, Integrator):
        assert log["car.applied"][-1] == pytest.approx(0.2, rel=0.01), "z = (z + 0.2)/2 ends at 0.2"


@dataclass(frozen=True, eq=False, kw_only=True)
class Own(Block):
    """A doe of somebody's own, which trusts that what it asks for is done."""

    action = In("rad")
    applied = In("rad", direct=False)
    delta_sw = Out("rad")
    state = Out("rad", direct=())


def test_a_doe_that_cannot_be_corrected_is_refused_on_a_car_that_reports() -> None:
    p = {**parts(), "car": Stubborn(), "controller": Steady()}
    with pytest.raises(WiringError, match=r"Own remembers the angle that it asked for, and this car reports another"):
        steering_loop(**p, doe=Own())


def test_placed_puts_the_car_beside_the_path() -> None:
    car = placed(NonlinearSingleTrack(vehicle=VW_PASSAT), course("paper"), s=200.0, e=0.3, psi_e=0.1)
    tracker = PathTracker(path=course("paper"))
    u = tracker.D(car.x0, car.y0, car.psi0, 0.0, 0.0, 0.0)
    y = tracker.output(0.0, tracker.settle(0.0, tracker.init(), u), u)
    assert (y.s, y.e, y.psi_e) == pytest.approx((200.0, 0.3, 0.1), abs=1e-6)
