"""Cars steered by torque are brought back and held by every controller that knows dead time and slew."""

from typing import Any

import numpy as np
import pytest

from steerkit.diagram.simulation import Log, simulate
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.metrics.signals import rates, rms
from steerkit.scenario import Scenario
from steerkit.scenario.assembly import placed
from steerkit.scenario.drive import assembled, controller

SCENARIO = Scenario(name="torque", steering={"command": "torque", "delay": 0.35, "lag": 0.0}, driver={"a_y_max": 1.5})
HELD = 0.3
"""|e| that it must not leave again [m]."""
LATER = 15.0
"""When bringing back is over [s]."""


def recovered(name: str, course: str, v: float, seconds: float, turned: float = 5.0, **steering: float) -> Log:
    """The drive of a car that starts 1 m off, turned away by so many degrees."""
    scenario = SCENARIO.with_(course=course, steering=steering, driver={"v_min": v, "v_max": v})
    loop = assembled(scenario, controller(name, scenario))
    car: Any = placed(loop.blocks["car"], scenario.path(), s=50.0, e=1.0, psi_e=radians_of(turned))
    return simulate(loop.with_block("car", car), seconds, every=5, allow_nonfinite=True)


def judged(log: Log) -> tuple[float, np.ndarray]:
    """When it last came within `HELD` [s], and |e| later [m]."""
    e = np.abs(log["path.e"])
    out = np.flatnonzero(~(e <= HELD))
    back = 0.0 if not out.size else float(log.t[out[-1]]) if out[-1] + 1 < len(e) else np.inf
    return back, e[log.t > LATER]


@pytest.mark.parametrize(
    ("name", "v", "gain"), [("stanley-delay", 20.0, 1.25), ("lqr", 20.0, 0.75), ("mpc", 12.0, 1.25)]
)
def test_a_car_steered_by_torque_is_brought_back_and_held(name: str, v: float, gain: float) -> None:
    log = recovered(name, "sweeping-1003", v, 20.0, gain=gain)
    back, e = judged(log)
    assert e.max() < HELD
    assert back < 14.0
    assert float(abs(log["path.e"]).max()) < 6.0  # 5 degrees at 20 m/s are 1.7 m/s; 2.25 m/s^2 come after 0.35 s


@pytest.mark.parametrize(("gain", "rate", "e"), [(0.75, 4.0, 0.16), (1.0, 4.0, 0.01), (1.25, 4.0, 0.1)])
def test_stanley_behind_the_predictor_keeps_a_calm_wheel(gain: float, rate: float, e: float) -> None:
    """At 12 m/s the bends of this course ask for 3 degrees a second."""
    log = recovered("stanley-delay", "sweeping-1003", 12.0, 22.0, gain=gain)
    late = log.t > LATER
    assert degrees_of(rms(rates(log.t[late], log["car.delta_sw"][late]))) < rate
    assert judged(log)[1].max() < e


@pytest.mark.parametrize(
    ("name", "slew", "most", "later"),
    [("stanley-delay", 0.7, 1.4, 0.05), ("lqr", 0.5, 2.0, 0.1), ("mpc", 0.5, 2.0, 0.1)],
)
def test_slow_steering_is_not_asked_for_an_approach_that_it_cannot_end(
    name: str, slew: float, most: float, later: float
) -> None:
    """As behind some production cars' ports; as steep as Stanley's arctan asks, or with all of e in their costs, they
    get 6.5 to 8 m off."""
    log = recovered(name, "sweeping-1003", 15.0, 20.0, turned=0.0, slew=slew, delay=0.2)
    assert abs(log["path.e"]).max() < most
    assert judged(log)[1].max() < later


def test_lqr_holds_where_the_slew_is_half_of_what_it_is_told() -> None:
    """It swings by 10 m where an error counts up to twice as far."""
    told = SCENARIO.with_(
        course="sweeping-1007", steering={"slew": 2.0, "delay": 0.2}, driver={"v_min": 12.0, "v_max": 12.0}
    )
    loop = assembled(told.with_(steering={"slew": 1.0}), controller("lqr", told))
    car: Any = placed(loop.blocks["car"], told.path(), s=50.0, e=1.0)
    log = simulate(loop.with_block("car", car), 30.0, every=5, allow_nonfinite=True)
    assert abs(log["path.e"]).max() < 1.1
    assert judged(log)[1].max() < 0.02
