"""What the car will be doing when a command arrives: a learned policy's answer to dead time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from typing import Any, NamedTuple

from steerkit import maths as m
from steerkit.block import State
from steerkit.errors import require
from steerkit.task import DT

LONGEST = 12
"""Most samples of dead time that can be bridged."""
PREVIEW = LONGEST + 1
"""Curvatures of the path that a forecast needs, one a sample of driving."""
SLOWEST = 1.0
"""Speed below which a car counts as this fast [m/s]: the formulas divide by v."""
ANSWER = ("now", "before", "earlier", "back", "slip", "yaw", "loss")
"""The learned numbers by which a car answers its steering wheel: see `moved`."""
LEAST = 0.1
"""Least share of its course in a slow bend that a fast car is taken to have left."""
_REMEMBERED = LONGEST + 2


class Motion(NamedTuple):
    """Where a car is against its path: e [m], course c = e_dot/v [rad], psi_e [rad], r_e [rad/s]; each of any shape."""

    e: Any
    c: Any
    psi_e: Any
    r_e: Any


def course_left(loss: Any, v: Any) -> Any:
    """1 - loss*v^2, LEAST at least; loss [s^2/m^2] and v [m/s] of any kind."""
    return m.maximum(1.0 - loss * v * v, LEAST)


def moved(car: Any, x: Motion, v: Any, doe: Sequence[Any], bend: Any = 0.0, dt: float = DT) -> Motion:
    """The motion one sample later, as far as it is the wheel's doing; for floats, arrays and symbols.

    With the angle of the course to the car's axis w = c - psi_e, and the wheel's angles doe = (doe', doe, doe(t-dt)):

        p    = g*(now*doe' + before*doe + earlier*doe(t-dt)) - (back + slip*v^2)*w
        r_e' = r_e + yaw*v*p/g - bend,   psi_e' = psi_e + dt*r,   c' = c + p + dt*r,   r = (r_e + r_e')/2
        e'   = e + dt*v*(c + c')/2

    in which p is how w turns, by wheel, tyres and lag.

    car: anything with the numbers of `ANSWER`. v [m/s], at least SLOWEST. bend [rad/s]: by how much v*kappa grows in
    the sample. It is the same in every steady bend: nothing changes when doe is turned by x and psi_e by -x*ratio, of
    ratio = g*(now + before + earlier)/(back + slip*v^2). g = `course_left(loss, v)`: what the tyres' slip leaves of w
    in a bend, but not of the yaw rate; of a single track (L + (K - m*l_r/(L*c_f))*v^2)/(L + K*v^2) at its front axle.
    """
    g = course_left(car.loss, v)
    wheel = g * (car.now * doe[0] + car.before * doe[1] + car.earlier * doe[2])
    p = wheel - (car.back + car.slip * v * v) * (x.c - x.psi_e)
    r_e = x.r_e + car.yaw * v * p / g - bend
    turn = 0.5 * dt * (x.r_e + r_e)
    c = x.c + p + turn
    return Motion(x.e + 0.5 * dt * v * (x.c + c), c, x.psi_e + turn, r_e)


@dataclass(frozen=True, kw_only=True)
class Forecast:
    """A car's dead time and its answer to the wheel, learned; carries what is seen to where the next command acts.

    The state s(k) that is seen is what the angles until `samples` samples before have made of the car. The angles on
    their way since then are known, the bends ahead too: `moved`, once for each, gives the car's motion at the moment
    from which the next angle acts. A policy that is asked about that motion drives a car without dead time. What is
    seen of w = c - psi_e and of r_e is first filtered, as sensors are noisy: trust*seen + (1 - trust)*foreseen a
    sample before.

    Every number may be a symbol. Raises ValueError unless 0 <= samples <= LONGEST and 0 < trust <= 1.
    Source: Walsh, Nouri, Li, Littman 2009 (learning with constant delay by simulating the model over it); Smith 1957.
    """

    samples: int = 0
    """Dead time in samples: whole ones; what is left of one is in the numbers below."""
    now: Any = 0.0
    before: Any = 0.0
    earlier: Any = 0.0
    back: Any = 0.0
    slip: Any = 0.0
    yaw: Any = 0.0
    straight: Any = 0.0
    """Angle of the wheel at which the car goes straight on [rad]; the policy is told angles from there."""
    trust: Any = 1.0
    """Share of what is seen in the filtered values [1]."""
    loss: Any = 0.0
    """One more number of `moved`; it stands last as older files do not have it."""
    dt: float = DT
    """Sample time [s]."""

    def __post_init__(self) -> None:
        whole = isinstance(self.samples, int) and 0 <= self.samples <= LONGEST
        require(whole, "Forecast", f"samples = {self.samples!r}, expected 0 to {LONGEST}")
        if not m.is_symbol(self.trust):
            require(0.0 < self.trust <= 1.0, "Forecast", f"trust = {self.trust}, expected 0 < trust <= 1")

    @property
    def numbers(self) -> tuple[Any, ...]:
        """All but `samples` and `dt`, in order: what differs between cars of the same dead time."""
        return astuple(self)[1:-1]

    def with_numbers(self, numbers: Sequence[Any]) -> Forecast:
        """The same dead time with other `numbers`."""
        names = [field.name for field in fields(self)][1:-1]
        return Forecast(samples=self.samples, dt=self.dt, **dict(zip(names, numbers, strict=True)))

    def ahead(self, x: State, u: Any) -> tuple[Any, ...]:
        """The policy's six inputs (e, e_dot, v, psi_e, r_e, doe) when its command acts; x, u: see `remember`."""
        v = m.maximum(u.v, SLOWEST)
        w, r_e = self._filtered(x, u, v)
        motion = Motion(u.e, w + u.psi_e, u.psi_e, r_e)
        for i in range(self.samples):
            bend = v * (u.preview[i + 1] - u.preview[i])
            motion = moved(self, motion, v, self._angles(x, u, self.samples - i), bend, self.dt)
        e, c, psi_e, r_e = motion
        return e, v * c, u.v, psi_e, r_e, u.doe - self.straight

    def remember(self, x: State, u: Any) -> State:
        """The state of the next sample: angles of the last samples, oldest first, and what the filter needs.

        u: e, e_dot, v, psi_e, r_e, doe as seen, and preview [1/m], PREVIEW curvatures at s + j*v*dt.
        """
        v = m.maximum(u.v, SLOWEST)
        return (*x[1:_REMEMBERED], u.doe, *self._filtered(x, u, v), v, u.preview[0])

    def _filtered(self, x: State, u: Any, v: Any) -> tuple[Any, Any]:
        """w and r_e, filtered."""
        *_, w, r_e, v_before, kappa = x
        bend = v * u.preview[0] - v_before * kappa
        foreseen = moved(self, Motion(0.0, w, 0.0, r_e), v_before, self._angles(x, u, self.samples + 1), bend, self.dt)
        seen = u.e_dot / v - u.psi_e
        w_next = foreseen.c - foreseen.psi_e
        known = m.is_finite(w_next + foreseen.r_e)  # else a NaN that was seen once would stay for good
        filtered = w_next + self.trust * (seen - w_next), foreseen.r_e + self.trust * (u.r_e - foreseen.r_e)
        return m.where(known, filtered[0], seen), m.where(known, filtered[1], u.r_e)

    def _angles(self, x: State, u: Any, steps: int) -> tuple[Any, Any, Any]:
        """The angle that begins to act `steps` samples before the next command's, and the two before it."""
        angles = (*x[:_REMEMBERED], u.doe)
        at = len(angles) - steps
        doe, before, earlier = (angles[at - i] - self.straight for i in range(3))
        return doe, before, earlier


def nothing(batch: tuple[int, ...] = ()) -> State:
    """A state in which nothing has been seen yet."""
    return (m.filled(0.0, batch),) * (_REMEMBERED + 4)


def at_first(u: Any) -> State:
    """The state at a first sample, in which the wheel is taken to have stood still: the inputs as for `remember`."""
    v = m.maximum(u.v, SLOWEST)
    return (*(u.doe,) * _REMEMBERED, u.e_dot / v - u.psi_e, u.r_e, v, u.preview[0])
