"""The true car, its motor and its course: a single track with saturating tyres, written without the product's."""

import math
from dataclasses import dataclass, field

import numpy as np

MASS, INERTIA, FRONT, REAR, RATIO = 1639.0, 2824.0, 1.2195, 1.4905, 15.6
STIFF_FRONT, STIFF_REAR, GRIP = 197e3, 255e3, 0.9
LENGTH = FRONT + REAR
NEAR = 120
"""So many points of the course to either side of the last nearest one are looked at."""


class Course:
    """Arcs and straights with clothoids between: (length [m], curvature [1/m]) one after the other."""

    def __init__(self, parts: list[tuple[float, float]], *, closed: bool, ease: float = 12.0):
        step = 0.05
        kappa = np.concatenate([np.full(round(length / step), bend) for length, bend in parts])
        window = round(ease / step)
        kernel = np.full(window, 1.0 / window)
        wide = np.concatenate([kappa[-window:], kappa, kappa[:window]]) if closed else np.pad(kappa, window, "edge")
        self.kappa = np.convolve(wide, kernel, "same")[window:-window]
        self.psi = np.concatenate([[0.0], np.cumsum(self.kappa * step)[:-1]])
        middle = self.psi + 0.5 * self.kappa * step
        self.x = np.concatenate([[0.0], np.cumsum(np.cos(middle) * step)[:-1]])
        self.y = np.concatenate([[0.0], np.cumsum(np.sin(middle) * step)[:-1]])
        self.step, self.closed, self.length = step, closed, step * len(kappa)
        beyond = "wrap" if closed else "edge"
        self._x, self._y = np.pad(self.x, NEAR, beyond), np.pad(self.y, NEAR, beyond)

    def csv(self) -> str:
        every = round(1.0 / self.step)
        rows = [f"{x:.4f},{y:.4f}" for x, y in zip(self.x[::every], self.y[::every])]
        return "x,y\n" + "\n".join(rows) + "\n"

    def at(self, x: float, y: float, near: int | None = None) -> tuple[int, float, float]:
        """(nearest point, e [m] + = left, heading of the course [rad])."""
        n = len(self.x)
        if near is None:
            i = int(np.argmin((self.x - x) ** 2 + (self.y - y) ** 2))
        else:
            some = slice(near, near + 2 * NEAR + 1)
            i = near - NEAR + int(np.argmin((self._x[some] - x) ** 2 + (self._y[some] - y) ** 2))
            i = i % n if self.closed else min(max(i, 0), n - 1)
        psi = float(self.psi[i])
        return i, -(x - float(self.x[i])) * math.sin(psi) + (y - float(self.y[i])) * math.cos(psi), psi


def stadium() -> Course:
    """Two straights, two half circles of 25 m radius; the clothoids of `ease` keep the circles whole."""
    half = math.pi * 25.0
    return Course([(40.0, 0.0), (half, 0.04), (80.0, 0.0), (half, 0.04), (40.0, 0.0)], closed=True)


def road() -> Course:
    """An open road with a bend, no longer than it takes to engage and to be told of its end."""
    return Course([(10.0, 0.0), (25.0, 0.03), (25.0, 0.0)], closed=False)


@dataclass
class Car:
    """The car and its steering motor; SI, e at the front axle."""

    course: Course
    x: float = 0.0
    y: float = 0.0
    psi: float = 0.0
    v: float = 5.0
    slide: float = 0.0
    """Lateral speed [m/s]."""
    r: float = 0.0
    wheel: float = 0.0
    """True steering-wheel angle [rad]."""
    a_y: float = 0.0
    near: int | None = field(default=None)
    kinematic: bool = False
    """Does it roll where its wheels point at any speed?"""

    def steer(self, target: float, dt: float) -> None:
        """The motor, or the human's hands: lag 0.1 s, at most 550 degrees a second."""
        rate = max(-9.6, min(9.6, (target - self.wheel) / 0.1))
        self.wheel += rate * dt

    def move(self, dt: float, v: float) -> None:
        """One Euler step; the human keeps the speed v [m/s]."""
        self.v += max(-3.0, min(3.0, (v - self.v) / 0.3)) * dt
        delta, speed = self.wheel / RATIO, max(abs(self.v), 0.5)
        load_front, load_rear = MASS * 9.81 * REAR / LENGTH, MASS * 9.81 * FRONT / LENGTH
        slip_front = delta - math.atan2(self.slide + FRONT * self.r, speed)
        slip_rear = -math.atan2(self.slide - REAR * self.r, speed)
        most_front, most_rear = GRIP * load_front, GRIP * load_rear
        force_front = most_front * math.tanh(STIFF_FRONT * slip_front / most_front)
        force_rear = most_rear * math.tanh(STIFF_REAR * slip_rear / most_rear)
        if self.v > 1.0 and not self.kinematic:
            slide = (force_front * math.cos(delta) + force_rear) / MASS - self.v * self.r
            turn = (FRONT * force_front * math.cos(delta) - REAR * force_rear) / INERTIA
            self.slide += slide * dt
            self.r += turn * dt
            self.a_y = (force_front * math.cos(delta) + force_rear) / MASS
        else:  # a slow car rolls where its wheels point
            self.r = self.v * math.tan(delta) / LENGTH
            self.slide = REAR * self.r
            self.a_y = self.v * self.r
        self.psi += self.r * dt
        self.x += (self.v * math.cos(self.psi) - self.slide * math.sin(self.psi)) * dt
        self.y += (self.v * math.sin(self.psi) + self.slide * math.cos(self.psi)) * dt

    def error(self) -> tuple[float, float, float]:
        """e [m] at the front axle, psi_e [rad], curvature there [1/m]."""
        x, y = self.x + FRONT * math.cos(self.psi), self.y + FRONT * math.sin(self.psi)
        self.near, e, psi = self.course.at(x, y, self.near)
        return e, math.remainder(self.psi - psi, 2.0 * math.pi), float(self.course.kappa[self.near])


def stanley(e: float, psi_e: float, v: float, r: float, kappa: float) -> float:
    """What the attacker's client and its human steer [rad at the wheel]: front-axle Stanley with yaw damping.

    They cut bends by 0.1 to 0.2 m, as people do.
    """
    return _turned(REAR * kappa, e, psi_e, v, r, kappa)


def centred(e: float, psi_e: float, v: float, r: float, kappa: float) -> float:
    """The same with the front tyres' slip in a bend in its right place: what an exact driver steers."""
    return _turned(MASS * REAR / (LENGTH * STIFF_FRONT) * v * v * kappa, e, psi_e, v, r, kappa)


def _turned(ahead: float, e: float, psi_e: float, v: float, r: float, kappa: float) -> float:
    delta = ahead - psi_e - math.atan2(2.0 * e, 1.0 + abs(v)) - 0.12 * (r - v * kappa)
    return max(-9.0, min(9.0, RATIO * delta))
