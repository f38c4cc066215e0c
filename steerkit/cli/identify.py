"""`steerkit identify`, from recorded drives to a vehicle file; `steerkit resimulate`, one driven by others."""

import contextlib
import json
import math
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from steerkit import identification as ident
from steerkit.cli import WORDS
from steerkit.cli.log import Columns, Dbc, Map, SteerRatio, column_map
from steerkit.cli.options import Machine, Picture, Quiet, Report, write_page, written
from steerkit.identification.ahead import HORIZONS, QUANTITIES, look_ahead
from steerkit.identification.fit import intervals
from steerkit.logs import read_drive
from steerkit.logs import resimulate as again
from steerkit.plants.steering_actuator import SteeringActuator, steering_of
from steerkit.vehicles import scaled, vehicle
from steerkit.vehicles import vehicle as vehicle_named

_FITS = ("rms", "rms_driving", "mean_driving", "rms_rezeroed", "zero_shift")
"""Numbers of a prediction."""


def identify(
    log: Annotated[list[str], typer.Argument(help="A recording, or its files; or `genesis`, `genesis-rfs`.")],
    columns: Map = None,
    column: Columns = None,
    dbc: Dbc = None,
    steer_ratio: SteerRatio = None,
    held_out: Annotated[str | None, typer.Option(help="Another drive of the same car, to predict.")] = None,
    base: Annotated[str, typer.Option(help="Car whose mass and geometry are given: name or FILE.toml.")] = "vw-passat",
    wheelbase: Annotated[float | None, typer.Option(help="Wheelbase, in m, if not the base's.")] = None,
    mass: Annotated[float | None, typer.Option(help="Mass, in kg, if not the base's.")] = None,
    fix: Annotated[list[str] | None, typer.Option(help="NAME=VALUE: hold a parameter; repeatable.")] = None,
    tyres: Annotated[bool, typer.Option("--tyres", help="Fit Pacejka tyres too, and judge them.")] = False,
    name: Annotated[str, typer.Option(help="Name of the car in the file.")] = "",
    out: Annotated[Path | None, written("Vehicle file to write, else it is printed", ".toml")] = None,
    plot: Picture = None,
    report: Report = None,
    dt: Annotated[
        float | None, typer.Option(help="Step of the common clock in s; default: the log's, 0.01 to 0.05.")
    ] = None,
    trust_units: Annotated[bool, typer.Option("--trust-units", help="Do not judge units and signs.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print results only, no progress.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line.")] = False,
) -> None:
    """Estimate a car's steering ratio, offset, delay, lag and cornering stiffness from a recorded drive.

    LOG is anything that `steerkit log` shows: CSV, MATLAB, npz, Parquet, MCAP, a ROS bag, MF4, a CAN log with --dbc;
    several files, if they are of one clock. Columns of other names or units are given by --map, a TOML file whose table
    `columns` has lines such as::

        delta_sw = { column = "angle", unit = "deg", scale = -1 }

    for t, delta_sw, v, and r or psi; or by --column delta_sw=angle:deg:-1.

    The vehicle file serves wherever a car's name does: `vehicle("my-car.toml")`, `--base`, a scenario.
    """
    to_pipe = not as_json and out is None  # then the vehicle file alone goes to standard output
    console = Console(stderr=to_pipe, record=True)
    console = console if console.is_terminal else Console(stderr=to_pipe, record=True, width=110)
    given = column_map(columns, column)
    how: Any = {"dbc": dbc or (), "steer_ratio": steer_ratio, "dt": dt, "trusted": trust_units}
    car = vehicle(base)
    if wheelbase is not None or mass is not None:
        length, weight = wheelbase or float(car.wheelbase), mass or float(car.m)
        car = scaled(f"{car.name}-scaled", m=weight, wheelbase=length, steer_ratio=float(car.steer_ratio))
    called, held = name or f"{Path(log[0]).name.split('.')[0]}-car", _fixed(fix or ())
    with console.status("reading and fitting", spinner="line") if not quiet else contextlib.nullcontext():
        drive = ident.read_drive(log, given, **how)
        identified = ident.identify(drive, car, fixed=held, name=called)
        prediction, agrees, judged = None, "", drive
        if held_out:
            judged = other = ident.read_drive(held_out, given, **how)
            prediction = identified.predict(other)
            if other.turns:
                agrees = identified.against(ident.identify(other, car, fixed=held))
        # what the tyres' model has too: its delay is both of the other's
        of_tyres = {key: value for key, value in held.items() if key in ("steer_ratio", "offset", "rate_zero")}
        grip = ident.identify_tyres(drive, car, fixed=of_tyres) if tyres else None
        ahead = look_ahead(identified, judged, grip)
    command = " ".join(["steerkit", *sys.argv[1:]])
    _report(console, identified, prediction, ahead, grip, quiet=quiet)
    if agrees:
        console.print(escape(agrees), highlight=False, soft_wrap=True)
    if out is not None:
        identified.save(out, command=command, held_out=prediction)
        console.print(f"vehicle file: {out}", soft_wrap=True)
    elif not as_json:
        print(identified.text(command=command, held_out=prediction), end="")
    if report is not None:
        found = filter(None, [agrees])
        write_page(report, console, f"{identified.vehicle.name}, identified", found, [identified.plot(prediction)])
        console.print(f"report: {report}", soft_wrap=True)
    if plot is not None:
        identified.plot(prediction).savefig(plot)
        console.print(f"picture: {plot}", soft_wrap=True)
    if as_json:
        fits = {"fit": identified.fit} | ({"held_out": prediction} if prediction else {})
        answer = {
            "vehicle": identified.vehicle.name,
            "estimates": intervals(identified.estimates),
            "correlation_time": identified.correlation_time,
            "ahead": {"seconds": HORIZONS} | asdict(ahead),
            "notes": [*identified.drive.notes, *identified.notes, *filter(None, [agrees])],
        }
        if grip:
            answer["tyres"] = {"estimates": intervals(grip.estimates), "notes": grip.notes}
        for word, fit in fits.items():
            answer[word] = {"drive": fit.drive.name} | {key: getattr(fit, key) for key in _FITS}
        print(json.dumps(answer))


def _report(console: Any, identified: Any, prediction: Any, ahead: Any, grip: Any, *, quiet: bool) -> None:
    if not quiet:
        for part in (identified.fit, *([prediction] if prediction else ())):
            for note in part.drive.notes:
                console.print(f"{part.drive.name}: {escape(note)}", soft_wrap=True, highlight=False)
    for what, found in ((identified.vehicle.name, identified), ("Pacejka tyres", grip)):
        table = Table("parameter", "value", "95 % interval", "unit", "source", "", title=what)
        for e in found.estimates if found else ():
            known = math.isfinite(e.value)
            ends = (f"{e.value:.4g}", escape(f"[{e.low:.4g}, {e.high:.4g}]")) if known else ("-", "-")
            table.add_row(e.name, *ends, e.unit, e.source, e.note)
        if found:
            console.print(table)
    fits = Table("yaw rate of", "RMS \\[rad/s]", "from 3 m/s on", "mean", "wheel's zero found anew")
    for part in (identified.fit, *([prediction] if prediction else ())):
        fits.add_row(part.drive.name, *(f"{getattr(part, key):.5f}" for key in _FITS[:4]))
    console.print(fits)
    title = f"{ahead.drive}: RMS error ahead, from {ahead.starts} starts"
    errors = Table("", "predicted by", *(f"{seconds:g} s" for seconds in HORIZONS), title=escape(title))
    for quantity, by_predictor in ahead.errors.items():
        for who, misses in by_predictor.items():
            errors.add_row(f"{quantity} \\[{QUANTITIES[quantity]}]", who, *(f"{miss:.3f}" for miss in misses))
    if ahead.errors:
        console.print(errors)
    console.print(f"ahead: {escape(ahead.note)}", highlight=False, soft_wrap=True)
    if not quiet:
        for note in (*identified.notes, *(grip.notes if grip else ())):
            console.print(escape(note), highlight=False, soft_wrap=True)


def _fixed(words: list[str] | tuple[str, ...]) -> dict[str, float]:
    held = {}
    for word in words:
        key, _, value = word.partition("=")
        try:
            held[key] = float(value)
        except ValueError:
            raise ValueError(f"--fix {word}: expected NAME=VALUE, such as lag=0") from None
    return held


def resimulate(
    recording: Annotated[str, typer.Argument(help="As for `steerkit identify`; or `genesis`, `genesis-rfs`.")],
    controller: Annotated[list[str] | None, typer.Option(help="Who drives it again; repeatable. Default: mpc.")] = None,
    vehicle: Annotated[str, typer.Option(help="Vehicle file of the car; default: identified from the drive.")] = "",
    columns: Map = None,
    column: Columns = None,
    plot: Picture = None,
    report: Report = None,
    quiet: Quiet = False,
    as_json: Machine = False,
) -> None:
    """Drive a recorded drive again in simulation: where would a controller have steered otherwise, and by how much?

    The same way (by dead reckoning from speed and yaw rate) at the same speed, on the car of --vehicle, or the one
    identified from the drive. Compared where it was recorded at 3 m/s or faster, over 20 samples a second.
    """
    names = controller or ["mpc"]
    drive = read_drive(recording, column_map(columns, column))
    console = Console(stderr=as_json, record=True)
    console = console if console.is_terminal else Console(stderr=as_json, record=True, width=110)
    car, steering, car_text = _car(vehicle, drive)
    if not quiet:
        for note in (*drive.notes, car_text):
            console.print(note, markup=False, highlight=False, soft_wrap=True)
    driven = [again.resimulate(drive, name, vehicle=car, steering=steering, progress=not quiet) for name in names]
    if as_json:
        print(json.dumps({"resimulated": [one.figures() for one in driven], "car": car_text}))
    if not as_json or report is not None:
        _compare(console, driven)
    if plot is not None:
        again.compared(*driven).savefig(plot)
        console.print(f"picture: {plot}", soft_wrap=True)
    if report is not None:
        verdict = [one.verdict() for one in driven]
        write_page(report, console, f"{drive.name}, driven again", verdict, [again.compared(*driven)])
        console.print(f"report: {report}", soft_wrap=True)


def _car(file: str, drive: Any) -> tuple[Any, Any, str]:
    if file:
        motor = steering_of(file) if file.endswith(".toml") else SteeringActuator()
        return vehicle_named(file), motor, f"the car: {file}, delay {motor.delay:.2f} s, lag {motor.lag:.2f} s"
    found = ident.identify(drive)
    motor = steering_of("the identified car", text=found.text())
    known = f"ratio {found.vehicle.steer_ratio:.2f}, lag {motor.lag + motor.delay:.2f} s"
    return found.vehicle, motor, f"the car, as identified from the drive: {known}"


def _compare(console: Any, driven: list[Any]) -> None:
    rows = [one.figures() for one in driven]
    table = Table("", "as driven", *(row["controller"] for row in rows), title=f"{rows[0]['drive']}")
    for key, text in WORDS["resimulated"].items():
        table.add_row(text, *(f"{value:.2f}" for value in (rows[0]["driven"][key], *(r["again"][key] for r in rows))))
    for key, text in (
        ("rms_differs_deg", "differs from the driven (deg RMS)"),
        ("max_differs_deg", "at most (deg)"),
        ("max_e", "beside the driven way at most (m)"),
    ):
        table.add_row(text, "", *(f"{row[key]:.2f}" for row in rows))
    console.print(table)
    places = Table(
        "controller", "t (s)", "v (m/s)", "driven (deg)", "again (deg)", "differs (deg)", title="Most otherwise"
    )
    for row in rows:
        for p in row["places"]:
            numbers = (p["t"], p["v"], p["driven_deg"], p["again_deg"], p["differs_deg"])
            places.add_row(row["controller"], *(f"{x:.1f}" for x in numbers))
    console.print(places)
