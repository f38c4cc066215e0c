"""The command `steerkit prove`: a manoeuvre in simulation, in a log, or on a car, evaluated and judged."""

from __future__ import annotations

import contextlib
import json
import shlex
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from steerkit._support.errors import require
from steerkit.car import prove as car_prove
from steerkit.car import recording as recordings
from steerkit.car.session import Options
from steerkit.cli.log import Columns, Dbc, Map, SteerRatio, column_map
from steerkit.cli.options import CarOptions, car_options, drive_options, in_simulation, on_car
from steerkit.logs import read_drive
from steerkit.logs.drive import Drive
from steerkit.proving import page
from steerkit.proving.evaluate import Evaluation, evaluate
from steerkit.proving.find import found
from steerkit.proving.manoeuvre import Limit, Manoeuvre, read_limits, some
from steerkit.proving.runs import Run
from steerkit.proving.simulate import of_fleet, simulated
from steerkit.scenario import Scenario
from steerkit.scenario.scenario import read_scenario
from steerkit.task import DT
from steerkit.vehicles import Vehicle
from steerkit.vehicles import vehicle as vehicle_named
from steerkit.vehicles.fleet import fleet

RECORDED = {name: name for name in ("delta_sw", "v", "r", "a_y", "beta", "x", "y", "psi", "e")}
RECORDED |= {"delta_sw_cmd": "command"}
"""Signals of a run, and what they are called in a car's recording."""
_ABREAST = 5  # evaluations in columns of a table
WORDS = {True: "PASSED", False: "FAILED", None: "not judged"}


@drive_options
def prove(
    options: CarOptions,
    manoeuvres: Annotated[
        list[str] | None, typer.Argument(metavar="MANOEUVRE...", help="Names, TOML files, or `all`; none: a list.")
    ] = None,
    car: Annotated[
        list[str] | None,
        typer.Option(help="sim (default); a log, or its files, repeatable; or the TOML file of a car on a CAN bus."),
    ] = None,
    speed: Annotated[float | None, typer.Option(help="Instead of the manoeuvre's (m/s).")] = None,
    a_y: Annotated[float | None, typer.Option(help="Size of the input, instead of the manoeuvre's (m/s^2).")] = None,
    limits: Annotated[Path | None, typer.Option(help="TOML file of [[limit]] tables instead of its own.")] = None,
    report: Annotated[Path | None, typer.Option(help="Page to write (.html), or a folder for one a manoeuvre.")] = None,
    vehicle: Annotated[
        list[str] | None,
        typer.Option(help="Car, or its data for a log: a name, a vehicle file, or `fleet`; repeatable: side by side."),
    ] = None,
    controller: Annotated[
        list[str] | None, typer.Option(help="Who drives a course, or leads to the input on a car; repeatable.")
    ] = None,
    scenario_file: Annotated[Path | None, in_simulation("TOML file: plant, steering.", "--scenario")] = None,
    seed: Annotated[int, in_simulation("Seed of what is drawn by lot.")] = 0,
    columns: Map = None,
    column: Columns = None,
    dbc: Dbc = None,
    steer_ratio: SteerRatio = None,
    yes: Annotated[bool, on_car("Consent to every run; with --simulated.", "--yes")] = False,
    repeats: Annotated[int | None, on_car("Runs to each side.")] = None,
    minutes: Annotated[float, on_car("Longest time; 0: until all is driven.")] = 0.0,
) -> None:
    """Drive a manoeuvre of vehicle testing, or find it in a log, and judge it: ISO 4138, 7401, 13674, 3888, 11270, R79.

    The same definition serves a simulation of any car, a log, and a car behind its gate. Exit code: 0; 1 where a limit
    is not kept.
    """
    if not manoeuvres:
        _list(options.as_json)
        return
    wanted = [one.at(speed, a_y if one.input else None) for one in some(manoeuvres)]
    kept = read_limits(limits) if limits else []
    page_file = report if report is not None and report.suffix else None
    require(page_file is None or page_file.suffix == ".html", f"--report {report}", "expected FILE.html, or a folder")
    require(page_file is None or len(wanted) == 1, f"--report {report}", "one page is of one manoeuvre; name a folder")
    where, drivers, cars = car or ["sim"], controller or ["stanley"], vehicle or []
    console = Console(stderr=options.as_json, quiet=options.quiet and not options.as_json)
    done = dict[str, list[Evaluation]]()
    with contextlib.redirect_stdout(sys.stderr) if options.as_json else contextlib.nullcontext():
        if where == ["sim"]:
            base = read_scenario(scenario_file) if scenario_file else Scenario()
            each = _in_simulation(wanted, base, cars or ([] if scenario_file else ["vw-passat"]), drivers, kept, seed)
        elif where[0].endswith(".toml"):
            require(options.simulated or not yes, "--yes", "is for a simulated car; on a real one a person consents")
            how = {"base": drivers[0], "repeats": repeats, "yes": yes, "minutes": minutes}
            each = _on_a_car(wanted, car_options(options, where[0]), kept, how)
        else:
            if len(where) == 1 and _has_runs(Path(where[0])):
                each = (_recorded(one, Path(where[0]), kept) for one in wanted)
            else:
                drive = read_drive(where, column_map(columns, column), dbc=dbc or (), steer_ratio=steer_ratio)
                each = _in_a_log(wanted, drive, vehicle_named(cars[0] if cars else "vw-passat"), kept)
        for one in each:
            done.setdefault(one.manoeuvre.name, []).append(one)
    driven = "a car" if where[0].endswith(".toml") else "simulation" if where == ["sim"] else "log"
    driven = "simulated car on a bus" if options.simulated else driven
    for evaluations in done.values():
        _print(console, evaluations)
        if report is not None:
            file = page_file or report / f"{evaluations[0].manoeuvre.name}.html"
            file.parent.mkdir(parents=True, exist_ok=True)
            page.write(file, evaluations, general={"how": driven}, command=shlex.join(["steerkit", *sys.argv[1:]]))
            console.print(f"report: {file}", soft_wrap=True, highlight=False)
    judged = [one.passed for evaluations in done.values() for one in evaluations]
    if options.as_json:
        facts = [one.facts() for evaluations in done.values() for one in evaluations]
        print(json.dumps({"evaluations": _plain(facts)}, allow_nan=False))
    raise typer.Exit(1 if False in judged else 0)


def _in_simulation(
    wanted: Sequence[Manoeuvre],
    base: Scenario,
    cars: Sequence[str],
    controllers: Sequence[str],
    limits: Sequence[Limit],
    seed: int,
) -> Iterator[Evaluation]:
    """Of each manoeuvre, each car (none: the scenario's), and on a course each controller."""
    for one in wanted:
        if list(cars) == ["fleet"]:
            for each, runs in of_fleet(one, list(fleet().values())):
                yield evaluate(one, runs, each.vehicle, who=each.vehicle.name, limits=limits)
            continue
        scenarios = [base] if not cars else [base.with_(vehicle={"name": name}) for name in cars]
        for scenario in scenarios:
            scenario = scenario.with_(steering=scenario.vehicle.steering_in_file())
            for driver in controllers if one.course else controllers[:1]:
                runs = simulated(one, scenario, controller=driver, seed=seed)
                who = f"{scenario.nominal.name}, simulated ({scenario.vehicle.plant})"
                who = f"{who}, {driver}" if one.course else who
                yield evaluate(one, runs, scenario.nominal, who=who, limits=limits)


def _in_a_log(
    wanted: Sequence[Manoeuvre], drive: Drive, data: Vehicle, limits: Sequence[Limit]
) -> Iterator[Evaluation]:
    """Of each manoeuvre what the log has of it."""
    for one in wanted:
        driven, runs, notes = found(one, drive)
        yield evaluate(driven, runs, data, who=f"{drive.name} (data of {data.name})", limits=limits, notes=notes)


def _on_a_car(wanted: Sequence[Manoeuvre], options: Options, limits: Sequence[Limit], how: Any) -> Iterator[Evaluation]:
    """Each manoeuvre by the car of a file, from its recording."""
    for one in wanted:
        figures = car_prove.drive(options, one, **how)
        yield _recorded(one, Path(figures["recording"]), limits)


def _has_runs(file: Path) -> bool:
    """Is it a recording of ours with runs of manoeuvres in it, and not a log of another program?"""
    try:
        return file.suffix == ".mcap" and bool(car_prove.runs_in(file))
    except ValueError:
        return False


def _recorded(one: Manoeuvre, file: Path, limits: Sequence[Limit]) -> Evaluation:
    """The runs of a car's own recording, which says when each began, and why it ended; whole or cut short."""
    recording, cut = recordings.read(file), list[Run]()
    config, told = (
        recordings.config_of(recording),
        [run for run in car_prove.runs_in(file) if run["manoeuvre"] == one.name],
    )
    rows = [row for row in recording.of("/car") if np.isfinite([row[of] for of in RECORDED.values()]).all()]
    at = np.array([row["t"] for row in rows])
    for run in told:
        on_course = run["side"] == "course"
        begin = run["begin"] - (0.0 if on_course else one.conditions.settle)
        t = np.arange(begin, run["end"] + 1e-9, DT)
        if len(t) < 10 or len(at) < 10:
            continue
        cut.append(
            Run(
                t=t - run["begin"],
                signals={name: np.interp(t, at, [row[of] for row in rows]) for name, of in RECORDED.items()},
                side="left" if on_course else run["side"],
                number=run["number"],
                invalid=run["cause"] or "",
                whole=on_course and one.input is not None,
            )
        )
    driven = one.at(told[0]["v"], told[0]["a_y"] if one.input and told[0]["a_y"] else None) if told else one
    notes = [] if told else ["no run of it is in this recording"]
    return evaluate(driven, cut, config.vehicle, who=f"{config.vehicle.name}, {file.name}", limits=limits, notes=notes)


def _list(as_json: bool) -> None:
    """The manoeuvres that ship."""
    rows = some(["all"])
    if as_json:
        print(json.dumps({"manoeuvres": [{"name": m.name, "title": m.title, "norm": m.norm} for m in rows]}))
        return
    table = Table("manoeuvre", "what it is", "after", title="Manoeuvres: steerkit prove NAME --car sim")
    for m in rows:
        table.add_row(m.name, m.about, m.norm)
    Console().print(table)


def _print(console: Any, evaluations: Sequence[Evaluation]) -> None:
    """Tables of one manoeuvre; of many cars one row each."""
    first = evaluations[0]
    title = f"{first.manoeuvre.title}, {first.manoeuvre.conditions.v:.3g} m/s ({escape(first.manoeuvre.norm)})"
    quantities = list(dict.fromkeys(r.quantity for one in evaluations for r in one.results))
    if len(evaluations) > 1:
        rows = [("", *(WORDS[one.passed] for one in evaluations))]
        known = [{r.quantity: f"{r.value:.4g}" for r in one.results} for one in evaluations]
        rows += [(quantity, *(values.get(quantity, "") for values in known)) for quantity in quantities]
        names = [escape(one.who) for one in evaluations]
        if len(evaluations) > _ABREAST:  # a fleet: a line a car
            for name, *values in zip(["car", *names], *rows):
                console.print("  ".join([f"{name:32}", *values]), soft_wrap=True, highlight=False)
            return
        table = Table("", *names, title=title)
        for row in rows:
            table.add_row(*row)
        console.print(table)
        return
    table = Table("quantity", "value", "95 % interval", "unit", "of", "", title=f"{title}: {escape(first.who)}")
    for r in first.results:
        interval = f"[{r.low:.4g}, {r.high:.4g}]" if r.high - r.low >= 0.0 else ""
        table.add_row(r.quantity, f"{r.value:.4g}", escape(interval), r.unit, str(r.n), r.note)
    console.print(table)
    for limit, passed in first.verdicts:
        console.print(
            f"{WORDS[passed]}: {limit.quantity} {limit.text()} ({escape(limit.source)})",
            soft_wrap=True,
            highlight=False,
        )
    for run in first.runs:
        if run.invalid:
            text = f"run {run.number}, {run.side}, does not count: {escape(run.invalid)}"
            console.print(text, soft_wrap=True, highlight=False)
    for note in first.notes:
        console.print(escape(note), soft_wrap=True, highlight=False)
    if first.manoeuvre.unverified:
        text = f"numbers not verified against the norm's text: {', '.join(first.manoeuvre.unverified)}"
        console.print(text, soft_wrap=True, highlight=False)


def _plain(value: Any) -> Any:
    """As JSON has it: None for a number that is none."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and value != value else value
