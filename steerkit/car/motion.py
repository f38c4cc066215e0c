"""The witness of the pose: does the car move as the kit's own wheel and speed, and the gyro, say?"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from steerkit._support.errors import Checked, number
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.estimators.estimate import Estimated
from steerkit.vehicles.rollout import Rollout

SPACING = 0.5
"""Time between two samples that every later pose is compared with, and between two steps of learning [s]."""
HORIZON = 10.0
"""How long a sample is kept [s]."""
LOOK = 0.1
"""Time between two looks at what does not jump [s]."""
READ_LATE = 0.06
"""How late a busy computer may read a frame [s]; the process that reads watches that of its own."""
_USUAL = 0.02
"""Time between two poses [s]: so far the car may drive before the next comes."""
ASTRAY = 0.5
"""How far off the path counts as astray [m]."""
_NOISES, _DEVIATIONS = 4.0, 2.5
"""So many deviations of a sample's noise, and of all that is not known of the car, may add up."""
_LONG = 600.0
"""Over so long what was learned of a car is forgotten [s]."""
_MOST = 3.0
"""Deviations of the data sheet's, beyond which nothing is learned but the pose is wrong."""
_DRIFT = (0.005, 0.005, radians_of(0.06))
"""By how much position, and heading against gyro, wander [m/sqrt(s), rad/sqrt(s)]."""
_TURN_SHARE = radians_of(0.3)
"""The same of the heading against the wheel by turning, whose ratio is not the same everywhere [rad/sqrt(rad)]."""
_SIDE = radians_of(0.045)
"""By how much the direction of travel wanders against the heading: wind, a banked road [rad/sqrt(m)]."""
_LEVER, _SLIP, _UNDERSTEER, _LATE = 0.15, 1.0, (0.5, 0.001), 0.03
"""Deviations: of the place of the pose along the car [m], of the rear axle's slip [1], of the understeer gradient [1,
rad s^2/m], of how much later the pose is than the wheel's angle [s]."""
SPEED, ZERO, LEVER, SLIP, RATE, RATIO, WHEEL, UNDERSTEER, LATE = range(9)
"""Parameters: what is not known of sensors and car; the levels of the four ways to reckon follow."""
_CALIBRATED = {
    "steer_ratio": (RATIO, 0.005),
    "offset": (WHEEL, radians_of(0.15)),
    "rate_zero": (RATE, radians_of(0.01)),
    "understeer": (UNDERSTEER, 1e-4),
}
"""What a calibration finds, and its least deviation, for a car is not quite the same the next day."""
_N, _ALL = 9, 13
_FAULTS = {
    SPEED: ("the kit's speed would be {:+.1f} % off", 100.0),
    ZERO: ("the heading's zero would be {:+.2f} deg off", degrees_of(1.0)),
    RATE: ("the gyro's zero would be {:+.2f} deg/s off", degrees_of(1.0)),
    RATIO: ("the steering ratio would be {:+.0f} % off", 100.0),
    WHEEL: ("the wheel's zero would be {:+.1f} deg off", degrees_of(1.0)),
}
# what is added up: of the kit's speed and wheel x, y [m], way [m], turn [rad], what the parameters do to them; then of
# the gyro, of the pose's speed; then, over the way, of heading, turn and the rest
_X, _Y, _WAY, _TURN, _SLIDE, _BY_WHEEL, _BY_UNDERSTEER, _GYRO, _SPEED, _HEADED, _TURNED, _W_WHEEL, _W_UNDER, _W_RATE = (
    range(14)
)


@dataclass(frozen=True, kw_only=True)
class MotionLimits(Checked):
    """How good sensors and data sheet are: what the witness may not take for a fault.

    Those of a sensor's noise and of what is not known are standard deviations.
    """

    pose_jump: float = number(0.15, "m", low=0.02, high=0.5)
    """Jump of the position that a good receiver makes [m]."""
    position_noise: float = number(0.015, "m", low=0.002, high=0.1)
    """Noise of the position [m]."""
    heading_jump: float = number(radians_of(0.5), "rad", low=radians_of(0.05), high=radians_of(3.0))
    """Jump of the heading that a good receiver makes [rad]."""
    heading_noise: float = number(radians_of(0.12), "rad", low=radians_of(0.02), high=radians_of(1.0))
    """Noise of the heading [rad]."""
    heading_zero: float = number(radians_of(0.3), "rad", low=radians_of(0.05), high=radians_of(2.0))
    """How far the heading's zero may lie off the car's axis [rad]."""
    speed_share: float = number(0.02, low=0.002, high=0.05)
    """Error of the kit's speed [1]."""
    rate_zero: float = number(radians_of(0.15), "rad/s", low=radians_of(0.01), high=radians_of(1.0))
    """Zero of the gyro [rad/s]."""
    ratio_share: float = number(0.12, low=0.005, high=0.2)
    """Error of the steering ratio [1]; a calibrated car's vehicle file has its own."""
    wheel_zero: float = number(radians_of(1.5), "rad", low=radians_of(0.1), high=radians_of(10.0))
    """Zero of the wheel's angle [rad]; a calibrated car's vehicle file has its own."""
    turn_wander: float = number(radians_of(0.05), "rad", low=radians_of(0.01), high=radians_of(0.3))
    """By how much wind, a banked road and play turn the car over a metre; over n of them sqrt(n) as much [rad]."""


class MotionCheck:
    """Compares each pose with what was reckoned from every half second of the last ten.

    Five ways to reckon: the position along and across from the kit's speed and the pose's heading; the heading from
    the gyro, and from the wheel, r = v tan(delta)/(L + K v^2); the position across from the wheel alone. The speed of
    the pose is compared with the kit's. With x the parameters and levels as they were known then, P their covariance,
    J what they do to the value now, each innovation must stay within

        jump + 4 noise + 2.5 sqrt(J P J' + wander^2 T + ...),

    P of the data sheet at first, or of `known`, an earlier calibration; a Kalman filter learns x and P on the way. What
    comes after a sample teaches it nothing, and x must stay within 3 deviations of the data sheet's.
    Source: Brown 1992, A baseline GPS RAIM scheme; Gelb 1974, section 4.2.
    """

    def __init__(self, limits: MotionLimits, car: Rollout, known: Mapping[str, Estimated] | None = None):
        self.limits = limits
        sizes = (car.wheelbase, car.understeer, car.steer_ratio, car.l_r, car.rear_slip, car.yaw_time)
        self._numbers = tuple(map(float, sizes))
        jump, noise = limits.pose_jump, limits.position_noise
        self._noise = np.array([noise, noise, limits.heading_noise, limits.heading_noise])
        self._jump = np.array([jump, jump, limits.heading_jump, limits.heading_jump, jump, jump])
        self._jump += _NOISES * np.array([*self._noise, noise, noise])
        self._step = 0.5 * jump, 0.5 * jump, 0.5 * limits.heading_jump, 0.5 * limits.heading_jump
        under = float(_UNDERSTEER[0] * abs(car.understeer) + _UNDERSTEER[1])
        deviation = np.array(
            (
                *(limits.speed_share, limits.heading_zero, _LEVER, _SLIP * float(car.rear_slip), limits.rate_zero),
                *(limits.ratio_share, limits.wheel_zero, under, _LATE),
            )
        )
        self._sheet = np.zeros(_N)
        sheet = {"steer_ratio": float(car.steer_ratio), "understeer": float(car.understeer)}
        for name, (place, least) in _CALIBRATED.items():
            if q := (known or {}).get(name):
                share = -1.0 / sheet[name] if place == RATIO else 1.0  # a smaller ratio turns more
                self._sheet[place] = share * (q.value - sheet.get(name, 0.0))
                deviation[place] = min(deviation[place], max(abs(share * q.deviation), least))
        self._prior = np.diag(deviation**2)
        self._deviation = deviation
        self._x, self._P = np.zeros(_ALL), np.zeros((_ALL, _ALL))
        self.doubt()
        self.forget()

    def doubt(self) -> None:
        """What was learned is taken back to the data sheet."""
        self._x[:_N], self._P[:] = self._sheet, 0.0
        self._P[:_N, :_N], self._P[_N:, _N:] = self._prior, np.diag(4.0 * self._noise**2)
        self._anew = True

    def forget(self) -> None:
        """Begin anew, after a pause without poses; what was learned of the car stays."""
        self._t: float | None = None
        self._psi = self._tan = 0.0
        self._added, self._rates = [0.0] * 14, [0.0] * 14
        self._last: tuple[float, float, float, float] | None = None
        self._posed, self._late = -math.inf, 0.0
        self._looked = -math.inf, (0.0, 0.0, 0.0, 0.0)
        self._anew, self._learned = True, (-math.inf, np.zeros(14), 0.0)
        self._kept: list[tuple[float, np.ndarray, float, np.ndarray, np.ndarray]] = []
        self._stacked: tuple[np.ndarray, ...] | None = None

    def moves(self, t: float, *, psi: float, v: float, r: float, delta_sw: float, v_kit: float) -> None:
        """Heading, speed and yaw rate of the pose, wheel and speed of the kit at time t [SI]: added up (trapezoids)."""
        L, K, n, l_r, slip, yaw_time = self._numbers
        dt, first = (0.0, True) if self._t is None else (max(0.0, t - self._t), False)
        lag = 1.0 if first else 1.0 - math.exp(-dt / (yaw_time * max(abs(v_kit), 1.0)))
        self._tan += (math.tan(max(-1.2, min(1.2, delta_sw / n))) - self._tan) * lag
        tan, square, length = self._tan, v_kit * v_kit, L + K * v_kit * v_kit
        gain = v_kit / length
        rate = gain * tan
        self._psi = psi if first else self._psi + math.remainder(psi - self._psi, 2.0 * math.pi)
        course, half = psi + (l_r - slip * square) * tan / length, 0.5 * dt
        now = [v_kit * math.cos(course), v_kit * math.sin(course), v_kit, rate, square * rate]
        now += gain / n * (1.0 + tan * tan), -rate * square / length, r, v - v_kit
        added = [a + half * (b + c) for a, b, c in zip(self._added, self._rates, now)]
        turn, by_wheel, by_understeer = added[_TURN], added[_BY_WHEEL], added[_BY_UNDERSTEER]
        now += [v_kit * (self._psi - turn), v_kit * turn, v_kit * by_wheel, v_kit * by_understeer, v_kit * rate]
        added += [a + half * (b + c) for a, b, c in zip(self._added[9:], self._rates[9:], now[9:])]
        self._t, self._added, self._rates = t if self._t is None else max(t, self._t), added, now

    def pose(self, t: float, x: float, y: float) -> str:
        """The position at time t [s, m]: what contradicts the motion of the last seconds, or ""."""
        if self._t is None:
            return ""
        ahead = max(0.0, min(t - self._t, 0.1))  # the position may come before the speed of the same moment
        left_x, left_y = (p - a - ahead * r for p, a, r in zip((x, y), self._added, self._rates))
        t = max(t, self._posed)
        gap, self._posed = min(t - self._posed, READ_LATE) if self._last else 0.0, t
        last_x, last_y, along, across = self._last or (left_x, left_y, 0.0, 0.0)
        cos, sin = math.cos(self._psi), math.sin(self._psi)
        along += (left_x - last_x) * cos + (left_y - last_y) * sin
        across += (left_y - last_y) * cos - (left_x - last_x) * sin
        self._last = (left_x, left_y, along, across)
        self._late = max(gap, self._late - 0.5 * gap)
        here = along, across, self._psi - self._added[_GYRO], self._psi - self._added[_TURN]
        jumped = any([not abs(a - b) <= c for a, b, c in zip(here, self._looked[1], self._step)])  # or is no number
        if not (jumped or t - self._looked[0] >= LOOK - 1e-9):
            return ""
        self._looked = t, here
        added = np.array(self._added)
        what = self._against(t, np.array(here), added)
        if t - self._learned[0] >= SPACING:
            taught = self._learn(t, np.array(here), added)
            what = what or taught
            self._kept = [one for one in self._kept if one[0] > t - HORIZON]
            self._kept.append((t, added, self._rates[_TURN], self._x.copy(), self._P.copy()))
            self._stacked = tuple(np.array(column) for column in zip(*self._kept))
        if what:
            self.doubt()
        return what

    def _learn(self, t: float, here: np.ndarray, added: np.ndarray) -> str:
        """One step of the filter; what of it no data sheet allows, or ""."""
        x, P, noise = self._x, self._P, 2.0 * self._noise  # twice, as it hangs together for a second
        noise[0] += self._late * abs(self._rates[_WAY])
        then, before, rate = self._learned
        self._learned = t, added, self._rates[_TURN]
        if self._anew:
            self._anew, x[_N:] = False, here
            P[_N:], P[:, _N:] = 0.0, 0.0
            P[_N:, _N:] = np.diag(noise**2)
            return ""
        span, more = t - then, added - before
        step = np.eye(_ALL)
        step[_N:] = _effects(span, more, before, rate, self._rates[_TURN])[:4]
        x[:] = step @ x
        P[:] = step @ P @ step.T
        P[:_N, :_N] += 2.0 * span / _LONG * self._prior
        P[ZERO, ZERO] += _SIDE**2 * abs(more[_WAY])
        P[range(_N, _ALL), range(_N, _ALL)] += self._wander(span, more)[:4]
        for k, value in enumerate(here, _N):
            gain = P[:, k] / (P[k, k] + noise[k - _N] ** 2)
            x += gain * (value - x[k])
            P -= np.outer(gain, P[k])
        P[:] = 0.5 * (P + P.T)
        off = (x[:_N] - self._sheet) / self._deviation
        worst = max(_FAULTS, key=lambda k: abs(off[k]))
        if abs(off[worst]) <= _MOST:
            return ""
        text, factor = _FAULTS[worst]
        most = factor * _MOST * self._deviation[worst]
        return f"{text.format(factor * (x[worst] - self._sheet[worst]))}, expected at most {most:.2g}"

    def _wander(self, span: Any, added: np.ndarray) -> np.ndarray:
        """Variance of what wanders within a time, of each of the six comparisons."""
        way, turned = np.abs(added[..., _WAY]), np.abs(added[..., _TURN])
        turn = self.limits.turn_wander**2 * way + _TURN_SHARE**2 * turned
        along, across, gyro = (drift**2 * span for drift in _DRIFT)
        across, gyro = across + _SIDE**2 * way**3 / 3.0, gyro + (0.3 * _TURN_SHARE) ** 2 * turned
        by_wheel = across + way**2 * turn / 3.0
        return np.stack([along, across, gyro, turn, by_wheel, along], axis=-1)

    def _against(self, t: float, here: np.ndarray, by_now: np.ndarray) -> str:
        """What the oldest of the kept samples that contradicts this one says, or ""."""
        if self._stacked is None:
            return ""
        then, added, rate, x, P = self._stacked
        span, more = t - then, by_now - added
        J = _effects(span, more, added, rate, self._rates[_TURN])
        now = np.tile([*here, here[1], 0.0], (len(span), 1))
        now[:, 4] += more[:, _HEADED]
        now[:, 5] = more[:, _SPEED]
        left = now - (J @ x[:, :, None])[:, :, 0]
        most = np.tile(self._jump, (len(span), 1))
        most[:, (0, 5)] += self._late * abs(self._rates[_WAY])
        i, k = np.nonzero(~(np.abs(left) <= most))  # of a NaN too; only where these are the bounds are worked out whole
        rows, wander = J[i, k], self._wander(span, more)[i, k]
        beyond = ~(
            np.abs(left[i, k])
            <= most[i, k] + _DEVIATIONS * np.sqrt(np.einsum("ma,mab,mb->m", rows, P[i], rows) + wander)
        )
        if not beyond.any():
            return ""
        window, kind = int(i[beyond][0]), int(k[beyond][0])
        off, during = float(left[window, kind]), f"{span[window]:.1f} s"
        return (
            f"the position is {off:+.2f} m along from where {during} at {self._rates[_WAY]:.1f} m/s lead",
            f"the position drifted by {off:+.2f} m across the heading in {during}",
            f"the heading is {degrees_of(off):+.1f} deg from where the yaw rate of {during} leads",
            f"the car turned by {degrees_of(off):+.1f} deg more than its wheel says in {during}",
            f"the position is {off:+.2f} m aside from where the wheel of {during} leads",
            f"the speed of the pose leads {off:+.2f} m further than the kit's in {during}",
        )[kind]

    def astray(self, v: float, kappa: float) -> float:
        """The time in which a pose that lies just below the bounds leads the car `ASTRAY` off [s]; inf: not in 10 s.

        v [m/s], kappa [1/m]: of the car, which may be a deviation off what is believed of it, to the other side.
        """
        span = np.arange(41) * (HORIZON / 40.0)
        (L, K, n, *_), rates = self._numbers, np.zeros(14)
        gain = v / (L + K * v * v)
        rates[[_WAY, _TURN, _SLIDE]] = v, v * kappa, v**3 * kappa
        rates[[_BY_WHEEL, _BY_UNDERSTEER]] = gain / n, -kappa * v**3 / (L + K * v * v)
        added = np.outer(span, rates)
        added[:, _TURNED:_W_RATE] = 0.5 * v * span[:, None] * added[:, (_TURN, _BY_WHEEL, _BY_UNDERSTEER)]
        added[:, _W_RATE] = v * added[:, _TURN]
        J = _effects(span, added, np.zeros(14), 0.0, v * kappa)
        most = self._jump + (_DEVIATIONS + 1.0) * np.sqrt(np.sum(J @ self._P * J, axis=2) + self._wander(span, added))
        most[:, 0] += _USUAL * abs(v)
        off = most[:, 4] + most[:, 0] * np.sin(np.minimum(np.abs(added[:, _TURN]), 0.5 * math.pi))
        return float(np.interp(ASTRAY, off, span, right=math.inf))


def _effects(span: Any, added: np.ndarray, before: np.ndarray, rate: Any, rate_now: Any) -> np.ndarray:
    """J (..., 6, 13): what parameters and levels of a moment do to each comparison `span` [s] later.

    added: what has been added up since; before: until then; the wheel's yaw rate [rad/s], then and now.
    """
    J = np.zeros((*added.shape[:-1], 6, _ALL))
    way, turn = added[..., _WAY], added[..., _TURN]
    J[..., 0, SPEED] = J[..., 5, SPEED] = J[..., 1, ZERO] = J[..., 4, _ALL - 1] = way
    J[..., 1, LEVER], J[..., 1, SLIP], J[..., 2, RATE] = turn, -added[..., _SLIDE], -span
    J[..., 3, SPEED] = J[..., 3, RATIO] = turn
    J[..., 3, WHEEL], J[..., 3, UNDERSTEER], J[..., 3, LATE] = (
        added[..., _BY_WHEEL],
        added[..., _BY_UNDERSTEER],
        rate - rate_now,
    )
    J[..., range(4), range(_N, _ALL)] = 1.0
    J[..., 4, _N + 1], J[..., 4, ZERO], J[..., 4, LEVER], J[..., 4, SLIP] = 1.0, way, turn, -added[..., _SLIDE]
    J[..., 4, SPEED] = J[..., 4, RATIO] = added[..., _TURNED] - before[..., _TURN] * way
    J[..., 4, WHEEL] = added[..., _W_WHEEL] - before[..., _BY_WHEEL] * way
    J[..., 4, UNDERSTEER] = added[..., _W_UNDER] - before[..., _BY_UNDERSTEER] * way
    J[..., 4, LATE] = rate * way - added[..., _W_RATE]
    return J
