"""Systems to and from python-control give the same numbers there and here."""

from typing import Any

import control
import numpy as np
import pytest

from steerkit.analysis import FromControl, to_control
from steerkit.compiled import compile
from steerkit.diagram import maths as m
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.scenario.assembly import placed
from tests.support.parts import Gain
from tests.support.straight_road import PASSAT, ROAD, steered
from tests.support.traced_blocks import mixed_loop


def test_an_exported_loop_runs_as_it_does_here() -> None:
    car = placed(LinearSingleTrack(vehicle=PASSAT, v0=6.0), ROAD, s=20.0, e=0.5)
    loop = steered().with_block("car", car)
    system = to_control(loop, outputs=["path.e", "car.r"])
    t = np.arange(40) * 0.05
    ours = control.input_output_response(system, t, 0, system.params["x0"])
    log = simulate(loop, 2.0, every=5)
    np.testing.assert_allclose(ours.outputs[0], log["path.e"], atol=1e-12)
    np.testing.assert_allclose(ours.outputs[1], log["car.r"], atol=1e-12)


def test_a_system_of_python_controls_runs_as_it_does_there() -> None:
    """Continuous and nonlinear: x'' = u - x' - sin(x), against its own integrator."""

    def rhs(t: float, x: Any, u: Any, params: Any) -> Any:
        return [x[1], u[0] - x[1] - m.sin(x[0])]

    system = control.nlsys(rhs, lambda t, x, u, p: [x[0]], states=2, inputs=["u"], outputs=["y"])
    block = FromControl(system=system, units={"u": "m", "y": "m"}, x0=(1.0, 0.0), direct=False)
    back = Gain(k=-0.5)
    loop = Loop(blocks={"system": block, "back": back}, wires=[(block.y, back.u), (back.y, block.u)])
    log = simulate(loop, 3.0)
    t = log.t
    held = np.asarray(log["back.y"])
    x = np.array([1.0, 0.0])
    for k in range(len(t) - 1):  # the input is held over a sample
        part = control.input_output_response(system, t[k : k + 2], np.full(2, held[k]), x)
        x = part.states[:, -1]
        assert log["system.y"][k + 1] == pytest.approx(x[0], abs=1e-3)
    assert compile(loop, backend="python").run(3.0)["system.y"][-1] == pytest.approx(log["system.y"][-1], abs=1e-12)


def test_an_exported_loop_that_starts_later_knows_its_time() -> None:
    """One of its blocks depends on t; python-control's time counts from the state it starts from."""
    loop = mixed_loop()
    later = simulate(loop, 1.0, record=()).state
    system = to_control(loop, outputs=["mixed.y", "decay.x"], at=later)
    t = np.arange(20) * 0.05
    ours = control.input_output_response(system, t, 0, system.params["x0"])
    log = simulate(loop, 1.0, state=later)
    assert np.ptp(log["mixed.y"]) > 0.5
    np.testing.assert_allclose(ours.outputs[0], log["mixed.y"], atol=1e-12)
    np.testing.assert_allclose(ours.outputs[1], log["decay.x"], atol=1e-12)
