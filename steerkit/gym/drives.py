"""N cars of a task in Python, episode after episode: on floats for one car, on arrays for more."""

from collections.abc import Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from steerkit._support import native
from steerkit._support.errors import require
from steerkit.compiled.trace import TraceError
from steerkit.diagram.loop import LoopState
from steerkit.diagram.maths import Array
from steerkit.gym.episodes import Episodes
from steerkit.gym.task import Draw, Task, each, require_finite

Backend = Literal["python", "c"]


def cars_of(
    task: Task, cars: int, backend: Backend, mode: AutoresetMode, threads: int | None = None
) -> "Drives | Episodes":
    """The cars of a task, in Python or in C; with a warning in Python where a part of it cannot be compiled."""
    require(backend in ("python", "c"), "TrackSteering", f"backend {backend!r}; valid: python, c")
    if backend == "python":
        return Drives(task, cars, mode)
    try:
        return Episodes(task, cars, mode, threads)
    except native.NoCompilerError as error:
        raise native.NoCompilerError(f"{error}; or go without: backend='python'") from error
    except TraceError as error:
        cure = "to compile it, use steerkit.diagram.maths in place of numpy"
        gymnasium.logger.warn(f"TrackSteering: {error}; all is computed in Python; {cure}")
        return Drives(task, cars, mode)


class Drives:
    """N cars, each with its own start, noise and clock; `Episodes` is the same in C, and documents the fields."""

    def __init__(self, task: Task, cars: int, mode: AutoresetMode):
        self.task, self.n, self._mode, self._loop = task, cars, mode, task.loop
        self._signals = [*task.columns, *task.info]
        self._at = [self._loop.locate(name) for name in self._signals]
        self._agent = self._loop.names.index("controller")
        self._k = np.zeros(cars)
        self._x: list[Any] = []
        self._y: list[Any] = []
        self._values = np.full((len(self._signals), cars), np.nan)
        self._steps, self._cost = np.zeros(cars, dtype=int), np.zeros(cars)
        self._generators: Sequence[np.random.Generator] = ()
        self._last: tuple[NDArray[np.float32], dict[str, Array]] | None = None
        self.reward, self.over = np.zeros(cars), np.ones(cars, dtype=bool)
        self.terminated, self.truncated = np.zeros(cars, dtype=bool), np.zeros(cars, dtype=bool)

    @property
    def observation(self) -> NDArray[np.float32]:
        """What the agents see, (N, columns)."""
        return self.task.observation(self._s)

    @property
    def _s(self) -> Array:
        return self._values[: len(self.task.columns)].T

    def draw_from(self, generators: Sequence[np.random.Generator]) -> None:
        """Draw the starts of car i from generator i."""
        self._generators = generators

    def start(self, cars: NDArray[np.intp], draws: Sequence[Draw]) -> None:
        """Put the cars of these numbers where they were drawn."""
        start = self.task.starts.states(draws)
        self._put(cars, start)
        first = self._loop.sample(start)
        for row, name in enumerate(self._signals):
            self._values[row, cars] = first[name]
        self._steps[cars], self._cost[cars], self.over[cars] = 0, 0.0, False

    def step(self, actions: Array) -> None:
        """Drive all cars one sample with these actions [rad], and go on with the next episode where one has ended.

        Raises FloatingPointError when a signal is no finite number any more, ResetNeeded before the first start.
        """
        if not self._x:
            raise gymnasium.error.ResetNeeded("step: no episode has begun; call reset()")
        before = self._s.copy()
        self._x[self._agent] = (float(actions[0]) if self.n == 1 else actions,)
        for phase in range(self._loop.period):
            self._loop.run_phase(phase, self._t(phase), self._x, self._y)
        self._k += self._loop.period
        self._values = self._look()
        self._steps += 1
        self._cost, failed = self.task.price(before, actions, self._s)
        require_finite(self._signals, np.vstack([self._values, self._cost]), self._steps)
        late = (self._steps >= self.task.longest) | (self._info("path.s") >= self.task.end)
        self.reward = np.where(failed, -self.task.failure, -self._cost)
        self.terminated, self.truncated = failed, late & ~failed
        anew = self.over
        if self._mode is AutoresetMode.NEXT_STEP and anew.any():  # they were driven on for nothing
            self.reward[anew], self.terminated[anew], self.truncated[anew] = 0.0, False, False
        self.over = self.terminated | self.truncated
        if self._mode is AutoresetMode.SAME_STEP:
            anew = self.over.copy()
            self._last = self.observation, self.infos()
        if self._mode is not AutoresetMode.DISABLED and anew.any():
            cars = np.flatnonzero(anew)
            self.start(cars, [self.task.starts.draw(self._generators[car]) for car in cars.tolist()])

    def infos(self) -> dict[str, Array]:
        """What an agent need not know but people want to, (N,) each: SI; copies."""
        rows = self._values[len(self.task.columns) :].copy()
        named = dict(zip([name.split(".")[1] for name in self.task.info], rows))
        return named | {"t": self._steps * self.task.dt, "cost": self._cost.copy()}

    def last(self) -> tuple[NDArray[np.float32], dict[str, Array]]:
        """Observations and infos at the end of the episodes that ended in the last step."""
        assert self._last is not None
        return self._last

    def _info(self, name: str) -> Array:
        return self._values[len(self.task.columns) + self.task.info.index(name)]

    def _put(self, cars: NDArray[np.intp], start: LoopState) -> None:
        self._k[cars] = 0.0

        def number(value: Any) -> Any:
            return float(np.ravel(value)[0]) if self.n == 1 else np.array(np.broadcast_to(value, self.n), float)

        def exchanged(old: Any, value: Any) -> Any:
            new = number(old)
            new[cars] = value
            return new

        if self.n == 1 or not self._x:  # the first time all cars start
            self._x, self._y = ([each(number, part) for part in parts] for parts in (start.x, start.y))
        else:
            self._x = [each(exchanged, *states) for states in zip(self._x, start.x)]
            self._y = [each(exchanged, *outputs) for outputs in zip(self._y, start.y)]

    def _look(self) -> Array:
        x, y = list(self._x), list(self._y)
        self._loop.run_phase(0, self._t(0), x, y)
        return np.array([np.broadcast_to(y[i][j], self.n) for i, j in self._at], dtype=float)

    def _t(self, phase: int) -> Any:
        k = self._k + phase
        return float(k[0]) * self._loop.dt if self.n == 1 else k * self._loop.dt
