"""Gymnasium's own checks."""

from typing import Any

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env

ID = "steerkit.gym:steerkit/TrackSteering-v0"


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "options",
    [
        {"render_mode": "rgb_array"},
        {"conditions": "hard", "cost": "paper"},
        {"actions": "bang-bang", "cost": "paper", "scenario": {"vehicle": {"name": "bmw-320i", "plant": "linear"}}},
        {"actions": "continuous", "course": "genesis"},
        {"actions": "continuous", "doe": "low-pass", "start": "beginning"},
        {"actions": (-0.1, 0.1), "course": "random-3"},
    ],
    ids=str,
)
def test_the_checker_has_nothing_to_say(options: dict[str, Any]) -> None:
    env = gymnasium.make(ID, **options)
    check_env(env.unwrapped, skip_render_check="render_mode" not in options)
