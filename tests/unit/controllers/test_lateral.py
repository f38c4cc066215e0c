"""LQR and MPC of lateral acceleration against least squares and a bounded solver; files for the challenge."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from steerkit.controllers.lateral import DT, PREVIEW, STEER, ChallengeController, LateralMpc
from steerkit.scenario import Scenario
from steerkit.scenario.lateral import LateralTarget, lateral_drive

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


# ---- controllers of the challenge, from files


COUNTS = """
from . import BaseController

class Controller(BaseController):
    made = 0
    def __init__(self):
        type(self).made += 1
        self.asked = 0
    def update(self, target_lataccel, current_lataccel, state, future_plan):
        self.asked += 1
        assert len(future_plan.lataccel) == len(future_plan.roll_lataccel) == 50
        assert len(future_plan.v_ego) == len(future_plan.a_ego) == 50
        return 0.001 * self.asked + 0.1 * (future_plan.lataccel[2] - state.roll_lataccel) + 0.01 * state.v_ego
"""


def target() -> LateralTarget:
    return LateralTarget.of(np.arange(20) * 0.1, 10.0, 0.5)


def loaded(tmp_path: Path, text: str) -> ChallengeController:
    file = tmp_path / "mine.py"
    file.write_text(text)
    return ChallengeController.load(f"{file}:Controller")


def test_it_is_asked_once_a_sample_and_begins_anew_with_each_drive(tmp_path: Path) -> None:
    block = loaded(tmp_path, COUNTS)
    for _ in range(2):
        log = lateral_drive(Scenario(), target(), block)
        k = np.arange(20)
        ahead = 0.1 * np.minimum(k + 3, 19)
        assert log["controller.a_y_cmd"] == pytest.approx(0.001 * (k + 1) + 0.1 * (ahead - 0.5) + 0.1)


@pytest.mark.parametrize(
    ("body", "fault"),
    [
        ("return float('nan')", "answered nan at 0.0 s, expected one finite number"),
        ("return None", "answered None"),
        ("return 'left'", "failed at 0.0 s: ValueError: could not convert"),
        ("return [0.1, 0.2]", "answered [0.1, 0.2]"),
        ("raise RuntimeError('no')", "failed at 0.0 s: RuntimeError: no"),
        ("self.n = getattr(self, 'n', 0) + 1; return 1 / (4 - self.n)", "failed at 0.3 s: ZeroDivisionError"),
        ("raise SystemExit(3)", "failed at 0.0 s: SystemExit: 3"),
    ],
)
def test_a_hostile_answer_is_said_in_one_line(body: str, fault: str, tmp_path: Path) -> None:
    text = f"class Controller:\n    def update(self, target, now, state, plan):\n        {body}\n"
    with pytest.raises(ValueError, match=r"controller '.*mine.py:Controller'") as caught:
        lateral_drive(Scenario(), target(), loaded(tmp_path, text))
    assert fault in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("Controller = 3\n", "is 3, expected a class with update"),
        ("class Controller:\n    pass\n", "expected a class with update"),
    ],
)
def test_a_file_that_is_none_is_said(text: str, fault: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"controller '.*mine.py:Controller'") as caught:
        loaded(tmp_path, text)
    assert fault in str(caught.value)


def test_a_batch_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="cannot be batched"):
        loaded(tmp_path, COUNTS).init((3,))
