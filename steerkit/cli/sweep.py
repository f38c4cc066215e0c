"""The command `steerkit sweep`: a controller on a course, with every combination of parameter values at once."""

import json
import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.table import Table

from steerkit._support.console import console
from steerkit._support.errors import require
from steerkit._support.files import write_rows
from steerkit.cli.options import SceneOptions, drive_options, driven_on, in_simulation, scenario_of
from steerkit.compiled import TraceError
from steerkit.diagram.loop import Loop
from steerkit.plots.style import save
from steerkit.scenario import drive
from steerkit.scenario.sweep import USUAL
from steerkit.scenario.sweep import sweep as swept

_SET = "NAME=LOW:HIGH:COUNT, NAME=LOW:HIGH:COUNT:log (evenly spaced in log) or NAME=VALUE,VALUE,..."


@drive_options
def sweep(
    ctx: typer.Context,
    options: SceneOptions,
    controller: Annotated[str, typer.Argument(help="As for `steerkit drive`; or your own: my_file.py:make.")],
    parameters: Annotated[
        list[str],
        typer.Option("--set", help=f"{_SET}: a field of the controller, or of a block: car.vehicle.m. Repeatable."),
    ],
    metrics: Annotated[list[str], typer.Option("--metric", help="Metric of docs/metrics.md; repeatable.")] = [*USUAL],  # noqa: B006 (typer copies it)
    delay: Annotated[float, in_simulation("Steering delay (s).")] = 0.0,
    seconds: Annotated[float, typer.Option(help="How long each car drives (s); 0: as long as its course takes.")] = 0.0,
    out: Annotated[
        Path | None, typer.Option(help="Directory for sweep.csv and sweep.png; default: under runs/.")
    ] = None,
) -> None:
    """Drive with hundreds of values of a controller's or a car's parameters at once: a table and a picture.

    Several --set make a grid. All drives are compiled into one program and have the same driver, noise and gusts.
    """
    require(out is None or out.is_dir() or not out.exists(), f"--out {out}", "is a file, expected a directory")
    scenario = scenario_of(ctx)
    loop = drive.drive_loop(scenario, drive.controller(controller, scenario), seed=options.seed)
    values = dict(_values(text, loop) for text in parameters)
    require(len(values) == len(parameters), "--set", f"a name stands twice in {', '.join(parameters)}")
    console.stderr = options.as_json
    try:
        lasts, show = seconds or scenario.seconds, not options.quiet
        found = swept(loop, values, lasts, metrics, distance=scenario.length, progress=show)
    except TraceError as error:
        raise ValueError(f"sweep {controller}: {error}") from error
    best = {metric: found.best(metric) for metric in metrics if np.isfinite(found[metric]).any()}
    default = f"sweep-{Path(controller).name.replace(':', '-')}-{driven_on(scenario, options.conditions)}"
    place = out or Path("runs") / f"{default}-seed{options.seed}"
    place.mkdir(parents=True, exist_ok=True)
    write_rows(place / "sweep.csv", found.columns, list(found.columns.values()))
    kept = f"{math.prod(map(len, found.values.values()))} drives: {place}/sweep.csv"
    if len(values) <= 2:
        save(found.plot(), place / "sweep.png")
        kept += f"; picture: {place}/sweep.png"
    shown = Table("best", *found.columns, title=f"{controller} on {scenario.course.name}")
    for metric, row in best.items():
        shown.add_row(metric, *(f"{value:.4g}" for value in row.values()))
    console.print(shown)
    if not options.quiet:
        console.print(kept, soft_wrap=True, markup=False)
    if options.as_json:
        columns = {name: [*map(_plain, column.tolist())] for name, column in found.columns.items()}
        rows = {metric: {name: _plain(x) for name, x in row.items()} for metric, row in best.items()}
        print(json.dumps({"controller": controller, "best": rows, "columns": columns}, allow_nan=False))


def _plain(number: float) -> float | None:
    return number if math.isfinite(number) else None


def _values(text: str, loop: Loop) -> tuple[str, Any]:
    """What one --set says: the field's whole name, and its values."""
    name, equals, numbers = text.partition("=")
    words = numbers.split(":")
    try:
        if len(words) == 1:
            values: Any = [float(word) for word in numbers.split(",")]
        elif len(words) == 4 and words[3] == "log":
            values = np.geomspace(float(words[0]), float(words[1]), int(words[2]))
        else:
            low, high, count = words
            values = np.linspace(float(low), float(high), int(count))
        require(equals and name and len(values) and np.isfinite(values).all(), "", "")
    except ValueError:
        raise ValueError(f"--set {text}: expected {_SET}") from None
    field = name.partition(".")[0]
    if field not in loop.names:  # one of the controller, or of the one that it wraps
        inside, block = ["controller"], loop.blocks["controller"]
        while field not in block.__dataclass_fields__ and hasattr(block, "block"):
            inside, block = [*inside, "block"], block.block
        name = ".".join([*(inside if field in block.__dataclass_fields__ else inside[:1]), name])
    return name, values
