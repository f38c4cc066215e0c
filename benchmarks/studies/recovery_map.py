"""The start states from which a recovery controller brings the car back, and whether it keeps to the limits.

A nonlinear single track stands off a straight path: |e| up to 3 m at the reference point, |heading error| up to 45
degrees, at 2 to 9 m/s, wheel straight; steering delay 0.2 s and lag 0.1 s, which the controller is told. Recovered:
|e| < 0.1 m from some moment to the end of 20 s. Within limits: |a_y| <= 3 m/s^2 and wheel speed <= 550 deg/s all along,
the commanded one too.

    python -m benchmarks study recovery_map [--controllers NAME ...] [--out recovery.png] [--quick] [--json]

The MPCs cannot be compiled: they drive 9 x 9 start states a speed instead of 25 x 25, in minutes.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.rounds import CAR, LAG, design_model, reference_of
from steerkit.compiled import compile
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.paths.courses import straight
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.scenario.catalogue import make_controller
from steerkit.task import A_Y_MAX, DT, RELEASE

DELAY = 0.2
SPEEDS = (2.0, 4.0, 6.0, 9.0)
FARTHEST, STEEPEST = 3.0, radians_of(45.0)
SECONDS = 20.0
QUICK_SECONDS = 5.0
"""In the quick form, of a controller that drives car by car [s]."""
RATE = radians_of(550.0)
ROAD = straight(400.0)
RECORD = ["path.e", "car.a_y", "actuator.rate", "controller.delta_sw"]
NAMES = ("stanley-delay", "stanley-textbook", "mpc", "nonlinear-mpc")


def start_loop(controller: Block) -> Loop:
    """The loop; every car's start is set by parameters."""
    reference = reference_of(controller)
    car = placed(NonlinearSingleTrack(vehicle=CAR, v0=5.0), ROAD, s=20.0)
    actuator = SteeringActuator(delay=DELAY, lag=LAG)
    return steering_loop(
        car=car,
        path=ROAD,
        driver=ConstantSpeed(speed=5.0),
        controller=controller,
        actuator=actuator,
        reference=reference,
    )


def starts(sides: int, reference: float) -> dict[str, Any]:
    """Start states of all cars: speed, offset and heading, the offset at the reference point."""
    e = np.linspace(-FARTHEST, FARTHEST, sides)
    psi = np.linspace(-STEEPEST, STEEPEST, sides)
    v, e, psi = (a.ravel() for a in np.meshgrid(SPEEDS, e, psi, indexing="ij"))
    return {"car.y0": e - reference * np.sin(psi), "car.psi0": psi, "car.v0": v, "driver.speed": v}


def driven(controller: Block, values: dict[str, Any], seconds: float = SECONDS) -> Log:
    """All cars' logs, 20 samples a second; car by car where the controller cannot be traced."""
    loop = start_loop(controller)
    if type(controller).__name__ in ("Stanley", "DelayPredictor"):
        run = compile(loop, record=RECORD, every=5, parameters=list(values))
        return run.run(seconds, parameters=values, allow_nonfinite=True)
    logs = []
    for i in track(range(len(values["car.y0"])), description="start states", console=Console(stderr=True)):
        one = {name: float(column[i]) for name, column in values.items()}
        car = replace(loop.blocks["car"], y0=one["car.y0"], psi0=one["car.psi0"], v0=one["car.v0"])  # type: ignore[call-arg]
        alone = loop.with_block("car", car).with_block("driver", ConstantSpeed(speed=one["driver.speed"]))
        logs.append(simulate(alone, seconds, record=RECORD, every=5, allow_nonfinite=True))
    signals = {name: np.stack([log[name] for log in logs], axis=-1) for name in RECORD}
    return Log(logs[0].t, signals, logs[0].units)


def judged(log: Log) -> dict[str, Any]:
    """For every car: seconds until it is back for good (infinite: never), largest |a_y|, wheel and command speed."""
    e = np.nan_to_num(np.abs(log["path.e"]), nan=np.inf)
    away = e >= RELEASE
    last = np.where(away.any(axis=0), len(e) - 1 - np.argmax(away[::-1], axis=0), -1)
    back = np.where(last < len(e) - 1, (last + 1) * DT, np.inf)
    command = np.abs(np.diff(log["controller.delta_sw"], axis=0)).max(axis=0) / DT
    return {
        "seconds": back,
        "a_y": np.abs(log["car.a_y"]).max(axis=0),
        "farthest": e.max(axis=0),
        "rate": np.abs(log["actuator.rate"]).max(axis=0),
        "command_rate": command,
    }


def within_limits(outcome: dict[str, Any]) -> Any:
    """Which cars kept to 3 m/s^2 and to the wheel's speed, steered and commanded."""
    fastest = np.maximum(outcome["rate"], outcome["command_rate"])
    return (outcome["a_y"] <= A_Y_MAX) & (fastest <= RATE * 1.000001)


def summary(outcome: dict[str, Any], v: Any) -> list[dict[str, float]]:
    """A row a speed."""
    rows = []
    for speed in SPEEDS:
        at = v == speed
        back = np.isfinite(outcome["seconds"][at])
        kept = within_limits(outcome)[at]
        rows.append(
            {
                "v": speed,
                "recovered": float(np.mean(back)),
                "within_limits": float(np.mean(back & kept)),
                "median_s": float(np.median(outcome["seconds"][at])),
                "slowest_s": float(outcome["seconds"][at].max()),
                "a_y_max": float(outcome["a_y"][at].max()),
                "rate_max_deg_s": float(degrees_of(outcome["rate"][at].max())),
                "farthest_m": float(outcome["farthest"][at].max()),
            }
        )
    return rows


def picture(results: dict[str, tuple[int, dict[str, Any]]], file: str) -> None:
    """Start states by controller and speed: back within the limits, back beyond them, not back; lines: seconds."""
    from matplotlib.colors import ListedColormap
    from matplotlib.figure import Figure
    from matplotlib.patches import Patch

    from steerkit.plots.style import COLOURS, save, style

    kinds = {"not back": "#c8574b", "back, but beyond 3 m/s² or 550 deg/s": "#ecc25c", "back within both": "#9ccba8"}
    reach = (-FARTHEST, FARTHEST, -degrees_of(STEEPEST), degrees_of(STEEPEST))
    with style():
        figure = Figure(figsize=(2.7 * len(SPEEDS) + 0.5, 2.5 * len(results) + 1.0), layout="constrained")
        axes = figure.subplots(len(results), len(SPEEDS), sharex=True, sharey=True, squeeze=False)
        for row, (name, (sides, outcome)) in zip(axes, results.items()):
            shape = (len(SPEEDS), sides, sides)
            back = np.isfinite(outcome["seconds"]).reshape(shape)
            kept = within_limits(outcome).reshape(shape)
            e, psi = np.linspace(*reach[:2], sides), np.linspace(*reach[2:], sides)
            for ax, v, b, k, s in zip(row, SPEEDS, back, kept, outcome["seconds"].reshape(shape)):
                kind = np.where(b, np.where(k, 2, 1), 0)
                ax.pcolormesh(e, psi, kind.T, cmap=ListedColormap(list(kinds.values())), vmin=0, vmax=2)
                if b.mean() > 0.5:
                    lines = ax.contour(
                        e,
                        psi,
                        np.where(b, s, np.nan).T,
                        levels=[1, 2, 3, 4, 5, 6, 8, 10, 12],
                        colors=COLOURS["ink"],
                        linewidths=0.5,
                    )
                    ax.clabel(lines, fmt="%g s", fontsize=7)
                ax.set(title=f"{name}, {v:g} m/s", xlim=reach[:2], ylim=reach[2:])
                ax.grid(False)
        for ax in axes[-1]:
            ax.set_xlabel("e at the start [m]")
        for ax in axes[:, 0]:
            ax.set_ylabel("psi_e at the start [deg]")
        title = f"Back to |e| < {RELEASE:g} m from a start off the path; {DELAY:g} s delay, {LAG:g} s lag"
        figure.suptitle(title, x=0.01, ha="left", fontsize=10.5, fontweight="bold", color=COLOURS["ink"])
        patches = [Patch(color=colour, label=label) for label, colour in reversed(kinds.items())]
        figure.legend(handles=patches, loc="outside lower left", ncols=3)
    save(figure, file, dpi=120)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick drives a coarse grid of start states, the MPCs one a speed for 5 s."""
    default = ["stanley-delay", "mpc", "nonlinear-mpc"]
    parser.add_argument("--controllers", nargs="+", default=default, choices=NAMES)
    parser.add_argument("--out", default=None, help="file for a picture of the start states")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Drive all start states, print a table, draw the picture."""
    report: dict[str, Any] = {}
    results: dict[str, tuple[int, dict[str, Any]]] = {}
    for name in options.controllers:
        controller = make_controller(name, design_model(delay=DELAY))
        sides = (1 if options.quick else 9) if name.endswith("mpc") else (5 if options.quick else 25)
        values = starts(sides, reference_of(controller))
        seconds = QUICK_SECONDS if options.quick and name.endswith("mpc") else SECONDS
        outcome = judged(driven(controller, values, seconds))
        results[name] = (sides, outcome)
        report[name] = summary(outcome, values["car.v0"])
        print(f"\n{name}: {sides * sides} start states a speed")
        print("   v     back  within limits   median   slowest   |a_y|   wheel speed   farthest")
        for row in report[name]:
            print(
                f"{row['v']:4.0f} {row['recovered']:8.1%} {row['within_limits']:12.1%} {row['median_s']:9.1f} s"
                f"{row['slowest_s']:8.1f} s {row['a_y_max']:6.2f} {row['rate_max_deg_s']:9.0f} deg/s"
                f" {row['farthest_m']:8.1f} m"
            )
    if options.out:
        picture(results, options.out)
        print(f"\npicture: {options.out}")
    return report
