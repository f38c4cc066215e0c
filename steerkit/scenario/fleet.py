"""Scenarios drawn by seed: a production car with its delay, and what else nobody wrote into a data sheet."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from steerkit._support.random import seed_state, uniform
from steerkit.paths.path import Path
from steerkit.scenario.scenario import Scenario
from steerkit.vehicles import drawn_car

COURSES_FROM = 1000
"""Random courses from this number on are for such scenarios: nothing was tuned on them."""
LAG = (0.1, 0.3)
"""Least and largest lag of the steering [s]."""
OFFSET_DEG = 3.0
"""Largest |offset| of the steering wheel [degrees]."""
PLAY_DEG = 2.0
"""Largest free play of the steering, at the wheel [degrees]."""
_STREAM = 22  # of `seed_state`: what is drawn besides the car


def straightest(path: Path, length: float = 20.0) -> float:
    """Where the stretch of `length` [m] begins that bends least in its worst place [m]."""
    s = np.arange(0.0, path.length, 1.0)
    kappa = np.abs(path.kappa(s))
    worst = np.max([np.roll(kappa, -k) for k in range(int(length))], axis=0)
    return float(s[worst.argmin()])


def fleet_scenario(number: int, **changes: Any) -> Scenario:
    """A production car drawn by a seed, on a course that nothing was tuned on, under `hard` conditions.

    Drawn are: the car, as `vehicle("fleet-17")` is, with its own steering delay; the lag of its steering, uniform from
    0.1 to 0.3 s; the offset of its wheel, uniform within +-3 degrees; free play, uniform up to 2 degrees. The course is
    `random-1017` for number 17; drives begin where it is straightest, as a car put down in a tight bend leaves the path
    whoever steers it.

    number: the seed, a whole number >= 0. changes: as for `Scenario.with_`; a drive on another course begins where
    they say. Raises ValueError for another number, and for changes that make no scenario.
    """
    car = drawn_car(number)
    share, state = uniform(seed_state(number, stream=_STREAM))
    side, state = uniform(state)
    worn, _ = uniform(state)
    scenario = Scenario.under(
        "hard",
        name=f"fleet-{number}",
        vehicle=car.vehicle.name,
        course=f"random-{COURSES_FROM + number}",
        steering={
            "delay": round(car.steer_delay, 2),
            "lag": round(LAG[0] + (LAG[1] - LAG[0]) * share, 3),
            "offset_deg": round(OFFSET_DEG * (2.0 * side - 1.0), 2),
            "play_deg": round(PLAY_DEG * worn, 2),
        },
    ).with_(**changes)
    given = changes.get("course", {})
    if not isinstance(given, Mapping) or given.keys() & {"name", "start"}:  # a course takes longer than all the rest
        return scenario
    return scenario.with_(course={"start": straightest(scenario.path())})
