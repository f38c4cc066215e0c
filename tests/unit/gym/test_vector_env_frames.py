"""Frames show the car and change with it."""

from typing import Any

import gymnasium
import numpy as np
import pytest

import steerkit.gym  # noqa: F401  registers the environments
from steerkit.controllers.nfq_policy import IDOE_ACTIONS

ID = "steerkit/TrackSteering-v0"
HOLD = IDOE_ACTIONS.index(0.0)


def test_frames_show_the_car_and_change_with_it() -> None:
    env: Any = gymnasium.make(ID, render_mode="rgb_array", course="circle")
    env.reset(seed=0)
    first = env.render()
    env.step(HOLD)
    second, scene = env.render(), env.unwrapped._painter._scene
    assert first.shape == second.shape == (*first.shape[:2], 3)
    assert first.dtype == np.uint8
    assert (first != second).any()
    assert scene.strip.get_xlim() == pytest.approx((0.05 - 10.0, 0.05))
    env.reset(seed=1)
    env.render()
    assert len(scene.lines["learned"].get_xdata()) == 1, "a new episode has a history of its own"
    with pytest.warns(UserWarning, match="made without render_mode"):
        assert gymnasium.make(ID).unwrapped.render() is None
