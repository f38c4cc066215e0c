"""`steerkit resimulate`: a recorded drive, driven again by another controller."""

import json
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.table import Table

from steerkit.cli import WORDS
from steerkit.cli.log import Columns, Map, column_map
from steerkit.cli.options import Machine, Picture, Quiet, Report, write_page
from steerkit.identification import identify
from steerkit.logs import read_drive
from steerkit.logs import resimulate as again
from steerkit.plants.steering_actuator import SteeringActuator, steering_of
from steerkit.plots.style import save
from steerkit.vehicles import vehicle as vehicle_named


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
        _report(console, driven)
    if plot is not None:
        save(again.compared(*driven), plot)
        console.print(f"picture: {plot}", soft_wrap=True)
    if report is not None:
        verdict = [one.verdict() for one in driven]
        write_page(report, console, f"{drive.name}, driven again", verdict, [again.compared(*driven)])
        console.print(f"report: {report}", soft_wrap=True)


def _car(file: str, drive: Any) -> tuple[Any, Any, str]:
    if file:
        motor = steering_of(file) if file.endswith(".toml") else SteeringActuator()
        return vehicle_named(file), motor, f"the car: {file}, delay {motor.delay:.2f} s, lag {motor.lag:.2f} s"
    found = identify(drive)
    motor = steering_of("the identified car", text=found.text())
    known = f"ratio {found.vehicle.steer_ratio:.2f}, lag {motor.lag + motor.delay:.2f} s"
    return found.vehicle, motor, f"the car, as identified from the drive: {known}"


def _report(console: Any, driven: list[Any]) -> None:
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
