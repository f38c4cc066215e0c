"""What a scenario is made of: its course, and the blocks of its steering and its sensors."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

from steerkit.block import Block
from steerkit.courses import course, course_of, lane_change, random_course
from steerkit.path import Path
from steerkit.plants.poor_sensors import PoorSensors
from steerkit.plants.sensors import Sensors
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.plants.steering_column import SteeringColumn
from steerkit.plants.steering_link import SteeringLink
from steerkit.units import radians_of
from steerkit.vehicles import Vehicle, vehicle_of

if TYPE_CHECKING:
    from steerkit.scenario.scenario import Scenario


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


def actuator_of(scenario: Scenario) -> SteeringActuator:
    """The motor at the steering wheel."""
    return SteeringActuator(
        delay=scenario.delay,
        lag=scenario.lag,
        rate_limit=radians_of(scenario.rate_limit_deg),
        offset=radians_of(scenario.offset_deg),
        limit=scenario.nominal.delta_sw_max,
    )


def column_of(scenario: Scenario) -> SteeringColumn | None:
    """Friction and free play between motor and road wheels; None if there are none."""
    if (scenario.friction_deg, scenario.play_deg) == (0.0, 0.0):
        return None
    return SteeringColumn(friction=radians_of(scenario.friction_deg), play=radians_of(scenario.play_deg))


def sensors_of(scenario: Scenario, seed: int) -> Block | None:
    """What the controllers see; None for the truth."""
    noise, latency = scenario.noise, scenario.latency
    if scenario.sensing == "real":
        poor = PoorSensors.real(scenario.nominal, seed).scaled(noise)
        return replace(poor, block=replace(poor.block, latency=latency))
    if noise == 0.0 and latency == 0.0:
        return None
    full = Sensors.hard(seed)
    return replace(
        full,
        position_drift=noise * full.position_drift,
        psi_drift=noise * full.psi_drift,
        r_noise=noise * full.r_noise,
        latency=latency,
    )


def is_random(name: str) -> bool:
    """Is it the name of a random course?"""
    kind, _, number = name.partition("-")
    return kind == "random" and number.isdigit()


@lru_cache(maxsize=32)
def path_of(name: str, closed: bool | None, text: str | None, v_max: float) -> Path:
    """The course of that name, or in the text of a file."""
    if text is not None:
        return course_of(text, name, closed=closed)
    if name.startswith("iso3888-"):
        return lane_change(int(name[-1]), speed=v_max)
    return random_course(int(name.partition("-")[2])) if is_random(name) else course(name)


@lru_cache(maxsize=32)
def car_of(text: str, name: str) -> Vehicle:
    """The car in the text of a vehicle file."""
    return vehicle_of(text, name)
