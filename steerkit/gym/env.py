"""One car as a Gymnasium environment."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from steerkit._support.errors import known
from steerkit.gym.drives import Backend, cars_of
from steerkit.gym.frames import Painter
from steerkit.gym.task import Task

_CAR = np.array([0])


class TrackSteering(gymnasium.Env[NDArray[np.float32], Any]):
    """Steer one car along a course; `gymnasium.make("steerkit/TrackSteering-v0", course="genesis", ...)`.

    Observation, action, reward, ends and options: see `steerkit.gym.task.Task`. `reset(options={"s": ..., "e": ...,
    "psi_e": ...})` chooses a start. `info` holds the truth: e, s, progress, x, y [m], psi [rad], v [m/s], a_y
    [m/s^2], delta_sw [rad], t [s] and the cost. The same seed and actions give the same numbers, bit for bit.

    render_mode: None or `rgb_array`. backend: `python`, or `c`, faster but for some seconds the first time.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, *, render_mode: str | None = None, backend: Backend = "python", **options: Any):
        if render_mode is not None:
            known(render_mode, self.metadata["render_modes"], "TrackSteering: render_mode")
        self.task = Task.of(options)
        self.render_mode = render_mode
        self.action_space = self.task.action_space
        self.observation_space = self.task.observation_space  # type: ignore[assignment]
        self._cars = cars_of(self.task, 1, backend, AutoresetMode.DISABLED)
        self._painter = Painter(self.task) if render_mode else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode; options s [m], e [m], psi_e [rad] say where."""
        super().reset(seed=seed)
        self._cars.draw_from([self.np_random])
        self._cars.start(_CAR, [self.task.starts.draw(self.np_random, options)])
        return self._cars.observation[0].copy(), self._info()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive one sample; raises ResetNeeded after the end of an episode."""
        if self._cars.over[0]:
            raise gymnasium.error.ResetNeeded(
                "TrackSteering.step: the episode is over, or none has begun; call reset()"
            )
        cars = self._cars
        cars.step(self.task.angle(action, ()))
        judged = float(cars.reward[0]), bool(cars.terminated[0]), bool(cars.truncated[0])
        return self._cars.observation[0].copy(), *judged, self._info()

    def render(self) -> Any:
        """The frame of this moment, (height, width, 3) uint8; None without a render_mode."""
        if self._painter is None:
            gymnasium.logger.warn("TrackSteering.render: made without render_mode; make(..., render_mode='rgb_array')")
            return None
        return self._painter.frame()

    def _info(self) -> dict[str, Any]:
        info = {name: float(values[0]) for name, values in self._cars.infos().items()}
        if self._painter:
            self._painter.add(info)
        return info
