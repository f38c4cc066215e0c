"""A small model of how the car answers the wheel, learned from the recorded transitions, and what it is used for."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.controllers.delay_compensator import LENGTH, SLOWEST, CourseMotion, SteeringAnswer, felt, moved
from steerkit.controllers.policy import COLUMNS, DOE, E_DOT, PSI_E, R_E, E, StateDescription, V
from steerkit.diagram.maths import Array
from steerkit.learning.data.transitions import Transitions
from steerkit.task import DT, TRIP

KAPPA = len(COLUMNS)
"""In recorded states, the column of the path's curvature, where there is one."""
CENTRED = 300.0
"""How firmly a wheel is taken to be mounted straight: some hundred samples' worth of evidence. White noise alone would
ask for 4; but what the model leaves unexplained goes on for seconds, such as a bend's."""
SAME = 10.0
"""How firmly `slip` is taken to be 0, so that it stays 0 while all speeds are alike."""
SAME_AT_SPEED = 2500.0
"""The same of `loss`, over the mean of now + before + earlier."""
FINE = 1.0 / 30.0
"""How much less evidence the small angles of a fast car need, and how much more an offset among them."""
LEAST_LOST = -0.5
MOST_LOST = 4.0
"""Least and largest loss*v^2 believed at a car's highest speed: twice or a fifth of the wheel's effect is left."""
OFF_CENTRE = 0.5
"""Largest offset of the wheel that is believed [rad]."""
SPREAD = 0.13
"""How far imagined states lie from recorded ones, as a share of the description's half ranges."""


class Felt(NamedTuple):
    """The wheel's angle as a car feels it (`steerkit.controllers.delay_compensator.felt`), each (n,) [rad]."""

    now: Array
    """In the sample."""
    before: Array
    """In the one before."""
    slow: Array
    """What the next one's overshoot is counted from."""

    def part(self, rows: Any, signs: Array | float = 1.0) -> "Felt":
        """Those of some rows, mirrored where a sign is -1."""
        return Felt(*[angles[rows] * signs for angles in self])

    def shifted(self, angle: Array) -> "Felt":
        """With the wheel turned by an angle (n,) [rad] all along."""
        return Felt(*[angles + angle for angles in self])


@dataclass(frozen=True, kw_only=True)
class CarModel(SteeringAnswer):
    """How path errors change in one sample, in a few learned numbers; the geometry of the path is known.

    With the course of the reference point against the path c = e_dot/v and its angle to the car w = c - psi_e:

        doe' = sat(held*doe + pushed*a),   v' = v

    for the dynamic output element and the speed driver; e', c', psi_e' and r_e' by
    `steerkit.controllers.delay_compensator.moved`, in which nothing changes when doe is turned by x and psi_e by
    -x*ratio, where `ratio` is the learned steering ratio's inverse. Bends ahead, changes of speed and noise are in
    `residuals`. Seven numbers, found by least squares from about 20 transitions on; two more where the path's curvature
    was recorded: `straight`, and how the tyres' slip grows with speed. At low speed that shows in how fast w comes back
    (`slip`); the states of a `fast` car are those of `with_heading_of_yaw_rate`, and it shows in how far w goes
    (`loss`).
    """

    held: float
    pushed: float
    limit: float
    """Largest |doe| [rad]."""

    @classmethod
    def fit(cls, record: Transitions, description: StateDescription, *, fast: bool = False) -> "CarModel":
        """The model of recorded transitions; raises ValueError for none, or for states of other columns.

        Where they hold the curvature (a column kappa after the others), the yaw rate's answer is found without the
        bends' part in it, which is of the same size and the other sign, and `straight` is found. fast: of a
        record of `with_heading_of_yaw_rate`, with kappa.
        """
        has_kappa = record.names == (*COLUMNS, "kappa")
        valid = f"columns {record.names}, the model needs {COLUMNS}, and kappa or not"
        require(has_kappa or record.names == COLUMNS, "CarModel.fit", valid)
        require(len(record) > 0, "CarModel.fit", "no transitions, expected at least one")
        s, s_next, limit = record.s, record.s_next, description.high[DOE]
        doe, doe_next, v = s[:, DOE], s_next[:, DOE], speed(s)
        free = np.abs(doe_next) < 0.999 * limit
        held, pushed = _least_squares(np.column_stack((doe, record.a))[free], doe_next[free], trace=1e-6)
        w = s[:, E_DOT] / v - s[:, PSI_E]
        turn = s_next[:, E_DOT] / speed(s_next) - s[:, E_DOT] / v - 0.5 * DT * (s[:, R_E] + s_next[:, R_E])
        follows = follow(record)
        rows = follows if follows.sum() >= 10 else np.ones(len(s), dtype=bool)
        x = np.column_stack((doe_next, doe, earlier_doe(record), -w))
        constant, straight = 0.0, 0.0
        answer = {"fast": float(fast)}
        if fast:
            course, turn = turn, s_next[:, E_DOT] / speed(s_next) - s_next[:, PSI_E] - w
        if has_kappa:
            grown, same = (-v * v * doe_next, SAME_AT_SPEED) if fast else (-v * v * w, SAME)
            x = np.column_stack((x, grown, np.ones(len(x))))
            fine = FINE if fast else 1.0
            trace = np.array([1e-3] * 3 + [1e-3 * fine, same, CENTRED / fine])
            *weights, constant = _least_squares(x[rows], turn[rows], trace=trace)
        else:
            weights = list(_least_squares(x[rows], turn[rows]))
        now, before, earlier, back, slip = (*weights, 0.0)[:5]
        answer |= {"now": now, "before": before, "earlier": earlier, "back": back}
        change = x[:, : len(weights)] @ np.array(weights) + constant
        if fast:
            answer["loss"] = believed_loss(slip / max(now + before + earlier, 1e-6), v)
            answer["yaw"] = 1.0 / LENGTH
            answer["nose"], answer["tail"] = course_share(change[rows], course[rows], v[rows])
        else:
            answer["slip"] = slip
            rise = s_next[:, R_E] - s[:, R_E]
            if has_kappa:
                rise = rise + s_next[:, V] * s_next[:, KAPPA] - s[:, V] * s[:, KAPPA]
            change = v * change
            answer["yaw"] = float(change @ rise / (change @ change + 1e-9))
        if now + before + earlier > 1e-6:
            straight = float(np.clip(-constant / (now + before + earlier), -OFF_CENTRE, OFF_CENTRE))
        return cls(held=held, pushed=pushed, limit=limit, straight=straight, **answer)

    def felt(self, record: Transitions) -> Felt | None:
        """The angles that it felt in recorded states; None: the wheel's."""
        if not self.feels:
            return None
        follows, (now, slow) = follow(record), angles_felt(self, record)
        before = now.copy()
        before[follows] = now[np.flatnonzero(follows) - 1]
        return Felt(now, before, slow)

    def step(self, s: Array, a: Array, earlier: Array, felt: Felt | None = None) -> Array:
        """States (n, columns) one sample after s, under the actions a (n,), where doe was `earlier` (n,) before s.

        felt: of a car that feels another angle than the wheel's; without it: of one whose wheel has stood still.
        """
        doe_next = np.clip(self.held * s[:, DOE] + self.pushed * a, -self.limit, self.limit)
        return self.turned(s, doe_next, earlier, felt)

    def turned(self, s: Array, doe_next: Array, earlier: Array, felt: Felt | None = None) -> Array:
        """The same with the wheel turned to `doe_next` (n,) [rad]."""
        e, e_dot, v, psi_e, r_e, doe = s.T
        course = e_dot / speed(s)
        angles = doe_next, doe, earlier
        if self.feels:
            felt = felt or Felt(doe, earlier, doe)
            angles = self.after(s, doe_next, felt).now, felt.now, felt.before
        e, course, psi_e, r_e = moved(self, CourseMotion(e, course, psi_e, r_e), v, angles)
        return np.column_stack((e, v * course, v, psi_e, r_e, doe_next))

    def after(self, s: Array, doe_next: Array, before: Felt) -> Felt:
        """What it feels in the sample after s (n, columns), with the wheel at `doe_next` (n,) [rad]."""
        now, slow = felt(self, doe_next, before.slow, before.now, speed(s))
        return Felt(now, before.now, slow)

    def ratio(self, v: Array) -> Array:
        """Angle of the course to the car's axis over that of the steering wheel in a steady bend [1]; 0 while unknown.

        (now + before + earlier)/((1 + loss*v^2)*(back + slip*v^2)), v (n,) [m/s].
        """
        back = self.back + self.slip * v * v
        wheel = (self.now + self.before + self.earlier) / (1.0 + self.loss * v * v)
        return np.where(back > 1e-3, wheel / np.maximum(back, 1e-3), 0.0)


def believed_loss(loss: float, v: Array) -> float:
    """`loss` within what is believed of a car of these speeds (n,)."""
    fastest = float(v.max()) ** 2
    return float(np.clip(loss, LEAST_LOST / fastest, MOST_LOST / fastest))


def course_share(turned: Array, course: Array, v: Array) -> tuple[float, float]:
    """`nose` and `tail` of changes of w (n,) and the course's part of them (n,); all of it where little shows."""
    fastest = float(v.max()) ** 2
    x = np.column_stack((turned, -turned * v * v / fastest))
    nose, tail = _least_squares(x, course - turned, trace=1e-4)
    return 1.0 + nose, tail / fastest


def with_heading_of_yaw_rate(record: Transitions) -> Transitions:
    """The same transitions, with psi_e such that e_dot/v - psi_e is LENGTH*r/v (see `moved`); with the column kappa."""
    s, s_next = _by_yaw_rate(record.s), _by_yaw_rate(record.s_next)
    return Transitions(record.names, s, record.a, s_next, record.episode, record.own)


def _by_yaw_rate(s: Array) -> Array:
    s, v = s.copy(), speed(s)
    s[:, PSI_E] = (s[:, E_DOT] - LENGTH * (s[:, R_E] + v * s[:, KAPPA])) / v
    return s


def angles_felt(car: Any, record: Transitions) -> tuple[Array, Array]:
    """What a car feels of recorded angles (n,), and the slow part after each; (n, k) of one with numbers (k,)."""
    now, slow = list[Any](), list[Any]()
    rows = zip(record.s[:, DOE].tolist(), speed(record.s).tolist(), follow(record).tolist(), strict=True)
    for doe, v, follows in rows:
        u, at = felt(car, doe, slow[-1], now[-1], v) if follows else (doe + 0.0 * car.lead,) * 2
        now.append(u)
        slow.append(at)
    return np.array(now), np.array(slow)


def follow(record: Transitions) -> NDArray[np.bool_]:
    """Is each row the sample after the row above it (n,)?"""
    follows = np.zeros(len(record), dtype=bool)
    follows[1:] = record.episode[1:] == record.episode[:-1]
    return follows


def earlier_doe(record: Transitions) -> Array:
    """doe one sample before each row (n,) [rad]; its own where the row begins an episode."""
    doe = record.s[:, DOE].copy()
    rows = np.flatnonzero(follow(record))
    doe[rows] = record.s[rows - 1, DOE]
    return doe


@dataclass(frozen=True, kw_only=True)
class Imagined:
    """States near the recorded ones, in bends of any strength, with what the model did not foresee there."""

    s: Array
    """States (n, columns)."""
    earlier: Array
    """doe one sample before (n,) [rad]."""
    residual: Array
    """What to add to the model's next state (n, columns)."""
    felt: Felt | None = None
    """Of a car that feels another angle than the wheel's."""


class Explained(NamedTuple):
    """A record, the model of its car, and what that makes of it, row by row."""

    model: CarModel
    record: Transitions
    earlier: Array
    """doe one sample before (n,) [rad]."""
    felt: Felt | None
    """The angles that the car felt; None: the wheel's."""
    residual: Array
    """What came otherwise than the model foresees it (n, columns): noise, bends, changes of speed."""


def explained(model: CarModel, record: Transitions) -> Explained:
    """What the model makes of the record."""
    earlier, felt = earlier_doe(record), model.felt(record)
    return Explained(model, record, earlier, felt, record.s_next - model.step(record.s, record.a, earlier, felt))


def imagine(known: Explained, description: StateDescription, count: int, rng: np.random.Generator) -> Imagined:
    """`count` states: recorded ones, mirrored at random, at another speed, moved a little, in another steady bend.

    Those recorded under the recovery controller count within TRIP of the path: further off the learner never steers.
    The speed is drawn from the recorded range, a quarter wider at either end; e, the heading, r_e and doe are moved by
    SPREAD of the description's half ranges, mostly less; the steady bend is drawn from all that the wheel can steer.
    """
    model, record, earlier, felt, residual = known
    near = near_path(record)
    row = near[rng.integers(len(near), size=count)]
    signs = np.where(np.array(description.mirror_signs) < 0.0, rng.choice([-1.0, 1.0], count)[:, None], 1.0)
    s = record.s[row] * signs
    back = (earlier[row] - record.s[row, DOE]) * signs[:, DOE]
    if felt is not None:
        felt = felt.part(row, signs[:, DOE]).shifted(-s[:, DOE])
    v = rng.uniform(record.s[:, V].min(), record.s[:, V].max(), count)
    s[:, PSI_E] += (model.ratio(speed(s)) - model.ratio(np.maximum(v, SLOWEST))) * s[:, DOE]
    s[:, E_DOT] *= v / speed(s)
    s[:, V] = v
    size = SPREAD * description.half * 2.0 * rng.uniform(0.0, 1.0, (count, 1)) ** 2
    shift = size * rng.standard_normal((count, len(COLUMNS)))
    excess = description.excess(v)
    shift[:, [PSI_E, R_E]] /= excess[:, None]
    shift[:, DOE] /= excess**2
    s[:, E] += shift[:, E]
    s[:, E_DOT] += v * shift[:, PSI_E]
    s[:, PSI_E] += shift[:, PSI_E]
    s[:, R_E] += shift[:, R_E]
    bend = rng.uniform(-model.limit, model.limit, count) / excess**2
    s[:, PSI_E] -= model.ratio(speed(s)) * (bend - s[:, DOE] - shift[:, DOE])
    s[:, DOE] = bend
    felt = felt and felt.shifted(bend)
    return Imagined(s=s, earlier=bend + back, residual=residual[row] * signs, felt=felt)


def near_path(record: Transitions) -> NDArray[np.intp]:
    """Rows of the learner's own, and others within TRIP of the path; all where there are none such."""
    near = np.flatnonzero(record.own | (np.abs(record.s[:, E]) < TRIP))
    return near if len(near) else np.arange(len(record))


def speed(s: Array) -> Array:
    """Speeds of the states s (n, columns) that may be divided by, SLOWEST at least (n,) [m/s]."""
    return np.maximum(s[:, V], SLOWEST)


def _least_squares(x: Array, y: Array, trace: float | Array = 1e-3) -> tuple[float, ...]:
    """Weights of y on x with a trace of regularisation: unexcited directions stay 0."""
    weights = np.linalg.solve(x.T @ x + trace * np.eye(x.shape[1]), x.T @ y)
    return tuple(float(value) for value in weights)
