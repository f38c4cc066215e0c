"""PufferLib's buffers over a batch of cars in C: the face of a `pufferlib.PufferEnv`, which PufferLib's trainers take.

    python examples/pufferlib_buffers.py

PufferLib itself is not needed for this: it asks for these attributes and methods, and for no base class. An episode
that ends begins anew in the same step, and its last observation is not seen.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from steerkit.gym.episodes import Episodes
from steerkit.gym.task import Task


class PufferSteering:
    """N cars of a task, car i drawn with seed + i.

    buf: an object with the arrays `observations`, `rewards` (float32), `terminals`, `truncations`, `masks` and
    `actions` of all N to write into; by default they are made.
    """

    emulated = False
    done = False
    observations: Any
    rewards: Any
    terminals: Any
    truncations: Any
    masks: Any
    actions: Any

    def __init__(self, num_envs: int = 1, *, buf: Any = None, seed: int = 0, log_interval: int = 128, **options: Any):
        self.task, self.num_agents, self.agents_per_batch = Task.of(options), num_envs, num_envs
        self.single_observation_space, self.single_action_space = self.task.observation_space, self.task.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        n, columns = num_envs, len(self.task.columns)
        kinds: dict[str, Any] = {"rewards": np.float32, "terminals": bool, "truncations": bool, "masks": bool}
        made = {name: np.zeros(n, kind) for name, kind in kinds.items()}
        made |= {"observations": np.zeros((n, columns), np.float32)}
        made |= {"actions": np.zeros(self.action_space.shape or (n,), self.action_space.dtype)}
        for name, array in made.items():
            setattr(self, name, array if buf is None else getattr(buf, name))
        self.masks[:] = True
        self.driver_env = self
        self._cars = Episodes(self.task, n, AutoresetMode.SAME_STEP, observation=self.observations)
        self._seed, self._every, self._steps = seed, log_interval, 0
        self._returns, self._ended, self._infos = np.zeros(n), list[float](), list[dict[str, float]]()

    def reset(self, seed: int | None = None) -> tuple[Any, list[dict[str, float]]]:
        """Start all cars; a seed stands for the one given at first."""
        self._seed = self._seed if seed is None else seed
        generators = [seeding.np_random(self._seed + i)[0] for i in range(self.num_agents)]
        self._cars.draw_from(generators)
        self._cars.start(np.arange(self.num_agents), [self.task.draw(generator) for generator in generators])
        self.rewards[:], self.terminals[:], self.truncations[:], self._returns[:] = 0.0, False, False, 0.0
        return self.observations, []

    def step(self, actions: Any) -> tuple[Any, ...]:
        """Drive all cars one sample: the buffers, and every `log_interval` steps the mean return of ended episodes."""
        cars = self._cars
        cars.step(self.task.angle(actions, self.action_space.shape or ()))
        self.rewards[:], self.terminals[:], self.truncations[:] = cars.reward, cars.terminated, cars.truncated
        self._returns += cars.reward
        over = cars.terminated | cars.truncated
        self._ended += self._returns[over].tolist()
        self._returns[over] = 0.0
        self._steps += 1
        self._infos = []
        if self._steps % self._every == 0 and self._ended:
            self._infos, self._ended = [{"episode_return": float(np.mean(self._ended))}], []
        return self.observations, self.rewards, self.terminals, self.truncations, self._infos

    def async_reset(self, seed: int | None = None) -> None:
        """`reset`, to be followed by `recv`."""
        self.reset(seed)

    def send(self, actions: Any) -> None:
        """`step`, to be followed by `recv`."""
        self.step(actions)

    def recv(self) -> tuple[Any, ...]:
        """What the last `async_reset` or `send` brought, with the numbers of the cars and their masks."""
        brought = self.observations, self.rewards, self.terminals, self.truncations, self._infos
        return *brought, np.arange(self.num_agents), self.masks

    def close(self) -> None:
        """Nothing is to be closed."""


if __name__ == "__main__":
    env = PufferSteering(256)
    env.async_reset()
    rng, began = np.random.default_rng(0), time.perf_counter()
    for _ in range(256):
        env.recv()
        env.send(rng.integers(0, 5, env.num_agents))
        for info in env.recv()[4]:
            print(f"mean return of the episodes that ended: {info['episode_return']:.2f}")
    print(f"{256 * env.num_agents / (time.perf_counter() - began):,.0f} steps a second")
