"""What was identified: estimates with intervals, the car they make, and how well it predicts a drive."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import known, require
from steerkit._support.files import write_text
from steerkit.compiled import compile
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Scalar
from steerkit.logs.drive import Array, Drive, moments
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.speed_driver import Playback
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.plots.style import COLOURS, new_figure, style
from steerkit.vehicles import Vehicle
from steerkit.vehicles.file import vehicle_text

REZERO = 15.0
"""Driving from which the wheel's zero is found again, in the second figure of a prediction [s]."""
OPEN = {
    "steer_ratio": "car.vehicle.steer_ratio",
    "delay": "drive.delay",
    "lag": "actuator.lag",
    "offset": "actuator.offset",
}
"""Parameters that are fields of blocks."""
_SLOW_ENOUGH = 0.01  # [s], a step at which every car within the bounds is integrated stably
_PAUSE = 0.04  # share of the axis between the fitted and the held-out drive


def stiffnesses(base: Vehicle, d_f: Scalar, d_r: Scalar) -> tuple[Scalar, Scalar]:
    """(c_f, c_r) [N/rad] of cornering compliances d_f, d_r [rad s^2/m]: c_f = m l_r/(L d_f), c_r = m l_f/(L d_r).

    A compliance is the slip angle of an axle per lateral acceleration, and K = d_f - d_r.
    Source: Bundorf, Leffert 1976 (in degrees per g).
    """
    per = base.m / base.wheelbase
    return per * base.l_r / d_f, per * base.l_f / d_r


class Simulator:
    """Yaw rates of the model for a drive's steering and speed; compiled once, then run for any parameters.

    The delay is that of continuous time: what the sampled loop adds by holding its signals is taken off.
    steering and speed: recorded; model: `Playback`, `SteeringActuator`, `LinearSingleTrack`.
    """

    def __init__(self, drive: Drive, base: Vehicle):
        self.drive, self.base = drive, base
        play = Playback(angles=tuple(drive.delta_sw.tolist()), speeds=tuple(drive.v.tolist()), dt=drive.dt)
        # the wheel may turn as fast as it was recorded to turn: no rate limit acts
        actuator = SteeringActuator(limit=30.0, rate_limit=200.0, dt=drive.dt)
        substeps = math.ceil(drive.dt / _SLOW_ENOUGH - 1e-9)
        car = LinearSingleTrack(vehicle=base, dt=drive.dt, substeps=substeps, v0=float(drive.v[0]))
        loop = Loop(
            blocks={"drive": play, "actuator": actuator, "car": car},
            wires=[(play.delta_sw, actuator.delta_sw_cmd), (actuator.delta_sw, car.delta_sw_cmd), (play.v, car.v_cmd)],
        )
        names = (*OPEN.values(), "car.vehicle.c_f", "car.vehicle.c_r")
        self._compiled = compile(loop, record=["car.r"], parameters=names)

    def yaw_rates(self, sets: list[dict[str, float]]) -> Array:
        """Yaw rate (n, len(sets)) [rad/s] for each set of steer_ratio, delay, lag, offset, d_f, d_r."""
        each = {name: np.array([one[name] for one in sets]) for name in sets[0]}
        c_f, c_r = stiffnesses(self.base, each["d_f"], each["d_r"])
        values = {field: each[name] for name, field in OPEN.items()}
        values["drive.delay"] = each["delay"] - self.drive.dt  # actuator and car hold their inputs: dt/2 late each
        values |= {"car.vehicle.c_f": c_f, "car.vehicle.c_r": c_r}
        log = self._compiled.run(len(self.drive.v) * self.drive.dt, parameters=values)
        return log["car.r"]


@dataclass(frozen=True)
class Estimate:
    """A parameter with its 95 % interval and its source: the log, the prior, or both."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    learned: float
    """Share of the prior's variance that the log took away, 0 to 1; NaN for a parameter that was given."""
    note: str = ""

    @property
    def source(self) -> str:
        """`log` (9/10 of the prior's variance is gone), `log and prior` (1/2), `prior`, or `given`."""
        if math.isnan(self.learned):
            return "given"
        return "log" if self.learned > 0.9 else "log and prior" if self.learned > 0.5 else "prior"


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """A drive's yaw rate as the identified car has it, next to the measured one."""

    drive: Drive
    r: Array
    """Predicted yaw rate (n,) [rad/s]."""
    rms: float
    """Root mean square of measured minus predicted, all recorded samples [rad/s]."""
    rms_driving: float
    """The same at 3 m/s and above [rad/s]."""
    mean_driving: float
    """Mean of measured minus predicted at 3 m/s and above [rad/s]."""
    rms_rezeroed: float
    """With the wheel's zero found again on the first 15 s of driving, and judged on the rest [rad/s]."""
    zero_shift: float
    """By how much that zero differs, at the steering wheel [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Identified:
    """The outcome of `identify`."""

    vehicle: Vehicle
    """The car: the base's mass, inertia and geometry, with steering ratio and cornering stiffnesses as found."""
    estimates: tuple[Estimate, ...]
    drive: Drive
    base: Vehicle
    theta: dict[str, float]
    """Of the model: among them the pure delay from steering wheel to road wheels and the first-order lag after it [s],
    the offset, which must be added to the recorded angle [rad], and rate_zero, that of the yaw rate [rad/s]."""
    covariance: Array
    """Of the free parameters, in the order of `free`."""
    free: tuple[str, ...]
    fit: Prediction
    correlation_time: float
    """Integrated correlation time of the residual [s]; the log counts as so many independent samples fewer."""
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Estimate:
        by_name = {estimate.name: estimate for estimate in self.estimates}
        return by_name[known(name, by_name, "estimate")]

    def predict(self, drive: Drive) -> Prediction:
        """Another drive of the same car, from its steering and speed alone."""
        return predict(Simulator(drive, self.base), self.theta)

    def text(self, *, command: str = "", held_out: Prediction | None = None) -> str:
        """The vehicle file: TOML with the car, its steering, the intervals and where they come from."""
        provenance: dict[str, Any] = {
            "log": self.drive.name,
            "sha256": self.drive.digest,
            "seconds": round(len(self.drive.v) * self.drive.dt, 3),
            "repairs": list(self.drive.notes),
            "notes": list(self.notes),
            "base": f"{self.base.name}: m, i_z, l_f, l_r, mu are given, not identified",
            "fit_rms": round(self.fit.rms, 6),
        }
        if held_out is not None:
            provenance |= {
                "held_out": held_out.drive.name,
                "held_out_sha256": held_out.drive.digest,
                "held_out_rms": round(held_out.rms, 6),
            }
        provenance |= {"command": command} if command else {}
        steering = {name: self.theta[name] for name in ("delay", "lag", "offset")}
        return vehicle_text(self.vehicle, steering=steering, estimates=self.intervals, provenance=provenance)

    @property
    def intervals(self) -> dict[str, dict[str, Any]]:
        """Value, 95 % interval, unit and source of each estimate."""
        keys = ("value", "low", "high", "unit", "source")
        return {e.name: {key: getattr(e, key) for key in keys} for e in self.estimates}

    def save(self, file: str | Path, *, command: str = "", held_out: Prediction | None = None) -> None:
        """Write the vehicle file; `vehicle(file)` and `steering_of(file)` read it."""
        require(str(file).endswith(".toml"), "Identified.save", f"{file}: a vehicle file ends in .toml")
        write_text(file, self.text(command=command, held_out=held_out))

    def plot(self, held_out: Prediction | None = None) -> Any:
        """Yaw rate, residual and speed over time, the held-out drive after the fitted one; beside them a scatter plot.

        A matplotlib figure.
        """
        parts = [(self.fit, "fitted", COLOURS["learned"])]
        if held_out is not None:
            parts.append((held_out, "held out", COLOURS["analytic"]))
        pause = _PAUSE * sum(part.drive.t[-1] for part, _, _ in parts)
        with style():
            title = f"{self.vehicle.name}: yaw rate from steering wheel and speed alone"
            figure, (cloud, rate, left, speed) = new_figure(3, map_beside=True, title=title)
            start = 0.0
            for part, word, colour in parts:
                drive = part.drive
                t = start + drive.t
                hidden = ~drive.measured
                measured, error = np.where(hidden, np.nan, drive.r), np.where(hidden, np.nan, drive.r - part.r)
                rate.plot(t, measured, color=COLOURS["muted"], lw=2.2, alpha=0.7, label=None if start else "measured")
                rate.plot(t, part.r, color=colour, lw=0.8, label=f"predicted, {word}")
                left.plot(t, 1e3 * error, color=colour, lw=0.6, label=f"{word}: RMS {1e3 * part.rms:.2f} mrad/s")
                speed.plot(t, drive.v, color=colour, lw=1.0)
                use = drive.driving
                cloud.plot(drive.r[use], part.r[use], ".", color=colour, ms=1.2, alpha=0.5, rasterized=True)
                start = t[-1] + pause
            if held_out is not None:
                again = f"zero of the wheel found again: {1e3 * held_out.rms_rezeroed:.2f} mrad/s"
                left.plot([], [], " ", label=again)
            reach = 1.05 * max(float(np.abs(part.drive.r).max()) for part, _, _ in parts)
            cloud.plot([-reach, reach], [-reach, reach], color=COLOURS["ink"], lw=0.6)
            cloud.set(
                aspect="equal",
                xlabel="measured yaw rate [rad/s]",
                ylabel="predicted yaw rate [rad/s]",
                xlim=(-reach, reach),
                ylim=(-reach, reach),
            )
            left.axhline(0.0, color=COLOURS["ink"], lw=0.6)
            rate.set_ylabel("yaw rate [rad/s]")
            left.set_ylabel("measured - predicted\n[mrad/s]")
            speed.set(ylabel="speed [m/s]", xlabel="t [s], one drive after the other" if held_out else "t [s]")
            speed.set_ylim(bottom=0.0)
            for axis in (rate, left):
                axis.legend(loc="lower right", ncols=3, fontsize=7, handlelength=1.2, columnspacing=1.2)
                low, high = axis.get_ylim()
                axis.set_ylim(low - 0.22 * (high - low), high)
            rate.margins(x=0.01)
            return figure


def predict(simulator: Simulator, theta: dict[str, float]) -> Prediction:
    """The drive of a simulator with parameters theta."""
    drive, step = simulator.drive, 1e-3
    rates = simulator.yaw_rates([theta, theta | {"offset": theta["offset"] + step}])
    zero = 0.0 if drive.calibrated else theta["rate_zero"]
    predicted = rates[:, 0] + zero
    error = drive.r - predicted
    use = np.flatnonzero(drive.driving)
    rms_driving, mean = moments(error[use])
    slope = (rates[:, 1] - rates[:, 0]) / step
    first, later = np.split(use, [min(len(use) // 2, round(REZERO / drive.dt))])
    shift = float(slope[first] @ error[first] / (slope[first] @ slope[first]))
    return Prediction(
        drive=drive,
        r=predicted,
        rms=moments(error[drive.measured])[0],
        rms_driving=rms_driving,
        mean_driving=mean,
        rms_rezeroed=moments((error - shift * slope)[later])[0],
        zero_shift=shift,
    )
