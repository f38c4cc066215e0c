"""The controllers that bring a car steered by torque back to its path, and how close they hold it.

The car answers 0.35 s after a command, its lateral acceleration follows within 5 m/s^3 and 3 m/s^2 and comes out 25 %
weaker, as told, or 25 % stronger. It starts 1 m off, turned away by 5 degrees, on courses with bends of 100 m and more,
at steady speeds of 12 to 20 m/s; in bends the human slows to 1.5 m/s^2, so that the weak one has a third of its 2.25
m/s^2 left. All controllers are told dead time, slew and limit. Later: from 15 s on.

    python -m benchmarks study torque_steering [--controllers NAME ...] [--quick] [--json]
"""

from __future__ import annotations

import argparse
import itertools
from dataclasses import replace
from typing import Any

import numpy as np

from steerkit.diagram.simulation import Log, simulate
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.metrics.signals import rates
from steerkit.scenario import Scenario
from steerkit.scenario.assembly import placed
from steerkit.scenario.drive import assembled, controller

SCENARIO = Scenario(name="torque", steering="torque", delay=0.35, lag=0.0, a_y_human=1.5)
CONTROLLERS = ("stanley-delay", "lqr", "mpc", "nonlinear-mpc", "stanley")
SPEEDS = (12.0, 16.0, 20.0)
GAINS = (0.75, 1.0, 1.25)
COURSES = ("sweeping-1003", "sweeping-1004", "sweeping-1005")
HELD = 0.3
"""|e| that it must not leave again [m]."""
LATER = 15.0
"""When bringing back is over [s]."""
SECONDS = 60.0


def caught(name: str, course: str, v: float, gain: float, seconds: float = SECONDS) -> Log:
    """The drive of a car that starts 1 m off, turned away by 5 degrees."""
    scenario = replace(SCENARIO, course=course, gain=gain, v_min=v, v_max=v)
    loop = assembled(scenario, controller(name, scenario))
    car: Any = placed(loop.blocks["car"], scenario.path(), s=50.0, e=1.0, psi_e=radians_of(5.0))
    return simulate(loop.with_block("car", car), seconds, every=5, allow_nonfinite=True)


def judged(log: Log) -> dict[str, float]:
    """When it last came within `HELD` [s], and what it did later: RMS and largest |e| [m], RMS wheel speed [deg/s]."""
    e = np.abs(log["path.e"])
    late = log.t > LATER
    out = np.flatnonzero(~(e <= HELD))
    back = 0.0 if not out.size else float(log.t[out[-1]]) if out[-1] + 1 < len(e) else np.inf
    return {
        "back_s": back,
        "rms_e_m": float(np.sqrt(np.mean(e[late] ** 2))),
        "max_e_m": float(e[late].max()),
        "rms_rate_deg_s": float(degrees_of(np.sqrt(np.mean(rates(log.t[late], log["car.delta_sw"][late]) ** 2)))),
    }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick drives one controller on one course, at one speed."""
    parser.add_argument("--controllers", nargs="+", default=list(CONTROLLERS), metavar="NAME")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Drive all, and print the worst of all courses."""
    few = 1 if options.quick else None
    report: dict[str, Any] = {}
    print(f"\nSteered by torque: the worst of {len(COURSES[:few])} courses, from 1 m off and turned away by 5 degrees")
    print(f"{'':14}{'v':>5}{'gain':>6}{'back':>9}{'later RMS e':>13}{'max |e|':>10}{'RMS wheel':>12}")
    names: list[str] = options.controllers[:few]
    for name, v, gain in itertools.product(names, SPEEDS[:few], GAINS[:few]):
        drives = [judged(caught(name, course, v, gain, 20.0 if options.quick else SECONDS)) for course in COURSES[:few]]
        worst = {key: max(drive[key] for drive in drives) for key in drives[0]}
        report.setdefault(name, []).append({"v": v, "gain": gain, "held": worst["max_e_m"] < HELD, **worst})
        print(
            f"{name:14}{v:5.0f}{gain:6.2f}{worst['back_s']:7.1f} s{worst['rms_e_m']:11.3f} m{worst['max_e_m']:8.3f} m"
            f"{worst['rms_rate_deg_s']:8.1f} °/s",
            flush=True,
        )
    return report
