"""LQR and MPC of lateral acceleration against least squares, a bounded solver, and plants that are their own model."""

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from steerkit.controllers.lateral import DT, PREVIEW, STEER, LateralMpc

TOLD = LateralMpc.told(0.3, 0.15)


def seen(block: LateralMpc, target: Any, a_y: float, roll: float = 0.0) -> Any:
    ahead = tuple(np.broadcast_to(target, PREVIEW).tolist())
    return block.U(a_y=a_y, a_roll=roll, preview=ahead, preview_roll=(roll,) * PREVIEW)


def followed(block: LateralMpc, target: Any, gain: float, roll: float = 0.0) -> tuple[np.ndarray, list[float], Any]:
    """a_y [m/s^2] after `target`, (n,), of a car that is the block's model with that gain; commands; the last state."""
    pulses, x = np.diff((0.0, *block.response)), block.init()
    n = len(pulses)
    commands, a_y = [0.0] * n, []
    for k in range(len(target) - PREVIEW):
        a_y.append(gain * float(pulses @ commands[: -n - 1 : -1]) + roll)
        u = seen(block, target[k + 1 : k + 1 + PREVIEW], a_y[-1], roll)
        y = block.output(0.0, x, u)
        x = block.update(0.0, x, u, y)
        commands.append(y.a_y_cmd)
    return np.array(a_y), commands[n:], x


def test_the_told_response_is_a_dead_time_and_a_lag() -> None:
    assert TOLD[:3] == pytest.approx((0.0, 0.0, 0.0), abs=1e-12)
    assert TOLD[3] == pytest.approx(1.0 - math.exp(-0.1 / 0.15))
    assert 0.98 < TOLD[-1] < 1.0


@pytest.mark.parametrize("moves", [1, 10])
def test_a_constant_target_of_its_own_model_is_held_for_nothing(moves: int) -> None:
    block = LateralMpc(response=(0.0, 0.0, 0.6, 1.0), gain=1.7, moves=moves)
    x = (*[0.5 / 1.7] * 4, 1.7, 0.01, 0.5, 0.5 / 1.7)
    for _ in range(5):
        u = seen(block, 0.5, 0.5)
        y = block.output(0.0, x, u)
        x = block.update(0.0, x, u, y)
        assert y.a_y_cmd == pytest.approx(0.5 / 1.7, abs=1e-9)


@pytest.mark.parametrize(
    ("moves", "size", "pace", "q"),
    [(1, 0.4, 0.2, 30.0), (1, 3.0, 0.6, 1.0), (4, 3.0, 0.2, 30.0), (10, 3.0, 0.6, 100.0)],
)
def test_the_first_command_is_that_of_a_bounded_solver(moves: int, size: float, pace: float, q: float) -> None:
    """The measure over the horizon, stated anew sample by sample, and solved by another library."""
    rng = np.random.default_rng(3)
    block = LateralMpc(response=TOLD, gain=1.4, gain_doubt=0.0, moves=moves, q_step=q)
    n, g = len(TOLD), 1.4
    past, a_y, roll = rng.uniform(-1.0, 1.0, n), 0.7, 0.1
    target = size * np.sin(np.arange(1, PREVIEW + 1) * pace) + size
    pulses = np.diff((0.0, *TOLD))
    w = a_y - roll - g * pulses @ past[::-1]

    def residuals(commands: np.ndarray) -> np.ndarray:
        u, rows, before = np.concatenate((past, commands)), [], a_y
        for i in range(PREVIEW):
            now = g * pulses @ u[i + 1 : i + 1 + n][::-1] + w * math.exp(-DT / 1.5) ** (i + 1) + roll
            rows += [
                math.sqrt(50.0) * (now - target[i]),
                (now - before) / DT,
                math.sqrt(q) * g * (u[n + i] - u[n + i - 1]),
            ]
            before = now
        return np.array(rows)

    zero = residuals(np.zeros(PREVIEW))
    matrix = np.array([residuals(row) - zero for row in np.eye(PREVIEW)]).T
    limit = np.where(np.arange(PREVIEW) < moves, STEER, np.inf)
    best = lsq_linear(matrix, -zero, bounds=(-limit, limit), tol=1e-13).x
    assert (size > 1.0) == (np.abs(best[:moves]).max() > 0.99 * STEER)
    x = (*past.tolist(), g, 0.0, 0.0, 0.0)
    assert block.output(0.0, x, seen(block, target, a_y, roll)).a_y_cmd == pytest.approx(best[0], abs=1e-5)


def test_it_finds_its_gain_and_feeds_the_roll_forward() -> None:
    block = LateralMpc(response=TOLD)
    target = 0.8 * np.sin(0.08 * np.arange(400))
    a_y, _, x = followed(block, target, 1.9, roll=0.2)
    assert x[-4] == pytest.approx(1.9, abs=0.02)
    late = a_y[200:] - target[200 : len(a_y)]
    assert np.abs(late).max() < 0.02


def test_mirrored_it_answers_mirrored() -> None:
    block, rng = LateralMpc(response=TOLD, moves=5), np.random.default_rng(1)
    target = 4.0 * rng.normal(size=120)
    _, commands, _ = followed(block, target, 1.5, roll=0.3)
    _, mirrored, _ = followed(block, -target, 1.5, roll=-0.3)
    assert commands == pytest.approx([-c for c in mirrored], abs=1e-12)
    assert max(map(abs, commands)) == STEER


@pytest.mark.parametrize(
    ("fields", "fault"),
    [
        ({"response": ()}, "response of 0 samples, expected 1 to 50"),
        ({"response": (0.0, math.nan)}, "response = "),
        ({"response": (1.0, 0.0)}, r"response ends at 0.0 \[1\], expected above 0"),
        ({"response": TOLD, "moves": 21}, "moves = 21"),
    ],
)
def test_what_it_cannot_be_made_of_is_said(fields: dict[str, Any], fault: str) -> None:
    with pytest.raises(ValueError, match=f"LateralMpc: {fault}"):
        LateralMpc(**fields)
