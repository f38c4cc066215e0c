"""Files for the controls challenge: what drives, what is told to it, and files that are hostile."""

from pathlib import Path

import numpy as np
import pytest

from steerkit.controllers.lateral import ChallengeController
from steerkit.scenario import Scenario
from steerkit.scenario.lateral import LateralTarget, lateral_drive

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
        ("x = 1\n", "has no 'Controller'; it has x"),
        ("Controller = 3\n", "is 3, expected a class with update"),
        ("class Controller:\n    pass\n", "expected a class with update"),
        ("from . import Something\n", "fails when it is imported: ImportError"),
        ("import sys\nsys.exit(1)\n", "fails when it is imported: SystemExit"),
        ("class Controller(:\n", "fails when it is imported: SyntaxError"),
    ],
)
def test_a_file_that_is_none_is_said(text: str, fault: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"controller '.*mine.py:Controller'") as caught:
        loaded(tmp_path, text)
    assert fault in str(caught.value)


def test_a_batch_is_refused(tmp_path: Path) -> None:
    with pytest.raises(TypeError, match="cannot be batched"):
        loaded(tmp_path, COUNTS).init((3,))
