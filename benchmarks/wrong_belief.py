"""Closed-loop drives of cars whose data sheets are wrong in everything that controllers and estimators believe.

They are judged by the simulated truth. Part of the studies `calibration` and `vehicle_state`.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from steerkit.diagram.simulation import simulate
from steerkit.diagram.units import degrees_of
from steerkit.metrics.signals import largest, rates, rms
from steerkit.scenario import Scenario, fleet_scenario
from steerkit.scenario.drive import controller, drive_loop
from steerkit.task import DT

DELAY_OFF, OFFSET_OFF_DEG, RATIOS = 0.2, 3.0, (0.8, 1.25)
"""Error of what is believed: dead time [s] and offset [degrees], to either side; true ratio over the data sheet's."""
_LEAST, _MOST = (0.8, -0.3), (1.25, 0.3)
"""Of the tyres' stiffness over the data sheet's [1], and the gyro's zero [degrees/s]."""
_FIRST = 1.0
"""Time from which on no error may be large [s]."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One drive, from half of its time on; the known pose is the estimator's, or without one the sensors'."""

    rms_e: float
    """[m]"""
    max_e: float
    """From the first second on [m]."""
    rms_wheel_deg: float
    """RMS speed of the steering wheel [degrees/s]."""
    rms_side: float = math.nan
    """Error of the known position to the side [m]; this and the following where the scenario has sensors."""
    rms_heading: float = math.nan
    """Error of the known heading [rad]."""
    nis_mean: float = math.nan
    """Mean normalised innovation [1]; NaN without an estimator, and the next."""
    nis_share: float = math.nan
    """How often they are within their 95 % bound [1]."""


def wrong_belief(number: int) -> tuple[Scenario, Scenario]:
    """A production car by its number as controllers believe it to be, and the same with true parameters.

    `fleet_scenario`'s car, lag, free play and course, under `hard` sensors. The ratio is off by 25 % either way, the
    wheel by 3 degrees, the believed dead time by 0.2 s: eight numbers in a row have all eight signs. A car whose dead
    time is believed 0.2 s too short has that much steering delay at least.
    """
    ratio, side, less = RATIOS[number & 1], 1.0 - (number & 2), number & 4
    true = fleet_scenario(
        number, vehicle={"ratio": ratio}, steering={"offset_deg": side * OFFSET_OFF_DEG}, knowledge={"oracle": True}
    )
    if less:
        true = true.with_(steering={"delay": max(true.steering.delay, DELAY_OFF)})
    dead = true.believed_dead_time + (-DELAY_OFF if less else DELAY_OFF)
    return true.with_(knowledge={"oracle": False, "delay": round(dead, 3)}), true


def unlike(number: int, estimator: str) -> Scenario:
    """The same car for a vehicle-state estimator: tyres, the measured wheel and the gyro's zero are wrong as well.

    Tyres by 20 to 25 %, the measured wheel by 3 degrees either way, the gyro's zero by up to 0.3 degrees/s.
    """
    wrong, _ = wrong_belief(number)
    tyres, zero = np.random.default_rng((number, 7)).uniform(_LEAST, _MOST)
    side = 1.0 - 2.0 * (number >> 3 & 1)
    assert wrong.knowledge.delay is not None
    age = 0.0 if estimator == "none" else wrong.sensors.latency  # behind an estimator nothing is late
    return wrong.with_(
        sensors={"estimator": estimator, "kind": "no sideslip", "gyro_zero_deg": float(zero)},
        knowledge={"delay": round(max(wrong.knowledge.delay - age, 0.0), 3)},
        reference="own",
        vehicle={"tyres": float(tyres)},
        steering={"wheel_zero_deg": side * OFFSET_OFF_DEG},
    )


def driven(name: str, scenario: Scenario, *, seed: int, seconds: float) -> Outcome:
    """That controller's drive of so many seconds in that scenario."""
    loop = drive_loop(scenario, controller(name, scenario), seed=seed)
    log = simulate(loop, seconds, every=round(DT / loop.dt), allow_nonfinite=True)
    late = log.t >= 0.5 * seconds
    known = "estimator" if "estimator.x" in log else "sensors"
    outcome = Outcome(
        rms_e=rms(log["path.e"][late]),
        max_e=largest(log["path.e"][log.t >= _FIRST]),
        rms_wheel_deg=rms(degrees_of(rates(log.t[late], log["car.delta_sw"][late]))),
    )
    if f"{known}.x" not in log:
        return outcome
    car, seen = ({key: log[f"{part}.{key}"][late] for key in ("x", "y", "psi")} for part in ("car", known))
    side = np.cos(car["psi"]) * (seen["y"] - car["y"]) - np.sin(car["psi"]) * (seen["x"] - car["x"])
    turned = np.angle(np.exp(1j * (seen["psi"] - car["psi"])))
    outcome = replace(outcome, rms_side=rms(side), rms_heading=rms(turned))
    if known == "sensors" or "estimator.nis" not in log:
        return outcome
    nis, count = log["estimator.nis"][late], log["estimator.nis_count"][late]
    within = float(np.mean(nis <= chdtri(4, 0.05)))
    return replace(outcome, nis_mean=float(nis.sum() / count.sum()), nis_share=within)
