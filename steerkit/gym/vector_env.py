"""N cars as one Gymnasium vector environment: one loop serves them all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.gym.drives import Backend, Drives
from steerkit.gym.episodes import Episodes
from steerkit.gym.frames import Painter
from steerkit.gym.task import Task

Flags = NDArray[np.bool_]


class TrackSteeringVector(VectorEnv[NDArray[np.float32], Any, NDArray[Any]]):
    """Steer N cars, each along a course of its own start, human and noise; `gymnasium.make_vec(id, num_envs=N)`.

    Car i of `reset(seed=k)` is the car of `TrackSteering.reset(seed=k + i)`, with the same numbers to rounding (the
    backends compute sines in other orders). Options as for `TrackSteering`. In `info` every value is an (N,) array,
    with a mask under `_name`.

    autoreset_mode: `NextStep` (Gymnasium's default: the step after an episode's end starts the next one, whatever the
    action, with reward 0), `SameStep` (the end's observation and info under `final_obs` and `final_info`) or
    `Disabled` (call `reset(options={"reset_mask": ...})`). backend: `c` compiles loop, cost and starts for some seconds
    the first time, `python` runs them on arrays. threads: of `c`; by default one for 256 cars, up to the number of
    cores. copy: False gives the arrays that the next step writes over, which saves their copies.

    A cost or a scenario of your own that cannot be run on symbols is computed in Python, with a warning that says so.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        backend: Backend = "c",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        copy: bool = True,
        **options: Any,
    ):
        where = "TrackSteeringVector"
        require(num_envs >= 1, where, f"num_envs = {num_envs}, expected a number of cars >= 1")
        require(render_mode in (None, "rgb_array"), where, f"render_mode {render_mode!r}; valid: rgb_array")
        valid = [mode.value for mode in AutoresetMode]
        known = isinstance(autoreset_mode, AutoresetMode) or autoreset_mode in valid
        require(known, where, f"autoreset_mode {autoreset_mode!r}; valid: {', '.join(valid)}")
        self.task, self.num_envs, self.render_mode = Task.of(options), num_envs, render_mode
        require(threads is None or threads >= 1, where, f"threads = {threads}, expected a number >= 1, or None")
        self._mode, self._copy = AutoresetMode(autoreset_mode), copy
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 20, "autoreset_mode": self._mode}
        self.single_action_space = self.task.action_space
        self.single_observation_space = self.task.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._drives = self._in_c(threads) if backend == "c" else Drives(self.task, num_envs, backend)
        self._painters = [Painter(self.task) for _ in range(num_envs)] if render_mode else []
        self._seeded: list[tuple[np.random.Generator, int]] = []
        self._over = np.ones(num_envs, dtype=bool)
        self._all = np.ones(num_envs, dtype=bool)

    @property  # type: ignore[misc]
    def np_random(self) -> Any:
        """The generators of the cars."""
        return tuple(rng for rng, _ in self._generators())

    @property
    def np_random_seed(self) -> Any:
        """The seeds they were made with."""
        return tuple(seed for _, seed in self._generators())

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start episodes in all cars, or in those of options["reset_mask"]; car i gets seed + i, or seed[i]."""
        given = dict(options or {})
        mask = given.pop("reset_mask", None)
        if mask is None:
            mask = np.ones(self.num_envs, dtype=bool)
        fits = isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (self.num_envs,) and mask.any()
        require(fits, "reset", f"reset_mask {mask!r}, expected a boolean array ({self.num_envs},), not all False")
        seeds = (
            list(seed)
            if isinstance(seed, Sequence)
            else [None if seed is None else seed + i for i in range(self.num_envs)]
        )
        require(len(seeds) == self.num_envs, "reset", f"{len(seeds)} seeds, expected {self.num_envs}, one a car")
        generators = self._generators()
        for i in np.flatnonzero(mask).tolist():
            if seeds[i] is not None:
                generators[i] = seeding.np_random(seeds[i])
        if isinstance(self._drives, Episodes):
            self._drives.draw_from([rng for rng, _ in generators])
        self._start(mask, given)
        return self._observed(), self._infos(mask)

    def step(self, actions: Any) -> tuple[NDArray[np.float32], NDArray[Any], Flags, Flags, dict[str, Any]]:
        """Drive all cars one sample, and start those anew whose episode is over."""
        stopped = self._over.copy()
        if stopped.any() and (self._mode is not AutoresetMode.NEXT_STEP or not self._seeded):
            raise gymnasium.error.ResetNeeded(f"step: the episodes of cars {np.flatnonzero(stopped)} are over; reset()")
        angles = self.task.angle(actions, self.action_space.shape or ())
        if isinstance(self._drives, Episodes):
            return self._stepped(self._drives, angles)
        reward, terminated, truncated = self._drives.step(angles)
        if stopped.any():  # they were driven on for nothing
            self._start(stopped, {})
            reward[stopped], terminated[stopped], truncated[stopped] = 0.0, False, False
        self._over = terminated | truncated
        last: dict[str, Any] = {}
        if self._mode is AutoresetMode.SAME_STEP and self._over.any():
            last = _final(self._over, self._observed(), self._drives.infos())
            self._start(self._over, {})
        return self._observed(), reward, terminated, truncated, self._shown() | last

    def _in_c(self, threads: int | None) -> Drives | Episodes:
        """All of it in C, or, where that cannot be, the loop alone."""
        from steerkit.compiled.trace import TraceError  # loads casadi

        try:
            return Episodes(self.task, self.num_envs, self._mode, threads)
        except TraceError as error:
            gymnasium.logger.warn(f"TrackSteeringVector: {error}; rewards, ends and starts are computed in Python")
            return Drives(self.task, self.num_envs, "c")

    def _stepped(self, cars: Episodes, angles: NDArray[np.float64]) -> tuple[Any, ...]:
        """One step of all that is in C."""
        cars.step(angles)
        self._over = cars.over
        ended = cars.terminated | cars.truncated
        last: dict[str, Any] = {}
        if self._mode is AutoresetMode.SAME_STEP and ended.any():
            last = _final(ended, *cars.last())
        judged = cars.reward, cars.terminated, cars.truncated
        return self._observed(), *([a.copy() for a in judged] if self._copy else judged), self._shown() | last

    def _shown(self) -> dict[str, Any]:
        """The infos of all cars, which the frames are painted from too."""
        infos = self._infos(self._all)
        for i, painter in enumerate(self._painters):
            painter.add({name: values[i] for name, values in infos.items()})
        return infos

    def render(self) -> Any:
        """A tuple of frames, one a car; None without a render_mode."""
        return tuple(painter.frame() for painter in self._painters) if self._painters else None

    def _generators(self) -> list[tuple[np.random.Generator, int]]:
        if not self._seeded:
            self._seeded = [seeding.np_random(None) for _ in range(self.num_envs)]
        return self._seeded

    def _start(self, mask: Flags, options: dict[str, Any]) -> None:
        cars, generators = np.flatnonzero(mask), self._generators()
        self._drives.start(cars, [self.task.starts.draw(generators[i][0], options) for i in cars])
        self._over = self._over & ~mask
        if self._painters:
            infos = self._infos(mask)
            for i in cars:
                self._painters[i].begin({name: values[i] for name, values in infos.items()})

    def _observed(self) -> NDArray[np.float32]:
        if isinstance(self._drives, Episodes):
            return self._drives.observation.copy() if self._copy else self._drives.observation
        return self.task.observation(self._drives.s)

    def _infos(self, mask: Flags) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        every = bool(mask.all())
        for name, values in self._drives.infos().items():
            infos[name], infos[f"_{name}"] = values if every else np.where(mask, values, 0.0), mask.copy()
        return infos


def _final(over: Flags, seen: NDArray[np.float32], told: dict[str, NDArray[np.float64]]) -> dict[str, Any]:
    """The last observations and infos of the episodes that are over, in Gymnasium's form."""
    final = np.full(len(over), None, dtype=object)
    for i in np.flatnonzero(over):
        final[i] = seen[i]
    infos: dict[str, Any] = {}
    for name, values in told.items():
        infos[name], infos[f"_{name}"] = np.where(over, values, 0.0), over.copy()
    return {"final_obs": final, "final_info": infos, "_final_obs": over.copy(), "_final_info": over.copy()}
