"""Transitions of a car whose model is known."""

import numpy as np

from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.model import CarModel

ACTIONS = (-0.3, 0.0, 0.3)
CAR = CarModel(held=1.0, pushed=1.0, now=0.002, before=0.004, earlier=0.003, back=0.14, yaw=0.36, limit=9.0)


def driven(model: CarModel = CAR, n: int = 200, seed: int = 0) -> Transitions:
    """What the model's car does under random actions, in episodes of 20 samples."""
    rng, record = np.random.default_rng(seed), Transitions()
    for episode in range(n // 20):
        s = np.array([[0.0, *rng.normal(0.0, 0.1, 1), rng.uniform(4.0, 7.0), *rng.normal(0.0, 0.1, 2), 0.0]])
        earlier = s[:, 5]
        for _ in range(20):
            a = rng.choice(ACTIONS, 1)
            s_next = model.step(s, a, earlier)
            record.extend(s, a, s_next, episode)
            s, earlier = s_next, s[:, 5]
    return record
