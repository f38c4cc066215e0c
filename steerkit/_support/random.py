"""Random numbers with explicit state, the same from floats, batches, CasADi symbols and generated C.

MRG32k3a, a combined multiple recursive generator of period 2^191 (L'Ecuyer 1999, Operations Research 47:159):

    p1(n) = (1403580 p1(n-2) - 810728 p1(n-3)) mod m1,   m1 = 2^32 - 209
    p2(n) = (527612 p2(n-1) - 1370589 p2(n-3)) mod m2,   m2 = 2^32 - 22853
    u(n)  = ((p1(n) - p2(n)) mod m1) / (m1 + 1),         with 0 taken as m1, so that 0 < u < 1

Its six state numbers and all products are whole numbers below 2^53, exact in doubles, and a quotient is at least 1/m
from the next whole number, more than rounding can bridge; so every backend draws the same numbers, to the last bit.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar

RandomState = tuple[Scalar, ...]
"""The generator's six state numbers, oldest first: three of p1, then three of p2."""

_M1, _M2 = 4294967087.0, 4294944443.0
_NORM = 2.328306549295727688e-10  # 1 / (m1 + 1), as published


OpenSeed = Callable[[int], RandomState]
"""A seed chosen later: in a block's `seed` while its start is traced, it gives the six that stand for a stream."""


def seed_state(seed: int | OpenSeed, batch: tuple[int, ...] = (), *, stream: int = 0) -> RandomState:
    """The generator's state for a seed: car i of a batch gets seed + i, and so draws what a single run with it does.

    seed, stream: whole numbers >= 0, seed below 2^63. Different streams of one seed are unrelated: blocks of
    different kinds use different streams, so that driver and sensors of seed 1 do not share their noise. Returns six
    floats, or `(N,)` arrays for `batch=(N,)`. The numbers are six outputs of SplitMix64 (Steele, Lea, Flood 2014).
    Raises ValueError for a seed or stream that is no such number.
    """
    if callable(seed):
        return seed(stream)
    for name, value in (("seed", seed), ("stream", stream)):
        whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
        require(whole and 0 <= value < 2**63, "seed_state", f"{name} = {value!r}, expected a whole number >= 0")
    seeds = np.uint64(seed) + np.arange(math.prod(batch), dtype=np.uint64)
    z = _mixed(seeds) ^ _mixed(np.array([stream + 0x5EED], dtype=np.uint64))
    state = []
    for modulus in (_M1,) * 3 + (_M2,) * 3:
        z = z + np.uint64(0x9E3779B97F4A7C15)
        number = 1 + _mixed(z) % np.uint64(int(modulus) - 1)  # never 0: a component of zeros would stay zero
        state.append(number.astype(float).reshape(batch) if batch else float(number[0]))
    return tuple(state)


def uniform(state: RandomState) -> tuple[Scalar, RandomState]:
    """One number u, uniform in (0, 1), and the state after it; equations above."""
    a, b, c, d, e, f = state
    p1 = 1403580.0 * b - 810728.0 * a
    p1 = p1 - _M1 * m.floor(p1 / _M1)
    p2 = 527612.0 * f - 1370589.0 * d
    p2 = p2 - _M2 * m.floor(p2 / _M2)
    difference = p1 - p2
    u = _NORM * m.where(difference > 0.0, difference, difference + _M1)
    return u, (b, c, p1, e, f, p2)


def normals(state: RandomState) -> tuple[Scalar, Scalar, RandomState]:
    """Two independent standard normal numbers, and the state after them.

        n1 = sqrt(-2 ln u1) cos(2 pi u2),   n2 = sqrt(-2 ln u1) sin(2 pi u2)

    |n| < 6.7. Equal in all backends to their logarithms' and sines' last bits. Source: Box, Muller 1958.
    """
    u1, state = uniform(state)
    u2, state = uniform(state)
    radius = m.sqrt(-2.0 * m.log(u1))
    angle = 2.0 * m.pi * u2
    return radius * m.cos(angle), radius * m.sin(angle), state


def _mixed(z: Any) -> Any:
    """SplitMix64's output function on an array of 64-bit numbers."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))
