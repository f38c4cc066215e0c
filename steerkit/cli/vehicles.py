"""The command `steerkit vehicles`: what can be driven with."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from steerkit.cli.options import Machine


def vehicles(
    having: Annotated[str, typer.Argument(help="Only cars whose name has this in it, such as toyota.")] = "",
    as_json: Machine = False,
) -> None:
    """List the cars: those by name, and the fleet of production cars with the steering delay of each.

    delay: of the steering, as production software assumes it; from: the slowest speed that the maker's interface takes
    commands at. One of the fleet can also be drawn: `--vehicle fleet-17` is the car of seed 17.
    """
    from rich.console import Console
    from rich.table import Table

    from steerkit.vehicles import VEHICLES, fleet

    cars = {name: (car, None) for name, car in VEHICLES.items()}
    cars |= {name: (member.vehicle, member) for name, member in fleet().items()}  # type: ignore[misc]
    rows: list[dict[str, Any]] = []
    for name, (car, member) in cars.items():
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
    if not rows:
        raise ValueError(f"vehicles: no name has '{having}' in it; without it all are listed")
    if as_json:
        print(json.dumps({"vehicles": rows}))
        return
    table = Table()
    table.add_column("vehicle", no_wrap=True)
    for heading in ("mass (kg)", "wheelbase (m)", "ratio", "delay (s)", "interface", "from (m/s)"):
        table.add_column(heading)
    for name, mass, wheelbase, ratio, delay, interface, slowest in (row.values() for row in rows):
        known = ("-",) * 3 if delay is None else (f"{delay:.2f}", interface, f"{slowest:.1f}")
        table.add_row(name, f"{mass:.0f}", f"{wheelbase:.2f}", f"{ratio:.1f}", *known)
    Console().print(table)
