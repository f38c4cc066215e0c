"""N cars of a task driven sample by sample: what the single and the vector environment share."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.diagram.loop import LoopState
from steerkit.gym.starts import Draw
from steerkit.gym.task import Array, Task

Backend = Literal["python", "c"]


class _Cars(Protocol):
    """The loop states of N cars, wherever they are kept."""

    def put(self, cars: NDArray[np.intp], start: LoopState) -> None: ...

    def advance(self, actions: Array) -> None: ...

    def look(self) -> Array: ...


class Outcome(NamedTuple):
    """What a step brought, (N,) each."""

    reward: Array
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]


class Drives:
    """N cars, each with its own start, noise and clock; `s` (N, columns) is what their agents see now (SI).

    backend: "python" runs the loop's own Python, on floats for one car, on arrays for more; "c" compiles it.
    """

    def __init__(self, task: Task, cars: int, backend: Backend):
        require(backend in ("python", "c"), "TrackSteering", f"backend {backend!r}; valid: python, c")
        task.require_period()
        self.task, self.n = task, cars
        self._names = [name.split(".")[1] for name in task.info]
        signals = [*task.columns, *task.info]
        self._cars: _Cars = _Compiled(task, cars, signals) if backend == "c" else _Interpreted(task, cars, signals)
        self._signals = signals
        self._values = np.full((len(signals), cars), np.nan)
        self.steps = np.zeros(cars, dtype=int)
        self._cost = np.zeros(cars)

    @property
    def s(self) -> Array:
        """The states that the agents see, (N, columns)."""
        return self._values[: len(self.task.columns)].T

    def start(self, cars: NDArray[np.intp], draws: Sequence[Draw]) -> None:
        """Put the cars of these numbers where they were drawn."""
        start = self.task.starts.states(draws)
        self._cars.put(cars, start)
        first = self.task.loop.sample(start)
        for row, name in enumerate(self._signals):
            self._values[row, cars] = first[name]
        self.steps[cars], self._cost[cars] = 0, 0.0

    def step(self, actions: Array) -> Outcome:
        """Drive all cars one sample with these actions [rad].

        Raises FloatingPointError when a signal is no finite number any more.
        """
        before = self.s.copy()
        self._cars.advance(actions)
        self._values = self._cars.look()
        if not np.isfinite(self._values).all():
            row, car = np.argwhere(~np.isfinite(self._values))[0]
            raise FloatingPointError(
                f"TrackSteering: {self._signals[row]} of car {car} is {self._values[row, car]} after "
                f"{self.steps[car] + 1} steps; a block of the scenario, or an action, is out of its range"
            )
        self.steps += 1
        self._cost, terminated = self.task.price(before, actions, self.s)
        truncated = (self.steps >= self.task.longest) | (self.info("path.s") >= self.task.end)
        reward = np.where(terminated, -self.task.failure, -self._cost)
        return Outcome(reward, terminated, truncated & ~terminated)

    def info(self, name: str) -> Array:
        """A true signal (N,)."""
        return self._values[len(self.task.columns) + self.task.info.index(name)]

    def infos(self) -> dict[str, Array]:
        """What an agent need not know but people want to, (N,) each: SI."""
        rows = self._values[len(self.task.columns) :].copy()
        return dict(zip(self._names, rows)) | {"t": self.steps * self.task.dt, "cost": self._cost.copy()}


class _Interpreted:
    """The loop's own Python; a car has a clock of its own as long as it starts together with the others."""

    def __init__(self, task: Task, cars: int, signals: Sequence[str]):
        self.loop, self.n = task.loop, cars
        self._at = [self.loop.locate(name) for name in signals]
        self._agent = self.loop.names.index("controller")
        self._k = np.zeros(cars)
        self._x: list[Any] = []
        self._y: list[Any] = []

    def put(self, cars: NDArray[np.intp], start: LoopState) -> None:
        self._k[cars] = 0.0
        if self.n == 1:
            self._x, self._y = [_first(x) for x in start.x], [_first(y) for y in start.y]
            return
        if not self._x:  # the first time all cars start
            self._x, self._y = [_wide(x, self.n) for x in start.x], [_wide(y, self.n) for y in start.y]
            return
        for mine, new in ((self._x, start.x), (self._y, start.y)):
            for b, (old, values) in enumerate(zip(mine, new)):
                mine[b] = _with(old, values, cars, self.n)

    def advance(self, actions: Array) -> None:
        self._x[self._agent] = (float(actions[0]) if self.n == 1 else actions,)
        for phase in range(self.loop.period):
            self.loop.run_phase(phase, self._t(phase), self._x, self._y)
        self._k += self.loop.period

    def look(self) -> Array:
        x, y = list(self._x), list(self._y)
        self.loop.run_phase(0, self._t(0), x, y)
        return np.array([np.broadcast_to(y[i][j], self.n) for i, j in self._at], dtype=float)

    def _t(self, phase: int) -> Any:
        k = self._k + phase
        return float(k[0]) * self.loop.dt if self.n == 1 else k * self.loop.dt


class _Compiled:
    """The loop in C."""

    def __init__(self, task: Task, cars: int, signals: Sequence[str]):
        from steerkit.compiled.fleet import Fleet  # loads casadi

        self._fleet = Fleet(task.loop, cars)
        self._rows = [self._fleet.signal_slot(name) for name in signals]
        self._action = self._fleet.state_slot("controller")

    def put(self, cars: NDArray[np.intp], start: LoopState) -> None:
        self._fleet.put(cars, start.x, start.y)

    def advance(self, actions: Array) -> None:
        self._fleet.set(self._action, actions)
        self._fleet.advance()

    def look(self) -> Array:
        return self._fleet.look()[self._rows]


def _like(state: Any, values: list[Any]) -> Any:
    return type(state)(*values) if hasattr(state, "_fields") else tuple(values)


def _first(state: Any) -> Any:
    """The state or outputs of one car, in floats."""
    return _like(state, [_first(v) if isinstance(v, tuple) else float(np.ravel(v)[0]) for v in state])


def _wide(state: Any, n: int) -> Any:
    """The same with an (N,) array for every number."""
    return _like(
        state, [_wide(v, n) if isinstance(v, tuple) else np.array(np.broadcast_to(v, n), float) for v in state]
    )


def _with(state: Any, values: Any, cars: NDArray[np.intp], n: int) -> Any:
    """`state` with `values` for some cars."""
    new = []
    for old, value in zip(state, values):
        if isinstance(old, tuple):
            new.append(_with(old, value, cars, n))
        else:
            new.append(np.array(np.broadcast_to(old, n), dtype=float))
            new[-1][cars] = value
    return _like(state, new)
