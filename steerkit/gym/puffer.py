"""N cars as PufferLib's native environments are: buffers, written in place."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.gym.episodes import Episodes
from steerkit.gym.task import Task

Array = NDArray[Any]


class PufferSteering:
    """N cars in C, with the face of a `pufferlib.PufferEnv`: for trainers that take its buffers.

    An episode that ends begins anew in the same step, and its last observation is not seen; `rewards` are float32.
    Options as for `TrackSteering`. PufferLib itself is not needed: it asks for these attributes and methods, no base.

    num_envs: cars. buf: an object with the arrays `observations`, `rewards`, `terminals`, `truncations`, `masks` and
    `actions` of all N to write into; by default they are made. seed: of car 0; car i has seed + i. log_interval: after
    how many steps `infos` holds means of the episodes that ended: `episode_return`, `episode_length` [steps],
    `failures` [1]. Raises as `Episodes` does.
    """

    emulated = False

    def __init__(
        self,
        num_envs: int = 1,
        *,
        buf: Any = None,
        seed: int = 0,
        threads: int | None = None,
        log_interval: int = 128,
        **options: Any,
    ):
        require(num_envs >= 1, "PufferSteering", f"num_envs = {num_envs}, expected a number of cars >= 1")
        self.task, self.num_agents, self.agents_per_batch = Task.of(options), num_envs, num_envs
        self.single_observation_space, self.single_action_space = self.task.observation_space, self.task.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observations: Array = _of(buf, "observations", (num_envs, len(self.task.columns)), np.float32)
        self.rewards: Array = _of(buf, "rewards", (num_envs,), np.float32)
        self.terminals: Array = _of(buf, "terminals", (num_envs,), np.bool_)
        self.truncations: Array = _of(buf, "truncations", (num_envs,), np.bool_)
        self.masks: Array = _of(buf, "masks", (num_envs,), np.bool_)
        self.actions: Array = _of(buf, "actions", self.action_space.shape or (num_envs,), self.action_space.dtype)
        self.masks[:] = True
        self._cars = Episodes(self.task, num_envs, AutoresetMode.SAME_STEP, threads, self.observations)
        self._seed, self._every, self._steps = seed, log_interval, 0
        self._sums = np.zeros((2, num_envs))
        self._ended: list[Array] = []
        self._infos: list[dict[str, float]] = []

    @property
    def driver_env(self) -> PufferSteering:
        """Itself: it is no wrapper."""
        return self

    @property
    def done(self) -> bool:
        """Never: episodes follow each other."""
        return False

    def reset(self, seed: int | None = None) -> tuple[Array, list[dict[str, float]]]:
        """Start all cars; a seed stands for the one given at first."""
        self._seed = self._seed if seed is None else seed
        generators = [seeding.np_random(self._seed + i)[0] for i in range(self.num_agents)]
        self._cars.draw_from(generators)
        self._cars.start(np.arange(self.num_agents), [self.task.starts.draw(generator) for generator in generators])
        self.rewards[:], self.terminals[:], self.truncations[:] = 0.0, False, False
        self._sums[:], self._steps, self._ended, self._infos = 0.0, 0, [], []
        return self.observations, []

    def step(self, actions: Array) -> tuple[Array, Array, Array, Array, list[dict[str, float]]]:
        """Drive all cars one sample: (observations, rewards, terminals, truncations, infos), the buffers themselves."""
        cars = self._cars
        cars.step(self.task.angle(actions, self.action_space.shape or ()))
        self.rewards[:] = cars.reward
        self.terminals[:], self.truncations[:] = cars.terminated, cars.truncated
        self._sums += (cars.reward, np.ones(self.num_agents))
        over = cars.terminated | cars.truncated
        if over.any():
            self._ended.append(np.vstack((self._sums[:, over], cars.terminated[over])))
            self._sums[:, over] = 0.0
        self._steps += 1
        self._infos = []
        if self._steps % self._every == 0 and self._ended:
            means = np.concatenate(self._ended, axis=1).mean(axis=1)
            names = "episode_return", "episode_length", "failures"
            self._infos, self._ended = [dict(zip(names, means.tolist()))], []
        return self.observations, self.rewards, self.terminals, self.truncations, self._infos

    def async_reset(self, seed: int | None = None) -> None:
        """`reset`, to be followed by `recv`."""
        self.reset(seed)

    def send(self, actions: Array) -> None:
        """`step`, to be followed by `recv`."""
        self.step(actions)

    def recv(self) -> tuple[Any, ...]:
        """What the last `async_reset` or `send` brought, with the numbers of the cars and their masks."""
        told = self.observations, self.rewards, self.terminals, self.truncations, self._infos
        return *told, np.arange(self.num_agents), self.masks

    def close(self) -> None:
        """Nothing is to be closed."""


def _of(buf: Any, name: str, shape: tuple[int, ...], dtype: Any) -> Array:
    """The buffer of that name, or a new one."""
    if buf is None:
        return np.zeros(shape, dtype)
    given = np.asarray(getattr(buf, name))
    require(given.shape == shape, "PufferSteering", f"buf.{name} of shape {given.shape}, expected {shape}")
    return given
