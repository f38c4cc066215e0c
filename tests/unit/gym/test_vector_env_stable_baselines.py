"""Policies of Stable-Baselines3 as blocks."""

import sys
from typing import Any

import gymnasium
import numpy as np
import pytest

import steerkit.gym
from steerkit.gym import Task, TrackSteering

ID = "steerkit/TrackSteering-v0"
CONTINUOUS = "steerkit/TrackSteeringContinuous-v0"


@pytest.mark.parametrize("actions", ["i-doe", "continuous"])
def test_the_cars_of_a_vec_are_those_of_the_vector_environment(actions: str) -> None:
    """Through ends and starts, whose last observations the agent is told."""
    pytest.importorskip("stable_baselines3")
    options: dict[str, Any] = {"actions": actions, "backend": "python", "duration": 1.0, "limit": 0.2}
    cars = steerkit.gym.stable_baselines_vec(3, **options)
    same = steerkit.gym.TrackSteeringVector(3, autoreset_mode="SameStep", **options)
    cars.seed(5)
    np.testing.assert_array_equal(cars.reset(), same.reset(seed=5)[0])
    rng, ends, late = np.random.default_rng(0), 0, 0
    for _ in range(120):
        action = rng.integers(0, 5, 3) if actions == "i-doe" else rng.uniform(-1.0, 1.0, (3, 1)).astype(np.float32)
        seen, reward, over, each = cars.step(action)
        other, gained, terminated, truncated, infos = same.step(action)
        np.testing.assert_array_equal(seen, other)
        np.testing.assert_array_equal(reward, gained)
        np.testing.assert_array_equal(over, terminated | truncated)
        for car in np.flatnonzero(over):
            np.testing.assert_array_equal(each[car]["terminal_observation"], infos["final_obs"][car])
            assert each[car]["TimeLimit.truncated"] == truncated[car]
        ends, late = ends + over.sum(), late + truncated.sum()
    assert ends > late > 0
    with pytest.raises(AttributeError, match="one loop drives all cars"):
        cars.set_attr("task", None)


def test_without_stable_baselines3_its_vec_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    with pytest.raises(ValueError, match=r"stable_baselines_vec needs stable_baselines3: pip install '.*\[gym\]'"):
        steerkit.gym.stable_baselines_vec(2)


def test_stable_baselines3_has_nothing_to_say() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    for name in (ID, CONTINUOUS):
        checker.check_env(gymnasium.make(name).unwrapped, warn=True)


@pytest.mark.parametrize("between", ["ReLU", "Tanh"])
@pytest.mark.parametrize("kind", ["DQN", "SAC", "TD3", "PPO"])
def test_the_block_of_a_stable_baselines3_model_predicts_what_the_model_does(kind: str, between: str) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    import torch  # here, as it takes longer than all else together, and most processes of the tests can do without

    task = Task(actions="i-doe" if kind == "DQN" else "continuous")
    env = TrackSteering(actions="i-doe" if kind == "DQN" else "continuous")
    model = getattr(sb3, kind)(
        "MlpPolicy", env, seed=0, policy_kwargs={"net_arch": [16, 16], "activation_fn": getattr(torch.nn, between)}
    )
    if kind == "PPO":
        model.policy.action_net.weight.data *= 300.0  # a fresh one asks for next to nothing: there is nothing to clip
    block = steerkit.gym.from_stable_baselines(model)  # of the task that its environment has
    observations = np.random.default_rng(0).uniform(-2.0, 2.0, (200, 6)).astype(np.float32)
    actions, _ = model.predict(observations, deterministic=True)
    d = task.description
    told = block.output(0.0, (), block.D(*(observations.astype(float) * d.half + d.mid).T)).action
    np.testing.assert_allclose(told, task.angle(actions, np.shape(actions)), atol=1e-5)
    other = Task(actions="bang-bang")
    with pytest.raises(ValueError, match="expected those of the task"):
        steerkit.gym.from_stable_baselines(model, other)
