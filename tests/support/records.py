"""Small records of transitions, and a net."""

import numpy as np

from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.rprop import Net

ACTIONS = (-0.5, 0.0, 0.5)


def level(q: float) -> Net:
    """A net whose value is q everywhere."""
    return np.zeros((1, 7), np.float32), np.array([np.log(q / (1.0 - q))], np.float32)


def states(e: list[float]) -> np.ndarray:
    s = np.zeros((len(e), 6))
    s[:, 0], s[:, 2] = e, 5.0
    return s


def chain(e: list[float], episode: list[int], a: float = 0.5) -> Transitions:
    """Rows k: from e[k] to e[k + 1]."""
    record = Transitions()
    record.extend(states(e[:-1]), np.full(len(e) - 1, a), states(e[1:]), episode)
    return record


def recorded(n: int = 300, seed: int = 0) -> Transitions:
    rng = np.random.default_rng(seed)
    record = Transitions()
    s = rng.uniform(-1.0, 1.0, (n + 1, 6)) * [0.4, 1.0, 1.0, 0.3, 0.3, 6.0] + [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]
    record.extend(s[:-1], rng.choice(ACTIONS, n), s[1:], np.arange(n) // 50)
    return record
