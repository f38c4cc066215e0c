"""The command `steerkit prove`: a manoeuvre in simulation, in a log, or on a car, evaluated and judged."""

import contextlib
import json
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from steerkit._support.console import shown
from steerkit._support.errors import require
from steerkit.car import prove as car_prove
from steerkit.car import recording as recordings
from steerkit.cli.log import Columns, Dbc, Map, SteerRatio, column_map
from steerkit.cli.options import CarOptions, car_options, drive_options, in_simulation, on_car
from steerkit.logs import read_drive
from steerkit.logs.drive import Drive
from steerkit.proving import page
from steerkit.proving.evaluate import Evaluation, evaluate
from steerkit.proving.manoeuvre import Manoeuvre, read_limits, some
from steerkit.proving.runs import Run, found, of_fleet, simulated
from steerkit.scenario import Scenario, read_scenario
from steerkit.task import DT
from steerkit.vehicles import Vehicle, fleet
from steerkit.vehicles import vehicle as vehicle_named

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
    limits: Annotated[Path | None, typer.Option(help="TOML file of tables `limit` instead of its own.")] = None,
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
    minutes: Annotated[float, on_car("Of a run on the course; 0: a round.")] = 0.0,
) -> None:
    """Drive a manoeuvre of vehicle testing, or find it in a log, and judge it: ISO 4138, 7401, 13674, 3888, 11270, R79.

    The same definition serves a simulation of any car, a log, and a car behind its gate. Exit code 1: a limit not kept.
    """
    if not manoeuvres:
        _list(options.as_json)
        return
    wanted = [one.at(speed, a_y if one.input else None) for one in some(manoeuvres)]
    sized = a_y is None or any(one.input for one in wanted)
    require(sized, f"--a-y {a_y}", "is the size of an open-loop input; these manoeuvres are driven on a course")
    kept = read_limits(limits) if limits else []
    page_file = report if report is not None and report.suffix else None
    require(page_file is None or page_file.suffix == ".html", f"--report {report}", "expected FILE.html, or a folder")
    require(page_file is None or len(wanted) == 1, f"--report {report}", "one page is of one manoeuvre; name a folder")
    where, drivers, cars = car or ["sim"], controller or ["stanley"], vehicle or []
    console = Console(stderr=options.as_json)
    with contextlib.redirect_stdout(sys.stderr) if options.as_json else contextlib.nullcontext():
        driven = "log"
        each: Callable[[Manoeuvre], Iterator[Driven]]
        if where == ["sim"]:
            base = read_scenario(scenario_file) if scenario_file else Scenario()
            names = [] if cars == ["fleet"] else cars or ["vw-passat"]
            scenarios = [base.with_(vehicle={"name": name}) for name in names] if cars or not scenario_file else [base]
            driven, each = "simulation", partial(_simulated, scenarios=scenarios, controllers=drivers, seed=seed)
        elif where[0].endswith(".toml"):
            how: dict[str, Any] = {"base": drivers[0], "repeats": repeats, "yes": yes, "minutes": minutes}
            driven = "simulated car on a bus" if options.simulated else "a car"
            on_a_car = car_options(options, where[0])
            each = lambda one: _recorded(one, *_own(car_prove.drive(on_a_car, one, **how)["recording"]))  # noqa: E731
        elif len(where) == 1 and (own := _with_runs(Path(where[0]))):
            each = lambda one: _recorded(one, *own)  # noqa: E731
        else:
            drive = read_drive(where, column_map(columns, column), dbc=dbc or (), steer_ratio=steer_ratio)
            data = vehicle_named(cars[0] if cars else "vw-passat")
            each = partial(_found, drive=drive, data=data)
        steps = shown(wanted, "" if options.quiet or len(wanted) < 2 else "manoeuvres")
        done = [[evaluate(**it, limits=kept) for it in each(one)] for one in steps]
    for evaluations in done:
        _print(console, evaluations)
        if report is not None:
            file = page_file or report / f"{evaluations[0].manoeuvre.name}.html"
            file.parent.mkdir(parents=True, exist_ok=True)
            page.write(file, evaluations, general={"how": driven}, command=shlex.join(["steerkit", *sys.argv[1:]]))
            console.print(f"report: {file}", soft_wrap=True, highlight=False)
    if options.as_json:
        facts = [one.facts() for evaluations in done for one in evaluations]
        print(json.dumps({"evaluations": facts}, allow_nan=False))
    raise typer.Exit(int(any(one.passed is False for evaluations in done for one in evaluations)))


Driven = dict[str, Any]
"""What is evaluated: the parameters of `evaluate`."""


def _simulated(
    one: Manoeuvre, scenarios: Sequence[Scenario], controllers: Sequence[str], seed: int
) -> Iterator[Driven]:
    """By each scenario's car (none: the fleet), and on a course each controller."""
    for each, runs in [] if scenarios else of_fleet(one, list(fleet().values())):
        yield {"manoeuvre": one, "runs": runs, "vehicle": each.vehicle, "who": each.vehicle.name}
    for scenario in scenarios:
        scenario = scenario.with_(steering=scenario.vehicle.steering_in_file())
        for driver in controllers if one.course else controllers[:1]:
            runs = simulated(one, scenario, controller=driver, seed=seed)
            who = f"{scenario.nominal.name}, simulated ({scenario.vehicle.plant})" + f", {driver}" * bool(one.course)
            yield {"manoeuvre": one, "runs": runs, "vehicle": scenario.nominal, "who": who}


def _found(one: Manoeuvre, drive: Drive, data: Vehicle) -> Iterator[Driven]:
    """What a log has of it."""
    driven, runs, notes = found(one, drive)
    who = f"{drive.name} (data of {data.name})"
    yield {"manoeuvre": driven, "runs": runs, "vehicle": data, "who": who, "notes": notes}


Own = tuple[Path, recordings.Recorded, list[dict[str, Any]]]
"""A recording of ours: its file, what was read of it, and the runs in it."""


def _own(file: str) -> Own:
    recorded = recordings.read(file)
    return Path(file), recorded, car_prove.runs_in(recorded)


def _with_runs(file: Path) -> Own | None:
    """A recording of ours with runs in it; None for one without, or a log of another program."""
    if file.suffix != ".mcap":
        return None
    try:
        recorded = recordings.read(file)
    except ValueError:
        return None
    runs = car_prove.runs_in(recorded)
    return (file, recorded, runs) if runs else None


def _recorded(
    one: Manoeuvre, file: Path, recording: recordings.Recorded, runs: list[dict[str, Any]]
) -> Iterator[Driven]:
    """The runs of a car's own recording, which says when each began, and why it ended; whole or cut short."""
    cut, vehicle = list[Run](), recordings.config_of(recording).vehicle
    told = [run for run in runs if run["manoeuvre"] == one.name]
    rows = [row for row in recording.of("/car") if np.isfinite([row[of] for of in RECORDED.values()]).all()]
    at = np.array([row["t"] for row in rows])
    for run in told:
        on_course = run["side"] == "course"
        t = np.arange(run["begin"] - (0.0 if on_course else one.conditions.settle), run["end"] + 1e-9, DT)
        if len(t) < 10 or len(at) < 10:
            continue
        signals = {name: np.interp(t, at, [row[of] for row in rows]) for name, of in RECORDED.items()}
        side, whole = "left" if on_course else run["side"], on_course and one.input is not None
        more: dict[str, Any] = {"number": run["number"], "invalid": run["cause"] or "", "whole": whole}
        cut.append(Run(t=t - run["begin"], signals=signals, side=side, **more))
    driven = one.at(told[0]["v"], told[0]["a_y"] if one.input and told[0]["a_y"] else None) if told else one
    notes = [] if told else ["no run of it is in this recording"]
    who = f"{vehicle.name}, {file.name}"
    yield {"manoeuvre": driven, "runs": cut, "vehicle": vehicle, "who": who, "notes": notes}


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
    say = partial(console.print, soft_wrap=True, highlight=False)
    first, m = evaluations[0], evaluations[0].manoeuvre
    title = f"{m.title}, {m.conditions.v:.3g} m/s ({escape(m.norm)})"
    if len(evaluations) > 1:
        quantities = dict.fromkeys(r.quantity for one in evaluations for r in one.results)
        rows = [("", *(escape(one.who) for one in evaluations)), ("", *(WORDS[one.passed] for one in evaluations))]
        known = [{r.quantity: f"{r.value:.4g}" for r in one.results} for one in evaluations]
        rows += [(quantity, *(values.get(quantity, "") for values in known)) for quantity in quantities]
        if len(evaluations) > _ABREAST:  # a fleet: a line a car
            for name, *values in [("car", *(name for name, *_ in rows[1:])), *list(zip(*rows))[1:]]:
                say("  ".join([f"{name:32}", *values]))
            return
        table = Table(*rows[0], title=title)
        for row in rows[1:]:
            table.add_row(*row)
        console.print(table)
        return
    table = Table("quantity", "value", "95 % interval", "unit", "of", "", title=f"{title}: {escape(first.who)}")
    for r in first.results:
        interval = f"[{r.low:.4g}, {r.high:.4g}]" if r.high - r.low >= 0.0 else ""
        table.add_row(r.quantity, f"{r.value:.4g}", escape(interval), r.unit, str(r.n), r.note)
    console.print(table)
    for limit, passed in first.verdicts:
        say(f"{WORDS[passed]}: {limit.quantity} {limit.text()} ({escape(limit.source)})")
    for run in first.runs:
        if run.invalid:
            say(f"run {run.number}, {run.side}, does not count: {escape(run.invalid)}")
    for note in first.notes:
        say(escape(note))
    if m.unverified:
        say(f"numbers not verified against the norm's text: {', '.join(m.unverified)}")
