"""Steering a car along a path as Gymnasium environments; importing this registers them (extra `gym`).

* `steerkit/TrackSteering-v0`: discrete actions, by default the paper's five steps of the steering wheel;
* `steerkit/TrackSteeringContinuous-v0`: the same with the wheel's speed in [-1, 1];
* `steerkit/LateralAcceleration-v0`: a target of lateral acceleration instead of a course.

The first two have a vector environment of their own, so that `gymnasium.make_vec(id, num_envs=N)` drives N cars in one
loop, in C with all that is judged and drawn; it is made of `steerkit.gym.episodes.Episodes`, a batch in given arrays.
"""

import lazy_loader

try:
    import gymnasium
except ImportError as why:
    raise ImportError("steerkit.gym needs Gymnasium: pip install 'steerkit-control[gym]'") from why

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

for _name, _kwargs in (("TrackSteering", {}), ("TrackSteeringContinuous", {"actions": "continuous"})):
    if f"steerkit/{_name}-v0" not in gymnasium.registry:
        gymnasium.register(
            id=f"steerkit/{_name}-v0",
            entry_point="steerkit.gym.vector_env:TrackSteering",
            vector_entry_point="steerkit.gym.vector_env:TrackSteeringVector",
            kwargs=_kwargs,
        )
if "steerkit/LateralAcceleration-v0" not in gymnasium.registry:
    gymnasium.register("steerkit/LateralAcceleration-v0", entry_point="steerkit.gym.vector_env:LateralAcceleration")
