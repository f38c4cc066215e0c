"""Transitions of a drive that was recorded elsewhere, and whether it shows enough of the car to learn from."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require, require_within
from steerkit.controllers.delay_compensator import LONGEST
from steerkit.controllers.policy import DOE, E_DOT, PSI_E, StateDescription, V
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of
from steerkit.doe import OutputElement
from steerkit.learning.data import distance
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.learner_state import TURNED
from steerkit.learning.nfq.dead_time import aligned, dead_time_of
from steerkit.learning.nfq.model import follow, speed
from steerkit.task import DT
from steerkit.vehicles import Vehicle

Array = NDArray[Any]

BENDS = "drive bends, to both sides, that need 30 degrees of the wheel and more"
SMOOTH = 31
"""Samples of the cubics that make a path of where the car went: 1.5 s."""
BLOCK = 40
"""Samples of the blocks within which what the car leaves unexplained may hang together: 2 s."""
NEEDED: Mapping[str, tuple[float, str, str]] = {
    "seconds": (40.0, "s of driving at 3 m/s or faster", "drive for two minutes"),
    "rate_deg": (8.0, "deg/s of wheel, RMS (less is hidden by play and noise)", BENDS),
    "gain_percent": (2.0, "% deviation of the steering's gain", BENDS),
    "delay_ms": (20.0, "ms deviation of the dead time", "turn the wheel to and fro, as in a slalom"),
    "straight_deg": (1.5, "degrees of deviation of the straight-ahead angle", "add straights and bends to both sides"),
    "unexplained_percent": (20.0, "% of the car's turning that the wheel does not explain", BENDS),
}
_LEAST = ("seconds", "rate_deg")
"""Of an `Excitation`: these at least, the others in NEEDED at most; there in words, with what to drive besides."""


def as_driven(drive: Any, vehicle: Vehicle, *, delay: float = 0.0, lag: float = 0.0) -> Log:
    """A recorded drive as a drive along its own path, with the signals of a learning run's.

    The path is that of the front axle, by dead reckoning, smoothed by cubics over 1.5 s; with beta of a steady bend,

        beta = atan((l_r - m l_f v^2/(L c_r)) r/v),   psi = integral of r,
        p = integral of v (cos, sin)(psi + beta) + l_f (cos, sin)(psi),

    e, e_dot, psi_e, r_e and kappa are those of p against its smoothed self; `doe.state` is the command of the sample
    before. The car model that is learned of them does not depend on the path.

    drive: as `steerkit.logs.read_drive` gives it, on a clock of 0.05 s. vehicle: whose geometry, mass and rear tyres
    are believed. delay, lag: by how much later than its command the recorded wheel turns [s]: command(t) = (delta_sw +
    lag d(delta_sw)/dt)(t + delay); 0: it is the command. Raises ValueError for another clock, and for delays and lags
    that are not within 0 to 0.6 s.
    """
    from scipy.integrate import cumulative_trapezoid  # SciPy loads as slowly as all else that a drive needs
    from scipy.signal import savgol_filter

    where, dt = drive.name, drive.dt
    require(abs(dt - DT) < 1e-9, where, f"a clock of {dt:g} s, expected {DT:g} s: read_drive(..., dt={DT:g})")
    require(len(drive.v) > 2 * SMOOTH, where, f"{len(drive.v)} samples, expected more than {2 * SMOOTH}")
    for name, late in (("delay", delay), ("lag", lag)):
        require_within(where, name, late, "s", 0.0, LONGEST * DT)
    t, v, r = np.arange(len(drive.v)) * dt, np.maximum(drive.v, 0.1), drive.r
    l_f, l_r, length = float(vehicle.l_f), float(vehicle.l_r), float(vehicle.wheelbase)
    integral = partial(cumulative_trapezoid, dx=dt, initial=0.0)
    psi = integral(r)
    beta = np.arctan((l_r - float(vehicle.m) * l_f * v * v / (length * float(vehicle.c_r))) * r / v)
    x, y = integral(v * np.cos(psi + beta)), integral(v * np.sin(psi + beta))
    px, py = x + l_f * np.cos(psi), y + l_f * np.sin(psi)
    smooth = [[savgol_filter(z, SMOOTH, 3, deriv=n, delta=dt) for z in (px, py)] for n in range(3)]
    (sx, sy), (dx, dy), (ddx, ddy) = smooth
    along = np.maximum(np.hypot(dx, dy), 0.1)
    kappa = (dx * ddy - dy * ddx) / along**3
    psi_e = np.arctan2(np.sin(psi) * dx - np.cos(psi) * dy, np.cos(psi) * dx + np.sin(psi) * dy)
    command = np.interp(t + delay, t, drive.delta_sw + lag * np.gradient(drive.delta_sw, dt))
    s = integral(along)
    signals = {
        "path.e": (dx * (py - sy) - dy * (px - sx)) / along,
        "path.e_dot": v * np.sin(psi_e + beta) + r * l_f * np.cos(psi_e),
        "path.psi_e": psi_e,
        "path.progress": s,
        "path.s": s,
        "path.kappa": kappa,
        "path.r_e": r - v * kappa,
        "car.x": x,
        "car.y": y,
        "car.v": drive.v,
        "car.r": r,
        "car.a_y": v * (r + np.gradient(beta, dt)),
        "car.delta_sw": drive.delta_sw,
        "supervisor.delta_sw": command,
        "supervisor.learning": np.zeros(len(t)),
        "doe.state": np.concatenate((command[:1], command[:-1])),
    }
    return Log(t, signals, {})


SIGNALS = distance.SIGNALS | {"kappa": "path.kappa"}
"""Recorded column -> signal of a drive's log."""


def transitions_of(
    drive: Any, vehicle: Vehicle, element: OutputElement, largest: float, *, delay: float = 0.0, lag: float = 0.0
) -> tuple[Transitions, Log]:
    """A recorded drive's transitions, as of another's steering and with the column kappa, and its log (`as_driven`).

    The action is what `element` would have needed from one angle to the next; larger ones than `largest` [rad] are left
    out, as the motor may not follow, and so are headings beyond TURNED. Episodes end where the drive is not `driving`.
    vehicle, delay, lag: see `as_driven`, also for what is raised.
    """
    log = as_driven(drive, vehicle, delay=delay, lag=lag)
    s = np.column_stack([log[signal] for signal in SIGNALS.values()])
    limit = float(element.limit)
    s[:, DOE] = np.clip(s[:, DOE], -limit, limit)
    action = np.asarray(element.action_for(s[1:, DOE], s[:-1, DOE]), dtype=float)
    known = (log.t > 0.0) & (log.t <= log.t[-1] - delay)
    sound = drive.driving & known & (np.abs(s[:, PSI_E]) < TURNED)
    row = np.flatnonzero(sound[:-1] & sound[1:] & (np.abs(action) <= largest))
    episode = np.cumsum(np.diff(row, prepend=row[:1]) > 1)
    record = Transitions(tuple(SIGNALS), s[row], action[row], s[row + 1], episode, False)
    log.signals["controller.action"] = np.append(action, 0.0)
    return record, log


@dataclass(frozen=True, kw_only=True)
class Excitation:
    """How well a record determines its car, by least squares of the angle w = e_dot/v - psi_e on the wheel's angle:

        w = (gain + loss v^2) doe + late d(doe)/dt + constant,   doe: of the dead time before

    The covariance is the sandwich A^-1 (sum of g g') A^-1, A = X'X, g = X'residual of blocks of 2 s, within which what
    the line leaves unexplained hangs together. Deviations are those of gain at the mean speed, of -late/gain, and of
    the straight-ahead angle. Source: Ljung 1999, section 9.4; White 1982 (sandwich).
    """

    seconds: float
    """Usable driving [s]."""
    gain_percent: float
    """Deviation of the steering's gain [%]."""
    delay_ms: float
    """Deviation of the dead time [ms]."""
    straight_deg: float
    """Deviation of the wheel's straight-ahead angle [degrees]."""
    unexplained_percent: float
    """Share of w's variance that the wheel does not explain [%]."""
    wheel_deg: float
    """Largest |wheel| but for 1 % of the time [degrees]."""
    rate_deg: float
    """RMS speed of the wheel [deg/s], times (v/v0)^2 above v0 = `StateDescription.scaled_from`."""
    v_low: float
    """Speeds but for 1 % of the time at either end [m/s]."""
    v_high: float

    @classmethod
    def of(cls, record: Transitions, description: StateDescription, longest: float) -> "Excitation":
        """That of transitions with the column kappa; longest: dead time that is looked for [s]."""
        seconds = len(record) * DT
        if seconds < 10.0:  # nothing to say of them
            return cls(seconds=seconds, **dict.fromkeys(_OTHERS, math.nan))
        part = aligned(record, dead_time_of(record, min(LONGEST, round(longest / DT))))
        v, doe = speed(part.s), part.s_next[:, DOE]
        rate = (doe - part.s[:, DOE]) / DT
        w = part.s_next[:, E_DOT] / speed(part.s_next) - part.s_next[:, PSI_E]
        mean_v2 = float(np.mean(v * v))
        x = np.column_stack((doe, (v * v - mean_v2) * doe, rate, np.ones(len(doe))))
        information = x.T @ x + 1e-9 * np.eye(4)
        weights = np.linalg.solve(information, x.T @ w)
        rest = w - x @ weights
        block = np.cumsum(~follow(part)) * len(part) + np.arange(len(part)) // BLOCK
        scores = np.array([x[block == one].T @ rest[block == one] for one in np.unique(block)])
        inverse = np.linalg.inv(information)
        deviation = np.sqrt(np.diag(inverse @ (scores.T @ scores) @ inverse))
        gain = max(abs(float(weights[0])), 1e-9)
        low, high = np.percentile(record.s[:, V], (1.0, 99.0))
        return cls(
            seconds=seconds,
            gain_percent=100.0 * float(deviation[0]) / gain,
            delay_ms=1e3 * float(deviation[2]) / gain,
            straight_deg=degrees_of(float(deviation[3]) / gain),
            unexplained_percent=100.0 * float(np.mean(rest**2) / max(float(np.var(w)), 1e-12)),
            wheel_deg=degrees_of(float(np.percentile(np.abs(record.s[:, DOE]), 99.0))),
            rate_deg=degrees_of(float(np.sqrt(np.mean((rate * description.excess(v) ** 2) ** 2)))),
            v_low=float(low),
            v_high=float(high),
        )

    def require_enough(self, where: str) -> None:
        """Raise ValueError unless all that is NEEDED is there, saying what is, and what to drive instead."""
        lacks = []
        for name, (bound, what, advice) in NEEDED.items():
            value, least = getattr(self, name), name in _LEAST
            if value < bound if least else value > bound:
                lacks.append(f"{value:.3g} {what}, expected {bound:g} or {'more' if least else 'less'}: {advice}")
        require(not lacks, where, f"shows too little of the car to learn from: {'; '.join(lacks)}")

    def __str__(self) -> str:
        return (
            f"{self.seconds:.0f} s at {self.v_low:.1f} to {self.v_high:.1f} m/s, wheel to {self.wheel_deg:.0f} degrees "
            f"at {self.rate_deg:.0f} deg/s RMS; deviations: gain {self.gain_percent:.2g} %, dead time "
            f"{self.delay_ms:.0f} ms, straight ahead {self.straight_deg:.2g} degrees; not explained by the wheel "
            f"{self.unexplained_percent:.2g} %"
        )


_OTHERS = tuple(field.name for field in fields(Excitation) if field.name != "seconds")
