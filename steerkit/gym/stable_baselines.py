"""Policies trained with Stable-Baselines3 as controller blocks that need neither it nor torch."""

from __future__ import annotations

from typing import Any

from gymnasium import spaces

from steerkit._support.errors import require
from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.gym.task import Task


def from_stable_baselines(model: Any, task: Task) -> PolicyBlock:
    """The greedy policy of a trained model (DQN, SAC, TD3, PPO, A2C with an MLP) of an environment of `task`.

    It steers as `model.predict(observation, deterministic=True)` does, to the rounding of float32. Raises ValueError
    for another kind of model, an unknown layer, or spaces that are not the task's.
    """
    where, kind = "from_stable_baselines", type(model).__name__
    same = model.observation_space == task.observation_space and model.action_space == task.action_space
    spaces_of = f"{model.observation_space}, {model.action_space}"
    require(
        same,
        where,
        f"a model of {spaces_of}, expected those of the task: {task.observation_space}, {task.action_space}",
    )
    policy = model.policy
    if kind == "DQN":
        parts, head = [policy.q_net.q_net], "argmax"
    elif kind == "SAC":
        parts, head = [policy.actor.latent_pi, policy.actor.mu], "tanh"
    elif kind == "TD3":
        parts, head = [*policy.actor.mu[:-1]], "tanh"  # its last layer is that tanh
    elif kind in ("PPO", "A2C"):
        discrete = isinstance(model.action_space, spaces.Discrete)
        parts, head = [policy.mlp_extractor.policy_net, policy.action_net], "argmax" if discrete else "clip"
    else:
        raise ValueError(f"{where}: a {kind}; valid: DQN, SAC, TD3, PPO, A2C")
    flat = [layer for part in parts for layer in (part if type(part).__name__ == "Sequential" else [part])]
    weights, between = [], set()
    for layer in flat:
        name = type(layer).__name__
        require(name in ("Linear", "ReLU", "Tanh"), where, f"a layer {name}; valid: Linear, ReLU, Tanh")
        if name == "Linear":
            weights.append(tuple(p.detach().cpu().double().numpy() for p in (layer.weight, layer.bias)))
        else:
            between.add(name)
    require(len(between) <= 1, where, f"activations {', '.join(sorted(between))}, expected one kind")
    network = Network(layers=tuple(weights), activation="tanh" if between == {"Tanh"} else "relu", head=head)  # type: ignore[arg-type]
    return PolicyBlock(
        policy=network, actions=task.angles, largest=task.scale, description=task.description, dt=task.dt
    )
