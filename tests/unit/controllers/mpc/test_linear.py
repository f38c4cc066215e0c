"""Predictive steering when things go wrong, and the programme's solvers when they answer wrongly."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.controllers.mpc import block as module
from steerkit.controllers.mpc.block import FAILED, FALLBACK, PredictiveSteering
from steerkit.controllers.mpc.linear import MPC
from steerkit.controllers.mpc.nonlinear import NonlinearMPC
from steerkit.controllers.stanley import Stanley
from steerkit.controllers.supervisor import Supervisor
from steerkit.diagram.simulation import simulate
from steerkit.paths.courses import course, straight
from steerkit.plants.speed_driver import ConstantSpeed, RecordedSpeed
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from tests.support.predictive import CAR, KINDS, MOTOR, ZEROS, checked, controller, driven, inputs, kinds, unsolved

# ---- what comes in --------------------------------------------------------------------------------------------------


@kinds
@pytest.mark.parametrize("broken", [*ZEROS, "preview"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_broken_input_is_answered_by_the_plan_then_the_fallback(kind: Any, broken: str, value: float) -> None:
    block = controller(kind)
    good = inputs(block, e=0.3)
    bad = good._replace(**{broken: (value,) * block.preview_points if broken == "preview" else value})
    y = driven(block, [good, *[bad] * 6])
    checked(block, y)
    assert [row.fault for row in y] == [0.0] + [1.0] * 6
    assert [row.status for row in y[:5]] == [0.0] + [1.0] * 4
    assert math.isnan(y[1].residual)
    assert {row.status for row in y[5:]} == {2.0 if broken in ("beta", "delta_sw_meas") else 3.0}
    for before, after in pairwise(y[:5]):
        assert after.plan == (*before.plan[1:], 0.0)
        assert after.delta_sw == pytest.approx(before.delta_sw + block.dt * after.plan[0], abs=1e-12)


@kinds
@pytest.mark.parametrize("v", [0.0, -0.0, 0.05, -3.0])
def test_a_car_that_stands_or_reverses_keeps_its_wheel(kind: Any, v: float) -> None:
    block = controller(kind)
    y = driven(block, [inputs(block, e=0.3, delta_sw_meas=0.4), *[inputs(block, e=0.3, v=v)] * 3])
    assert [row.status for row in y] == [0.0, 3.0, 3.0, 3.0]
    assert [row.fault for row in y[1:]] == [4.0] * 3
    assert {row.delta_sw for row in y[1:]} == {y[0].delta_sw}
    assert driven(block, [inputs(block, v=0.0), inputs(block, v=5.0)])[1].status == 0.0


@kinds
@pytest.mark.parametrize(
    "start",
    [
        {"e": 3.0, "psi_e": 0.8, "v": 9.0},
        {"e": -40.0},
        {"psi_e": 3.1},
        {"v": 0.11},
        {"v": 300.0},
        {"r": 9.0, "beta": 1.5},
        {"delta_sw_meas": 20.0},
        {"kappa": 40.0},
        *[{name: 1e300} for name in ZEROS],
        {"kappa": -1e300},
    ],
)
def test_a_start_beyond_all_limits_has_a_command(kind: Any, start: dict[str, float]) -> None:
    block = controller(kind)
    y = driven(block, [inputs(block, **start)] * 8)
    last = min(max(start.get("delta_sw_meas", 0.0), -block.limit), block.limit)
    checked(block, y, last)
    if start.get("e") == 3.0:
        assert {row.status for row in y} == {0.0}


@settings(max_examples=60)
@given(
    kind=st.sampled_from(KINDS),
    e=st.floats(-5, 5),
    psi_e=st.floats(-3.2, 3.2),
    v=st.floats(-5, 30),
    beta=st.floats(-1.5, 1.5),
    r=st.floats(-3, 3),
    wheel=st.floats(-9.5, 9.5),
    kappa=st.floats(-0.3, 0.3),
)
def test_every_command_keeps_the_limits(kind: Any, wheel: float, kappa: float, **values: float) -> None:
    block = controller(kind)
    u = inputs(block, kappa=kappa, delta_sw_meas=wheel, **values)
    y = driven(block, [u, u])
    checked(block, y, min(max(wheel, -block.limit), block.limit))
    assert all(row.status != 0.0 or row.residual <= block.tolerance for row in y)


@kinds
def test_the_wheel_turns_before_the_bend(kind: Any) -> None:
    block = controller(kind, horizon=20)
    ahead = inputs(block)._replace(preview=(0.0,) * 6 + (0.05,) * (block.preview_points - 6))
    assert driven(block, [ahead])[0].plan[0] > 0.05


@kinds
def test_the_path_ends_before_the_preview_does(kind: Any) -> None:
    path = straight(12.0)
    loop = steering_loop(
        car=placed(CAR, path, e=0.3),
        path=path,
        driver=ConstantSpeed(speed=5.0),
        actuator=MOTOR,
        controller=controller(kind),
    )
    log = simulate(loop, 5.0)
    assert log["path.s"][-1] == pytest.approx(12.0, abs=1e-9)
    assert abs(log["path.e"][-1]) < 0.02
    assert (log["controller.status"] == 0.0).all()


# ---- what the solver says ---------------------------------------------------------------------------------------


def said(block: PredictiveSteering, monkeypatch: pytest.MonkeyPatch, **wrong: Any) -> Any:
    """The second of two outputs, for which the solver's answer has these entries instead."""
    u = inputs(block, e=0.2)
    x = block.settle(0.0, block.init(), u)
    y = block.output(0.0, x, u)
    x = block.update(0.0, x, u, y)
    unsolved(monkeypatch, **wrong)
    after = block.output(0.0, x, u)
    assert after.plan == (*y.plan[1:], 0.0)
    assert after.delta_sw == pytest.approx(y.delta_sw + block.dt * y.plan[1], abs=1e-12)
    return after


def test_an_admitted_failure_is_answered_by_the_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    y = said(controller(), monkeypatch, success=0.0)
    assert (y.status, y.fault) == (1.0, 2.0)


@pytest.mark.parametrize("residual", [math.inf, math.nan, 0.1])
def test_a_success_that_fails_the_check_is_answered_by_the_plan(residual: float, monkeypatch: Any) -> None:
    y = said(controller(), monkeypatch, residual=residual)
    assert (y.status, y.fault) == (1.0, 2.0)
    assert y.residual == (residual if math.isfinite(residual) else 1e9)


@pytest.mark.parametrize("late", [1, 2, 3, 4, 5])
def test_a_late_solution_is_not_used_and_the_fallback_comes_after_the_plan(late: int) -> None:
    now = {"t": 0.0, "tick": 0.0}

    def clock() -> float:
        now["t"] += now["tick"]
        return now["t"]

    block = replace(controller(), clock=clock, budget=0.01)
    u = inputs(block, e=0.2)
    x = block.settle(0.0, block.init(), u)
    for k in range(1 + late):
        now["tick"] = 0.02 if k else 0.005
        y = block.output(0.0, x, u)
        x = block.update(0.0, x, u, y)
    assert y.milliseconds == pytest.approx(20.0)
    assert (y.status, y.fault) == (1.0 if late <= block.patience else 2.0, 3.0)


def test_the_fallback_is_stanley(monkeypatch: pytest.MonkeyPatch) -> None:
    block = controller(delay=0.0)
    unsolved(monkeypatch, success=0.0, residual=1.0)
    u = inputs(block, e=0.05, psi_e=-0.02, r=0.05, kappa=0.02, delta_sw_meas=0.4)
    y = driven(block, [u])[0]
    stanley = Stanley.of(CAR.vehicle)
    asked = stanley.D(e=u.e, psi_e=u.psi_e, kappa=0.02, v=u.v, r=u.r, delta_sw_meas=u.delta_sw_meas)
    expected = stanley.output(0.0, stanley.settle(0.0, stanley.init(), asked), asked).delta_sw
    assert (y.status, y.fault) == (2.0, 2.0)
    assert y.delta_sw == pytest.approx(expected, abs=1e-9)


def test_without_beta_the_fallback_is_asked_where_the_car_will_be(monkeypatch: pytest.MonkeyPatch) -> None:
    block = controller()
    u = inputs(block, e=0.02, kappa=0.0)
    x = block.settle(0.0, block.init(), u)
    broken = block.output(0.0, x, u._replace(beta=math.nan))
    unsolved(monkeypatch, success=0.0)
    failed = block.output(0.0, x, u)
    assert (broken.status, failed.status) == (2.0, 2.0)
    assert broken.delta_sw == pytest.approx(failed.delta_sw, abs=1e-12)
    assert 0.05 < -broken.delta_sw < 0.4


def test_the_fallback_is_asked_at_its_own_point(monkeypatch: pytest.MonkeyPatch) -> None:
    """A controller at the centre of gravity, on a circle as its own front axle is beside it."""
    unsolved(monkeypatch, success=0.0, residual=1.0)
    l_f, kappa = CAR.vehicle.l_f, 0.02
    at_front = inputs(controller(delay=0.0), e=0.1, psi_e=0.03, kappa=kappa)
    e = at_front.e - l_f * at_front.psi_e - 0.5 * kappa * l_f**2  # of second order in l_f
    at_cg = inputs(controller(delay=0.0, reference=0.0), e=e, psi_e=at_front.psi_e + kappa * l_f, kappa=kappa)
    places = ((l_f, at_front), (0.0, at_cg))
    commands = [driven(controller(delay=0.0, reference=at), [u])[0].delta_sw for at, u in places]
    assert commands[1] == pytest.approx(commands[0], abs=0.02)
    assert abs(commands[0]) > 0.2


def test_the_fallback_drives_home(monkeypatch: pytest.MonkeyPatch) -> None:
    unsolved(monkeypatch, success=0.0, residual=1.0)
    path, motor = course("paper"), SteeringActuator(delay=0.2, lag=0.1)
    loop = steering_loop(
        car=placed(CAR, path, s=20.0, e=0.8),
        path=path,
        driver=ConstantSpeed(speed=5.0),
        actuator=motor,
        controller=MPC.of(CAR, motor),
        reference=CAR.vehicle.l_f,
    )
    log = simulate(loop, 12.0)
    assert (log["controller.status"] == 2.0).all()
    assert np.abs(log["path.e"][-200:]).max() < 0.1


@kinds
def test_a_run_can_be_repeated_bit_for_bit(kind: Any) -> None:
    path = course("paper")
    loop = steering_loop(
        car=placed(CAR, path, e=0.8),
        path=path,
        driver=ConstantSpeed(speed=6.0),
        actuator=MOTOR,
        controller=kind.of(CAR, MOTOR),
    )
    runs = [simulate(loop, 2.0, record=["controller.delta_sw", "controller.residual", "path.e"]) for _ in range(2)]
    for name in ("controller.delta_sw", "controller.residual", "path.e"):
        np.testing.assert_array_equal(runs[0][name], runs[1][name])


@pytest.mark.parametrize(("e", "psi_e_deg"), [(3.0, 30.0), (-3.0, 45.0)])
@kinds
def test_a_start_far_off_and_askew_is_recovered(kind: Any, e: float, psi_e_deg: float) -> None:
    path = straight(120.0)
    loop = steering_loop(
        car=placed(CAR, path, e=e, psi_e=math.radians(psi_e_deg)),
        path=path,
        driver=ConstantSpeed(speed=6.0),
        actuator=MOTOR,
        controller=kind.of(CAR, MOTOR),
        reference=CAR.vehicle.l_f,
    )
    log = simulate(loop, 15.0)
    assert np.abs(log["path.e"][-200:]).max() < 0.02
    assert np.abs(log["car.a_y"]).max() < 3.1


@kinds
def test_a_car_starts_from_standstill_and_stops_again(kind: Any) -> None:
    path = straight(60.0)
    driver = RecordedSpeed(speeds=(0.0, 0.0, 3.0, 3.0, 0.0, 0.0), spacing=2.0)
    loop = steering_loop(
        car=placed(CAR, path, e=0.3),
        path=path,
        driver=driver,
        actuator=MOTOR,
        controller=kind.of(CAR, MOTOR),
        reference=CAR.vehicle.l_f,
    )
    log = simulate(loop, 10.0)
    assert np.isfinite(log["controller.delta_sw"]).all()
    assert set(log["controller.fault"]) == {0.0, 4.0}
    assert abs(log["path.e"][-1]) < 0.05


@pytest.mark.parametrize("side", [1.0, -1.0])
@kinds
def test_the_fallback_turns_the_wheel_no_faster_than_the_motor(kind: Any, side: float) -> None:
    """Commanded to one side for long, found at the other (a stuck motor): the fallback goes on from the command."""
    block = controller(kind)
    n = max(block.pieces, 1)
    state = block.X((-6.0 * side,) * n, (0.0,) * block.horizon, float(block.patience))
    u = inputs(block, e=-1.5 * side, psi_e=-0.4 * side, delta_sw_meas=6.0 * side)
    _, there, then = block._ahead(state, u)
    ahead = (*there.tolist(), float(then[block.pieces, 6]))
    command, status = block._command(state, u, FAILED, state.plan, ahead)
    assert status == FALLBACK
    assert abs(command + 6.0 * side) <= block.rate_limit * block.dt + 1e-12
    assert block._fallback(u, ahead) * side > -5.0, "it would jump"


def test_an_actuators_times_are_its_delay_its_lag_and_half_of_its_sample() -> None:
    motor = SteeringActuator(delay=0.1, lag=0.13, rate_limit=5.0, limit=8.0, dt=0.02)
    block = MPC.of(CAR, motor)
    assert (block.delay, block.lag) == (pytest.approx(0.11), 0.13)
    assert (block.rate_limit, block.limit) == (5.0, 8.0)
    assert MPC.of(CAR, motor, delay=0.3).delay == 0.3


# ---- as a block -----------------------------------------------------------------------------------------------------


@kinds
def test_a_batch_is_solved_car_by_car(kind: Any) -> None:
    block = controller(kind)
    e = np.array([0.0, 0.3, math.nan])
    u = block.D(
        **{name: np.full(3, value) for name, value in ZEROS.items()} | {"e": e},
        preview=(np.full(3, 0.01),) * block.preview_points,
    )
    x = block.settle(0.0, block.init((3,)), u)
    y = block.output(0.0, x, u)
    after = block.update(0.0, x, u, y)
    assert {np.shape(value) for value in (*y[:-1], *y.plan, *after)} == {(3,)}
    for car in range(3):
        one = driven(block, [inputs(block, e=float(e[car]))])[0]
        np.testing.assert_array_equal([value[car] for value in y[:-1]], one[:-1])
        np.testing.assert_array_equal([value[car] for value in y.plan], one.plan)


def test_the_state_and_outputs_are_python_floats() -> None:
    block = controller(NonlinearMPC)
    u = inputs(block, e=0.1)
    x = block.settle(0.0, block.init(), u)
    y = block.output(0.0, x, u)
    assert {type(value) for value in (*y[:-1], *y.plan, *block.update(0.0, x, u, y))} == {float}


def test_time_is_taken_unless_there_is_no_clock() -> None:
    timed = replace(controller(), clock=module.time.perf_counter)
    assert driven(timed, [inputs(timed)])[0].milliseconds > 0.0
    assert driven(controller(), [inputs(controller())])[0].milliseconds == 0.0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (dict(horizon=1), r"MPC: horizon = 1, expected at least 2"),
        (dict(horizon=2.5), r"horizon = 2.5, expected a whole number"),
        (dict(solver="osqp"), r"solver = 'osqp'; valid: hpipm, piqp, qpoases"),
        (dict(q_rate=0.0), r"q_rate = 0.0 \[s\^2\], expected > 0"),
        (dict(delay=-0.1), r"delay = -0.1, expected >= 0"),
        (dict(delay=3.0), r"delay = 3.0 \[s\], expected at most 2 s"),
        (dict(rhs=3), r"rhs = 3, expected a function"),
        (dict(reference=12.0), r"reference = 12.0 \[m\], expected -5 to 5"),
        (dict(budget=math.nan), r"budget = nan \[s\], expected > 0, or None"),
        (dict(budget=0.01, clock=None), r"budget = 0.01 \[s\] needs a clock"),
        (dict(fallback=ConstantSpeed()), r"fallback with outputs \['v'\], expected delta_sw only"),
        (dict(fallback=Supervisor()), r"fallback Supervisor needs learner, ready, recovery; it may ask for"),
    ],
)
def test_a_wrong_parameter_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MPC.of(CAR, **wrong)


def test_a_car_without_equations_is_refused() -> None:
    with pytest.raises(ValueError, match=r"MPC: Vehicle has no right-hand side .* NonlinearSingleTrack\(vehicle=...\)"):
        MPC.of(CAR.vehicle, delay=0.2)
