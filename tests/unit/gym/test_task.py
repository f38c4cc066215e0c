"""What is steered, with which actions: options, rewards, ends."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from steerkit._support import native
from steerkit.controllers.nfq_policy import IDOE_ACTIONS
from steerkit.controllers.policy import StateDescription
from steerkit.diagram import maths as m
from steerkit.diagram.units import radians_of
from steerkit.gym import Task, TrackSteering
from steerkit.learning.costs import IdoeCost
from steerkit.scenario import Scenario

ID = "steerkit/TrackSteering-v0"
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")
HOLD = IDOE_ACTIONS.index(0.0)


def test_the_reward_is_minus_the_cost_and_failure_ends_the_episode() -> None:
    cost = IdoeCost(trip=0.3)
    env = gymnasium.make(ID, cost=cost, failure=7.0, course="straight", start_e=0.0, start_psi_e=0.0)
    observation, _ = env.reset(seed=0)
    description = StateDescription()
    for _ in range(100):
        before = observation * description.half + description.mid
        observation, reward, terminated, truncated, info = env.step(4)  # 60 degrees to the left, each time
        after = observation * description.half + description.mid
        expected, failed = cost(before[None], np.array([IDOE_ACTIONS[4]]), after[None])
        assert terminated == failed[0] == (info["e"] > 0.3)
        assert reward == (-7.0 if terminated else -expected[0])
        if terminated:
            break
    assert terminated
    assert not truncated
    assert 0.3 < info["e"] < 0.8
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        env.unwrapped.step(HOLD)


@pytest.mark.parametrize("backend", ["python", pytest.param("c", marks=needs_compiler)])
def test_a_cost_and_an_observation_of_ones_own(backend: Any) -> None:
    """The reward is minus that cost, of states in SI; the agent sees these columns, scaled by their ranges."""

    def cost(s: Any, a: Any, s_next: Any) -> Any:
        return s_next[:, 0] ** 2 + 0.1 * a**2 + 0.01 * m.absolute(s_next[:, 1]), m.absolute(s_next[:, 0]) > 0.4

    ranges = {"e": (-0.5, 0.5), "kappa": (-0.1, 0.1), "v": (2.0, 10.0)}
    env = TrackSteering(cost=cost, description=ranges, backend=backend)
    assert env.observation_space.shape == (3,)
    env.reset(seed=3)
    for _ in range(100):
        seen, reward, terminated, _, info = env.step(4)
        kappa = 0.1 * seen[1]
        assert seen[[0, 2]] == pytest.approx([info["e"] / 0.5, (info["v"] - 6.0) / 4.0], abs=1e-6)
        if terminated:
            break
        expected = info["e"] ** 2 + 0.1 * IDOE_ACTIONS[4] ** 2 + 0.01 * abs(kappa)
        assert reward == pytest.approx(-expected, abs=1e-8)
    assert terminated
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
