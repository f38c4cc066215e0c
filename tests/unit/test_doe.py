"""Output elements: their step responses, their limits, and that they go on from what was really steered."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from steerkit.diagram.units import radians_of
from steerkit.doe import Corrected, HeldAngle, Integrator, LowPass, PlainAngle
from tests.support.parts import Script

angles = st.floats(-12.0, 12.0)
does = pytest.mark.parametrize("doe", [Integrator(), LowPass(), PlainAngle()], ids=["integrator", "low-pass", "plain"])


def respond(doe: Any, *actions: float, seconds: float = 1.0) -> Log:
    """The angle over time when what the element asks for is what is steered."""
    script = Script(values=actions, dt=doe.dt)
    wires = [(script.angle, doe.action), (doe.delta_sw, doe.applied)]
    return simulate(Loop(blocks={"script": script, "doe": doe}, wires=wires), seconds)


def once(doe: Any, angle: float, action: float) -> Any:
    return doe.output(0.0, HeldAngle(angle), doe.D(action))


def test_the_integrator_adds_its_actions() -> None:
    actions = [radians_of(a) for a in (60.0, 10.0, -60.0, 0.0, 10.0)]
    log = respond(Integrator(), *actions, 0.0, seconds=0.3)
    np.testing.assert_allclose(log["doe.delta_sw"], np.cumsum([*actions, 0.0]), atol=1e-15)


def test_the_integrator_reaches_its_limit_and_comes_back_at_once() -> None:
    """No wind-up: the first action the other way moves the wheel."""
    step = radians_of(60.0)
    log = respond(Integrator(), *[step] * 20, -step, seconds=1.05)
    wheel = log["doe.delta_sw"]
    assert wheel[8:20] == pytest.approx([radians_of(520.0)] * 12)
    assert wheel[20] == pytest.approx(radians_of(460.0))


@pytest.mark.parametrize(("tau", "dt"), [(0.3, 0.05), (0.05, 0.05), (1.0, 0.01), (0.01, 0.05)])
def test_the_low_pass_steps_as_the_exponential(tau: float, dt: float) -> None:
    log = respond(LowPass(tau=tau, dt=dt), 1.5, seconds=100 * dt)
    np.testing.assert_allclose(log["doe.delta_sw"], 1.5 * -np.expm1(-(log.t + dt) / tau), rtol=1e-12)


@does
@given(angle=angles, action=angles)
def test_within_limits_and_odd(doe: Block, angle: float, action: float) -> None:
    there, back = once(doe, angle, action), once(doe, -angle, -action)
    assert abs(there.delta_sw) <= radians_of(520.0)
    assert there.delta_sw == -back.delta_sw
    assert there.state == angle


@does
@given(before=angles, angle=st.floats(-9.0, 9.0))
def test_the_action_for_an_angle_makes_it(doe: Any, before: float, angle: float) -> None:
    assert once(doe, before, doe.action_for(angle, before)).delta_sw == pytest.approx(angle, abs=1e-12)


@does
def test_it_goes_on_from_the_angle_really_applied(doe: Any) -> None:
    x = doe.update(0.0, HeldAngle(3.0), doe.U(action=1.0, applied=-2.0), doe.Y(4.0, 3.0))
    assert x == HeldAngle(-2.0)
    assert once(doe, x.delta_sw, 0.5).state == -2.0


@does
def test_an_angle_beyond_the_stop_is_remembered_as_the_stop(doe: Any) -> None:
    x = doe.update(0.0, HeldAngle(0.0), doe.U(action=0.0, applied=50.0), doe.Y(0.0, 0.0))
    assert x.delta_sw == radians_of(520.0)


def test_corrected_goes_on_from_what_was_really_commanded() -> None:
    for element in (Integrator(), LowPass(), PlainAngle()):
        doe = Corrected(element=element)
        told = doe.output(0.0, (), doe.D(action=0.3, applied=-2.0))
        expected = element.output(0.0, HeldAngle(-2.0), element.D(action=0.3))
        assert told == expected
        assert told.state == -2.0
    doe = Corrected()
    assert doe.output(0.0, (), doe.D(action=math.nan, applied=-2.0)).state == -2.0
    assert math.isnan(doe.output(0.0, (), doe.D(action=0.0, applied=math.nan)).delta_sw)
    assert doe.output(0.0, (), doe.D(action=0.0, applied=50.0)).state == radians_of(520.0)
    assert Corrected(element=Integrator(dt=0.02)).dt == 0.02
