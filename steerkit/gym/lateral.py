"""Following a target of lateral acceleration as a Gymnasium environment."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.controllers.lateral import DT, STEER, LateralMpc
from steerkit.diagram.block import set_ports
from steerkit.gym.task import Agent
from steerkit.metrics import lateral_cost
from steerkit.scenario import Scenario
from steerkit.scenario.lateral import LateralTarget, lateral_loop

_SEEN = 15


class LateralAcceleration(gymnasium.Env[NDArray[np.float32], Any]):
    """Follow a target of lateral acceleration, at a given speed and roll, 10 times a second.

    observation, float32: a_y_target - a_y, a_y, a_roll, v/20 - 1, the next 15 of preview - preview_roll, the last 8
    commands. action: a_y_cmd/2 in [-1, 1]. reward: minus what the sample adds to `total_cost` of `lateral_cost`, over
    100. terminated: never; truncated: at the target's end. `info`: a_y, a_y_target [m/s^2], at the end the costs too.

    scenario: as `lateral_loop` takes it, or a dictionary of its fields. target: as `LateralTarget.read` takes it; None:
    one drawn for each episode. Raises ValueError for others, and for an action outside [-1, 1].
    """

    NO_COMMANDS = (0.0,) * 8
    observation_space = spaces.Box(-10.0, 10.0, (4 + _SEEN + len(NO_COMMANDS),), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, *, scenario: Any = None, target: str | None = None, seconds: float = 60.0):
        self.scenario = scenario if isinstance(scenario, Scenario) else Scenario.under(**(scenario or {}))
        self._fixed = None if target is None else LateralTarget.read(target, self.scenario)
        self._seconds, self._past = seconds, self.NO_COMMANDS

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        draw = int(self.np_random.integers(2**31))
        self._target = self._fixed or LateralTarget.drawn(draw, seconds=self._seconds)
        self._past, self._driven = self.NO_COMMANDS, list[Any]()
        agent = Agent(dt=self._target.dt)
        set_ports(agent, (), LateralMpc.outputs)
        self._loop = lateral_loop(self.scenario, self._target, agent, seed=draw)
        self._state = self._loop.init()
        return self._look()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive one sample."""
        ok = np.size(action) == 1 and np.isfinite(action).all() and np.abs(action).max() <= 1.0 + 1e-6
        require(ok, "LateralAcceleration.step", f"action {action!r:.60}, expected one number within [-1, 1]")
        require(len(self._driven) < len(self._target.table), "LateralAcceleration.step", "the target is over; reset()")
        self._past = (*self._past[1:], STEER * float(np.reshape(action, -1)[0]))
        self._state = self._loop.with_block_state(self._state, "controller", (self._past[-1],))
        for _ in range(self._loop.period):
            self._state, _ = self._loop.step(self._state)
        seen, info = self._look()
        over = len(self._driven) >= len(self._target.table)
        cost = self._cost(self._driven[-2:])["total_cost"] / 100.0
        return seen, -cost, False, over, info | (self._cost(self._driven) if over else {})

    def _cost(self, driven: list[tuple[float, float]]) -> dict[str, float]:
        return lateral_cost(DT * np.arange(len(driven)), *np.array(driven).T)

    def _look(self) -> tuple[NDArray[np.float32], dict[str, Any]]:
        x, y = list(self._state.x), list(self._state.y)
        self._loop.run_phase(0, self._state.k * self._loop.dt, x, y)
        now = self._target.Y(*y[self._loop.names.index("target")])
        self._driven.append((now.a_y, now.a_y_target))
        told = (now.a_y_target, now.a_y, now.a_roll, now.v, now.preview, now.preview_roll, self._past)
        return self.seen(*told), {"a_y": float(now.a_y), "a_y_target": float(now.a_y_target)}

    @staticmethod
    def seen(
        target: float, a_y: float, roll: float, v: float, preview: Any, preview_roll: Any, past: Sequence[float]
    ) -> NDArray[np.float32]:
        """The observation, for whoever drives with a trained policy elsewhere; past: the last 8 commands [m/s^2]."""
        ahead = np.subtract(preview, preview_roll)[:_SEEN]
        values = (target - a_y, a_y, roll, v / 20.0 - 1.0, *ahead, *past)
        return np.clip(values, -10.0, 10.0).astype(np.float32)
