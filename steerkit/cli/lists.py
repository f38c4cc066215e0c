"""The commands `steerkit courses`, `vehicles` and `new`: what can be driven, with what, and files to begin with."""

import json
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from steerkit._support.errors import known, require
from steerkit._support.files import write_text
from steerkit.cli import WORDS
from steerkit.cli.options import Machine, Picture, written
from steerkit.paths import importers
from steerkit.paths.courses import course, names
from steerkit.paths.path import Path as CoursePath
from steerkit.plots.drive import plot_course
from steerkit.vehicles import VEHICLES, FleetCar, Vehicle, fleet
from steerkit.vehicles import vehicle as vehicle_named

ALSO: dict[str, str] = WORDS["courses"]
"""What else can be named, and what it is."""


def courses(
    file: Annotated[
        str, typer.Argument(metavar="[FILE[#KEY=VALUE,...]]", show_default=False, help="A map or a track.")
    ] = "",
    to: Annotated[Path | None, written("Course to write, of what is chosen", ".csv")] = None,
    plot: Picture = None,
    vehicle: Annotated[str, typer.Option(help="Car whose wheel has to do the bends: name or file.")] = "vw-passat",
    as_json: Machine = False,
) -> None:
    """List the courses; or what a map's FILE holds, and make a course of it.

    Keys for every file: noise (m, how far points lie beside the way), closed, reverse (yes, no). By kind: CSV
    lap; GPX track, lap; GeoJSON feature, lap; OpenDRIVE road, lane, to; CommonRoad and Lanelet2 lanelet, to; OSM way,
    to. `to` is where the shortest way along connected lanes leads. Every --course takes such an address, too.
    """
    if file:
        _of_file(file, to, plot, vehicle, as_json)
        return
    cure = "make something of a map's file; name it: steerkit courses lap.gpx --to lap.csv"
    require(to is None and plot is None, "--to, --plot", cure)
    rows = [_of_path(name, course(name)) for name in names()]
    if as_json:
        print(json.dumps({"courses": rows, "also": ALSO}))
        return
    table = Table("course", "length (m)", "closed", "tightest radius (m)")
    for name, length, closed, radius in (row.values() for row in rows):
        table.add_row(name, f"{length:.0f}", "yes" if closed else "no", f"{radius:.1f}" if radius else "straight")
    Console().print(table)
    for name, what in ALSO.items():
        print(f"{name:12s} {what}")


def _of_file(file: str, to: Path | None, plot: Path | None, vehicle: str, as_json: bool) -> None:
    found = importers.contents(file)
    address = importers.Address.parsed(file)
    single = len(found.pieces) == 1
    if not (address.choice or single) and to is None and plot is None:
        _list(found, address.file, as_json)
        return
    made = importers.read_course(file, tightest=float(vehicle_named(vehicle).tightest))
    if to is not None:
        made.to_csv(str(to))
    if plot is not None:
        plot_course(made.path).savefig(plot)
    row, speeds = _of_path(made.path.name, made.path), list[str]()
    for key, values, what in (("v", made.v, "as driven"), ("v_limit", made.v_limit, "allowed")):
        row[key] = None if values is None else [float(np.nanmin(values)), float(np.nanmax(values))]
        speeds += [] if values is None else [f"{np.nanmin(values):.1f} to {np.nanmax(values):.1f} m/s {what}"]
    if as_json:
        print(json.dumps({**row, "notes": made.notes, "written": [str(f) for f in (to, plot) if f is not None]}))
        return
    print(made.path)
    radius = row["tightest_radius_m"]
    print(f"tightest radius {radius:.1f} m" if radius else "straight", *speeds, sep=", ")
    for note in made.notes:
        print(f"  {note}")
    for place in (to, plot):
        if place is not None:
            print(f"wrote {place}")


def _of_path(name: str, path: CoursePath) -> dict[str, Any]:
    sharpest = float(abs(path.samples.kappa).max())
    radius = 1.0 / sharpest if sharpest > 1e-6 else None
    return {"course": name, "length_m": path.length, "closed": path.closed, "tightest_radius_m": radius}


def _list(found: importers.Map, file: str, as_json: bool) -> None:
    """What there is to choose from."""
    rows = []
    for group, parts in found.groups.items():
        pieces = [found.pieces[name] for name in parts]
        lanes = list(dict.fromkeys(piece.lane for piece in pieces))
        after = {found.pieces[name].group for piece in pieces for name in piece.next if name in found.pieces} - {group}
        row: dict[str, Any] = {
            found.kind: group,
            "length_m": found.length_of(group),
            "lanes": [lane for lane in lanes if lane],
        }
        rows.append(row | {"leads_to": sorted(after), "about": " ".join(dict.fromkeys(p.about for p in pieces))})
    notes = [*found.notes, *found.left_out]
    if as_json:
        print(json.dumps({"file": file, "kind": found.kind, f"{found.kind}s": rows, "notes": notes}))
        return
    table = Table(found.kind, "length (m)", "lanes", "leads to", "")
    for row in rows:
        leads = ", ".join(row["leads_to"][:8]) + (" ..." if len(row["leads_to"]) > 8 else "")
        table.add_row(row[found.kind], f"{row['length_m']:.0f}", ", ".join(row["lanes"]), leads, row["about"])
    Console().print(table)
    for note in notes:
        print(note)
    first = rows[0]
    lane = f",lane={first['lanes'][0]}" if len(first["lanes"]) > 1 else ""
    print(f"choose: steerkit courses '{file}#{found.kind}={first[found.kind]}{lane}' --to course.csv")


def vehicles(
    having: Annotated[str, typer.Argument(help="Only cars whose name has this in it, such as toyota.")] = "",
    as_json: Machine = False,
) -> None:
    """List the cars: those by name, and the fleet of production cars with the steering delay of each.

    delay: of the steering, as production software assumes it; from: the slowest speed that the maker's interface takes
    commands at. One of the fleet can also be drawn: `--vehicle fleet-17` is the car of seed 17.
    """
    rows: list[dict[str, Any]] = []
    known: dict[str, tuple[Vehicle, FleetCar | None]] = {name: (car, None) for name, car in VEHICLES.items()}
    known |= {name: (member.vehicle, member) for name, member in fleet().items()}
    for name, (car, member) in known.items():
        if having.lower() not in name:
            continue
        rows.append(
            {
                "vehicle": name,
                "mass_kg": car.m,
                "wheelbase_m": car.wheelbase,
                "steer_ratio": car.steer_ratio,
                "steer_delay_s": member and member.steer_delay,
                "interface": member and member.interface,
                "slowest_mps": member and member.slowest,
            }
        )
    require(rows, "vehicles", f"no name has '{having}' in it; without it all are listed")
    if as_json:
        print(json.dumps({"vehicles": rows}))
        return
    table = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True, show_edge=False)
    table.add_column("vehicle", no_wrap=True)
    for heading in ("mass\n(kg)", "wheel-\nbase\n(m)", "ratio", "delay\n(s)", "steer\nby", "from\n(m/s)"):
        table.add_column(heading, no_wrap=True, justify="left" if heading.endswith("by") else "right")
    for name, mass, wheelbase, ratio, waits, interface, slowest in (row.values() for row in rows):
        steering = ("-", "-", "-") if interface is None else (f"{waits:.2f}", interface, f"{slowest:.1f}")
        table.add_row(name, f"{mass:.0f}", f"{wheelbase:.2f}", f"{ratio:.1f}", *steering)
    Console(width=max(80, Console().width)).print(table)  # a narrower terminal would cut off words


_FILES: dict[str, list[str]] = WORDS["new"]
"""By kind: its file among the templates, and what to call with it."""


def new(
    kind: Annotated[str, typer.Argument(metavar="KIND", help=f"One of {', '.join(_FILES)}.")],
    out: Annotated[Path | None, typer.Option(help="Where to write it (my_KIND, with its ending).")] = None,
) -> None:
    """Write a file that works as it is, to be changed into your own: a controller, agent, vehicle, course, ..."""
    name, after = _FILES[known(kind, _FILES, "new")]
    ending = Path(name.removesuffix(".txt")).suffix
    place = out or Path(f"my_{kind}{ending}")
    require(place.suffix == ending, f"--out {place}", f"a {kind}'s file ends in {ending}")
    require(not place.exists(), str(place), "is there already and is left as it is; another name: --out")
    write_text(place, (files("steerkit.cli") / "templates" / name).read_text(encoding="utf-8"))
    print(f"wrote {place}; next: {after.format(place)}")
