"""Predictive steering against what is known in closed form: LQR, delay by augmentation, steady bends, bang-bang."""

from functools import cache
from typing import Any

import casadi
import control
import numpy as np
import pytest

from steerkit.controllers.lqr import cost_to_go
from steerkit.controllers.mpc.block import MPC, NonlinearMPC, PredictiveSteering
from steerkit.controllers.mpc.path_model import NX
from steerkit.diagram import maths as m
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack
from tests.support.predictive import KINDS, ahead, steady, table
from tests.support.straight_road import PASSAT

LINEAR, NONLINEAR = LinearSingleTrack(vehicle=PASSAT, v0=5.0), NonlinearSingleTrack(vehicle=PASSAT, v0=5.0)
ZEROS = dict.fromkeys(("e", "psi_e", "beta", "r", "delta_sw_meas"), 0.0)


@cache
def controller(kind: type[PredictiveSteering], car: Any, **settings: Any) -> PredictiveSteering:
    return kind.of(car, **({"clock": None} | settings))


def asked(block: PredictiveSteering, *, kappa: float = 0.0, commands: Any = (), **values: float) -> Any:
    """The outputs for inputs that are 0 if not given, after these commands."""
    u = block.D(**(ZEROS | {"v": 5.0} | values), preview=(kappa,) * block.preview_points)
    x = block.init()
    return block.output(0.0, (*commands, *x[len(commands) :]), u)


def gain(block: PredictiveSteering, v: float) -> np.ndarray:
    a, b, _ = block.model.linear(v)
    return np.asarray(control.dlqr(a, b[:, None], block.qp.q.full(), np.array([[block.q_rate]]))[0])[0]


@pytest.mark.parametrize(("v", "horizon"), [(3.5, 20), (5.0, 5), (5.1, 20), (8.93, 12)])
def test_without_an_active_limit_it_is_lqr(v: float, horizon: int) -> None:
    block = controller(MPC, LINEAR, horizon=horizon, delay=0.0)
    k = gain(block, v)
    for x in (np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.01, -0.004, 0.002, 0.01, 0.05, 0.04])):
        values = dict(zip(ZEROS, x.tolist()))
        y = asked(block, v=v, commands=(float(x[5]),), **values)
        assert y.status == 0.0
        assert y.plan[0] == pytest.approx(-k @ x, rel=1e-5, abs=1e-6)
        assert y.delta_sw == pytest.approx(x[5] - block.dt * k @ x, rel=1e-5, abs=1e-6)


def test_the_nonlinear_one_tends_to_lqr_for_small_deviations() -> None:
    block = controller(NonlinearMPC, NONLINEAR, delay=0.0)
    x = 1e-3 * np.array([1.0, -0.4, 0.5, 1.0, 5.0, 4.0])
    y = asked(block, e=x[0], psi_e=x[1], beta=x[2] / 5.0, r=x[3], delta_sw_meas=x[4], commands=(float(x[5]),))
    assert y.plan[0] == pytest.approx(-gain(block, 5.0) @ x, rel=2e-3)


def test_the_delay_is_answered_as_by_lqr_with_the_commands_on_their_way_as_states() -> None:
    late, v = 4, 5.0
    block = controller(MPC, LINEAR, delay=late * 0.05)
    a, _, _ = block.model.linear(v)
    n = 5 + late
    big, b = np.zeros((n, n)), np.zeros((n, 1))
    big[:5, :5], big[:5, 5] = a[:5, :5], a[:5, 5]
    big[5 : n - 1, 6:], big[n - 1, n - 1] = np.eye(late - 1), 1.0
    b[n - 1] = block.dt
    q, r = np.zeros((n, n)), np.array([[block.q_rate]])
    q[:5, :5] = block.qp.q.full()[:5, :5]
    k = np.asarray(control.dlqr(big, b, q, r)[0])[0]
    x = np.array([0.01, -0.004, 0.002, 0.01, 0.05, 0.06, 0.03, 0.02, 0.01])
    y = asked(block, v=v, commands=tuple(x[5:].tolist()), **dict(zip(ZEROS, x.tolist())))
    # the newest command on its way is that of the sample before: the new one joins it within the sample
    assert y.plan[0] == pytest.approx(-k @ x, rel=3e-3)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("car", [LINEAR, NONLINEAR])
@pytest.mark.parametrize(("v", "kappa"), [(5.0, 0.05), (7.4, -0.03), (4.0, 0.1), (9.0, 0.045)])
def test_a_steady_bend_is_held(kind: type[PredictiveSteering], car: Any, v: float, kappa: float) -> None:
    block = controller(kind, car, delay=0.125)
    speed = block.model.sway_is_speed
    _, psi_e, sway, r, wheel, _, pace = steady(block, v, [kappa])[0].tolist()
    x_dot, y_dot, psi_dot, *rest = car.rhs((0.0, 0.0, psi_e, sway, r), wheel / PASSAT.steer_ratio, v)
    along, drift = x_dot - PASSAT.l_f * r * np.sin(psi_e), y_dot + PASSAT.l_f * r * np.cos(psi_e)
    np.testing.assert_allclose([drift, psi_dot - kappa * along, along - v * pace, *rest], 0.0, atol=2e-3)
    beta = float(np.arctan2(sway, v)) if speed else sway
    y = asked(
        block,
        kappa=kappa,
        v=v / float(np.cos(beta)) if speed else v,
        psi_e=psi_e,
        beta=beta,
        r=r,
        delta_sw_meas=wheel,
        commands=(wheel,) * block.waiting,
    )
    assert y.status == 0.0
    assert abs(y.plan[0]) < 5e-3  # of rad/s; turning in takes about 1


@pytest.mark.parametrize("reference", [0.0, PASSAT.l_f, -PASSAT.l_r])
def test_the_car_in_path_coordinates_is_the_car_in_the_plane(reference: float) -> None:
    """On a circle: from a pose beside it, one by the path's model, one by the plant's own and geometry."""
    block = controller(NonlinearMPC, NONLINEAR, reference=reference)
    kappa, v, wheel = 0.05, 5.0, 2.0
    at = np.array([0.4, 0.1, 0.05, 0.2, wheel])
    predict = block.model.predictor([block.dt] * 4, 2)
    after = np.array(predict(at, [wheel] * 4, v, [kappa] * 4)).ravel()
    # the centre is the origin, the path's radius 20 m; the point starts below it, the car's centre of gravity behind
    psi, ahead = float(at[1]), np.array((np.cos(at[1]), np.sin(at[1])))
    start = np.array((0.0, -(1.0 / kappa - at[0]))) - reference * ahead
    x = (float(start[0]), float(start[1]), psi, float(at[2]), float(at[3]))
    for _ in range(400):
        x = m.rk4(lambda z: NONLINEAR.rhs(z, wheel / PASSAT.steer_ratio, v), x, 0.2 / 400)  # type: ignore[assignment]
    px, py = x[0] + reference * float(np.cos(x[2])), x[1] + reference * float(np.sin(x[2]))
    e = 1.0 / kappa - float(np.hypot(px, py))
    psi_e = x[2] - (float(np.arctan2(py, px)) + np.pi / 2.0)
    np.testing.assert_allclose(after, [e, psi_e, x[3], x[4], wheel], atol=2e-4)


@pytest.mark.parametrize("reference", [0.0, PASSAT.l_f])
def test_a_tight_bend_is_met_where_it_is(reference: float) -> None:
    """The preview's entries lie v*dt apart; the front axle gets along faster, v/cos(delta)."""
    block = controller(MPC, NONLINEAR, reference=reference, delay=0.2)
    v, kappa, first = 4.0, 0.16, 12
    u = block.D(**ZEROS, v=v, preview=tuple([0.0 if j < first else kappa for j in range(block.preview_points)]))
    _, then = ahead(block, u)
    assert np.all(np.diff(then[4:25, 6]) >= 0.0)  # the stages
    assert (then[4:25, 6] < 1e-9).sum() == first - 4  # on the straight, both run at v
    bent = u._replace(preview=(kappa,) * block.preview_points)
    assert np.ptp(ahead(block, bent)[1], axis=0).max() < 1e-12


def test_the_pace_of_the_front_axle_is_that_of_rigid_rolling_at_low_grip_use() -> None:
    """|v_front| = v_x/cos(delta) for a car that rolls without slip; v_x is the speed that `rhs` takes."""
    block = controller(MPC, NONLINEAR)
    for kappa in (0.02, 0.1, 0.16):
        pace = steady(block, 1.0, [kappa])[0, 6]
        assert pace == pytest.approx(1.0 / np.sqrt(1.0 - (PASSAT.wheelbase * kappa) ** 2), rel=5e-3)


@pytest.mark.parametrize("car", [LINEAR, NONLINEAR])
def test_the_slopes_of_a_step_are_those_that_casadi_finds(car: Any) -> None:
    step = controller(NonlinearMPC, car).model.affine_step(2)
    x, u, v, kappa = casadi.SX.sym("x", NX), casadi.SX.sym("u"), casadi.SX.sym("v"), casadi.SX.sym("k")
    after = step(x, u, v, kappa)[0]
    slopes = casadi.Function("slopes", [x, u, v, kappa], [casadi.jacobian(after, x), casadi.jacobian(after, u)])
    at = (np.array([0.3, 0.4, -0.2, 0.5, 3.0, 3.5]), -4.0, 5.0, 0.08)
    found, expected = step(*at), slopes(*at)
    np.testing.assert_allclose(found[1].full(), expected[0].full(), atol=1e-12)
    np.testing.assert_allclose(found[2].full(), expected[1].full(), atol=1e-12)


def test_the_tables_over_speed_are_the_exact_matrices() -> None:
    block = controller(MPC, NONLINEAR)
    for v in (4.1, 5.0, 7.77, 15.1):
        a, b, row = block.model.linear(v)
        cost = cost_to_go(a, b, block.qp.q.full(), block.q_rate)
        for found, exact in zip(table(block, v), (a, b, row, cost), strict=True):
            np.testing.assert_allclose(found, exact, rtol=1e-4, atol=1e-7 * np.abs(exact).max())


@pytest.mark.parametrize("car", [LINEAR, NONLINEAR])
@pytest.mark.parametrize(
    ("sway", "r", "wheel", "v"), [(0.02, 0.3, 1.0, 6.0), (-0.05, 0.1, -2.0, 9.0), (0.0, 0.0, 1.5, 4.0)]
)
def test_the_models_lateral_acceleration_is_the_plants_own(
    car: Any, sway: float, r: float, wheel: float, v: float
) -> None:
    plant = car.output(0.0, car.init()._replace(sway=sway, r=r, delta_sw=wheel, v=v), ())
    assert controller(MPC, car).model.a_y((0.2, -0.1, sway, r), wheel, v) == pytest.approx(plant.a_y, abs=1e-9)
