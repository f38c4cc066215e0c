"""Environments of one car and of many: their steps are those of the same loop simulated, and each other's."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from steerkit._support import native
from steerkit.controllers.nfq_policy import IDOE_ACTIONS
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block
from steerkit.diagram.simulation import simulate
from steerkit.gym import TrackSteering, TrackSteeringVector
from steerkit.gym.task import Agent
from steerkit.paths.path import Path
from steerkit.scenario import Scenario
from tests.support.steady_world import SteadyWorld
from tests.support.straight_road import recorded_speed

ID = "steerkit/TrackSteering-v0"
HOLD = IDOE_ACTIONS.index(0.0)
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")
backends = pytest.mark.parametrize("backend", ["python", pytest.param("c", marks=needs_compiler)])


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "options",
    [
        {"render_mode": "rgb_array"},
        {"conditions": "hard", "cost": "paper"},
        {"actions": "bang-bang", "cost": "paper", "scenario": {"vehicle": {"name": "bmw-320i", "plant": "linear"}}},
        {"actions": "continuous", "course": "genesis"},
        {"actions": "continuous", "doe": "low-pass", "start": "beginning"},
        {"actions": (-0.1, 0.1), "course": "random-3"},
    ],
    ids=str,
)
def test_the_checker_has_nothing_to_say(options: dict[str, Any]) -> None:
    env = gymnasium.make(f"steerkit.gym:{ID}", **options)
    check_env(env.unwrapped, skip_render_check="render_mode" not in options)


def test_the_steps_are_those_of_the_same_loop_simulated() -> None:
    actions = np.random.default_rng(0).integers(0, 5, 15)
    env = gymnasium.make(ID, scenario=SteadyWorld(course="circle"), start_e=0.0)
    env.reset(seed=5)
    infos = [env.step(a)[4] for a in actions]
    task = env.unwrapped.task  # type: ignore[attr-defined]

    @dataclass(frozen=True, eq=False, kw_only=True)
    class Script(Block):
        action = Agent.action
        angles: tuple[float, ...]

        def output(self, t: Any, x: Any, u: Any) -> Any:
            return self.Y(self.angles[min(round(t / self.dt), len(self.angles) - 1)])

    scenario = task.place
    loop = task.loop.with_block("controller", Script(angles=tuple(IDOE_ACTIONS[a] for a in actions)))
    start = task.starts([task.draw(np.random.default_rng(5))])
    x = [
        type(b)(*[float(v[0]) for v in b]) if hasattr(b, "_fields") else tuple(float(v[0]) for v in b) for b in start.x
    ]
    x[loop.names.index("controller")] = ()
    log = simulate(loop, 16 * 0.05, state=loop.init(x=x), every=5)
    assert scenario.ahead == pytest.approx(0.45 * 2.71)
    for name in ("e", "s", "x", "v", "a_y", "delta_sw"):
        signal = f"path.{name}" if name in ("e", "s") else f"car.{name}"
        assert [info[name] for info in infos] == log[signal][1:].tolist()


def test_the_end_of_an_open_course_truncates() -> None:
    env = gymnasium.make(ID, course="straight", start_e=0.0, start_psi_e=0.0)
    length = env.unwrapped.task.path.length  # type: ignore[attr-defined]
    env.reset(seed=0, options={"s": length - 8.0})
    for _ in range(40):
        _, _, terminated, truncated, info = env.step(HOLD)
        if truncated:
            break
    assert truncated
    assert not terminated
    assert length - 5.0 <= info["s"] < length - 4.5


def test_actions_out_of_range_are_refused() -> None:
    env = TrackSteering()
    env.reset(seed=0)
    for action in (5, -1, 1.5, np.array([1, 2])):
        with pytest.raises(ValueError, match="expected whole numbers 0 to 4"):
            env.step(action)
    env = TrackSteering(actions="continuous")
    env.reset(seed=0)
    for value in (1.5, -1.00001, float("nan")):
        with pytest.raises(ValueError, match=r"within \[-1, 1\]"):
            env.step(np.array([value]))
    with pytest.raises(ValueError, match="option 'x' is not known; valid: s, e, psi_e"):
        env.reset(options={"x": 3.0})


def worst_of(env: Any, steps: int) -> tuple[float, bool]:
    """Largest |e| of an agent that takes another angle every half second, and did an episode fail?"""
    rng = np.random.default_rng(1)
    env.reset(seed=1)
    worst, failed, action = 0.0, False, np.zeros(1)
    for k in range(steps):
        action = rng.uniform(-1.0, 1.0, 1) if k % 10 == 0 else action
        _, _, terminated, _, info = env.step(action.astype(np.float32))
        worst, failed = max(worst, abs(info["e"])), failed or terminated
        if terminated:
            break
        assert ("correction" in info, "share" in info) == (env.unwrapped.task.safe,) * 2
    return worst, failed


def test_with_a_filter_no_agent_fails() -> None:
    place: dict[str, Any] = dict(conditions="hard", actions="continuous")
    assert worst_of(gymnasium.make(ID, **place), 100)[1]
    worst, failed = worst_of(gymnasium.make(ID, safe=True, **place), 100)
    assert not failed
    assert 0.2 < worst < 0.5


def test_frames_change_with_the_car_and_a_new_episode_has_a_history_of_its_own() -> None:
    env: Any = gymnasium.make(ID, render_mode="rgb_array", course="circle")
    env.reset(seed=0)
    first = env.render()
    env.step(HOLD)
    assert (first != env.render()).any()
    env.reset(seed=1)
    env.render()
    assert len(env.unwrapped._painter._scene.lines["learned"].get_xdata()) == 1
    with pytest.warns(UserWarning, match="made without render_mode"):
        assert gymnasium.make(ID).unwrapped.render() is None


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


def rolled(env: Any, actions: np.ndarray) -> list[Any]:
    """What these actions bring, and where the cars are."""
    rows: list[Any] = [env.reset(seed=11)[0]]
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        rows += [observation.copy(), reward.copy(), terminated.copy(), truncated.copy(), info["e"], info["x"]]
    return rows


def equal(one_by_one: list[Any], together: list[Any]) -> None:
    for single, many in zip(one_by_one, together, strict=True):
        np.testing.assert_allclose(np.asarray(many, float), np.asarray(single, float), atol=1e-9)


@backends
def test_continuous_actions_turn_many_cars_as_they_turn_each(backend: str) -> None:
    """Discrete ones, and every way to go on: test_episodes.py."""
    wide = np.random.default_rng(0).uniform(-0.4, 0.4, (65, 3, 1)).astype(np.float32)
    name, options = "steerkit/TrackSteeringContinuous-v0", {"duration": 3.0}
    one_by_one = rolled(gymnasium.make_vec(name, 3, vectorization_mode="sync", **options), wide)
    equal(one_by_one, rolled(gymnasium.make_vec(name, 3, backend=backend, **options), wide))


def test_without_a_compiler_the_error_names_the_other_backend(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    for make in (lambda: gymnasium.make_vec(ID, 2), lambda: gymnasium.make(ID, backend="c")):
        with pytest.raises(native.NoCompilerError, match=r"no C compiler found .*; or go without: backend='python'"):
            make()


@backends
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
@pytest.mark.parametrize("cars", [1, 3])
def test_a_cost_that_is_no_number_any_more_is_named(cars: int, backend: Any) -> None:
    def root(s: Any, a: Any, s_next: Any) -> Any:
        return m.sqrt(0.02 - s_next[:, 0] * s_next[:, 0]), m.absolute(s_next[:, 0]) > 0.5

    env = TrackSteeringVector(cars, backend=backend, cost=root, course="straight")
    env.reset(seed=0)
    left = np.full((100, cars), 4)
    with pytest.raises(FloatingPointError, match=r"the cost of car \d is -?nan after \d+ steps"):
        [env.step(action) for action in left]


@needs_compiler
def test_a_loop_that_asks_for_the_time_is_not_compiled_for_many() -> None:
    class Recorded(Scenario):
        def blocks(self, path: Path, s: float = 0.0, seed: int = 0) -> dict[str, Block | None]:
            return super().blocks(path, s, seed) | {"driver": recorded_speed((4.0, 6.0, 5.0), spacing=1.0)}

    with pytest.raises(ValueError, match="depends on the time t"):
        TrackSteeringVector(2, scenario=Recorded())
    wide = np.random.default_rng(0).integers(0, 5, (50, 2))
    options: dict[str, Any] = {"scenario": Recorded(), "duration": 1.0}
    one_by_one = rolled(gymnasium.make_vec(ID, 2, vectorization_mode="sync", **options), wide)
    equal(one_by_one, rolled(TrackSteeringVector(2, backend="python", **options), wide))
