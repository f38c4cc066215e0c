"""How a single-track car moves on in one sample, and on what that depends: a stiff step for estimators."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar

Rhs = Callable[[Sequence[Scalar], Scalar, Scalar], Sequence[Scalar]]
"""(x', y', psi', sway', r') = rhs((x, y, psi, sway, r), delta, v): a plant's own, on floats, batches and symbols."""
_GAMMA = 1.0 - math.sqrt(0.5)
_DOUBLED = 2
"""How often a step of h/4 is doubled."""
_APART = 1e-4
"""By how much a state is moved to see what the rates owe to it [m/s, rad, rad/s]."""


class Answer(NamedTuple):
    """What one sample of length h makes of rates, and of differences, about one state of the car."""

    rate: Sequence[Scalar]
    """(x', y', psi', sway', r') there."""
    reach: tuple[Scalar, ...]
    """h phi(h J), rows of (sway, r): how far (sway', r') carries them."""
    keeps: tuple[Scalar, ...]
    """exp(h J), rows of (sway, r): what is left of a difference in them."""
    aside: tuple[Scalar, Scalar]
    """What sway does to (x', y')."""
    turned: tuple[Scalar, Scalar]
    """What the road wheels' angle does to (sway, r) within the sample [per rad]."""
    driven: tuple[Scalar, ...]
    """What the speed does within the sample to x, y, sway, r [per m/s]."""


def answer(rhs: Rhs, x: Sequence[Scalar], delta: Scalar, v: Scalar, h: float) -> Answer:
    """The car's answer about x = (x, y, psi, sway, r), road-wheel angle delta [rad] and speed v [m/s].

    J = d(sway', r')/d(sway, r) and its like are differences of `rhs`. With g = 1 - sqrt(1/2) and M = (I - g k J)^-1,

        reach(k) = k M^2 (I - g^2 k J) ~ k phi(k J),  keeps(k) = I + reach(k) J ~ exp(k J),
        reach(2 k) = (I + keeps(k)) reach(k),  keeps(2 k) = keeps(k)^2,

    from k = h/4, rational and L-stable, for at walking pace sway and r settle within a fraction of a sample, where
    explicit steps blow up. source: Hairer, Wanner 1996, section IV.7 (Rosenbrock methods); Hochbruck, Ostermann 2010
    (phi); Moler, Van Loan 2003 (doubling).
    """
    px, py, psi, sway, r = x
    rate = rhs(x, delta, v)
    by_sway, by_r = rhs((px, py, psi, sway + _APART, r), delta, v), rhs((px, py, psi, sway, r + _APART), delta, v)
    by_delta, by_v = rhs(x, delta + _APART, v), rhs(x, delta, v + _APART)
    j11, j12 = (by_sway[3] - rate[3]) / _APART, (by_r[3] - rate[3]) / _APART
    j21, j22 = (by_sway[4] - rate[4]) / _APART, (by_r[4] - rate[4]) / _APART
    jacobian = (j11, j12, j21, j22)
    k = h / 2**_DOUBLED
    m11, m12, m21, m22 = 1.0 - _GAMMA * k * j11, -_GAMMA * k * j12, -_GAMMA * k * j21, 1.0 - _GAMMA * k * j22
    det = m11 * m22 - m12 * m21
    inverse = (m22 / det, -m12 / det, -m21 / det, m11 / det)
    q = _GAMMA * _GAMMA * k
    reach = _product(_product(inverse, inverse), (k * (1.0 - q * j11), -k * q * j12, -k * q * j21, k * (1.0 - q * j22)))
    keeps = _with_one(_product(reach, jacobian))
    for _ in range(_DOUBLED):
        reach, keeps = _product(_with_one(keeps), reach), _product(keeps, keeps)
    a, b, c, d = reach
    b1, b2 = (by_delta[3] - rate[3]) / _APART, (by_delta[4] - rate[4]) / _APART
    v1, v2, v3, v4 = ((by_v[i] - rate[i]) / _APART for i in (0, 1, 3, 4))
    return Answer(
        rate,
        reach,
        keeps,
        ((by_sway[0] - rate[0]) / _APART, (by_sway[1] - rate[1]) / _APART),
        (a * b1 + b * b2, c * b1 + d * b2),
        (h * v1, h * v2, a * v3 + b * v4, c * v3 + d * v4),
    )


def _product(one: Sequence[Scalar], other: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """That of two (2, 2) matrices, each by its rows."""
    a, b, c, d = one
    e, f, g, h = other
    return a * e + b * g, a * f + b * h, c * e + d * g, c * f + d * h


def _with_one(matrix: Sequence[Scalar]) -> tuple[Scalar, ...]:
    """I + a (2, 2) matrix."""
    a, b, c, d = matrix
    return 1.0 + a, b, c, 1.0 + d


def moved(
    rhs: Rhs, x: Sequence[Scalar], delta: Scalar, v: Scalar, h: float, rate: Sequence[Scalar], reach: Sequence[Scalar]
) -> tuple[Scalar, ...]:
    """x = (x, y, psi, sway, r) a sample later: (sway, r) by their rate and reach, the pose by the midpoint between.

    rate: `rhs` at x. reach: of an `Answer` there, or at a state a few samples before.
    """
    px, py, psi, sway, r = x
    sway_after = sway + reach[0] * rate[3] + reach[1] * rate[4]
    r_after = r + reach[2] * rate[3] + reach[3] * rate[4]
    turn = 0.5 * h * (r + r_after)
    middle = rhs((px, py, psi + 0.5 * turn, 0.5 * (sway + sway_after), 0.5 * (r + r_after)), delta, v)
    return px + h * middle[0], py + h * middle[1], psi + turn, sway_after, r_after


def course(rhs: Rhs, sway: Scalar, r: Scalar, delta: Scalar, v: Scalar) -> tuple[Scalar, Scalar]:
    """Speed of the centre of gravity [m/s] and sideslip [rad] of a car with this sway, whatever `rhs` calls sway."""
    ahead, aside, *_ = rhs((0.0 * v, 0.0 * v, 0.0 * v, sway, r), delta, v)
    return m.sqrt(ahead * ahead + aside * aside), m.atan2(aside, ahead)
