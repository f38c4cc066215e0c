"""The command `steerkit vehicles`: what can be driven with."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Any

import typer

from steerkit.cli.options import Machine

if TYPE_CHECKING:
    from steerkit.vehicles import Vehicle
    from steerkit.vehicles.fleet import FleetCar


def vehicles(
    having: Annotated[
        str, typer.Argument(help="Only cars whose name has this in it, such as toyota; or a vehicle file, FILE.toml.")
    ] = "",
    as_json: Machine = False,
) -> None:
    """List the cars: those by name, and the fleet of production cars with the steering delay of each.

    delay: of the steering, as production software assumes it; from: the slowest speed that the maker's interface takes
    commands at. One of the fleet can also be drawn: `--vehicle fleet-17` is the car of seed 17.
    """
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table

    from steerkit.vehicles import VEHICLES, fleet

    rows: list[dict[str, Any]] = []
    cars: dict[str, tuple[Vehicle, FleetCar | None]] = {}
    delay: float | None = None
    if having.endswith(".toml"):
        from steerkit.scenario import Scenario

        named = Scenario(vehicle=having).vehicle
        cars[having], delay = (named.nominal, None), named.steering_in_file().get("delay")
    else:
        known = {name: (car, None) for name, car in VEHICLES.items()}
        known |= {name: (member.vehicle, member) for name, member in fleet().items()}  # type: ignore[misc]
        cars = {name: car for name, car in known.items() if having.lower() in name}
    for name, (car, member) in cars.items():
        rows.append(
            {
                "vehicle": name,
                "mass_kg": car.m,
                "wheelbase_m": car.wheelbase,
                "steer_ratio": car.steer_ratio,
                "steer_delay_s": member.steer_delay if member else delay,
                "interface": member and member.interface,
                "slowest_mps": member and member.slowest,
            }
        )
    if not rows:
        raise ValueError(f"vehicles: no name has '{having}' in it; without it all are listed")
    if as_json:
        print(json.dumps({"vehicles": rows}))
        return
    table = Table(box=SIMPLE_HEAD, pad_edge=False, collapse_padding=True, show_edge=False)
    table.add_column("vehicle", no_wrap=True)
    for heading in ("mass\n(kg)", "wheel-\nbase\n(m)", "ratio", "delay\n(s)", "steer\nby", "from\n(m/s)"):
        table.add_column(heading, no_wrap=True, justify="left" if heading.endswith("by") else "right")
    for name, mass, wheelbase, ratio, waits, interface, slowest in (row.values() for row in rows):
        steering = (
            "-" if waits is None else f"{waits:.2f}",
            interface or "-",
            "-" if slowest is None else f"{slowest:.1f}",
        )
        table.add_row(name, f"{mass:.0f}", f"{wheelbase:.2f}", f"{ratio:.1f}", *steering)
    Console(width=max(80, Console().width)).print(table)  # a narrower terminal would cut off words
