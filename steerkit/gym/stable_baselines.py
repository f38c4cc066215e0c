"""Policies trained with Stable-Baselines3 as controller blocks that need neither it nor torch."""

from operator import attrgetter
from typing import Any

import numpy as np

from steerkit._support.errors import known, optional, require
from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.gym.task import Task
from steerkit.gym.vector_env import TrackSteeringVector


def stable_baselines_vec(num_envs: int, **options: Any) -> Any:
    """N cars in one loop as a `VecEnv` of Stable-Baselines3; options as for `TrackSteeringVector`, without its modes.

    Its attribute `task` is the `Task`. Raises ValueError without Stable-Baselines3.
    """
    module = optional("stable_baselines3", "stable_baselines_vec", "gym").common.vec_env
    envs = TrackSteeringVector(num_envs, autoreset_mode="SameStep", **options)

    class Cars(module.VecEnv):  # type: ignore[name-defined]
        def reset(self) -> Any:
            seen, _ = envs.reset(seed=self._seeds)
            self._reset_seeds()
            return seen

        def step_async(self, actions: Any) -> None:
            self._actions = actions

        def step_wait(self) -> Any:
            seen, reward, terminated, truncated, infos = envs.step(self._actions)
            each: list[dict[str, Any]] = [{} for _ in range(num_envs)]
            for i in np.flatnonzero(terminated | truncated):
                each[i] = {"terminal_observation": infos["final_obs"][i], "TimeLimit.truncated": bool(truncated[i])}
            return seen, reward, terminated | truncated, each

        def get_attr(self, name: str, indices: Any = None) -> list[Any]:
            return [getattr(envs, name) for _ in self._get_indices(indices)]

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
            return [False for _ in self._get_indices(indices)]

        def _one_for_all(self, *_: Any, **__: Any) -> None:
            raise AttributeError("stable_baselines_vec: one loop drives all cars; options are given when it is made")

        set_attr = env_method = _one_for_all

        def close(self) -> None:
            envs.close()

    return Cars(num_envs, envs.single_observation_space, envs.single_action_space)


_NETS = {
    "DQN": ("argmax", "q_net.q_net"),
    "SAC": ("tanh", "actor.latent_pi", "actor.mu"),
    "TD3": ("tanh", "actor.mu"),
    "PPO": ("clip", "mlp_extractor.policy_net", "action_net"),
    "A2C": ("clip", "mlp_extractor.policy_net", "action_net"),
}
"""By kind of model: what becomes of a continuous policy's last layer, and where in it the layers are."""


def from_stable_baselines(model: Any, task: Task | None = None) -> PolicyBlock:
    """The greedy policy of a trained model (DQN, SAC, TD3, PPO, A2C with an MLP) as a controller block.

    task: what it was trained on; by default that of the model's environment, which a model from a file has not. It
    steers as `model.predict(observation, deterministic=True)` does, to the rounding of float32. Raises ValueError for
    another kind of model, an unknown layer, spaces that are not the task's, or a model without task.
    """
    where, kind = "from_stable_baselines", type(model).__name__
    if task is None:
        try:
            task = model.get_env().get_attr("task")[0]
        except AttributeError:
            what = "the model has no environment of steerkit that says what it steers"
            raise ValueError(f"{where}: {what}; give the task it was trained on: task=Task(...)") from None
    same = model.observation_space == task.observation_space and model.action_space == task.action_space
    expected = f"expected those of the task: {task.observation_space}, {task.action_space}"
    require(same, where, f"a model of {model.observation_space}, {model.action_space}, {expected}")
    head, *names = _NETS[known(kind, _NETS, f"{where}: model")]
    leaves = [leaf for name in names for leaf in attrgetter(name)(model.policy).modules() if not [*leaf.children()]]
    linear = [i for i, leaf in enumerate(leaves) if type(leaf).__name__ == "Linear"]
    between = {type(leaf).__name__ for leaf in leaves[: linear[-1]]} - {"Linear"}  # what follows in TD3 is the head
    fault = f"layers {', '.join(sorted(between))}, expected Linear ones with one of ReLU, Tanh between them"
    require(between in (set(), {"ReLU"}, {"Tanh"}), where, fault)
    network = Network(
        layers=tuple([tuple(p.detach().cpu().double().numpy() for p in leaves[i].parameters()) for i in linear]),
        activation="tanh" if between == {"Tanh"} else "relu",
        head="argmax" if task.angles else head,  # type: ignore[arg-type]
    )
    return PolicyBlock(
        policy=network, actions=task.angles, largest=task.scale, description=task.description, dt=task.dt
    )
