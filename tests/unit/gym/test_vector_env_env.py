"""One car as an environment: its steps are those of the same loop simulated."""

from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import pytest

from steerkit._support import native
from steerkit.controllers.nfq_policy import IDOE_ACTIONS
from steerkit.diagram.block import Block
from steerkit.diagram.simulation import simulate
from steerkit.gym import TrackSteering
from steerkit.gym.task import Agent
from tests.support.steady_world import SteadyWorld

ID = "steerkit/TrackSteering-v0"
HOLD = IDOE_ACTIONS.index(0.0)


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


def test_seeds_repeat_exactly_and_differ_from_each_other() -> None:
    def episode(seed: int, backend: str = "python") -> list[Any]:
        env = gymnasium.make(ID, conditions="hard", backend=backend)
        rows = [env.reset(seed=seed)[0].tolist()]
        return rows + [env.step(k % 5)[0].tolist() for k in range(20)]

    assert episode(3) == episode(3)
    assert episode(3) != episode(4)
    if native.compiler():
        np.testing.assert_allclose(episode(3, "c"), episode(3), atol=1e-6)


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
