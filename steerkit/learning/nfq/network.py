"""The Q-network as plain arrays: made from a seed, laid flat for a training engine, and back."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.controllers.nfq_policy import Net, check_net

__all__ = ["Net", "check_net", "flat", "forward", "new_net", "shaped", "sizes_of"]


def new_net(sizes: Sequence[int] = (7, 10, 10, 1), seed: int | Sequence[int] = 0) -> Net:
    """A net with every weight and offset drawn evenly from [-0.5, 0.5] (float32; the same for the same seed).

    sizes: units a layer, the inputs first. Raises ValueError for fewer than two layers or a size below 1.
    """
    require(len(sizes) >= 2 and min(sizes) >= 1, "new_net", f"sizes = {tuple(sizes)}, expected two or more, each >= 1")
    count = sum((i + 1) * o for i, o in pairwise(sizes))
    return shaped(np.random.default_rng(seed).uniform(-0.5, 0.5, count).astype(np.float32), sizes)


def sizes_of(net: Net) -> tuple[int, ...]:
    """Units a layer, the inputs first."""
    return (net[0].shape[1], *(w.shape[0] for w in net[::2]))


def flat(net: Net) -> NDArray[np.float32]:
    """All weights in one float32 vector: W row by row, then b, a layer after the other."""
    return np.concatenate([p.ravel() for p in net]).astype(np.float32, copy=False)


def shaped(weights: NDArray[np.float32], sizes: Sequence[int]) -> Net:
    """The net whose `flat` is `weights` (a copy)."""
    net: list[NDArray[np.float32]] = []
    at = 0
    for i, o in pairwise(sizes):
        net += [weights[at : at + i * o].reshape(o, i).copy(), weights[at + i * o : at + (i + 1) * o].copy()]
        at += (i + 1) * o
    return tuple(net)


def forward(net: Net, x: NDArray[np.floating]) -> NDArray[np.floating]:
    """Outputs (n,) for inputs x (n, n_in): y <- (1 + tanh((W y + b)/2))/2, layer by layer, in NumPy."""
    y = x.T
    for w, b in zip(net[::2], net[1::2]):
        y = 0.5 + 0.5 * np.tanh(0.5 * (w @ y + b[:, None]))
    return y[0]
