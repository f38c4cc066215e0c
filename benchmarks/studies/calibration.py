"""How soon, how well and how honestly a car's delay, ratio, offset and wear are found while it drives.

Parts: `drives`, production cars drawn by seed on courses of their own at 5 to 9 m/s under `hard` sensors, with a data
sheet that is wrong (ratio and tyres by 20 to 25 %, offset, wheel's and gyro's zero, friction, play), and commands that
do not act in 40 % of the time as far as the delay is concerned; `closed_loop`, `mpc-adaptive` for a minute in 40
production cars whose dead time is believed 0.2 s, wheel offset 3 degrees and ratio 25 % off.

Every estimator is fed what the others estimate, not the truth. Errors are 90 % quantiles over the drives, after 30 s
(delay + lag), 20 s (offset), 60 s (ratio), 120 s (friction, play); medians stand in the table. `delay_error_ms`,
`offset_error_deg` and `ratio_error_pct` are with a measured wheel, `delay_yaw_error_ms`, `offset_command_error_deg` and
`ratio_command_error_pct` by the commands and the yaw rate alone. `delay_seconds`: from when on 90 % of the drives are
within 10 ms. `coverage_pct`: how often a 95 % interval holds the truth, over all drives and quantities, after 60 s.
`adaptive_x_oracle`, `adaptive_worst_x`: RMS e from 30 s on over that of `mpc` with true parameters, median and worst of
the cars; `adaptive_wheel_x`, `adaptive_wheel_worst_x`: of the wheel's RMS speed; `adaptive_x_unadapted_worst`: of RMS e
over the better one of `mpc` and `mpc-offset-free`, with the same beliefs; `adaptive_max_e_m`: largest |e| in any
car, from the first second on.

    python -m benchmarks study calibration [--drives 200] [--cars 40] [--parts drives ...] [--quick] [--json]
"""

import argparse
import statistics
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.tables import as_line, say, show, show_figures
from benchmarks.wrong_belief import driven, wrong_belief
from steerkit.compiled import Backend, compile
from steerkit.diagram.block import Block
from steerkit.diagram.maths import Array
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.estimators.estimate import estimated as quantity
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import WheelDelay, YawDelay
from steerkit.estimators.steering_hysteresis import SteeringFriction, SteeringPlay
from steerkit.scenario import Scenario, fleet_scenario
from steerkit.scenario.drive import assembled, controller
from steerkit.task import DT
from steerkit.vehicles import Vehicle

CLOSE = 0.010
"""Error of delay + lag that is wanted [s]."""
TIMES = (5.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0, 90.0, 119.0)


HELD = 0.0075
"""Actuator and car of 10 ms hold their inputs: what follows is that much later than their parameters say [s]."""
_SHOWN = radians_of(3.0)
_AGE, _AGE_DEVIATION = 0.05, 0.01
"""The believed age of v and r, and how sure that is [s]."""
_SIGNALS = {
    "delta_sw_cmd": "controller.delta_sw",
    "delta_sw_meas": "column.delta_sw_meas",
    "v": "sensors.v",
    "r": "sensors.r",
    "psi": "sensors.psi",
}


@dataclass(frozen=True, kw_only=True)
class Drive:
    """A drive by a controller with true parameters, of a car whose data sheet is mostly wrong."""

    scenario: Scenario
    signals: dict[str, Array]
    """What is measured, 20 samples a second; active is 0 in 40 % of the time."""
    truth: dict[str, float]
    """Of every quantity that an estimator has."""


def drawn(number: int, seconds: float, backend: Backend = "auto") -> Drive:
    """A production car on a course of its own at 5 to 9 m/s, under `hard` sensors.

    Beside what `fleet_scenario` draws (delay, lag, offset within 3 degrees, play up to 2): ratio and tyres 20 % less to
    25 % more than the data sheet has, friction of 0.3 to 1 degree, a gyro whose zero is off by up to 0.005 rad/s, and a
    measured wheel that shows up to 3 degrees too little or too much.
    """
    rng = np.random.default_rng(number)
    ratio, tyres, friction, zero = rng.uniform([0.8, 0.8, 0.3, -0.005], [1.25, 1.25, 1.0, 0.005])
    shown = float(np.random.default_rng((number, 1)).uniform(-_SHOWN, _SHOWN))
    scenario = fleet_scenario(
        number,
        driver={"v_min": 5.0, "v_max": 9.0},
        vehicle={"ratio": ratio, "tyres": tyres},
        steering={"friction_deg": friction},
    )
    loop = assembled(scenario, controller("stanley-delay", scenario), seed=number)
    log = compile(loop, backend=backend, record=list(_SIGNALS.values()), every=round(DT / loop.dt)).run(seconds)
    signals = {name: np.array(log[signal]) for name, signal in _SIGNALS.items()}
    signals["r"] = signals["r"] + zero
    signals["delta_sw_meas"] = radians_of(0.1) * np.round((signals["delta_sw_meas"] + shown) / radians_of(0.1))
    signals["active"] = active(len(log.t), rng)
    sum_of_both, car = scenario.steering.delay + scenario.steering.lag, scenario.vehicle.true
    truth = {
        "wheel.delay_lag": sum_of_both,
        "wheel.delay": scenario.steering.delay,
        "wheel.lag": scenario.steering.lag,
        "yaw.delay_lag": sum_of_both + scenario.sensors.latency + HELD,
        "yaw.delay": scenario.steering.delay + scenario.sensors.latency + HELD,
        "yaw.lag": scenario.steering.lag,
        "filter.ratio": ratio,
        "filter.offset": radians_of(scenario.steering.offset_deg),
        "filter.rate_zero": zero,
        "filter.understeer": car.understeer_gradient,
        "measured.ratio": ratio,
        "measured.offset": -shown,
        "measured.rate_zero": zero,
        "friction.friction": radians_of(friction),
        "play.play": radians_of(scenario.steering.play_deg),
    }
    return Drive(scenario=scenario, signals=signals, truth={name: float(value) for name, value in truth.items()})


def active(n: int, rng: np.random.Generator, share: float = 0.6, stretch: float = 6.0) -> Array:
    """1 in that share of n samples, in stretches of some seconds, else 0: a driver who overrides now and then."""
    flags = np.zeros(n)
    k, on = 0, bool(rng.random() < share)
    while k < n:
        length = 1 + int(rng.exponential(stretch if on else stretch * (1.0 - share) / share) / DT)
        flags[k : k + length] = on
        k, on = k + length, not on
    return flags


def all_cars(vehicles: list[Vehicle]) -> Vehicle:
    """The cars as one, each number an array, for a batch."""
    names = [field.name for field in fields(Vehicle) if field.name not in ("name", "delta_sw_max")]
    numbers: dict[str, Any] = {name: np.array([getattr(v, name) for v in vehicles]) for name in names}
    return replace(vehicles[0], name="all", **numbers)


def estimators(vehicle: Vehicle) -> dict[str, Block]:
    """All estimators, by the names that results have them under."""
    return {
        "wheel": WheelDelay(),
        "yaw": YawDelay(vehicle=vehicle),
        "filter": SingleTrackFilter(vehicle=vehicle),
        "measured": SingleTrackFilter(vehicle=vehicle, held=False),
        "friction": SteeringFriction(),
        "play": SteeringPlay(vehicle=vehicle),
    }


def fed(name: str, u: Mapping[str, Any], y: Mapping[str, Any]) -> dict[str, Any]:
    """The inputs of one estimator: from what is measured (u), and from the outputs of those before it (y).

    Offsets and wear are looked for at all times; only who looks for the delay has to look away when overridden. By the
    measured wheel "measured" finds its offset and the ratio, and "play" the play; both are given the age of v and r.
    """
    if name in ("wheel", "yaw"):
        return dict(u)
    always = {**u, "active": 1.0 + 0.0 * u["v"]}
    if name in ("play", "measured"):  # behind a measured wheel there is the age of what is seen, and no lag
        none = 0.0 * u["v"]
        way = {"delay": _AGE + none, "lag": none, "lag_deviation": none, "delay_deviation": _AGE_DEVIATION + none}
        return always | {"angle": u["delta_sw_meas"], "delta_sw": u["delta_sw_meas"]} | way
    source = y["wheel"] if name == "friction" else y["yaw"]
    way = {"delay": source.delay, "lag": source.lag, "lag_deviation": source.lag_deviation}
    command = {"angle": u["delta_sw_cmd"], "delta_sw": u["delta_sw_cmd"]}
    return always | command | way | {"delay_deviation": source.delay_lag_deviation}


def estimated(drives: list[Drive], at: list[float]) -> dict[float, dict[str, Any]]:
    """The outputs of all estimators at these times [s], each an array over the drives; all drives run as one batch."""
    blocks = estimators(all_cars([drive.scenario.nominal for drive in drives]))
    signals = {name: np.array([drive.signals[name] for drive in drives]).T.copy() for name in drives[0].signals}
    batch = (len(drives),)
    x: dict[str, Any] = {name: block.init(batch) for name, block in blocks.items()}
    found: dict[float, dict[str, Any]] = {}
    ticks = {round(t / DT): t for t in at}
    for k in range(max(ticks) + 1):
        y = {name: block.output(k * DT, x[name], ()) for name, block in blocks.items()}
        if k in ticks:
            found[ticks[k]] = y
        if k == max(ticks):
            return found
        u = {name: values[k] for name, values in signals.items()}
        for name, block in blocks.items():
            given = fed(name, u, y)
            x[name] = block.update(k * DT, x[name], block.U(*[given[p.name] for p in block.inputs]), y[name])
    return found


def drives(options: argparse.Namespace) -> dict[str, Any]:
    """Errors and coverage over drawn drives."""
    count, times = (4, [12.0]) if options.quick else (options.drives, list(TIMES))
    backend: Backend = "python" if options.quick else "auto"  # of so short a drive, gcc would take most of the time
    numbers = track(range(options.first, options.first + count), "drives", console=Console(stderr=True))
    every = [drawn(number, times[-1] + 1.0, backend) for number in numbers]
    found = estimated(every, times)
    names = list(every[0].truth)
    truth = {name: np.array([drive.truth[name] for drive in every]) for name in names}
    said = {t: {name: quantity(found[t][name.split(".")[0]], name.split(".")[1]) for name in names} for t in times}
    error = {t: {name: np.abs(said[t][name].value - truth[name]) for name in names} for t in times}
    covered = {
        t: {name: np.mean((said[t][name].low <= truth[name]) & (truth[name] <= said[t][name].high)) for name in names}
        for t in times
    }

    def after(seconds: float) -> float:
        return min(times, key=lambda t: abs(t - seconds))

    def soon(name: str) -> float:
        close = [t for t in times if all(np.mean(error[later][name] <= CLOSE) >= 0.9 for later in times if later >= t)]
        return close[0] if close else float("nan")

    shown = [
        ("delay + lag, wheel", "wheel.delay_lag", 30.0, 1e3, "ms"),
        ("delay + lag, yaw rate", "yaw.delay_lag", 30.0, 1e3, "ms"),
        ("delay + lag, yaw, a minute", "yaw.delay_lag", 60.0, 1e3, "ms"),
        ("delay alone, wheel", "wheel.delay", 30.0, 1e3, "ms"),
        ("delay alone, yaw rate", "yaw.delay", 30.0, 1e3, "ms"),
        ("offset, wheel", "measured.offset", 20.0, degrees_of(1.0), "deg"),
        ("offset, command", "filter.offset", 20.0, degrees_of(1.0), "deg"),
        ("offset, command, a minute", "filter.offset", 60.0, degrees_of(1.0), "deg"),
        ("ratio, wheel", "measured.ratio", 60.0, 100.0 / truth["measured.ratio"], "%"),
        ("ratio, command", "filter.ratio", 60.0, 100.0 / truth["filter.ratio"], "%"),
        ("gyro's zero", "filter.rate_zero", 60.0, degrees_of(1.0), "deg/s"),
        ("friction", "friction.friction", 119.0, 100.0 / truth["friction.friction"], "%"),
        ("play, of 0.5 deg or more", "play.play", 119.0, 100.0 / truth["play.play"], "%"),
    ]
    table = {}
    for label, name, seconds, factor, unit in shown:
        t = after(seconds)
        scaled = factor * error[t][name]
        if name == "play.play" and (truth[name] >= radians_of(0.5)).any():
            scaled = scaled[truth[name] >= radians_of(0.5)]
        table[label] = {
            "after_s": t,
            "median": float(np.median(scaled)),
            "p90": float(np.quantile(scaled, 0.9)),
            "unit": unit,
            "valid_share": float(np.mean(said[t][name].valid)),
            "coverage_pct": 100.0 * float(covered[t][name]),
        }
    show(f"{count} drives", [{"quantity": label} | row for label, row in table.items()])
    end = after(60.0)
    return {
        "delay_error_ms": table["delay + lag, wheel"]["p90"],
        "delay_yaw_error_ms": table["delay + lag, yaw rate"]["p90"],
        "delay_seconds": soon("wheel.delay_lag"),
        "offset_error_deg": table["offset, wheel"]["p90"],
        "offset_command_error_deg": table["offset, command"]["p90"],
        "ratio_error_pct": table["ratio, wheel"]["p90"],
        "ratio_command_error_pct": table["ratio, command"]["p90"],
        "friction_error_pct": table["friction"]["p90"],
        "play_error_pct": table["play, of 0.5 deg or more"]["p90"],
        "coverage_pct": 100.0 * float(np.mean([covered[end][name] for name in names])),
        "table": table,
        "drives": count,
    }


def closed_loop(options: argparse.Namespace) -> dict[str, Any]:
    """An adaptive MPC with wrong beliefs against ones that do not adapt, with those or true parameters."""
    cars, seconds = (1, 16.0) if options.quick else (options.cars, 60.0)
    rows: list[dict[str, Any]] = []
    for number in range(options.first, options.first + cars):
        wrong, true = wrong_belief(number)
        drive = partial(driven, seed=number, seconds=seconds)
        truth, adapts = drive("mpc", true), drive("mpc-adaptive", wrong)
        fixed = min((drive(name, wrong) for name in ("mpc", "mpc-offset-free")), key=lambda one: one.rms_e)
        row: dict[str, Any] = {
            "car": number,
            "delay_off": wrong.believed_dead_time - true.believed_dead_time,
            "ratio": true.vehicle.ratio,
            "offset_deg": true.steering.offset_deg,
            "x": adapts.rms_e / truth.rms_e,
            "wheel_x": adapts.rms_wheel_deg / truth.rms_wheel_deg,
            "unadapted_x": adapts.rms_e / fixed.rms_e,
            "max_e": adapts.max_e,
            "rms_e_oracle": truth.rms_e,
        }
        rows.append(row)
        say(as_line(row))
    show("MPC with wrong beliefs: over that with true parameters, and over those that do not adapt", rows)
    x, wheel = ([row[key] for row in rows] for key in ("x", "wheel_x"))
    report = {
        "adaptive_x_oracle": statistics.median(x),
        "adaptive_worst_x": max(x),
        "adaptive_wheel_x": statistics.median(wheel),
        "adaptive_wheel_worst_x": max(wheel),
        "adaptive_x_unadapted_worst": max(row["unadapted_x"] for row in rows),
        "adaptive_max_e_m": max(row["max_e"] for row in rows),
    }
    return report | {"adaptive_cars": rows}


PARTS: dict[str, Callable[[argparse.Namespace], dict[str, Any]]] = {"drives": drives, "closed_loop": closed_loop}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick: four drives of 20 s, one car in closed loop for 16 s."""
    parser.add_argument("--drives", type=int, default=200, help="how many (200)")
    parser.add_argument("--cars", type=int, default=40, help="how many in closed loop (40)")
    parser.add_argument(
        "--first", type=int, default=2000, help="number of the first (2000): nothing was tuned on those"
    )
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS), help="which parts (all)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Carry out the parts; their figures together."""
    report: dict[str, Any] = {}
    for part in options.parts:
        report |= PARTS[part](options)
    show_figures(report)
    return report
