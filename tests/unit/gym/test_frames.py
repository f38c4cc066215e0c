"""Frames show the car and change with it."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

import steerkit.gym  # noqa: F401  registers the environments
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


def test_a_bend_to_the_left_goes_to_the_left() -> None:
    env: Any = gymnasium.make(ID, render_mode="rgb_array", course="circle", start_e=0.0, start_psi_e=0.0)
    env.reset(seed=0)
    assert float(env.unwrapped.task.path.samples.kappa.mean()) > 0.0
    picture = env.render()[:360].astype(int)  # what is seen from above, without the strip of e below it
    path = (np.abs(picture - (0x8F, 0xC3, 0xA0)).max(axis=-1) < 12).nonzero()
    ahead = path[0] < 100
    assert ahead.sum() > 20
    assert path[1][ahead].mean() < 360 - 4, "the path bends away from the middle, to the left"
