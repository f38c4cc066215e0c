"""A car's state after a sample's measurements: which of them are used, and what is remembered of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

from steerkit.diagram import maths as m
from steerkit.diagram.maths import Scalar
from steerkit.estimators.arrivals import Arrived
from steerkit.estimators.gauss import Covariance, corrected, covariance, widened
from steerkit.estimators.motion import Rhs, course

X, Y, PSI, SWAY, R, V, A, D_X, D_Y, D_PSI, HEADING, GYRO, WHEEL = range(13)
"""The estimated numbers, in the order of the state: the motion with the acceleration, then errors of sensors."""
NEVER = 1e9
"""s: `unseen` of a car of which no position has come yet."""
_LEAST = 1e-10
"""Least variance of a measurement, in SI units: 0.01 mm or mm/s, 0.01 mrad or mrad/s."""
_ABSURD = 1e7
"""Metres, radians and the like by which a measurement is no measurement."""
_X_SUM, _Y_SUM = (X, D_X), (Y, D_Y)
"""What a measured position is the sum of."""


class Memory(NamedTuple):
    """What the filter has to know of earlier measurements."""

    unseen: Scalar
    """Time since the last position that was used [s]."""
    position: Scalar
    """For how long positions have been rejected [s]; then speeds, yaw rates, headings."""
    speed: Scalar
    gyro: Scalar
    heading: Scalar
    turning: Scalar
    """The gyro's innovation over its deviation, averaged over `doubt_time` [1]; then the heading's, and to the side."""
    turned: Scalar
    aside: Scalar
    wheel: Scalar
    """The steering wheel's angle at the filter's time [rad]; held where none was heard."""
    held: Scalar
    """Is it?"""
    rejected: Scalar
    """Was a measurement of the last sample rejected?"""
    missing: Scalar
    """Was one of them, or the wheel's angle, not there?"""
    nis: Scalar
    """Sum of its squared normalised innovations [1]."""
    nis_count: Scalar
    """How many there were [1]."""


@dataclass(frozen=True, kw_only=True)
class Correction:
    """How measurements correct a state: the white noise of sensors, the gate, the times; see `VehicleState`."""

    position_noise: Scalar
    psi_noise: Scalar
    v_noise: Scalar
    r_noise: Scalar
    gate: float
    patience: float
    doubt_time: float
    dt: float

    def measured(
        self, rhs: Rhs, mean: Sequence[Scalar], p: Covariance, due: Arrived, memory: Memory, delta: Scalar
    ) -> tuple[Sequence[Scalar], Covariance, Memory]:
        """Means and covariances after what was measured at their time, and what is to be remembered of it."""
        speed, _ = course(rhs, mean[SWAY], mean[R], delta, mean[V])
        nis = count = rejected = 0.0
        waits, means = [], []
        # speed, yaw rate and heading, one by one, each against what is known after those before it
        for k, (states, doubted, deviation) in enumerate(
            (
                ((V,), (V,), self.v_noise),
                ((R, GYRO), (R, GYRO), self.r_noise),
                ((PSI, D_PSI, HEADING), (PSI, HEADING), self.psi_noise),
            )
        ):
            known = sum([mean[i] for i in states])
            missed = (due.v - speed, due.r - known, m.wrap(due.psi + due.lead * mean[R] - known))[k]
            noise = deviation**2 + _LEAST
            square = missed * missed / (covariance(p, states, states) + noise)
            here = m.absolute(missed) < _ABSURD
            used, lasted, wait = self._judged(square, here, memory[2 + k])
            p = widened(p, {i: m.where(lasted, missed * missed, 0.0) for i in doubted})
            mean, p = corrected(mean, p, states, missed, noise, used)
            rejected = m.where(m.both(here, wait > 0.0), 1.0, rejected)
            waits.append(wait)
            if k > 0:
                means.append(self._mean_of(memory[4 + k], m.sign(missed) * m.sqrt(square), here))
                nis, count = nis + m.where(here, square, 0.0), count + m.where(here, 1.0, 0.0)
        # the position, as a whole
        way_x, way_y, *_ = rhs((*mean[:PSI], mean[PSI] - 0.5 * due.lead * mean[R], *mean[SWAY:V]), delta, mean[V])
        x, y = due.x + due.lead * way_x, due.y + due.lead * way_y
        noise, never = self.position_noise**2 + _LEAST, memory.unseen >= NEVER
        missed_x, missed_y = x - mean[X] - mean[D_X], y - mean[Y] - mean[D_Y]
        xx, yy = covariance(p, _X_SUM, _X_SUM) + noise, covariance(p, _Y_SUM, _Y_SUM) + noise
        xy = covariance(p, _X_SUM, _Y_SUM)
        distance = yy * missed_x * missed_x - 2.0 * xy * missed_x * missed_y + xx * missed_y * missed_y
        distance = distance / (xx * yy - xy * xy)
        here = m.both(m.absolute(missed_x) < _ABSURD, m.absolute(missed_y) < _ABSURD)
        used, lasted, wait = self._judged(0.5 * distance, here, m.where(never, 2.0 * self.patience, memory.position))
        more_x, more_y = (m.where(lasted, missed * missed, 0.0) for missed in (missed_x, missed_y))
        moved_on = m.where(never, 0.0, 1.0)
        p = widened(p, {X: more_x, Y: more_y, D_X: moved_on * more_x, D_Y: moved_on * more_y})
        c, s = m.cos(mean[PSI]), m.sin(mean[PSI])
        across = m.sqrt(m.maximum(c * c * yy - 2.0 * s * c * xy + s * s * xx, _LEAST))
        means.append(self._mean_of(memory.aside, (c * missed_y - s * missed_x) / across, here))
        nis, count = nis + m.where(here, distance, 0.0), count + m.where(here, 2.0, 0.0)
        rejected = m.where(m.both(here, wait > 0.0), 1.0, rejected)
        mean, p = corrected(mean, p, _X_SUM, missed_x, noise, used)
        mean, p = corrected(mean, p, _Y_SUM, y - mean[Y] - mean[D_Y], noise, used)
        unseen = m.where(used, 0.0, memory.unseen + self.dt)
        return (
            mean,
            p,
            Memory._make((unseen, wait, *waits, *means, memory.wheel, memory.held, rejected, 0.0, nis, count)),
        )

    def _judged(self, square: Scalar, here: Scalar, wait: Scalar) -> tuple[Scalar, Scalar, Scalar]:
        """Is a measurement used; is it, as it has been off for long; and for how long it is now."""
        near = square <= self.gate * self.gate
        wait = m.where(here, m.where(near, 0.0, wait + self.dt), wait)
        lasted = m.both(here, wait > self.patience)
        return m.both(here, m.either(near, lasted)), lasted, m.where(lasted, 0.0, wait)

    def _mean_of(self, slow: Scalar, missed: Scalar, here: Scalar) -> Scalar:
        """The running mean of innovations over their deviation, each within the gate."""
        step = self.dt / self.doubt_time * (m.clip(missed, -self.gate, self.gate) - slow)
        return m.where(here, slow + step, slow)
