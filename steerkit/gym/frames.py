"""Frames of a drive: the car on its path, and the cross-track error of the last seconds."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit.gym.task import Task
from steerkit.plots.animation import Moments, Scene
from steerkit.plots.style import style

_SECONDS = 10.0
_WINDOW = 14.0  # m


class Painter:
    """Paints one car of a task; keeps its last ten seconds."""

    def __init__(self, task: Task):
        self._task = task
        self._seen: deque[Mapping[str, Any]] = deque(maxlen=round(_SECONDS / task.dt))
        self._scene: Scene | None = None

    def add(self, info: Mapping[str, Any]) -> None:
        """One sample: what an environment's `info` holds; with t = 0 an episode begins."""
        if info["t"] == 0.0:
            self._seen.clear()
        self._seen.append(info)

    def frame(self) -> NDArray[np.uint8]:
        """The picture of the last sample, (height, width, 3)."""
        names = [name for name in ("x", "y", "psi", "v", "delta_sw", "e") if name in self._seen[-1]]
        t, *columns = np.array([[info[name] for name in ("t", *names)] for info in self._seen], dtype=float).T
        run = Moments(t, dict(zip(names, columns)))
        with style():
            scene = self._scene = self._scene or self._new()
            scene.run = run
            scene.show(t[-1], 1.0)
            scene.strip.set_xlim(t[-1] - _SECONDS, t[-1])
            return scene.pixels()

    def _new(self) -> Scene:
        car = getattr(self._task.loop.blocks["car"], "vehicle", None)
        numbers = (("wheelbase", 2.7), ("l_f", 1.2), ("steer_ratio", 16.0))
        wheelbase, l_f, ratio = (float(np.max(getattr(car, name, usual))) for name, usual in numbers)
        before = Moments(np.array([-2.0, -1.0]) * _SECONDS, {name: np.zeros(2) for name in ("x", "y", "psi", "e")})
        scene = Scene(before, self._task.path, wheelbase, l_f, ratio, _WINDOW)
        scene.strip.set_ylim(*(np.array([-1.15, 1.15]) * self._task.limit))
        return scene
