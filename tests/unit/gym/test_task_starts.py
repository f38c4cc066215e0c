"""Where episodes start: settled in the bend, with room before the end, each with the driver and noise of its seed."""

import math
from typing import Any

import gymnasium
import numpy as np
import pytest

from steerkit.controllers.nfq_policy import IDOE_ACTIONS
from steerkit.gym import Task
from steerkit.gym.task import LEAST_ROOM, Draw
from steerkit.scenario import END_MARGIN
from tests.support.steady_world import SteadyWorld

ID = "steerkit/TrackSteering-v0"
HOLD = IDOE_ACTIONS.index(0.0)


def test_a_car_starts_in_the_steady_state_of_its_bend() -> None:
    for plant in ("linear", "nonlinear"):
        env = gymnasium.make(
            ID, scenario=SteadyWorld(course="circle", vehicle={"plant": plant}), start_e=0.0, start_psi_e=0.0
        )
        env.reset(seed=2)
        infos = [env.step(HOLD)[4] for _ in range(40)]
        assert max(abs(info["e"]) for info in infos) < 0.02  # 12 m of bend with the wheel held
        kappa = env.unwrapped.task.path.kappa(0.0)  # type: ignore[attr-defined]
        assert infos[0]["a_y"] == pytest.approx(6.0**2 * kappa, rel=0.02)


def test_on_an_open_course_a_car_starts_with_room_before_its_end() -> None:
    task, rng = Task(course="straight"), np.random.default_rng(0)
    starts = np.array([task.draw(rng).s for _ in range(2000)])
    end = task.path.length - END_MARGIN - LEAST_ROOM
    assert 0.0 <= starts.min() < 0.01 * end
    assert 0.99 * end < starts.max() <= end
    closed = Task(course="circle")
    around = np.array([closed.draw(rng).s for _ in range(2000)])
    assert around.max() > 0.99 * closed.path.length


@pytest.mark.parametrize(
    "options",
    [{"s": math.nan}, {"e": "left"}, {"s": None}, {"psi_e": math.inf}, {"e": [0.1, 0.2]}, {"s": 1e9}, {"s": True}],
)
def test_a_start_that_is_no_number_on_the_course_is_named(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"TrackSteering.reset.*{next(iter(options))}.*expected"):
        Task(course="genesis").draw(np.random.default_rng(0), options)


def test_each_episode_has_the_human_and_the_noise_of_its_seed() -> None:
    task = Task(conditions="hard")
    draws = [Draw(seed=seed, s=10.0, e=0.0, psi_e=0.0) for seed in (1, 2, 1)]
    states = dict(zip(task.loop.names, task.starts(draws).x, strict=True))
    for name in ("driver", "sensors"):
        numbers = np.array([np.broadcast_to(column, 3) for column in states[name]], dtype=float)
        np.testing.assert_array_equal(numbers[:, 0], numbers[:, 2])
        assert (numbers[:, 0] != numbers[:, 1]).any(), name
