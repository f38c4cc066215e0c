"""Closed-loop drives of cars whose data sheets are wrong in everything a controller is told; judged by the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace

from steerkit.diagram.simulation import simulate
from steerkit.diagram.units import degrees_of
from steerkit.metrics.signals import largest, rates, rms
from steerkit.scenario import Scenario, fleet_scenario
from steerkit.scenario.drive import controller, drive_loop
from steerkit.task import DT

DELAY_OFF, OFFSET_OFF_DEG, RATIOS = 0.2, 3.0, (0.8, 1.25)
"""How wrong what is told is: dead time [s] and offset [degrees], to either side; true ratio over the data sheet's."""
_FIRST = 1.0
"""Time from which on no error may be large [s]."""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """One drive."""

    rms_e: float
    """From half of its time on [m]."""
    max_e: float
    """From the first second on [m]."""
    rms_wheel_deg: float
    """RMS speed of the steering wheel, from half of the time on [degrees/s]."""


def mistold(number: int) -> tuple[Scenario, Scenario]:
    """A production car by its number as controllers are told of it, and the same with the truth told.

    `fleet_scenario`'s car, lag, free play and course, under `hard` sensors. The ratio is off by 25 % either way, the
    wheel by 3 degrees, the dead time that is told by 0.2 s: eight numbers in a row have all eight signs. A car that is
    told 0.2 s too little has that much steering delay at least.
    """
    ratio, side, less = RATIOS[number & 1], 1.0 - (number & 2), number & 4
    true = fleet_scenario(number, ratio=ratio, offset_deg=side * OFFSET_OFF_DEG, told="truth")
    if less:
        true = replace(true, delay=max(true.delay, DELAY_OFF))
    dead = true.believed_dead_time + (-DELAY_OFF if less else DELAY_OFF)
    return replace(true, told="data sheet", believed_delay=round(dead, 3)), true


def driven(name: str, scenario: Scenario, *, seed: int, seconds: float) -> Outcome:
    """That controller's drive of so many seconds in that scenario."""
    loop = drive_loop(scenario, controller(name, scenario), seed=seed)
    log = simulate(loop, seconds, every=round(DT / loop.dt), allow_nonfinite=True)
    late = log.t >= 0.5 * seconds
    return Outcome(
        rms_e=rms(log["path.e"][late]),
        max_e=largest(log["path.e"][log.t >= _FIRST]),
        rms_wheel_deg=rms(degrees_of(rates(log.t[late], log["car.delta_sw"][late]))),
    )
