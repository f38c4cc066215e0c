"""A wave of the wheel, instead of a controller or on top of one: its size, its begin and end, and that neither the
controller nor who adapts is misled by it."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.open_loop import WAVES, OpenLoop, WithExcitation, with_excitation
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block
from steerkit.diagram.units import radians_of
from steerkit.doe import Integrator
from steerkit.paths.courses import course
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario.catalogue import DesignModel, make_controller
from steerkit.vehicles import VW_PASSAT as PASSAT

STANLEY = Stanley.of(PASSAT)
TRIANGLE: dict[str, Any] = dict(block=STANLEY, wave=(0.0, 1.0, 0.0), spacing=0.5)
BELIEF = DesignModel(vehicle=PASSAT, path=course("paper"))
U: dict[str, Any] = dict(e=0.0, psi_e=0.0, kappa=0.0, v=5.0, r=0.0, delta_sw_meas=0.0)
BESIDE = {"e": 0.3, "psi_e": 0.02}


def angles(block: Block, samples: int, **changes: float) -> np.ndarray[Any, Any]:
    """What it asks for, of a car that stays where it is."""
    u, x, out = U | changes, block.init(), []
    for k in range(samples):
        y = block.output(0.05 * k, x, block.D(**u))
        out.append(y.delta_sw)
        x = block.update(0.05 * k, x, block.U(**u), y)
    return np.array(out)


def triangle(samples: int, amplitude: float, wait: float = 0.0) -> np.ndarray[Any, Any]:
    return amplitude * np.interp(0.05 * np.arange(samples) - wait, [0.0, 0.5, 1.0], TRIANGLE["wave"])


def bare(samples: int) -> np.ndarray[Any, Any]:
    return angles(OpenLoop(**TRIANGLE, on_top=True), samples, **BESIDE)


def test_open_loop_the_wave_stands_on_the_angle_at_its_beginning() -> None:
    found, own = angles(OpenLoop(**TRIANGLE, amplitude=0.8, wait=2.0), 80, **BESIDE), bare(80)
    assert found[:40] == pytest.approx(own[:40], abs=1e-12)
    assert found[60:] == pytest.approx(own[60:], abs=1e-12)
    trim = 0.0
    for angle in own[:40]:
        trim += 0.05 / 0.55 * (angle - trim)
    assert found[40:60] == pytest.approx(trim + triangle(20, 0.8), abs=1e-9)


def test_on_top_the_controller_goes_on_steering() -> None:
    found = angles(OpenLoop(**TRIANGLE, amplitude=-0.8, wait=1.0, on_top=True), 60, **BESIDE)
    assert found - bare(60) == pytest.approx(triangle(60, -0.8, wait=1.0), abs=1e-9)


def test_another_number_begins_anew_in_the_middle_of_a_drive() -> None:
    first = OpenLoop(**TRIANGLE, amplitude=0.8, number=1.0, on_top=True)
    second = OpenLoop(**TRIANGLE, amplitude=0.4, number=2.0, on_top=True)
    x, out, u = first.init(), [], U | BESIDE
    for k in range(50):
        block = first if k < 30 else second
        y = block.output(0.05 * k, x, block.D(**u))
        out.append(y.delta_sw)
        x = block.update(0.05 * k, x, block.U(**u), y)
    assert np.array(out[30:]) - bare(50)[30:] == pytest.approx(triangle(20, 0.4), abs=1e-9)


# ---- with excitation ------------------------------------------------------------------------------------------------


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
    assert angles(block, 80, v=v, r=r) - bare == pytest.approx(np.clip(per_a_y * a, -1.0, 1.0), abs=1e-9)


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
    assert not angles(blocks[2], 50).any()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: with_excitation(STANLEY, "sinus", PASSAT), r"wave 'sinus' is not known .*; valid: sine, steps, bends"),
        (lambda: WithExcitation(block=Integrator(), vehicle=PASSAT), "expected among them v, r"),
        (lambda: WithExcitation(block=ConstantSpeed(), vehicle=PASSAT), "expected among them delta_sw"),
        (lambda: OpenLoop(block=STANLEY, wave=(0.0,)), "a wave of 1 samples"),
        (lambda: OpenLoop(block=STANLEY, wave=(0.0, math.nan)), "wave"),
    ],
)
def test_what_cannot_be_is_refused(make: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()
