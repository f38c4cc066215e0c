"""Steering a car along a path as Gymnasium environments; importing this registers them (extra `gym`).

* `steerkit/TrackSteering-v0`: discrete actions, by default the paper's five steps of the steering wheel;
* `steerkit/TrackSteeringContinuous-v0`: the same with the wheel's speed in [-1, 1].

Both have a vector environment of their own, so that `gymnasium.make_vec(id, num_envs=N)` drives N cars in one loop, in
C with all that is judged and drawn; `PufferSteering` is the same in PufferLib's buffers.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

try:
    import gymnasium
except ImportError as why:
    raise ImportError("steerkit.gym needs Gymnasium: pip install 'steerkit-control[gym]'") from why

if TYPE_CHECKING:
    from steerkit.controllers.network_policy import Network, PolicyBlock
    from steerkit.gym.env import TrackSteering
    from steerkit.gym.puffer import PufferSteering
    from steerkit.gym.stable_baselines import from_stable_baselines
    from steerkit.gym.task import Task
    from steerkit.gym.vector_env import TrackSteeringVector

_HOME = {
    "Network": "controllers.network_policy",
    "PolicyBlock": "controllers.network_policy",
    "PufferSteering": "gym.puffer",
    "Task": "gym.task",
    "TrackSteering": "gym.env",
    "TrackSteeringVector": "gym.vector_env",
    "from_stable_baselines": "gym.stable_baselines",
}
__all__ = [
    "Network",
    "PolicyBlock",
    "PufferSteering",
    "Task",
    "TrackSteering",
    "TrackSteeringVector",
    "from_stable_baselines",
]

for _name, _kwargs in (("TrackSteering", {}), ("TrackSteeringContinuous", {"actions": "continuous"})):
    if f"steerkit/{_name}-v0" not in gymnasium.registry:
        gymnasium.register(
            id=f"steerkit/{_name}-v0",
            entry_point="steerkit.gym.env:TrackSteering",
            vector_entry_point="steerkit.gym.vector_env:TrackSteeringVector",
            kwargs=_kwargs,
        )


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'steerkit.gym' has no attribute '{name}'; it offers: {', '.join(__all__)}")
    return getattr(import_module(f"steerkit.{_HOME[name]}"), name)
