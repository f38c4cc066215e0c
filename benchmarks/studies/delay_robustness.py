"""The box in which a steering controller holds the car within 0.5 m: delay, tyres, steering ratio and offset off.

One round of the 795 m course, nonlinear single track, 0.1 s steering lag, perfect pose, |e| where the controller has
its errors measured (front axle; pure pursuit: rear axle). Every combination of

    tyre stiffness 0.7, 1, 1.3;  steering ratio 0.9, 1, 1.1;  steering-wheel offset -3, 0, 3 degrees;  4 to 9 m/s,

at every delay; before that, one undisturbed round of this course and of the recorded lap. The human slows to 3 m/s^2
for bends: at 9 m/s the 5.9 m hairpin would be 13.7 m/s^2, more than the road gives. First the controller is told the
true delay; `believes 0.2 s`: it is told that, whatever the truth. Its model of the car is the nominal one throughout.

    python -m benchmarks study delay_robustness [--controllers NAME ...] [--out robustness.png] [--quick] [--json]

mpc is not compiled, so it drives the corners of the box only, at 4 and 9 m/s (`--controllers mpc`; minutes).
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from benchmarks.rounds import CAR, design_model, drive_loop, driven, interpreted, on_course, rms, worst
from steerkit.compiled.trace import with_parameters
from steerkit.diagram.block import Block
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.paths.courses import course
from steerkit.scenario.catalogue import make_controller
from steerkit.task import TRIP

DELAYS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
BELIEVED = 0.2
TYRES, RATIOS, OFFSETS_DEG, SPEEDS = (0.7, 1.0, 1.3), (0.9, 1.0, 1.1), (-3.0, 0.0, 3.0), (4.0, 5.0, 6.0, 7.0, 8.0, 9.0)
NAMES = ("stanley-delay", "lqr", "mpc", "stanley", "stanley-textbook", "pure-pursuit")
COMPENSATES = ("stanley-delay", "lqr", "pure-pursuit", "mpc")
KINDS = {"nothing": (), "tyres": (0,), "ratio": (1,), "offset": (2,), "all": (0, 1, 2)}


def box(name: str, quick: bool) -> Any:
    """Rows of tyre factor, ratio factor, offset [deg], speed [m/s]."""
    if name == "mpc":
        corners = [*itertools.product((0.7, 1.3), (0.9, 1.1), (-3.0, 3.0)), (1.0, 1.0, 0.0)]
        return np.array([(*corner, v) for corner in corners for v in (4.0, 9.0)])
    return np.array([*itertools.product(TYRES, RATIOS, OFFSETS_DEG, SPEEDS[:: 5 if quick else 1])])


def largest(name: str, controller: Block, delay: float, cars: Any) -> Any:
    """Largest |e| [m] of every car; infinite where the round was not finished."""
    path = course("paper")
    loop = drive_loop(controller, delay=delay)
    values = {
        "car.vehicle.c_f": cars[:, 0] * CAR.c_f,
        "car.vehicle.c_r": cars[:, 0] * CAR.c_r,
        "car.vehicle.steer_ratio": cars[:, 1] * CAR.steer_ratio,
        "actuator.offset": radians_of(cars[:, 2]),
        "driver.driver.v_min": cars[:, 3],
        "driver.driver.v_max": cars[:, 3],
    }
    seconds = 1.05 * path.length / SPEEDS[0]  # faster cars slow down for bends, too
    if name != "mpc":
        return worst(driven(loop, seconds, values), path.length)
    ones = [with_parameters(loop, {key: float(column[i]) for key, column in values.items()}) for i in range(len(cars))]
    return np.array([float(worst(interpreted(one, seconds), path.length)) for one in shown(ones, f"mpc, {delay:g} s")])


def shown(things: Sequence[Any], what: str) -> Iterable[Any]:
    """The things, with a progress bar on stderr."""
    return track(things, description=what, transient=True, console=Console(stderr=True))


def by_kind(cars: Any, e: Any) -> dict[str, float]:
    """Worst |e| [m] with nothing off, one thing off, everything in the box."""
    off = np.column_stack((cars[:, 0] != 1.0, cars[:, 1] != 1.0, cars[:, 2] != 0.0))
    worst_of = {}
    for kind, may in KINDS.items():
        fits = ~np.delete(off, list(may), axis=1).any(axis=1)
        if fits.any():
            worst_of[kind] = float(e[fits].max())
    return worst_of


def laps(names: Sequence[str]) -> dict[str, dict[str, dict[str, float]]]:
    """One round each of the 795 m course and the recorded lap, nothing off, 0.2 s delay told, 4 to 9 m/s."""
    report: dict[str, dict[str, dict[str, float]]] = {}
    print(f"{'delay 0.2 s, lag 0.1 s':20}{'course':>9}{'RMS e':>10}{'max e':>9}{'|a_y|':>8}{'RMS wheel speed':>18}")
    for name, where in itertools.product(names, ("paper", "genesis")):
        path = course(where)
        length = path.length - (0.0 if path.closed else 2.0)
        loop = drive_loop(make_controller(name, design_model(delay=0.2, name=where)), name=where, delay=0.2)
        log = (interpreted if name == "mpc" else driven)(loop, 1.05 * path.length / 4.0)
        row = {
            "rms_e_m": rms(log, "path.e", length),
            "max_e_m": worst(log, length),
            "a_y_max": np.abs(log["car.a_y"][on_course(log, length)]).max(),
            "rms_rate_deg_s": degrees_of(rms(log, "actuator.rate", length)),
        }
        report.setdefault(name, {})[where] = {key: float(value) for key, value in row.items()}
        print(
            f"{name:20}{where:>9}{row['rms_e_m']:8.3f} m{row['max_e_m']:7.3f} m{row['a_y_max']:8.2f}"
            f"{row['rms_rate_deg_s']:12.1f} deg/s",
            flush=True,
        )
    print()
    return report


def boundary(name: str, believes: float | None, delays: Sequence[float], cars: Any) -> list[dict[str, Any]]:
    """A row a delay: worst |e| by kind and by speed, the share of cars held, the slowest that is not; printed too."""
    label, rows = labelled(name, believes), []
    for delay in delays:
        controller = make_controller(name, design_model(delay=delay if believes is None else believes))
        e = largest(name, controller, delay, cars)
        kinds, held = by_kind(cars, e), float(np.mean(e <= TRIP))
        failing = cars[e > TRIP, 3]
        slowest = float(failing.min()) if len(failing) else None
        speeds = {f"{v:g}": float(e[cars[:, 3] == v].max()) for v in np.unique(cars[:, 3])}
        rows.append(
            {
                "delay": delay,
                "worst_e_m": kinds,
                "worst_e_m_by_speed": speeds,
                "share_within": held,
                "slowest_failing_v": slowest,
            }
        )
        cells = "".join(f"{kinds[k]:9.3f}" if kinds.get(k, np.inf) < 5.0 else f"{'-':>9}" for k in KINDS)
        print(
            f"{label:34}{delay:5.2f}s{cells}{held:8.0%}  {'none' if slowest is None else f'{slowest:g} m/s'}",
            flush=True,
        )
    return rows


def labelled(name: str, believes: float | None) -> str:
    """What a controller is called in table and picture."""
    return name if believes is None else f"{name}, believes {believes:g} s"


def picture(report: dict[str, list[dict[str, Any]]], file: str) -> None:
    """Worst |e| of the whole box over delay and speed, a panel a controller; red is beyond 0.5 m."""
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    from steerkit.plots.style import COLOURS, save, style

    across = min(3, len(report))
    down = -(-len(report) // across)
    with style():
        figure = Figure(figsize=(3.3 * across + 0.6, 2.7 * down + 0.5), layout="constrained")
        axes = figure.subplots(down, across, squeeze=False)
        for ax in axes.flat[len(report) :]:
            ax.axis("off")
        for ax, (label, rows) in zip(axes.flat, report.items()):
            speeds = list(rows[0]["worst_e_m_by_speed"])
            e = np.array([[row["worst_e_m_by_speed"][v] for v in speeds] for row in rows])
            ax.imshow(
                np.clip(e, 0.05, 5.0),
                origin="lower",
                aspect="auto",
                cmap="RdYlGn_r",
                alpha=0.85,
                norm=LogNorm(TRIP / 10.0, TRIP * 10.0),
            )
            for (i, j), value in np.ndenumerate(e):
                bold = "bold" if value > TRIP else "normal"
                text = f"{value:.2f}" if value < 5.0 else "off"
                ax.text(j, i, text, ha="center", va="center", fontsize=7, weight=bold, color=COLOURS["ink"])
            ax.set_xticks(range(len(speeds)), speeds)
            ax.set_yticks(range(len(rows)), [f"{row['delay']:g}" for row in rows])
            ax.set_title(label)
            ax.grid(False)
        for ax in axes[-1]:
            ax.set_xlabel("v [m/s]")
        for ax in axes[:, 0]:
            ax.set_ylabel("delay [s]")
        figure.suptitle(
            "Largest |e| [m] of a round, worst of tyres ±30 %, ratio ±10 %, offset ±3°; bold: beyond 0.5 m",
            x=0.01,
            ha="left",
            fontsize=10,
            fontweight="bold",
            color=COLOURS["ink"],
        )
    save(figure, file, dpi=120)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick drives the delay-aware Stanley at two delays (at one
    where it believes 0.2 s), 4 and 9 m/s only."""
    parser.add_argument("--controllers", nargs="+", default=None, choices=NAMES, help="default: all but mpc")
    parser.add_argument("--out", default=None, help="file for a picture of the boundary")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Drive the whole box, print the boundary, draw it."""
    usual = ["stanley-delay"] if options.quick else [name for name in NAMES if name != "mpc"]
    controllers = options.controllers or usual
    report: dict[str, Any] = {"laps": laps(controllers)}
    print("worst |e| [m] of the round; - : beyond 5 m or not finished; share: cars of the whole box within 0.5 m")
    print(
        f"{'controller':34}{'delay':>6}" + "".join(f"{kind:>9}" for kind in KINDS) + f"{'share':>8}  slowest that fails"
    )
    pairs = [(name, b) for name in controllers for b in (None, BELIEVED) if b is None or name in COMPENSATES]
    boundaries = {}
    for name, believes in pairs:
        delays = DELAYS[:: 6 if options.quick else 2 if name == "mpc" else 1]
        if options.quick and believes is not None:
            delays = delays[:1]
        boundaries[labelled(name, believes)] = boundary(name, believes, delays, box(name, options.quick))
    if options.out:
        picture(boundaries, options.out)
        print(f"\npicture: {options.out}")
    return report | boundaries
