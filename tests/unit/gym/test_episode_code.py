"""What is compiled of a task is what Python computes of it, and what cannot be is named."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steerkit.compiled.trace import TraceError
from steerkit.gym.episode_code import episode_code
from steerkit.gym.task import Task


def code_of(task: Task) -> str:
    return episode_code(task, [*task.columns, *task.info], "path.s").source


@dataclass(frozen=True)
class Sorting:
    """A cost that no symbol can be asked for."""

    goal: float = 0.05

    def __call__(self, s: Any, a: Any, s_next: Any) -> Any:
        return np.sort(np.abs(s_next[:, 0])), s_next[:, 0] > 0.5


def test_a_cost_that_cannot_be_traced_is_named() -> None:
    with pytest.raises(TraceError, match="the cost cannot be run on symbols"):
        code_of(Task(cost=Sorting()))


def test_the_streams_of_random_numbers_are_those_of_the_blocks() -> None:
    """Of a clean car the human's alone; under hard conditions the sensors' too."""
    one, two = (code_of(Task(conditions=conditions)) for conditions in ("clean", "hard"))
    streams = [
        line for text in (one, two) for line in text.splitlines() if line.startswith("static const uint64_t streams")
    ]
    assert [line.count(",") for line in streams] == [0, 1]
