"""Is the steering wired the wrong way round? The signs of motor, wheel sensor and gyro, told from driving."""

import math

import numpy as np

from steerkit.task import DT
from steerkit.vehicles.rollout import Rollout

CLEAR = 6.0
"""Evidence from which on a sign is certain [1]."""
DOUBTED = 1.0
"""The same where something else says that steering or sensors are wrong [1]."""
_MEMORY = 1.5
"""A sample of so long ago counts for 1/e [s]."""
_NOISE = 0.006
"""Standard deviation of what is no answer in a yaw rate [rad/s]."""
_MISFIT = 0.05
"""This share of the answer's variance no model explains: dead times between samples, tyres, a motor's lag [1]."""
_GAINS = 0.4, 2.5
"""An answer may be so much smaller or larger than expected [1]."""
_SIGNS = np.array([[1.0], [-1.0]])
"""Of the two regressions."""
_MOST = 4.0
"""Lateral acceleration beyond which tyres and motors no longer answer in proportion [m/s^2]."""
_SLOWEST = 0.5
"""Speed below which nothing is learned [m/s]."""
_LONGEST = 2.0, 0.6, 0.3
"""Dead times of wheel, yaw rate and heading [s]."""


class SignTest:
    """Does y answer x with a gain of +1 or of -1? For a dead time that nobody knows, up to `longest` [s].

    With sums over the samples, weighted by exp(-age/1.5 s), of x and y less their means (an offset is no answer),

        R(sign) = min over d and 0.4 <= g <= 2.5 of  sum (y(t) - sign g x(t - d))^2 dt,
        evidence = (R(+) - R(-))/(min R + 0.05 sum y(t)^2 dt + noise^2 1.5 s):

    a likelihood ratio of two regressions, the error of both bounded from below. It stays below 40; beyond `CLEAR`, 6,
    the sign -1 leaves over a seventh of what +1 does, or less. A swing is explained by both, whatever its dead time.
    x, y in rad/s, finite. Source: Lehmann, Romano 2005, section 7.3.
    """

    def __init__(self, longest: float, dt: float = DT):
        self._keep, self._dt, self._line = math.exp(-dt / _MEMORY), dt, np.zeros(round(longest / dt) + 1)
        self.forget()

    def forget(self) -> None:
        """Begin anew."""
        self._begun, self._of_y, self._of_x = False, (0.0, 0.0, 0.0), np.zeros((3, len(self._line)))

    def add(self, x: float, y: float) -> None:
        """A sample [rad/s]; before the first, x was what y is."""
        line, of_x, keep, dt = self._line, self._of_x, self._keep, self._dt
        line[1:] = line[:-1] if self._begun else y
        line[0], self._begun = x, True
        weight, of_y, of_yy = self._of_y
        self._of_y = keep * weight + dt, keep * of_y + dt * y, keep * of_yy + dt * y * y
        of_x *= keep
        weighed = dt * line
        of_x[0] += weighed
        of_x[1] += weighed * line
        of_x[2] += dt * y * line

    @property
    def evidence(self) -> float:
        """For -1 against +1 [1]."""
        if not self._begun:
            return 0.0
        weight, y, yy = self._of_y
        x, xx, xy = self._of_x
        yy, xx, xy = yy - y * y / weight, np.maximum(xx - x * x / weight, 1e-12), xy - x * y / weight
        ratio = _SIGNS * (xy / xx)
        gain = np.minimum(np.maximum(ratio, _GAINS[0]), _GAINS[1])
        right, wrong = np.maximum((yy + xx * gain * (gain - 2.0 * ratio)).min(axis=1), 0.0).tolist()
        return (right - wrong) / (min(right, wrong) + _MISFIT * yy + _NOISE**2 * _MEMORY)


class SteeringSigns:
    """Which of motor, wheel sensor and gyro has the wrong sign: for a car that drives, and for a simulated one.

    Three `SignTest`s, all of yaw rates: what the command asks for, r = v tan(delta)/(L + K v^2), and the measured
    wheel's; the wheel's and the gyro's; the gyro's and the heading's. A motor that turns the other way contradicts the
    first; a wheel sensor the first two, a gyro the last two. What is certain stays so until the contrary is.
    """

    def __init__(self, car: Rollout, dt: float = DT):
        self._car, self._dt = car, dt
        self._tests = [SignTest(longest, dt) for longest in _LONGEST]
        self._t, self._psi = -math.inf, math.nan
        self.evidence, self._certain = [0.0] * 3, [0.0] * 3

    def forget(self) -> None:
        """Begin anew with the motor: it can only be tried by engaging."""
        self._tests[0].forget()
        self.evidence[0] = self._certain[0] = 0.0

    def add(self, t: float, *, command: float, wheel: float, v: float, r: float, psi: float) -> None:
        """What is known at time t [s, rad, m/s, rad/s]; command: NaN while none acts. One sample in dt is used."""
        dt = t - self._t
        if dt < self._dt - 1e-6:
            return
        turn = math.remainder(psi - self._psi, 2.0 * math.pi) / dt
        self._t, self._psi = t, psi
        if dt > 3.0 * self._dt or not (abs(v) >= _SLOWEST and math.isfinite(wheel + r + turn)):
            for test in self._tests:
                test.forget()
            return
        asked, wheeled, r, turn = (
            max(-_MOST, min(_MOST, v * rate)) / v for rate in (self._rate(command, v), self._rate(wheel, v), r, turn)
        )
        motor, sensor, gyro = self._tests
        if math.isfinite(command):
            motor.add(asked, wheeled)
        else:
            motor.forget()
        sensor.add(wheeled, r)
        gyro.add(r, turn)
        self.evidence = [test.evidence for test in self._tests]
        self._certain = [new if abs(new) >= CLEAR else old for new, old in zip(self.evidence, self._certain)]

    def _rate(self, angle: float, v: float) -> float:
        car = self._car
        steep = math.tan(max(-1.2, min(1.2, angle / float(car.steer_ratio))))
        return v * steep / float(car.wheelbase + car.understeer * v * v)

    def wrong(self, least: float = CLEAR) -> str:
        """Which sign is wrong, in words, by evidence of `least` or by what is certain; else ""."""
        signs = list(zip(self.evidence, self._certain))
        if max(map(max, signs)) < least:
            return ""
        motor, wheel, gyro = (max(sign) >= DOUBTED for sign in signs)
        answers, follows, heads = (min(sign) <= -DOUBTED for sign in signs)
        if motor and not wheel:
            other = "" if follows else ", or of the wheel's sensor (delta_sw)"
            return f"the wheel turns against the command: check the sign of the command (delta_sw_cmd){other}"
        if motor:
            return "the wheel's angle goes against command and car: check the sign of its sensor (delta_sw)"
        if not wheel:
            return "the yaw rate goes against the heading: check the sign of the yaw rate (r), or of the heading (psi)"
        if gyro:
            return "the yaw rate goes against wheel and heading: check the sign of the yaw rate (r)"
        both = " and of the command (delta_sw_cmd)" if answers else ""
        other = "the whole pose" if heads else "the yaw rate (r)"
        return f"the car turns against its wheel: check the sign of the wheel (delta_sw){both}, or of {other}"
