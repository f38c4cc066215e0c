"""A wave on top of a controller: how large, when not, and that neither the controller nor who adapts is misled."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.open_loop import WAVES, WithExcitation, with_excitation
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.units import radians_of
from steerkit.doe import Integrator
from steerkit.paths.courses import course
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario.catalogue import DesignModel, make_controller
from steerkit.vehicles import VW_PASSAT as PASSAT

STANLEY = Stanley.of(PASSAT)
BELIEF = DesignModel(vehicle=PASSAT, path=course("paper"))
U: dict[str, Any] = dict(e=0.0, psi_e=0.0, kappa=0.0, v=5.0, r=0.0, delta_sw_meas=0.0)


def angles(block: WithExcitation, samples: int, **changes: float) -> list[float]:
    """What it asks for, of a car that stands still on its path."""
    u = U | changes
    x, out = block.init(), []
    for k in range(samples):
        y = block.output(0.05 * k, x, block.D(**u))
        out.append(y.delta_sw)
        x = block.update(0.05 * k, x, block.U(**u), y)
    return out


@pytest.mark.parametrize(
    ("wave", "amplitude", "frequency", "steepness"),
    [("", 0.5, 0.3, 1.0), ("sine", 0.6, 0.3, 1.0), ("steps", 0.5, 0.2, 6.0)],
)
@pytest.mark.parametrize(
    ("v", "r"), [(2.0, 0.0), (5.0, 0.0), (8.0, 1.7 / 8.0), (8.0, -1.7 / 8.0), (5.0, 0.5), (5.0, -0.5)]
)
def test_the_waves_of_a_calibration(
    wave: str, amplitude: float, frequency: float, steepness: float, v: float, r: float
) -> None:
    """The same acceleration at any speed; at most 1 rad; in a bend no further than 2 m/s^2, nor what is beyond it."""
    block: Any = with_excitation(STANLEY, wave, PASSAT) if wave else WithExcitation(block=STANLEY, vehicle=PASSAT)
    swing = np.clip(steepness * np.sin(2.0 * math.pi * frequency * 0.05 * np.arange(80)), -1.0, 1.0)
    a = np.clip(amplitude * swing, min(-2.0 - v * r, 0.0), max(2.0 - v * r, 0.0))
    per_a_y = PASSAT.steer_ratio * (PASSAT.wheelbase + PASSAT.understeer_gradient * v * v) / v**2
    bare = angles(WithExcitation(block=STANLEY, vehicle=PASSAT, amplitude=0.0), 80, v=v, r=r)
    assert np.array(angles(block, 80, v=v, r=r)) - bare == pytest.approx(np.clip(per_a_y * a, -1.0, 1.0), abs=1e-9)


def test_slow_cars_and_those_without_a_speed_or_yaw_rate_are_left_alone() -> None:
    block = WithExcitation(block=STANLEY, vehicle=PASSAT)
    wrong = [{name: value} for name in ("v", "r") for value in (math.nan, math.inf, -math.inf)]
    for changes in (*wrong, {"v": 1.9}, {"v": 0.0}, {"v": -3.0}):
        assert block._wave((*STANLEY.init(), 0.8, 0.0), block.U(**U | changes)) == 0.0


def test_the_controller_goes_on_from_its_own_angle() -> None:
    """Else its limit of the rate would start from the wave, and the wave would add up."""
    block = WithExcitation(block=STANLEY, vehicle=PASSAT, amplitude=0.6, frequency=0.3)
    x = block.init()
    for k in range(40):
        y = block.output(0.05 * k, x, block.D(**U))
        x = block.update(0.05 * k, x, block.U(**U), y)
        assert x[:-2] == pytest.approx(STANLEY.update(0.0, STANLEY.init(), STANLEY.U(**U), STANLEY.Y(0.0)), abs=1e-12)
    assert max(map(abs, angles(block, 200))) < radians_of(58.0)


def test_another_wave_begins_at_its_beginning_while_the_state_goes_on() -> None:
    one, two = (WithExcitation(block=STANLEY, vehicle=PASSAT, number=number, frequency=0.5) for number in (0.0, 1.0))
    x = one.init()
    for k in range(13):
        x = one.update(0.0, x, one.U(**U), one.output(0.05 * k, x, one.D(**U)))
    assert one.output(0.0, x, one.D(**U)).delta_sw != 0.0
    assert two.output(0.0, x, two.D(**U)).delta_sw == 0.0
    x = two.update(0.0, x, two.U(**U), two.output(0.0, x, two.D(**U)))
    assert x[-2:] == (0.05, 1.0)
    assert len(x) == len(one.init())


def test_a_controller_that_adapts_watches_the_whole_angle(monkeypatch: pytest.MonkeyPatch) -> None:
    block = with_excitation(make_controller("stanley-adaptive", BELIEF), "sine", PASSAT)
    assert isinstance(block, Adaptive)
    assert all(isinstance(inner, WithExcitation) for inner in block.blocks)
    level = (0.0,) * block.preview_points  # type: ignore[attr-defined]
    seen = {port.name: level if port.name == "preview" else U.get(port.name, 0.0) for port in block.inputs}
    watched: list[float] = []
    told = type(block.delay).update
    monkeypatch.setattr(
        type(block.delay), "update", lambda of, t, x, u, y: watched.append(u.delta_sw_cmd) or told(of, t, x, u, y)
    )
    x = block.init()
    for _ in range(31):
        y = block.output(0.0, x, block.D(*[seen[name] for name in block.D._fields]))
        x = block.update(0.0, x, block.U(*[seen[name] for name in block.U._fields]), y)
    whole = WithExcitation(block=STANLEY, vehicle=PASSAT, **WAVES["sine"])
    assert watched == pytest.approx(angles(whole, 31), abs=1e-9)


def test_the_waves_have_names_and_numbers_of_their_own() -> None:
    blocks: list[Any] = [with_excitation(STANLEY, wave, PASSAT) for wave in WAVES]
    assert [block.number for block in blocks] == [0.0, 1.0, 2.0]
    assert angles(blocks[2], 50) == [0.0] * 50
    with pytest.raises(ValueError, match=r"wave 'sinus' is not known .*'sine'.*; valid: sine, steps, bends"):
        with_excitation(STANLEY, "sinus", PASSAT)


def test_what_it_is_not_made_for() -> None:
    with pytest.raises(ValueError, match="expected among them v, r"):
        WithExcitation(block=Integrator(), vehicle=PASSAT)
    with pytest.raises(ValueError, match="expected among them delta_sw"):
        WithExcitation(block=ConstantSpeed(), vehicle=PASSAT)
