"""The prediction over a steering delay."""

import math
from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.controllers.delay import DelayPredictor, delayed_stanley
from steerkit.controllers.lqr import Lqr
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block, In, Out
from steerkit.doe import PlainAngle
from steerkit.paths.courses import course
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack
from steerkit.vehicles.rollout import yaw_gain
from tests.support.straight_road import PASSAT, looped

AT_REST: dict[str, Any] = {"e": 0.0, "psi_e": 0.0, "v": 6.0, "r": 0.0, "delta_sw_meas": 0.0}


def ahead(block: DelayPredictor, commands: tuple[float, ...], r_model: float | None = None, **u: Any) -> dict[str, Any]:
    """What is predicted; r_model: the yaw rate that the model has, if not the car's."""
    signals = {"preview": (0.0,) * block.preview_points} | AT_REST | u
    return block.predict(signals["r"] if r_model is None else r_model, commands, block.D(**signals))


def around(delay: float, lag: float, **changes: Any) -> DelayPredictor:
    made = DelayPredictor.around(Stanley.of(PASSAT), PASSAT, delay=delay, lag=lag)
    points = changes.pop("preview_points", made.preview_points)
    return replace(made, model=replace(made.model, **changes), preview_points=points)


def without_slew(block: DelayPredictor) -> DelayPredictor:
    return replace(block, model=replace(block.model, slew=None))


def test_without_delay_and_lag_it_is_the_block_itself() -> None:
    stanley = Stanley.of(PASSAT)
    block = around(0.0, 0.0)
    u = AT_REST | {"e": 0.2, "psi_e": -0.1, "r": 0.1, "delta_sw_meas": 0.3}
    x = block.settle(0.0, block.init(), block.D(preview=(0.02, 0.02), **u))
    y = block.output(0.0, x, block.D(preview=(0.02, 0.02), **u))
    alone = stanley.settle(0.0, stanley.init(), stanley.D(kappa=0.02, **u))
    assert y.delta_sw == stanley.output(0.0, alone, stanley.D(kappa=0.02, **u)).delta_sw


@given(delay=st.floats(0.0, 0.3), lag=st.floats(0.02, 0.2), first=st.floats(-2.0, 2.0))
def test_the_wheel_answers_as_the_actuator_does(delay: float, lag: float, first: float) -> None:
    """A constant command: delta(delay + lag) = command + (first - command) exp(-(delay + lag)/lag)."""
    block = around(delay, lag, rate_limit=1e3)
    n = max(1, math.ceil(delay / 0.05 - 1e-9))
    wheel = ahead(block, (1.0,) * n, delta_sw_meas=first)["delta_sw_meas"]
    assert wheel == pytest.approx(1.0 + (first - 1.0) * math.exp(-(delay + lag) / lag), abs=1e-9)


@pytest.mark.parametrize("wrong", [0.2, -0.1])
def test_what_the_model_has_wrong_of_the_yaw_rate_it_has_wrong_all_the_way(wrong: float) -> None:
    """Wheel straight and held, the model at rest, the car turning: it goes on turning, and psi_e grows by r T."""
    block, time = around(0.2, 0.1), 0.3
    found = ahead(block, (0.0,) * 4, 0.0, r=wrong)
    assert found["r"] == pytest.approx(wrong)
    assert found["psi_e"] == pytest.approx(wrong * time)


@pytest.mark.parametrize("share", [0.8, 1.25])
def test_a_steady_bend_of_a_car_with_another_ratio_stays_one(share: float) -> None:
    """The model thinks the wheel turns the car at r; the car turns at `share` times that, and will go on to."""
    block, v, wheel = around(0.2, 0.1), 6.0, 1.5
    r_model = yaw_gain(v, block.model.wheelbase, block.model.understeer) * math.tan(wheel / block.model.steer_ratio)
    found = ahead(block, (wheel,) * 4, r_model, r=share * r_model, delta_sw_meas=wheel)
    assert found["r"] == pytest.approx(share * r_model)


@pytest.mark.parametrize("r", [0.5, -0.3])
def test_a_turn_off_a_straight_path_is_an_arc(r: float) -> None:
    """At a steady r, with the front axle `lever` ahead of the point that rolls: e = v/r (1 - cos rT) + lever sin rT."""
    block, v, time = around(0.2, 0.1, rear_slip=0.0), 6.0, 0.3
    found = ahead(block, (0.0,) * 4, 0.0, r=r)
    lever = block.reference + block.model.l_r
    assert found["e"] == pytest.approx(v / r * (1.0 - math.cos(r * time)) + lever * math.sin(r * time), abs=1e-3)


def test_the_curvature_of_a_step_is_that_of_its_middle() -> None:
    """Straight on where the path begins to bend, kappa = a t: psi_e falls by v a T^2/2."""
    block, v, time, a = around(0.2, 0.1), 6.0, 0.3, 0.01
    preview = tuple(a * 0.05 * i for i in range(block.preview_points))
    found = ahead(block, (0.0,) * 4, preview=preview)
    assert found["psi_e"] == pytest.approx(-v * a * time**2 / 2.0, rel=1e-3)
    assert found["kappa"] == pytest.approx(a * time)


@pytest.mark.parametrize("delay", [0.03, 0.05, 0.12])
def test_the_predicted_wheel_is_no_faster_than_the_motor(delay: float) -> None:
    """Full lock asked for, and no lag: after the delay the wheel has turned by rate_limit*delay."""
    block = around(delay, 0.0)
    n = max(1, math.ceil(delay / 0.05 - 1e-9))
    assert ahead(block, (9.0,) * n)["delta_sw_meas"] == pytest.approx(block.model.rate_limit * delay)


@pytest.mark.parametrize("delay", [0.1, 0.2, 0.3])
def test_the_prediction_comes_true(delay: float) -> None:
    """On the course, with a car it knows: what it says of e and psi_e is what happens, to a few millimetres."""
    path, lag = course("paper"), 0.1
    block = delayed_stanley(PASSAT, delay=delay, lag=lag)
    loop = looped(block, path, 5.0, delay, car=NonlinearSingleTrack(vehicle=PASSAT, v0=5.0), s=60.0, e=0.2)
    state, errors, naive = loop.init(), [], []
    n = len(Stanley.of(PASSAT).init())
    said: dict[int, tuple[float, float]] = {}
    for k in range(5 * 160):
        before = state.x[loop.names.index("controller")]
        state, sample = loop.step(state)
        e = sample["controller_path.e"]
        if k % 5 == 0:
            seen = ("controller_path.psi_e", "controller_path.preview", "car.v", "car.r", "actuator.delta_sw")
            u = block.D(e, *[sample[name] for name in seen])
            found = block.predict(before[n], before[n + 1 :], u)
            said[k + round((delay + lag) / 0.01)] = found["e"], e
        if k in said and k > 100:
            errors.append(abs(said[k][0] - e))
            naive.append(abs(said[k][1] - e))
    assert max(errors) < 0.02
    assert max(errors) < 0.35 * max(naive)


@pytest.mark.parametrize("a_y", [0.7, -2.9])
def test_a_slow_wheel_is_rolled_out_until_it_is_straight(a_y: float) -> None:
    """On a straight the wanted yaw rate falls to 0 by s = slew/v a second, and the car's follows with the lag tau."""
    v, slew, tau = 15.0, 5.0, 0.15
    bare = dict(wheelbase=2.7, understeer=0.0, reference=-1.5, l_r=1.5, rear_slip=0.0, yaw_time=tau / v)
    block = around(0.1, 0.0, slew=slew, preview_points=40, **bare)
    wheel = block.model.steer_ratio * math.atan(2.7 * a_y / v**2)
    u = dict(v=v, r=a_y / v, delta_sw_meas=wheel, preview=(0.0,) * 40)
    found, still = (ahead(one, (wheel, wheel), **u) for one in (block, without_slew(block)))
    lasts, s = abs(a_y) / slew, math.copysign(slew / v, a_y)
    faded = 1.0 - math.exp(-lasts / tau)
    psi = a_y / v * lasts - s * lasts**2 / 2.0 + s * tau * (lasts - tau * faded)
    side = a_y / v * lasts**2 / 2.0 - s * lasts**3 / 6.0 + s * tau * (lasts**2 / 2.0 - tau * lasts + tau**2 * faded)
    assert found["delta_sw_meas"] == pytest.approx(0.0, abs=1e-9)
    assert found["r"] == pytest.approx(s * tau * faded, rel=0.02)
    assert found["psi_e"] - still["psi_e"] == pytest.approx(psi, rel=0.02)
    assert found["e"] - still["e"] == pytest.approx(v * (side + still["psi_e"] * lasts), rel=0.02)


def test_a_steering_with_another_gain_is_predicted_as_it_is() -> None:
    """A wheel that stays 25 % beyond what was commanded is taken to stay there: the model learns by how much."""
    block, command = around(0.1, 0.0, slew=5.0, preview_points=40), 0.2
    u = AT_REST | {"v": 12.0, "delta_sw_meas": 1.25 * command, "preview": (0.0,) * 40}
    x: Any = block.settle(0.0, block.init(), block.D(**u))
    for _ in range(100):
        x = block.update(0.0, x, block.U(**u), block.Y(command))
    n = len(block.block.init())
    assert x[n + 2 : n + 4] == pytest.approx((command, 0.25 * command), rel=1e-3)
    assert len(x) == n + 4 + 2
    quick = without_slew(block)
    assert len(quick.init()) == n + 1 + 2


@dataclass(frozen=True, eq=False, kw_only=True)
class Anywhere(Block):
    """Does not say where it is measured."""

    e = In("m")
    delta_sw = Out("rad")


def test_a_block_that_does_not_say_where_is_measured_at_the_centre_of_gravity() -> None:
    assert DelayPredictor.around(Anywhere(), PASSAT, delay=0.1, lag=0.1).reference == 0.0


def test_it_wraps_only_what_it_can_serve() -> None:
    lqr = Lqr.of(PASSAT, LinearSingleTrack(vehicle=PASSAT).matrices, v_step=5.0, preview_points=2)
    with pytest.raises(ValueError, match="Lqr needs "):
        DelayPredictor(block=lqr)
    with pytest.raises(ValueError, match=r"PlainAngle needs action, applied"):
        DelayPredictor(block=PlainAngle())
    with pytest.raises(ValueError, match=r"dt = 0.01 s, but the wrapped block has 0.05 s"):
        DelayPredictor(block=Stanley.of(PASSAT), dt=0.01)
