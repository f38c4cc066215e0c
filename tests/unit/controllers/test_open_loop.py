"""A wave of the steering wheel: when it begins and ends, from which angle, and that the controller goes on after it."""

from typing import Any

import numpy as np
import pytest

from steerkit.controllers.open_loop import OpenLoop
from steerkit.controllers.stanley import Stanley
from steerkit.vehicles import VW_PASSAT as PASSAT

STANLEY = Stanley.of(PASSAT)
TRIANGLE = (0.0, 1.0, 0.0)
U: dict[str, Any] = dict(e=0.3, psi_e=0.02, kappa=0.0, v=5.0, r=0.0, delta_sw_meas=0.0)


def steered(block: OpenLoop, samples: int, **changes: Any) -> np.ndarray[Any, Any]:
    """Its angles, from a car that stays where it is beside its path."""
    u, x, out = U | changes, block.init(), []
    for k in range(samples):
        y = block.output(block.dt * k, x, block.D(**u))
        out.append(y.delta_sw)
        x = block.update(block.dt * k, x, block.U(**u), y)
    return np.array(out)


def bare(samples: int) -> np.ndarray[Any, Any]:
    return steered(OpenLoop(block=STANLEY, amplitude=0.0, on_top=True), samples)


def test_open_loop_the_wave_stands_on_the_angle_at_its_beginning() -> None:
    block = OpenLoop(block=STANLEY, wave=TRIANGLE, spacing=0.5, amplitude=0.8, wait=2.0)
    angles, own = steered(block, 80), bare(80)
    assert angles[:40] == pytest.approx(own[:40], abs=1e-12)
    assert angles[60:] == pytest.approx(own[60:], abs=1e-12)
    share = 0.05 / 0.55
    trim = 0.0
    for angle in own[:40]:
        trim += share * (angle - trim)
    wave = 0.8 * np.interp(0.05 * np.arange(20), [0.0, 0.5, 1.0], TRIANGLE)
    assert angles[40:60] == pytest.approx(trim + wave, abs=1e-9)


def test_on_top_the_controller_goes_on_steering() -> None:
    block = OpenLoop(block=STANLEY, wave=TRIANGLE, spacing=0.5, amplitude=-0.8, wait=1.0, on_top=True)
    wave = -0.8 * np.interp(0.05 * np.arange(60) - 1.0, [0.0, 0.5, 1.0], TRIANGLE)
    assert steered(block, 60) - bare(60) == pytest.approx(wave, abs=1e-9)


def test_another_number_begins_anew_in_the_middle_of_a_drive() -> None:
    first = OpenLoop(block=STANLEY, wave=TRIANGLE, spacing=0.5, amplitude=0.8, number=1.0, on_top=True)
    second = OpenLoop(block=STANLEY, wave=TRIANGLE, spacing=0.5, amplitude=0.4, number=2.0, on_top=True)
    x, out = first.init(), []
    for k in range(50):
        block = first if k < 30 else second
        y = block.output(0.05 * k, x, block.D(**U))
        out.append(y.delta_sw)
        x = block.update(0.05 * k, x, block.U(**U), y)
    wave = 0.4 * np.interp(0.05 * np.arange(20), [0.0, 0.5, 1.0], TRIANGLE)
    assert np.array(out[30:]) - bare(50)[30:] == pytest.approx(wave, abs=1e-9)


@pytest.mark.parametrize(
    ("wrong", "said"), [({"wave": (0.0,)}, "a wave of 1 samples"), ({"wave": (0.0, float("nan"))}, "wave")]
)
def test_what_is_no_wave_is_refused(wrong: dict[str, Any], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        OpenLoop(block=STANLEY, **({"wave": TRIANGLE} | wrong))
