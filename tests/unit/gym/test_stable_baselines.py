"""Policies of Stable-Baselines3 as blocks."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

import steerkit.gym
from steerkit.gym import Task, TrackSteering

ID = "steerkit/TrackSteering-v0"


CONTINUOUS = "steerkit/TrackSteeringContinuous-v0"


def test_stable_baselines3_has_nothing_to_say() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    for name in (ID, CONTINUOUS):
        checker.check_env(gymnasium.make(name).unwrapped, warn=True)


@pytest.mark.parametrize("kind", ["DQN", "SAC", "TD3", "PPO"])
def test_the_block_of_a_stable_baselines3_model_predicts_what_the_model_does(kind: str) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    task = Task(actions="i-doe" if kind == "DQN" else "continuous")
    env = TrackSteering(actions="i-doe" if kind == "DQN" else "continuous")
    model = getattr(sb3, kind)("MlpPolicy", env, seed=0, policy_kwargs={"net_arch": [16, 16]})
    block = steerkit.gym.from_stable_baselines(model, task)
    observations = np.random.default_rng(0).uniform(-2.0, 2.0, (200, 6)).astype(np.float32)
    actions, _ = model.predict(observations, deterministic=True)
    d = task.description
    told = block.output(0.0, (), block.D(*(observations.astype(float) * d.half + d.mid).T)).action
    np.testing.assert_allclose(told, task.angle(actions, np.shape(actions)), atol=1e-5)
    other = Task(actions="bang-bang")
    with pytest.raises(ValueError, match="expected those of the task"):
        steerkit.gym.from_stable_baselines(model, other)
