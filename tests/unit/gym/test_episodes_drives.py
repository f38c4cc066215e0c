"""N cars of a task, sample by sample: an episode ends for one reason."""

from typing import Any

import gymnasium
import pytest

import steerkit.gym  # noqa: F401

ID = "steerkit/TrackSteering-v0"
LEFT = 4  # 60 degrees to the left, each time, until it fails
STRAIGHT: dict[str, Any] = {"course": "straight", "start_e": 0.0, "start_psi_e": 0.0}


def last_flags(duration: float) -> tuple[int, bool, bool]:
    """Steps until the end of an episode of so many seconds, and whether it was terminated, truncated."""
    env = gymnasium.make(ID, duration=duration, **STRAIGHT)
    env.reset(seed=0)
    for step in range(1, 1000):
        *_, terminated, truncated, _ = env.step(LEFT)
        if terminated or truncated:
            return step, terminated, truncated
    raise AssertionError("it never ended")


def test_an_episode_that_fails_in_its_last_sample_has_failed_and_no_more() -> None:
    steps, *flags = last_flags(60.0)
    assert flags == [True, False]
    assert last_flags(0.05 * (steps + 1)) == (steps, True, False)
    assert last_flags(0.05 * steps) == (steps, True, False)  # time is over in the sample in which it fails
    assert last_flags(0.05 * (steps - 1)) == (steps - 1, False, True)


def test_a_new_episode_has_a_clock_of_its_own() -> None:
    env = gymnasium.make(ID, duration=0.5, **STRAIGHT)
    for _ in range(2):
        env.reset(seed=0)
        ends = [env.step(2)[2:4] for _ in range(10)]
        assert ends == [(False, False)] * 9 + [(False, True)]
        with pytest.raises(gymnasium.error.ResetNeeded):
            env.unwrapped.step(2)
