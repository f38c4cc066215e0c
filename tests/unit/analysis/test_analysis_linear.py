"""Linearising loops, breaking them open, and systems to and from python-control."""

import math

import control
import numpy as np
import pytest

from steerkit import analysis
from steerkit.analysis import FromControl, break_at, linearise, margins
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.paths.courses import circle
from steerkit.plants.sensors import Sensors
from steerkit.plants.speed_driver import SpeedDriver
from tests.support.straight_road import PASSAT, looped, steered

PLANT = control.ss([[0.9, 0.1], [0.0, 0.7]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], 0.05, inputs=["u"], outputs=["y"])
FILTER = control.ss([[0.5]], [[1.0]], [[-0.08]], [[-0.02]], 0.05, inputs=["u"], outputs=["y"])


def hand_built() -> Loop:
    """A plant and a dynamic controller, both linear, in positive feedback: u = FILTER y."""
    plant = FromControl(system=PLANT, units={"u": "m", "y": "m"}, x0=(1.0, 0.0))
    feedback = FromControl(system=FILTER, units={"u": "m", "y": "m"})
    return Loop(blocks={"plant": plant, "law": feedback}, wires=[(plant.y, feedback.u), (feedback.y, plant.u)])


def test_a_loop_is_python_controls_own_feedback() -> None:
    closed = linearise(hand_built(), inputs=["law.y"], outputs=["plant.y"])
    expected = control.feedback(PLANT, -FILTER)
    for w in (0.1, 1.0, 10.0, 50.0):
        z = np.exp(1j * w * 0.05)
        assert complex(closed(z)) == pytest.approx(complex(expected(z)), rel=1e-8)
    np.testing.assert_allclose(np.sort_complex(closed.poles()), np.sort_complex(expected.poles()), atol=1e-8)


def test_broken_open_it_is_the_series_and_closes_again() -> None:
    for signal in ("plant.y", "law.y"):
        opened = break_at(hand_built(), signal)
        z = np.exp(0.3j)
        assert complex(opened(z)) == pytest.approx(complex(-(PLANT * FILTER)(z)), rel=1e-8)
        closed = np.sort_complex(control.feedback(opened).poles())
        np.testing.assert_allclose(closed, np.sort_complex(control.feedback(PLANT, -FILTER).poles()), atol=1e-8)


def test_a_signal_may_be_a_port_and_a_loop_linearises_whole() -> None:
    """Without inputs and outputs `linearise(loop, at)` is from all signals to all."""
    loop = hand_built()
    at = simulate(loop, 1.0).state
    assert break_at(loop, loop.blocks["law"].y).A.tolist() == break_at(loop, "law.y").A.tolist()
    whole = linearise(loop, at)
    assert (whole.input_labels, whole.output_labels) == (["plant_y", "law_y"],) * 2
    expected = control.feedback(PLANT, -FILTER)
    np.testing.assert_allclose(np.sort_complex(whole.poles()), np.sort_complex(expected.poles()), atol=1e-8)
    steering = linearise(steered())
    assert {"controller_delta_sw", "car_a_y", "path_e"} <= set(steering.output_labels)
    assert np.abs(steering.poles()).max() == pytest.approx(1.0, abs=1e-6)  # the way driven


def test_what_does_not_matter_is_left_out() -> None:
    """Noise generators, the human's mood and the way driven are no part of the loop."""
    loop = steered(driver=SpeedDriver(v_min=6.0, v_max=6.0), sensors=Sensors(psi_bias=0.0))
    labels = break_at(loop, "controller.delta_sw").state_labels
    assert not [name for name in labels if name.startswith(("driver", "sensors", "path"))]
    assert {"car_y", "car_psi", "car_r", "car_sway"} <= set(labels)


def test_in_a_bend_it_says_that_the_pose_turns() -> None:
    loop = looped(Stanley.of(PASSAT), circle(30.0), 5.0, 0.0, actuator=None)
    steady = simulate(loop, 20.0).state
    with pytest.raises(analysis.NotTimeInvariantError, match="start on a straight path at a constant speed"):
        break_at(loop, "controller.delta_sw", at=steady)
    once = linearise(loop, inputs=["controller.delta_sw"], outputs=["path.e"], at=steady, invariant=False)
    assert once.nstates > 0


def test_a_fast_signal_is_lifted_and_has_no_margins() -> None:
    lifted = break_at(steered(), "actuator.delta_sw")
    assert (lifted.ninputs, lifted.noutputs) == (5, 5)
    assert np.abs(control.feedback(lifted, np.eye(5)).poles()).max() == pytest.approx(
        np.abs(control.feedback(break_at(steered(), "controller.delta_sw")).poles()).max(), abs=1e-6
    )
    with pytest.raises(ValueError, match="expected 1 and 1; break the loop at a signal of its slowest blocks"):
        margins(lifted)


def test_a_linear_loop_answers_a_step_as_its_simulation_does() -> None:
    t, y = control.step_response(linearise(steered(), inputs=["car.psi"], outputs=["car.r"]), 1.0)
    system = analysis.to_control(steered(), inputs=["car.psi"], outputs=["car.r"])
    response = control.input_output_response(system, t, np.full(len(t), 1e-4), system.params["x0"])
    np.testing.assert_allclose(y, np.asarray(response.outputs).ravel() / 1e-4, atol=1e-3 * np.abs(y).max())


def test_mistakes_are_told() -> None:
    with pytest.raises(ValueError, match=r"cut at plant.y, which is not among the inputs"):
        linearise(hand_built(), inputs=["law.y"], outputs=["plant.y"], cut=["plant.y"])
    with pytest.raises(ValueError, match=r"path.e does not act back on itself"):
        break_at(steered(), "path.e")
    with pytest.raises(ValueError, match="is a vector"):
        break_at(steered(), "controller_path.preview")
    with pytest.raises(ValueError, match="multiple of the loop's period 5"):
        break_at(steered(), "controller.delta_sw", at=simulate(steered(), 0.03).state)
    with pytest.raises(ValueError, match=r"dt = 0.1 s, but the system has 0.05 s"):
        FromControl(system=PLANT, dt=0.1)
    with pytest.raises(ValueError, match="units for w; ports: u, y"):
        FromControl(system=PLANT, units={"w": "m"})
    assert math.isinf(margins(control.ss([[0.5]], [[0.1]], [[1.0]], [[0.0]], 0.05)).phase)


def test_a_crossing_beyond_half_a_turn_bears_nearly_a_whole_turn_of_delay() -> None:
    """L = s^2/((s^2 + 0.1 s + 1)(s/5 + 1)) has |L| = 1 below its resonance at an angle just below 180 degrees, and
    above it: the delay margin is the least t > 0 with arg L - w t = pi (mod 2 pi) at either."""
    s = control.tf("s")
    loop = s**2 / ((s**2 + 0.1 * s + 1.0) * (s / 5.0 + 1.0))
    squares = np.polysub(np.polymul([1.0, -1.99, 1.0], [1.0 / 25.0, 1.0]), [1.0, 0.0, 0.0])  # |D|^2 - |N|^2 in w^2
    at = [math.sqrt(root.real) for root in np.roots(squares) if abs(root.imag) < 1e-12 and root.real > 0.0]
    delays = [((np.angle(loop(1j * w)) + math.pi) % (2.0 * math.pi)) / w for w in at]
    assert len(delays) == 2
    assert max(delays) > 8.0
    found = margins(control.ss(loop))
    assert found.delay == pytest.approx(min(delays), rel=1e-6)
    assert found.phase == pytest.approx(min(abs(np.angle(-loop(1j * w))) for w in at), rel=1e-6)
