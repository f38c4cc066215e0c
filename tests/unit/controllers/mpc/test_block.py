"""Predictive steering in good order, when things go wrong, and in compiled loops; and its copies."""

import copy
import json
import math
import pickle
import time
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.compiled import compile
from steerkit.compiled.trace import TraceError
from steerkit.controllers.mpc.block import FAILED, FALLBACK, MPC, NonlinearMPC, PredictiveSteering
from steerkit.controllers.stanley import Stanley
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.paths.courses import circle
from steerkit.paths.tracker import PathTracker
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario.assembly import placed
from tests.support.places import ROOT
from tests.support.predictive import (
    CAR,
    KINDS,
    MOTOR,
    STEERING,
    ZEROS,
    ahead,
    checked,
    controller,
    driven,
    inputs,
    kinds,
    unsolved,
)
from tests.support.straight_road import looped, recorded_speed

STEADY = ConstantSpeed(speed=6.0)
STOPS = recorded_speed((5.0, 0.0, 0.0, 5.0, 5.0), spacing=1.0)


def loop_of(block: PredictiveSteering, driver: Any = STEADY) -> Loop:
    return looped(block, circle(30.0), 5.0, MOTOR.delay, car=CAR, driver=driver, e=0.4)


# ---- what comes in --------------------------------------------------------------------------------------------------


@kinds
@pytest.mark.parametrize(
    ("broken", "value"),
    [*[(name, math.nan) for name in (*ZEROS, "preview")], ("e", math.inf), ("beta", -math.inf), ("preview", math.inf)],
)
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
    assert [row.residual for row in y[1:]] == [0.0] * 3
    assert {row.delta_sw for row in y[1:]} == {y[0].delta_sw}
    assert driven(block, [inputs(block, v=0.0), inputs(block, v=5.0)])[1].status == 0.0


beyond = st.sampled_from([40.0, 1e300, -1e300])


@settings(max_examples=80)
@given(
    kind=st.sampled_from(KINDS),
    e=st.floats(-5, 5) | beyond,
    psi_e=st.floats(-3.2, 3.2) | beyond,
    v=st.floats(-5, 30) | beyond,
    beta=st.floats(-1.5, 1.5) | beyond,
    r=st.floats(-3, 3) | beyond,
    wheel=st.floats(-9.5, 9.5) | beyond,
    kappa=st.floats(-0.3, 0.3) | beyond,
)
def test_every_command_keeps_the_limits(kind: Any, wheel: float, kappa: float, **values: float) -> None:
    block = controller(kind)
    u = inputs(block, kappa=kappa, delta_sw_meas=wheel, **values)
    y = driven(block, [u, u])
    checked(block, y, min(max(wheel, -block.limit), block.limit))
    assert all(row.status != 0.0 or row.residual <= block.tolerance for row in y)


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


@pytest.mark.parametrize(
    "wrong", [{"success": 0.0}, {"residual": math.inf}, {"residual": math.nan}, {"residual": 1.01e-5}]
)
def test_a_reported_failure_or_a_failed_check_is_answered_by_the_plan(
    wrong: dict[str, float], monkeypatch: Any
) -> None:
    y = said(controller(), monkeypatch, **wrong)
    assert (y.status, y.fault) == (1.0, 2.0)
    residual = wrong.get("residual", y.residual)
    assert y.residual == (residual if math.isfinite(residual) else 1e9)


@pytest.mark.parametrize("late", [1, 4, 5])
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
    assert (y.status, y.fault) == (1.0 if late <= 4 else 2.0, 3.0)


def test_the_fallback_is_stanley(monkeypatch: pytest.MonkeyPatch) -> None:
    block = controller(delay=0.0)
    unsolved(monkeypatch, success=0.0, residual=1.0)
    u = inputs(block, e=0.05, psi_e=-0.02, r=0.05, kappa=0.02, delta_sw_meas=0.4)
    y = driven(block, [u])[0]
    asked = block.fallback.D(e=u.e, psi_e=u.psi_e, kappa=0.02, v=u.v, r=u.r, delta_sw_meas=u.delta_sw_meas)
    expected = block.fallback.output(0.0, block.fallback.settle(0.0, (), asked), asked).delta_sw
    assert (y.status, y.fault) == (2.0, 2.0)
    assert y.delta_sw == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("reference", [1.2, -1.4, 0.0])
def test_the_fallbacks_errors_are_those_of_its_own_point(reference: float, side: float) -> None:
    """Compared with what a tracker measures there, on a circle to the left, and its mirror image; the rest is of third
    order."""
    path = circle(20.0)
    car = placed(LinearSingleTrack(vehicle=CAR.vehicle), path, s=2.0, e=0.04, psi_e=0.03)
    tracker = PathTracker(path=path, reference=reference)
    at = tracker.U(x=car.x0, y=car.y0, psi=car.psi0, v=5.0, beta=0.0, r=0.0)
    there = tracker.output(0.0, tracker.settle(0.0, tracker.init(), at), at)
    law = replace(Stanley.of(CAR.vehicle), reference=reference, a_y_max=1e3, rate_limit=1e3)
    signals = dict(kappa=side * 0.05, v=5.0, r=side * 0.3, delta_sw_meas=side * 0.5)
    asked = law.D(e=side * there.e, psi_e=side * there.psi_e, **signals)
    expected = law.output(0.0, law.settle(0.0, law.init(), asked), asked).delta_sw
    block = replace(controller(reference=0.0), fallback=law)
    found = block._fallback(inputs(block), (side * 0.04, side * 0.03, 0.0, side * 0.3, side * 0.5, 0.0, side * 0.05))
    assert found == pytest.approx(expected, abs=0.045)  # 2 mm and 2 mrad


@pytest.mark.parametrize("side", [1.0, -1.0])
@kinds
def test_the_fallback_turns_the_wheel_no_faster_than_the_motor(kind: Any, side: float) -> None:
    """Commanded to one side for long, found at the other (a stuck motor): the fallback goes on from the command."""
    block = controller(kind)
    state = block.X((-6.0 * side,) * block.waiting, (0.0,) * block.horizon, float(block.patience))
    u = inputs(block, e=-1.5 * side, psi_e=-0.4 * side, delta_sw_meas=6.0 * side)
    found, then = ahead(block, u, state)
    there = (*found.tolist(), float(then[block.waiting, 6]))
    command, status = block._command(state, u, FAILED, state.plan, there)
    assert status == FALLBACK
    assert abs(command + 6.0 * side) <= block.rate_limit * block.dt + 1e-12
    assert block._fallback(u, there) * side > -5.0, "it would jump"


@kinds
@pytest.mark.parametrize("slow", [False, True])
def test_it_plans_and_commands_what_was_written_down(kind: Any, slow: bool) -> None:
    """Beside a bend; far off, where the limits of e and a_y act; beyond e_reach, in a tight bend; at and beyond the
    ends of the model's speeds; beyond what sensors tell; without beta. slow: with another steering, steered by torque.
    """
    other = dict(fallback=replace(Stanley.of(CAR.vehicle), slew=8.0), delay=0.13, lag=0.0, horizon=9, reference=0.3)
    block = kind.of(CAR, clock=None, **(STEERING | (other if slow else {})))
    states: list[dict[str, float]] = [
        {"e": 0.02, "psi_e": 0.01},
        {"e": 0.7, "psi_e": -0.1, "r": 0.2, "v": 8.0},
        {"e": -1.5, "v": 6.0, "kappa": 0.08, "r": 0.4, "delta_sw_meas": 1.5},
        {"e": 0.3, "v": 0.1, "delta_sw_meas": 0.4},
        {"e": 0.2, "v": 45.0, "beta": 0.02, "kappa": 0.002},
        {"psi_e": 3.3, "r": 6.0, "beta": -2.0, "delta_sw_meas": -20.0},
        {"e": 0.1, "psi_e": 0.05, "beta": math.nan, "delta_sw_meas": 0.3},
    ]
    winding = 1.0 + 0.05 * np.arange(block.preview_points)
    found: list[float] = []
    for u in states:
        along = inputs(block, **u)._replace(preview=tuple((u.get("kappa", 0.01) * winding).tolist()))
        y = driven(block, [along] * 3)[2]
        found += [y.delta_sw, y.status, y.fault, *y.plan[:2], sum(y.plan[:6]), sum(y.plan)]
        there = block.D(*[-value for value in along[:6]], tuple([-kappa for kappa in along.preview]))
        assert driven(block, [there._replace(v=along.v)] * 3)[2].plan == pytest.approx([-w for w in y.plan], abs=2e-3)
    expected = json.loads((ROOT / "tests/golden/predictive.json").read_text(encoding="utf-8"))
    shown = json.dumps([float(f"{one:.7g}") for one in found])
    assert found == pytest.approx(expected[kind.__name__ + " slow" * slow], rel=1e-4, abs=1e-4), shown


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
        assert {type(value) for value in (*one[:-1], *one.plan)} == {float}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (dict(horizon=2.5), r"horizon = 2.5, expected a whole number"),
        (dict(fallback=CAR), "fallback of another kind than Stanley"),
        (dict(budget=0.01, clock=None), r"budget = 0.01 \[s\] needs a clock"),
    ],
)
def test_a_wrong_parameter_is_refused(wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        MPC.of(CAR, **wrong)
    with pytest.raises(ValueError, match=r"MPC: Vehicle has no right-hand side .* NonlinearSingleTrack\(vehicle=...\)"):
        MPC.of(CAR.vehicle, delay=0.2)


# ---- compiled -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("kind", "backend", "driver", "fields", "statuses"),
    [
        (MPC, "c", STOPS, {}, {0.0, 3.0}),
        (NonlinearMPC, "c", STEADY, {}, {0.0}),
        (MPC, "c", STEADY, {"tolerance": 1e-300}, {2.0}),
        (MPC, "c", STEADY, {"fallback": replace(Stanley.of(CAR.vehicle), slew=8.0), "delay": 0.0}, {0.0}),
        (MPC, "python", STOPS, {}, {0.0, 3.0}),
    ],
)
def test_a_compiled_loop_is_the_simulated_one(
    kind: Any, backend: Any, driver: Any, fields: dict[str, Any], statuses: set[float]
) -> None:
    """Also while it stands still, and when no solution passes the check."""
    loop = loop_of(controller(kind, **fields), driver)
    simulated, compiled = simulate(loop, 3.0), compile(loop, backend=backend).run(3.0)
    for name, tolerance in {"status": 0.0, "fault": 0.0, "delta_sw": 1e-9, "plan": 1e-9}.items():
        name = f"controller.{name}"
        np.testing.assert_allclose(compiled[name], simulated[name], atol=tolerance, rtol=0.0, err_msg=name)
    np.testing.assert_allclose(compiled["path.e"], simulated["path.e"], atol=1e-9)
    assert set(compiled["controller.status"]) == statuses


@dataclass(frozen=True, eq=False, kw_only=True)
class Breaks(Block):
    """Shows what it is given, except between 1 and 2 s."""

    given = In("rad")
    shown = Out("rad")

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(m.where(m.both(t > 0.999, t < 1.999), math.nan, u.given))


@pytest.mark.parametrize("name", ["beta", "psi_e"])
def test_a_broken_input_is_answered_the_same_in_c(name: str) -> None:
    """Without beta the fallback steers when the plan is at its end; without psi_e it cannot, and the command stays."""
    block, breaks = controller(), Breaks()
    whole = loop_of(block)
    into = next((a, b) for a, b in whole.wires if b.block is block and b.spec.name == name)
    wires = [wire for wire in whole.wires if wire != into] + [(into[0], breaks.given), (breaks.shown, into[1])]
    loop = Loop(blocks=whole.blocks | {"breaks": breaks}, wires=wires, dt=whole.dt)
    simulated = simulate(loop, 3.0, allow_nonfinite=True)
    compiled = compile(loop, backend="c").run(3.0, allow_nonfinite=True)
    for port in block.Y._fields:
        np.testing.assert_allclose(compiled[f"controller.{port}"], simulated[f"controller.{port}"], atol=1e-9)
    assert set(compiled["controller.status"]) == {0.0, 1.0, 2.0 if name == "beta" else 3.0}
    assert set(compiled["controller.fault"]) == {0.0, 1.0}


def test_what_cannot_be_compiled_says_so() -> None:
    loop = loop_of(controller(budget=0.01, clock=time.perf_counter))
    with pytest.raises(TraceError, match=r"controller.*\(MPC\).*budget = 0.01 \[s\] needs a clock"):
        compile(loop, backend="c")


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda block: pickle.loads(pickle.dumps(block))])
def test_a_copy_of_one_in_use_drives_the_same(copied: Any) -> None:
    block = controller()
    u = inputs(block, e=0.2)
    y, again = driven(block, [u])[0], copied(block)
    assert "programme" not in vars(again)
    assert driven(again, [u])[0] == y
    assert driven(block, [u])[0] == y


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (lambda rate: 0.0 * math.sin(rate), r"gives \[.*nan\] on symbols, \[.*\] on numbers"),
        (lambda rate: 0.1 if rate > 1.0 else 0.0, "cannot be run on symbols: .*truth value"),
        (lambda rate: np.zeros(2), "cannot be run on symbols"),
        (lambda rate: 0.1 * isinstance(rate, float), r"gives \[.*\] on symbols, \[.*\] on numbers"),
    ],
)
@pytest.mark.parametrize("kind", [MPC, NonlinearMPC])
def test_a_model_that_is_another_one_on_symbols_is_refused_with_its_line(kind: Any, wrong: Any, says: str) -> None:
    plant: Any = CAR

    def own(x: Any, delta: Any, v: Any) -> Any:
        *others, r_dot = plant.rhs(x, delta, v)
        return *others, r_dot + wrong(x[4])

    block = replace(kind.of(plant), rhs=own)
    line = own.__code__.co_firstlineno
    with pytest.raises(ValueError, match=rf"{kind.__name__}: rhs \(line {line} of test_block.py\) {says}.*m.where"):
        simulate(loop_of(block), 0.1)
