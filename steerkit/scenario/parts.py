"""What a scenario is made of: its course, and the blocks of its steering and its sensors."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import read_text
from steerkit.diagram.block import Block
from steerkit.diagram.units import radians_of
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.paths.courses import course, course_of, lane_change, random_course
from steerkit.paths.path import Array, Path
from steerkit.paths.waypoints import read_columns
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.sensors import DegradedSensors, Sensors
from steerkit.plants.speed_driver import CurveSpeedDriver, ceiling
from steerkit.plants.steering_actuator import SteeringActuator, SteeringColumn, SteeringLink
from steerkit.plants.torque_steering import TorqueSteering
from steerkit.task import DT
from steerkit.vehicles import Vehicle, vehicle_of

if TYPE_CHECKING:
    from steerkit.scenario.scenario import Scenario


DRAWN = {"random": (500.0, 0.1), "sweeping": (2000.0, 0.01)}
"""Length [m] and largest curvature [1/m] of random courses, by what their names begin with."""


def link_of(scenario: Scenario, seed: int) -> SteeringLink | None:
    """The way of a command to the motor; None if nothing happens on it."""
    if (scenario.quantum_deg, scenario.dead_band_deg, scenario.delay_jitter) == (0.0, 0.0, 0.0):
        return None
    return SteeringLink(
        quantum=radians_of(scenario.quantum_deg),
        dead_band=radians_of(scenario.dead_band_deg),
        jitter=scenario.delay_jitter,
        seed=seed,
    )


def actuator_of(scenario: Scenario) -> Block:
    """The motor at the steering wheel, or what steers by torque in its place."""
    if scenario.steering == "torque":
        return TorqueSteering.of(
            scenario.nominal,
            delay=scenario.delay,
            lag=scenario.lag,
            slew=scenario.slew,
            a_y_limit=scenario.a_y_limit,
            gain=scenario.gain,
            offset=radians_of(scenario.offset_deg),
            rate_limit=radians_of(scenario.rate_limit_deg),
        )
    return SteeringActuator(
        delay=scenario.delay,
        lag=scenario.lag,
        rate_limit=radians_of(scenario.rate_limit_deg),
        offset=radians_of(scenario.offset_deg),
        limit=scenario.nominal.delta_sw_max,
    )


def column_of(scenario: Scenario) -> SteeringColumn | None:
    """Friction and free play between motor and road wheels; None if there are none."""
    if (scenario.friction_deg, scenario.play_deg, scenario.wheel_zero_deg) == (0.0, 0.0, 0.0):
        return None
    return SteeringColumn(
        friction=radians_of(scenario.friction_deg),
        play=radians_of(scenario.play_deg),
        zero=radians_of(scenario.wheel_zero_deg),
    )


def sensors_of(scenario: Scenario, seed: int) -> Block | None:
    """What the controllers see; None for the truth."""
    noise, latency, zero = scenario.noise, scenario.latency, radians_of(scenario.gyro_zero_deg)
    if scenario.sensing == "real":
        poor = DegradedSensors.real(scenario.nominal, seed).scaled(noise)
        return replace(poor, block=replace(poor.block, r_bias=zero, latency=latency))
    sideslip = scenario.sensing == "hard"
    if (noise, latency, zero) == (0.0, 0.0, 0.0) and sideslip and scenario.estimator == "none":
        return None
    full = Sensors.hard(seed)
    hard = replace(
        full,
        position_drift=noise * full.position_drift,
        psi_drift=noise * full.psi_drift,
        r_noise=noise * full.r_noise,
        r_bias=zero,
        latency=latency,
    )
    return hard if sideslip else DegradedSensors(block=hard, rear=scenario.nominal.l_r)


def estimator_of(scenario: Scenario) -> VehicleState | None:
    """What stands between sensors and controllers; it is given the sensors' data sheet and the nominal car."""
    if scenario.estimator == "none":
        return None
    sensors: Any = sensors_of(scenario, 0)
    poor = isinstance(sensors, DegradedSensors)
    sheet: Sensors = sensors.block if poor else sensors
    adapts = scenario.estimator == "adaptive-state"
    return VehicleState.of(
        NonlinearSingleTrack(vehicle=scenario.nominal),
        horizon=scenario.latency + DT,
        position_drift=math.hypot(sheet.position_drift, sensors.jump if poor else 0.0),
        psi_drift=sheet.psi_drift,
        drift_time=sheet.drift_time,
        v_noise=sheet.v_noise,
        r_noise=sheet.r_noise,
        heading_drift=sensors.heading_drift if poor else 0.0,
        steering=SingleTrackFilter(vehicle=scenario.nominal, held=False) if adapts else None,
    )


def drawn_course(name: str) -> tuple[int, float, float] | None:
    """Seed, length [m] and largest curvature [1/m] of a random course; None for any other name."""
    kind, _, number = name.partition("-")
    return (int(number), *DRAWN[kind]) if kind in DRAWN and number.isdigit() else None


@lru_cache(maxsize=32)
def path_of(name: str, closed: bool | None, text: str | None, v_max: float) -> Path:
    """The course of that name, or in the text of a file."""
    if text is not None:
        return course_of(text, name, closed=closed)
    if name.startswith("iso3888-"):
        return lane_change(int(name[-1]), speed=v_max)
    drawn = drawn_course(name)
    if drawn is None:
        return course(name)
    seed, length, max_kappa = drawn
    return random_course(seed, length=length, max_kappa=max_kappa, name=name)


@lru_cache(maxsize=32)
def car_of(text: str, name: str) -> Vehicle:
    """The car in the text of a vehicle file."""
    return vehicle_of(text, name)


def profile_of(file: str) -> tuple[Array, Array]:
    """s [m] and v [m/s] of a speed profile's file; raises ValueError for one that cannot be read or is none."""
    try:
        return profile_in(read_text(file, "speed"), file)
    except OSError as error:
        raise ValueError(f"speed {file} cannot be read ({error.strerror}), expected a CSV file: s, v") from error


def profile_in(text: str, name: str) -> tuple[Array, Array]:
    """s [m] and v [m/s] in the text of a CSV file; raises ValueError for other columns, or an s that does not rise."""
    columns = read_columns(text, name)
    require({"s", "v"} <= columns.keys(), name, f"columns {', '.join(columns)}; valid: s [m], v [m/s]")
    s, v = columns["s"], columns["v"]
    fine = bool(np.isfinite(s).all() and np.isfinite(v).all() and (np.diff(s) > 0.0).all() and len(s) >= 2)
    require(fine, name, "expected two rows or more of numbers, s [m] rising from row to row")
    return s, v


def carried_speed(scenario: Scenario, text: str) -> tuple[Array, Array]:
    """s [m] and v [m/s] of a course's file that carries speeds: as it was driven, or as fast as is allowed.

    `limit`: v_limit, v_max where nothing is said, and slower for bends, as a `CurveSpeedDriver` is.
    """
    path, columns = scenario.path(), read_columns(text, scenario.course)
    key = {"recorded": "v", "limit": "v_limit"}[scenario.speed]
    told = f"no column {key} [m/s]; columns: {', '.join(columns)}"
    require({"s", key} <= columns.keys(), f"speed {scenario.speed}: {scenario.course}", told)
    s, v = columns["s"], columns[key]
    if scenario.speed == "recorded":
        require(
            np.isfinite(v).all() and (np.diff(s) > 0.0).all(), scenario.course, "s rising, v [m/s], expected numbers"
        )
        at = np.linspace(0.0, path.length, max(2, round(path.length) + 1))
        return at, np.interp(at, s, v, period=path.length if path.closed else None)
    n = max(2, round(path.length))
    at = np.linspace(0.0, path.length, n + 1)
    allowed = v[np.clip(np.searchsorted(s, at[:-1] + 1e-6, side="right") - 1, 0, len(s) - 1)]
    allowed = np.clip(np.where(np.isfinite(allowed), allowed, scenario.v_max), scenario.v_min, scenario.v_max)
    fastest = ceiling(path, scenario.a_y_human, CurveSpeedDriver.a_x_max, allowed)
    return at, np.append(fastest, fastest[0] if path.closed else fastest[-1])


def profile_on(path: Path, text: str, name: str) -> tuple[Array, Array]:
    """A file's profile, every metre of a course; a closed one goes on from its end to its beginning."""
    s, v = profile_in(text, name)
    longest = f"s to {s[-1]:g} m, on a course of {path.length:.1f} m"
    require(s[0] >= 0.0 and s[-1] <= path.length + 1.0, name, f"{longest}; expected s from 0 to the course's length")
    at = np.linspace(0.0, path.length, max(2, round(path.length) + 1))
    return at, np.interp(at, s, v, period=path.length if path.closed else None)
