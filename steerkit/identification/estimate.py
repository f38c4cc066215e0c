"""What was identified: estimates with intervals, the car they make, and how well it predicts a drive."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import write_text
from steerkit.identification.model import Simulator, stiffnesses
from steerkit.logs.drive import Array, Drive, moments
from steerkit.vehicles import Vehicle
from steerkit.vehicles.file import vehicle_text

REZERO = 15.0
"""Driving from which the wheel's zero is found anew, in the second figure of a prediction [s]."""


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A parameter with its 95 % interval, and who told it: the log, the prior, or both."""

    name: str
    value: float
    low: float
    high: float
    unit: str
    learned: float
    """Share of the prior's variance that the log took away, 0 to 1; NaN for a parameter that was given."""
    note: str = ""

    @property
    def told_by(self) -> str:
        """`log` (9/10 of the prior's variance is gone), `log and prior` (1/2), `prior`, or `given`."""
        if math.isnan(self.learned):
            return "given"
        return "log" if self.learned > 0.9 else "log and prior" if self.learned > 0.5 else "prior"


@dataclass(frozen=True, eq=False, kw_only=True)
class Prediction:
    """A drive's yaw rate as the identified car has it, next to the measured one."""

    drive: Drive
    r: Array
    """DelayPredictor yaw rate (n,) [rad/s]."""
    rms: float
    """Root mean square of measured minus predicted, all recorded samples [rad/s]."""
    rms_driving: float
    """The same at 3 m/s and above [rad/s]."""
    mean_driving: float
    """Mean of measured minus predicted at 3 m/s and above [rad/s]."""
    rms_rezeroed: float
    """With the wheel's zero found anew on the first 15 s of driving, and judged on the rest [rad/s]."""
    zero_shift: float
    """By how much that zero differs, at the steering wheel [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Identified:
    """The outcome of `identify`."""

    vehicle: Vehicle
    """The car: the base's mass, inertia and geometry, with steering ratio and cornering stiffnesses as found."""
    delay: float
    """Pure delay from steering wheel to road wheels [s]."""
    lag: float
    """First-order lag after it [s]."""
    offset: float
    """What must be added to the recorded angle, at the steering wheel [rad]."""
    rate_zero: float
    """Zero of the recorded yaw rate [rad/s]."""
    estimates: tuple[Estimate, ...]
    drive: Drive
    base: Vehicle
    theta: dict[str, float]
    covariance: Array
    """Of the free parameters, in the order of `free`."""
    free: tuple[str, ...]
    fit: Prediction
    correlation_time: float
    """Integrated correlation time of the residual [s]; the log counts as so many independent samples fewer."""
    notes: tuple[str, ...] = ()

    def __getitem__(self, name: str) -> Estimate:
        by_name = {estimate.name: estimate for estimate in self.estimates}
        if name not in by_name:
            raise KeyError(f"no estimate '{name}'; there are {', '.join(by_name)}")
        return by_name[name]

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
        steering = {"delay": self.delay, "lag": self.lag, "offset": self.offset}
        tables = {
            e.name: {"value": e.value, "low": e.low, "high": e.high, "unit": e.unit, "told_by": e.told_by}
            for e in self.estimates
        }
        return vehicle_text(self.vehicle, steering=steering, estimates=tables, provenance=provenance)

    def save(self, file: str | Path, *, command: str = "", held_out: Prediction | None = None) -> None:
        """Write the vehicle file; `vehicle(file)` and `steering_of(file)` read it."""
        require(str(file).endswith(".toml"), "Identified.save", f"{file}: a vehicle file ends in .toml")
        write_text(file, self.text(command=command, held_out=held_out))

    def plot(self, held_out: Prediction | None = None) -> Any:
        """Measured and predicted yaw rate and the residuals, as a matplotlib figure."""
        from steerkit.identification.pictures import residuals

        return residuals(self, held_out)


def car_of(base: Vehicle, theta: dict[str, float], name: str) -> Vehicle:
    """The base with what was found."""
    c_f, c_r = stiffnesses(base, theta["d_f"], theta["d_r"])
    return replace(base, name=name, steer_ratio=theta["steer_ratio"], c_f=float(c_f), c_r=float(c_r))


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
