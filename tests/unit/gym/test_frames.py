"""Frames show the car and change with it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from steerkit.controllers.nfq_policy import IDOE_ACTIONS

ID = "steerkit/TrackSteering-v0"


HOLD = IDOE_ACTIONS.index(0.0)


def test_frames_show_the_car_and_change_with_it() -> None:
    env = gymnasium.make(ID, render_mode="rgb_array", course="circle")
    env.reset(seed=0)
    first: Any = env.render()
    env.step(HOLD)
    second: Any = env.render()
    assert first.shape == (480, 720, 3)
    assert first.dtype == np.uint8
    assert (first == (0x1F, 0x6F, 0xA8)).all(axis=-1).sum() > 3000  # the car's blue
    assert (first != second).any()
    with pytest.warns(UserWarning, match="made without render_mode"):
        assert gymnasium.make(ID).unwrapped.render() is None
