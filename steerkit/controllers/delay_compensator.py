"""The motion of the car when a command arrives: a learned policy's compensation of dead time."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from steerkit._support.errors import Checked, number
from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.task import DT

LONGEST = 12
"""Most samples of dead time that can be bridged."""
PREVIEW = LONGEST + 1
"""Curvatures of the path that a forecast needs, one a sample of driving."""
SLOWEST = 1.0
"""Speed below which a car counts as this fast [m/s]: the formulas divide by v."""
ANSWER = ("now", "before", "earlier", "back", "slip", "yaw", "loss", "nose", "tail", "fast")
"""The learned numbers by which a car answers its steering wheel: see `moved`."""
FELT = ("lead", "fade", "most", "slew")
"""The learned numbers by which its steering overshoots and is slow: see `felt`."""
UNLIMITED = 1e6
"""Of `most` and `slew`: none [rad m^2/s^2]."""
LENGTH = 2.7
"""Of a fast car's w = LENGTH*r/v [m]: about a wheelbase, so that w is about an angle of the road wheels."""
_REMEMBERED = LONGEST + 2


class CourseMotion(NamedTuple):
    """Where a car is against its path: e [m], course c = e_dot/v [rad], psi_e [rad], r_e [rad/s]; each of any shape."""

    e: Any
    c: Any
    psi_e: Any
    r_e: Any


def turning(car: Any, c: Any, psi_e: Any, v: Any, r: Any) -> Any:
    """The angle w by which a car turns: c - psi_e; of one whose number `fast` is 1, LENGTH*r/v. r = r_e + v*kappa."""
    return m.where(car.fast > 0.5, LENGTH * r / v, c - psi_e)


def moved(car: Any, x: CourseMotion, v: Any, doe: Sequence[Any], bend: Any = 0.0, dt: float = DT) -> CourseMotion:
    """The motion one sample later, as far as it is the wheel's doing; for floats, arrays and symbols.

    With w = c - psi_e, and the wheel's angles doe = (doe', doe, doe(t-dt)):

        p    = (now*doe' + before*doe + earlier*doe(t-dt))/(1 + loss*v^2) - (back + slip*v^2)*w
        r_e' = r_e + yaw*v*p - bend,   c' = c + (nose - tail*v^2)*p + dt*r,   r = (r_e + r_e')/2
        w'   = w + p,   psi_e' = c' - w',   e' = e + dt*v*(c + c')/2

    in which p is how w turns. A slow car's w is the angle of its front axle's course to its own axis: nose = 1,
    tail = 0, loss = 0. Soft tyres take that angle away as speed grows (of a single track it is
    (L - m*l_f*v^2/(L*c_r))*r/v, nothing at 20 m/s for some), while the yaw rate stays. So a `fast` car's w is its yaw
    rate's, LENGTH*r/v (`turning`), its psi_e is c - w, and nose and tail say what of w the course makes.

    car: anything with the numbers of `ANSWER`. v [m/s], at least SLOWEST. bend [rad/s]: by how much v*kappa grows in
    the sample. It is the same in every steady bend: nothing changes when doe is turned by x and psi_e by -x*ratio, of
    ratio = (now + before + earlier)/((1 + loss*v^2)*(back + slip*v^2)).
    """
    wheel = (car.now * doe[0] + car.before * doe[1] + car.earlier * doe[2]) / (1.0 + car.loss * v * v)
    p = wheel - (car.back + car.slip * v * v) * (x.c - x.psi_e)
    r_e = x.r_e + car.yaw * v * p - bend
    turn = 0.5 * dt * (x.r_e + r_e)
    course = (car.nose - car.tail * v * v) * p
    c = x.c + course + turn
    return CourseMotion(x.e + 0.5 * dt * v * (x.c + c), c, x.psi_e + turn + (course - p), r_e)


def felt(car: Any, doe: Any, slow: Any, before: Any, v: Any) -> tuple[Any, Any]:
    """The wheel's angle as the car feels it, and the slow part's next value; for floats, arrays and symbols.

        u = sat(doe + sat(lead*(doe - slow), +-most/v^2), before +- slew/v^2),   slow' = slow + fade*(doe - slow)

    of a car whose steering overshoots what is asked of it, and comes back, and which turns no faster than its slew
    lets it (one steered by torque). before: u of the sample before. The other cars' u is doe.
    """
    square, off = v * v, doe - slow
    most, slew = car.most / square, car.slew / square
    u = m.clip(doe + m.clip(car.lead * off, -most, most), before - slew, before + slew)
    slow = slow + car.fade * off
    known = m.is_finite(u + slow)  # else one NaN would stay for good
    return m.where(known, u, doe), m.where(known, slow, doe)


@dataclass(frozen=True, kw_only=True)
class SteeringAnswer(Checked):
    """The learned numbers by which a car answers its steering wheel: see `moved`, and `felt`."""

    now: float = 0.0
    before: float = 0.0
    earlier: float = 0.0
    back: float = 0.0
    yaw: float = 0.0
    slip: float = 0.0
    """How the tyres' slip grows with speed [s^2/m^2]."""
    loss: float = 0.0
    """The wheel turns a fast car by 1/(1 + loss*v^2) of what it does at walking pace [s^2/m^2]."""
    nose: float = 1.0
    """Share of w's change that the course makes, at walking pace [1]."""
    tail: float = 0.0
    """What v^2 takes of that share [s^2/m^2]."""
    fast: float = 0.0
    """1 of a fast car, else 0."""
    straight: float = 0.0
    """Angle of the wheel at which the car goes straight on [rad]; policies and models get angles from there."""
    lead: float = 0.0
    """By how much the steering overshoots a change, as a share of it [1]."""
    fade: float = 0.0
    """Share of that which is gone a sample later [1]."""
    most: float = UNLIMITED
    """Largest overshoot, times v^2 [rad m^2/s^2]."""
    slew: float = UNLIMITED
    """Largest change in a sample, times v^2 [rad m^2/s^2]."""

    @property
    def feels(self) -> bool:
        """Does the car feel another angle than the wheel's?"""
        return self.lead != 0.0 or self.slew < UNLIMITED


@dataclass(frozen=True, kw_only=True)
class DelayCompensator(SteeringAnswer):
    """A car's dead time and its answer to the wheel, learned; predicts the motion at which the next command acts.

    The measured state s(k) is what the angles until `samples` samples before have made of the car. The angles on
    their way since then are known, the bends ahead too: `moved`, once for each, gives the car's motion at the moment
    from which the next angle acts. A policy that gets that motion drives a car without dead time. Angles are those that
    the car feels (`felt`). The measured motion is filtered first, as sensors are noisy: w and r_e are trust*measured +
    (1 - trust)*predicted a sample before, e and c the same by `trust_course`.

    Raises ValueError unless 0 <= samples <= LONGEST, 0 < trust <= 1 and 0 < trust_course <= 1.
    Source: Walsh, Nouri, Li, Littman 2009 (learning with constant delay by simulating the model over it); Smith 1957.
    """

    samples: int = number(0, low=0, high=LONGEST)
    """Dead time in samples: whole ones; what is left of one is in the other numbers."""
    trust: float = number(1.0, above=0.0, high=1.0)
    """Share of the measurement in the filtered w and r_e [1]."""
    trust_course: float = number(1.0, above=0.0, high=1.0)
    """Share of the measurement in the filtered e and c [1]."""
    dt: float = DT
    """Sample time [s]."""

    def ahead(self, x: State, u: Any) -> tuple[Any, ...]:
        """The policy's six inputs (e, e_dot, v, psi_e, r_e, doe) when its command acts; x, u: see `remember`."""
        v = m.maximum(u.v, SLOWEST)
        e, c, w, r_e = self._filtered(x, u, v)
        motion, angles = CourseMotion(e, c, c - w, r_e), self._angles(x, u)
        for i in range(self.samples):
            bend = v * (u.preview[i + 1] - u.preview[i])
            motion = moved(self, motion, v, angles[i + 3 : i : -1], bend, self.dt)
        e, c, psi_e, r_e = motion
        return e, v * c, u.v, psi_e, r_e, u.doe - self.straight

    def remember(self, x: State, u: Any) -> State:
        """The state of the next sample: angles of the last samples, oldest first, and what `felt` and the filter need.

        u: e, e_dot, v, psi_e, r_e, doe as measured, and preview [1/m], PREVIEW curvatures at s + j*v*dt.
        """
        v = m.maximum(u.v, SLOWEST)
        return (*x[1:_REMEMBERED], *self._felt(x, u), *self._filtered(x, u, v), v, u.preview[0])

    def at_first(self, u: Any) -> State:
        """The state at a first sample, in which the wheel is taken to have stood still; u: see `remember`."""
        v = m.maximum(u.v, SLOWEST)
        kappa = u.preview[0]
        w = turning(self, u.e_dot / v, u.psi_e, v, u.r_e + v * kappa)
        c = self._course(u, v, w)
        c_before = c - self.dt * u.r_e
        e_before = u.e - 0.5 * self.dt * v * (c_before + c)
        return (*(u.doe,) * (_REMEMBERED + 1), e_before, c_before, w, u.r_e, v, kappa)

    def _course(self, u: Any, v: Any, w: Any) -> Any:
        """c as measured; of a slow car by its filtered w, which takes e_dot's noise away."""
        return m.where(self.fast > 0.5, u.e_dot / v, w + u.psi_e)

    def _filtered(self, x: State, u: Any, v: Any) -> tuple[Any, ...]:
        """e, c, w and r_e, filtered."""
        *_, e, c, w, r_e, v_before, kappa = x
        bend = v * u.preview[0] - v_before * kappa
        foreseen = moved(self, CourseMotion(0.0, w, 0.0, r_e), v_before, self._angles(x, u)[2::-1], bend, self.dt)
        c_next, w_next = c + (foreseen.c - w), foreseen.c - foreseen.psi_e
        e_next = e + 0.5 * self.dt * v_before * (c + c_next)
        known = m.is_finite(e_next + w_next + foreseen.r_e)  # else one NaN would stay for good
        seen = turning(self, u.e_dot / v, u.psi_e, v, u.r_e + v * u.preview[0])
        w = m.where(known, w_next + self.trust * (seen - w_next), seen)
        r_e = m.where(known, foreseen.r_e + self.trust * (u.r_e - foreseen.r_e), u.r_e)
        seen, trust = self._course(u, v, w), self.trust_course
        c = m.where(known, trust * seen + (1.0 - trust) * c_next, seen)
        return m.where(known, trust * u.e + (1.0 - trust) * e_next, u.e), c, w, r_e

    def _felt(self, x: State, u: Any) -> tuple[Any, Any]:
        """The angle that the car feels, and the slow part's next value."""
        return felt(self, u.doe, x[_REMEMBERED], x[_REMEMBERED - 1], m.maximum(u.v, SLOWEST))

    def _angles(self, x: State, u: Any) -> Sequence[Any]:
        """The wheel's angles on their way, oldest first: of them 1, 2, 3 act until the next sample, 2, 3, 4 then."""
        angles = (*x[:_REMEMBERED], self._felt(x, u)[0])
        return [angle - self.straight for angle in angles[LONGEST - self.samples :]]


def nothing(batch: tuple[int, ...] = ()) -> State:
    """The state before the first sample."""
    return (m.filled(0.0, batch),) * (_REMEMBERED + 7)
