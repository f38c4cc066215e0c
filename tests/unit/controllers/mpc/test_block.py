"""Predictive steering in compiled loops, and its copies."""

from __future__ import annotations

import copy
import math
import pickle
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steerkit.compiled import compile
from steerkit.compiled.trace import TraceError
from steerkit.controllers.mpc.block import PredictiveSteering
from steerkit.controllers.mpc.linear import MPC
from steerkit.controllers.mpc.nonlinear import NonlinearMPC
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.paths.courses import circle
from steerkit.plants.speed_driver import ConstantSpeed, RecordedSpeed
from steerkit.scenario.assembly import placed, steering_loop
from tests.support.predictive import CAR, MOTOR, controller, driven, inputs

STEADY = ConstantSpeed(speed=6.0)


def loop_of(block: PredictiveSteering, driver: Any = STEADY) -> Any:
    path = circle(30.0)
    return steering_loop(
        car=placed(CAR, path, e=0.4),
        path=path,
        driver=driver,
        actuator=MOTOR,
        controller=block,
        reference=CAR.vehicle.l_f,
    )


STOPS = RecordedSpeed(speeds=(5.0, 0.0, 0.0, 5.0, 5.0), spacing=1.0)


@pytest.mark.parametrize(
    ("kind", "backend", "driver", "fields", "told"),
    [
        (MPC, "c", STOPS, {}, {0.0, 3.0}),
        (NonlinearMPC, "c", STEADY, {}, {0.0}),
        (MPC, "c", STEADY, {"tolerance": 1e-300}, {2.0}),
        (MPC, "c", STEADY, {"slew": 8.0, "delay": 0.0}, {0.0}),
        (MPC, "python", STOPS, {}, {0.0, 3.0}),
    ],
)
def test_a_compiled_loop_is_the_simulated_one(
    kind: Any, backend: Any, driver: Any, fields: dict[str, Any], told: set[float]
) -> None:
    """Also while it stands still, and when no solution passes the check."""
    loop = loop_of(controller(kind, **fields), driver)
    simulated, compiled = simulate(loop, 3.0), compile(loop, backend=backend).run(3.0)
    for name, tolerance in {"status": 0.0, "fault": 0.0, "delta_sw": 1e-9, "plan": 1e-9}.items():
        name = f"controller.{name}"
        np.testing.assert_allclose(compiled[name], simulated[name], atol=tolerance, rtol=0.0, err_msg=name)
    np.testing.assert_allclose(compiled["path.e"], simulated["path.e"], atol=1e-9)
    assert set(compiled["controller.status"]) == told


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


def test_a_batch_is_compiled_car_by_car() -> None:
    loop = loop_of(controller())
    program = compile(loop, backend="c", record=["path.e", "controller.delta_sw"])
    one, three = program.run(1.0), program.run(1.0, batch=3)
    for name in one.signals:
        np.testing.assert_array_equal(three[name], np.repeat(one[name][:, None], 3, axis=1))


@pytest.mark.parametrize(
    ("fields", "backend", "message"),
    [
        ({}, "vm", r"controller \(MPC\).*runs code of its own.*backend 'c' or 'python'"),
        ({"solver": "piqp"}, "c", r"MPC.*solver 'piqp' is not called from C here; valid: hpipm"),
        ({"budget": 0.01, "clock": time.perf_counter}, "c", r"controller \(MPC\).*budget = 0.01 \[s\] needs a clock"),
    ],
)
def test_what_cannot_be_compiled_says_so(fields: dict[str, Any], backend: Any, message: str) -> None:
    loop = loop_of(controller(**fields))
    with pytest.raises(TraceError, match=message):
        compile(loop, backend=backend).run(0.1)


def test_a_solver_that_c_does_not_call_can_be_compiled_to_python() -> None:
    loop = loop_of(controller(solver="piqp"))
    simulated, compiled = simulate(loop, 0.5), compile(loop, backend="python").run(0.5)
    np.testing.assert_allclose(compiled["controller.delta_sw"], simulated["controller.delta_sw"], atol=1e-9)


@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda block: pickle.loads(pickle.dumps(block))])
def test_a_copy_of_one_in_use_drives_the_same(copied: Any) -> None:
    block = controller()
    u = inputs(block, e=0.2)
    y, again = driven(block, [u])[0], copied(block)
    assert "programme" not in vars(again)
    assert driven(again, [u])[0] == y
    assert driven(block, [u])[0] == y
