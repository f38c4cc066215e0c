"""The environment of lateral acceleration: Gymnasium's own checks, its costs, and what it refuses."""

from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import steerkit.gym
from steerkit.controllers.lateral import ChallengeController
from steerkit.scenario import Scenario
from steerkit.scenario.lateral import LateralTarget, lateral_cost_of, lateral_drive


def test_it_is_an_environment() -> None:
    check_env(gymnasium.make("steerkit/LateralAcceleration-v0", seconds=6.0).unwrapped, skip_render_check=True)


def test_it_drives_as_the_drive_does_and_its_rewards_are_the_cost(tmp_path: Any) -> None:
    file = tmp_path / "target.csv"
    t = 0.1 * np.arange(80)
    np.savetxt(
        file, np.column_stack((np.sin(t), 10.0 + 0.0 * t, 0.1 * t)), delimiter=",", header="a_y,v,a_roll", comments=""
    )
    env, steer = steerkit.gym.LateralAcceleration(target=str(file)), []
    seen, _ = env.reset(seed=0)
    rewards, over = [], False
    while not over:
        assert seen[:4] == pytest.approx(
            [np.sin(t[len(steer)]) - seen[1], seen[1], 0.1 * t[len(steer)], -0.5], abs=1e-6
        )
        steer.append(0.4 * float(np.sin(len(steer))))
        assert env.observation_space.contains(seen)
        seen, reward, ended, over, info = env.step(np.array([steer[-1] / 2.0]))
        assert not ended
        rewards.append(reward)
        assert seen[-2:] == pytest.approx(([0.0] * 2 + steer)[-2:], abs=1e-6)
    assert len(rewards) == 79

    class Listed:
        def __init__(self) -> None:
            self.left = [*steer, 0.0]

        def update(self, *_: Any) -> float:
            return self.left.pop(0)

    log = lateral_drive(Scenario(), LateralTarget.read(str(file)), ChallengeController(make=Listed))
    cost = lateral_cost_of(log)
    assert {key: info[key] for key in cost} == pytest.approx(cost, rel=1e-9)
    off, jerk = log["target.a_y"] - log["target.a_y_target"], np.diff(log["target.a_y"]) / 0.1
    each = 50.0 * 0.5 * (off[1:] ** 2 + off[:-1] ** 2) + jerk**2
    assert rewards == pytest.approx(-each)


def test_each_episode_is_its_seeds() -> None:
    env = steerkit.gym.LateralAcceleration(seconds=6.0)
    first = [env.reset(seed=seed)[0] for seed in (3, 3, 4)]
    assert np.array_equal(first[0], first[1])
    assert not np.array_equal(first[0], first[2])


@pytest.mark.parametrize("action", [1.5, np.nan, [0.1, 0.2]])
def test_actions_out_of_the_space_are_refused(action: Any) -> None:
    env = steerkit.gym.LateralAcceleration(seconds=6.0)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"action .*, expected one number within \[-1, 1\]"):
        env.step(np.array(action))


def test_after_the_end_it_asks_for_a_reset() -> None:
    env = steerkit.gym.LateralAcceleration(seconds=0.3)
    env.reset(seed=0)
    assert [env.step(np.zeros(1))[3] for _ in range(2)] == [False, True]
    with pytest.raises(ValueError, match="the target is over"):
        env.step(np.zeros(1))
