"""Drives of cars whose data sheets are wrong, behind a vehicle-state estimator or without one; judged by the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from benchmarks.calibration_loop import OFFSET_OFF_DEG, mistold
from steerkit.diagram.simulation import simulate
from steerkit.diagram.units import degrees_of
from steerkit.metrics.signals import rates, rms
from steerkit.scenario import Scenario
from steerkit.scenario.drive import controller, drive_loop
from steerkit.task import DT

KINDS = ("none", "vehicle-state", "adaptive-state")
"""What stands between sensors and controllers."""
_LEAST, _MOST = (0.8, -0.3), (1.25, 0.3)
"""Of the tyres' stiffness over the data sheet's [1], and the gyro's zero [degrees/s]."""


@dataclass(frozen=True, kw_only=True)
class Seen:
    """One drive, from half of its time on; what is known of the car is the sensors' where there is no estimator."""

    rms_e: float
    """[m]"""
    rms_wheel_deg: float
    """RMS speed of the steering wheel [degrees/s]."""
    rms_side: float
    """Of the error to the side of what is known of the car's place [m]."""
    rms_heading: float
    """Of its heading's error [rad]."""
    max_e: float
    """From the first second on [m]."""
    nis_mean: float
    """Mean normalised innovation [1]; NaN without an estimator, and the next."""
    nis_share: float
    """How often they are within their 95 % bound [1]."""


def unlike(number: int, estimator: str) -> Scenario:
    """A production car by its number as estimator and controllers are told of it, under `hard` sensors.

    As in `mistold` the ratio is 25 % off, the commands' offset 3 degrees, and the dead time that is told 0.2 s; the
    measured wheel is 3 degrees off as well, either way, tyres by 20 to 25 % and the gyro's zero by up to 0.3 degrees/s.
    """
    wrong, _ = mistold(number)
    tyres, zero = np.random.default_rng((number, 7)).uniform(_LEAST, _MOST)
    side = 1.0 - 2.0 * (number >> 3 & 1)
    assert wrong.believed_delay is not None
    told = wrong.believed_delay - (0.0 if estimator == "none" else wrong.latency)  # behind one, nothing is late
    return replace(
        wrong,
        estimator=estimator,
        believed_delay=round(max(told, 0.0), 3),
        sensing="no sideslip",
        reference="own",
        tyres=float(tyres),
        wheel_zero_deg=side * OFFSET_OFF_DEG,
        gyro_zero_deg=float(zero),
    )


def driven(name: str, number: int, estimator: str, seconds: float) -> Seen:
    """That controller's drive of so many seconds of that car."""
    scenario = unlike(number, estimator)
    loop = drive_loop(scenario, controller(name, scenario), seed=number)
    log = simulate(loop, seconds, every=round(DT / loop.dt), allow_nonfinite=True)
    late = log.t >= 0.5 * seconds
    known = "sensors" if estimator == "none" else "estimator"
    car, seen = ({key: log[f"{part}.{key}"][late] for key in ("x", "y", "psi")} for part in ("car", known))
    c, s = np.cos(car["psi"]), np.sin(car["psi"])
    side = c * (seen["y"] - car["y"]) - s * (seen["x"] - car["x"])
    turned = np.angle(np.exp(1j * (seen["psi"] - car["psi"])))
    mean = share = float("nan")
    if estimator != "none":
        nis, count = log["estimator.nis"][late], log["estimator.nis_count"][late]
        mean, share = float(nis.sum() / count.sum()), float(np.mean(nis <= chi2.ppf(0.95, 4)))
    e = log["path.e"]
    return Seen(
        rms_e=rms(e[late]),
        rms_wheel_deg=rms(degrees_of(rates(log.t[late], log["car.delta_sw"][late]))),
        rms_side=rms(side),
        rms_heading=rms(turned),
        max_e=float(np.abs(e[log.t >= 1.0]).max()),
        nis_mean=mean,
        nis_share=share,
    )
