"""The learner's state: its description, and the patterns a net is trained on."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from steerkit.controllers.policy import ACTION, V
from steerkit.controllers.state_description import StateDescription

STANDARD = StateDescription()
"""The six inputs of the steering task, in their usual ranges."""


def patterns(
    description: StateDescription, s: NDArray[np.float64], a: NDArray[np.float64], scale: float
) -> NDArray[np.float32]:
    """Net inputs (n, columns + 1) of states s (n, columns) and actions a (n,) [rad]; scale [rad] becomes 1."""
    if description.scaled_from < math.inf:
        s, a = np.column_stack(description.scaled(tuple(s.T))), a * description.excess(s[:, V]) ** 2
    x = np.empty((len(s), s.shape[1] + 1), dtype=np.float32)
    x[:, :ACTION] = (s - description.mid) / description.half
    x[:, ACTION] = a / scale
    return x


def mirror_patterns(description: StateDescription, x: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same patterns seen in the mirror: a change of signs, as ranges are centred wherever the sign is -1."""
    return x * np.array([*description.mirror_signs, -1.0], dtype=np.float32)


def goal_patterns(
    description: StateDescription, actions: Sequence[float], count: int, rng: np.random.Generator
) -> NDArray[np.float32]:
    """`count` hint-to-goal patterns: states drawn evenly from the goal region, with the action that stays in it.

    That action is 0 where the set has it (an integrating output element holds its angle), else any one of the set.
    """
    scale = description.scale_of(tuple(actions))
    x = rng.uniform(-1.0, 1.0, (count, len(description.names) + 1)) * np.array([*description.goal, 0.0])
    x[:, ACTION] = 0.0 if 0.0 in actions else rng.choice(np.array(actions), count) / scale
    return x.astype(np.float32)
