"""What is steered, with which actions, from which starts: options, rewards, ends."""

import math
from typing import Any

import gymnasium
import numpy as np
import pytest

from steerkit._support import native
from steerkit.controllers.nfq_policy import IDOE_ACTIONS
from steerkit.diagram import maths as m
from steerkit.diagram.units import radians_of
from steerkit.gym import Task, TrackSteering
from steerkit.gym.task import LEAST_ROOM, Draw
from steerkit.scenario import END_MARGIN, Scenario
from tests.support.steady_world import SteadyWorld

ID = "steerkit/TrackSteering-v0"
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")
HOLD = IDOE_ACTIONS.index(0.0)


@pytest.mark.parametrize("backend", ["python", pytest.param("c", marks=needs_compiler)])
def test_a_cost_and_an_observation_of_ones_own(backend: Any) -> None:
    """The reward is minus that cost, of states in SI, and the failure's at the end; columns are scaled by ranges."""

    def cost(s: Any, a: Any, s_next: Any) -> Any:
        return s_next[:, 0] ** 2 + 0.1 * a**2 + 0.01 * m.absolute(s_next[:, 1]), m.absolute(s_next[:, 0]) > 0.4

    ranges = {"e": (-0.5, 0.5), "kappa": (-0.1, 0.1), "v": (2.0, 10.0)}
    env = TrackSteering(cost=cost, description=ranges, backend=backend, failure=7.0)
    assert env.observation_space.shape == (3,)
    env.reset(seed=3)
    for _ in range(100):
        seen, reward, terminated, truncated, info = env.step(4)
        kappa = 0.1 * seen[1]
        assert seen[[0, 2]] == pytest.approx([info["e"] / 0.5, (info["v"] - 6.0) / 4.0], abs=1e-6)
        if terminated:
            break
        expected = info["e"] ** 2 + 0.1 * IDOE_ACTIONS[4] ** 2 + 0.01 * abs(kappa)
        assert reward == pytest.approx(-expected, abs=1e-8)
    assert (terminated, truncated, reward) == (True, False, -7.0)
    assert 0.4 < abs(info["e"]) < 0.6


def test_options_choose_the_start() -> None:
    env = gymnasium.make(ID)
    observation, info = env.reset(seed=0, options={"s": 100.0, "e": -0.2, "psi_e": 0.0})
    assert (info["s"], info["e"]) == (pytest.approx(100.0, abs=1e-6), pytest.approx(-0.2, abs=1e-6))
    assert observation[0] == pytest.approx(-0.2, abs=1e-6)
    assert observation[1] == pytest.approx(0.0, abs=1e-3)  # e stays as it is at first


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            {"action": "continuous"},
            r"option 'action' is not known .did you mean 'actions'\?.; valid: course, vehicle, conditions, scenario",
        ),
        ({"actions": "steps"}, "valid: i-doe, bang-bang, continuous, angles"),
        ({"scenario": {"corse": "paper"}}, "a scenario has no field 'corse'; valid: name, reference"),
        ({"scenario": object()}, "expected a Scenario, a dictionary of its fields, or its TOML file"),
        ({"scenario": Scenario(), "course": "genesis"}, "belong to the scenario"),
        ({"backend": "fortran"}, "valid: python, c"),
    ],
)
def test_mistakes_in_options_are_named_with_the_valid_ones(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        TrackSteering(**options)


@pytest.mark.parametrize(
    ("options", "largest"), [({}, radians_of(25.0)), ({"doe": "plain"}, radians_of(520.0)), ({"largest": 0.3}, 0.3)]
)
def test_a_continuous_action_means_its_share_of_the_largest_angle(options: dict[str, Any], largest: float) -> None:
    task = Task(actions="continuous", **options)
    for share in (-1.0, -0.5, 0.0, 0.25, 1.0):
        assert task.angle(np.array([share]), (1,)) == pytest.approx([share * largest])
    np.testing.assert_allclose(task.angle(np.array([[0.5], [-1.0]]), (2, 1)), [0.5 * largest, -largest])


def test_safe_is_a_filter_behind_the_output_element() -> None:
    loop = Task(safe=True).loop
    assert loop.inputs_of("safety")["command"] == "doe.delta_sw"
    assert loop.inputs_of("doe")["applied"] == "safety.delta_sw"
    assert "safety" not in Task().loop.names
    assert Task(safe={"delay_doubt": 0.1}).loop.blocks["safety"].delay_doubt == 0.1  # type: ignore[attr-defined]


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
