"""Vehicle files: a car, its steering and where the numbers come from, as TOML; read by `vehicle("car.toml")`."""

import dataclasses
import json
from collections.abc import Mapping
from typing import Any

from steerkit._support.errors import require
from steerkit._support.files import toml_of
from steerkit.vehicles.parameters import Vehicle

FORMAT = "steerkit vehicle 1"
_REMARKS = {
    "vehicle": "  # SI and radians; cornering stiffness per axle",
    "steering": "  # from the command, or the recorded angle, to the road wheels: s, s, rad",
    "estimates": "  # 95 % intervals",
}


def vehicle_of(text: str, where: str) -> Vehicle:
    """The car in the text of a vehicle file; raises ValueError naming `where`, the key and what is valid."""
    table = table_of(text, "vehicle", where)
    valid = {f.name for f in dataclasses.fields(Vehicle)}
    needed = {f.name for f in dataclasses.fields(Vehicle) if f.default is dataclasses.MISSING}
    for verb, keys in (("lacks", needed - table.keys()), ("has the unknown key", table.keys() - valid)):
        require(not keys, where, f"[vehicle] {verb} {', '.join(sorted(keys))}; it holds {', '.join(sorted(valid))}")
    odd = [key for key, value in table.items() if key != "name" and type(value) not in (int, float)]
    require(not odd, where, f"[vehicle] {', '.join(odd)}, expected numbers")
    try:
        return Vehicle(**table)
    except (ValueError, TypeError) as error:
        raise ValueError(f"{where}: {error}") from error


def vehicle_text(car: Vehicle, **more: Mapping[str, Any] | None) -> str:
    """The text of a vehicle file; numbers come back bit for bit.

    more: its tables `steering` (delay, lag [s], offset [rad]), `estimates` (intervals by name) and `provenance`.
    """
    rows = [f"format = {json.dumps(FORMAT)}"]
    for name, table in ({"vehicle": dataclasses.asdict(car)} | more).items():
        if table:
            rows += ["", f"[{name}]{_REMARKS.get(name, '')}", *rows_of(table)]
    return "\n".join(rows) + "\n"


def rows_of(table: Mapping[str, Any]) -> list[str]:
    """A table in lines of TOML, without what is None."""
    return [f"{key} = {_value(value)}" for key, value in table.items() if value is not None]


def _value(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{ {', '.join(f'{key} = {_value(v)}' for key, v in value.items())} }}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_value, value))}]"
    if isinstance(value, str | bool):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    return repr(float(value))


def table_of(text: str, name: str, where: str) -> dict[str, Any]:
    """One table of a vehicle file; raises ValueError naming the file and what it lacks."""
    tables = tables_of(text, where)
    require(isinstance(tables.get(name), dict), where, f"no table [{name}]; it holds {', '.join(tables)}")
    return tables[name]


def tables_of(text: str, where: str) -> dict[str, Any]:
    """All that is in the text of a vehicle file; raises ValueError for another format."""
    data = toml_of(text, where)
    written = data.get("format")
    require(written == FORMAT, where, f"format = {written!r}, expected {FORMAT!r}: a file of `steerkit identify`")
    return data
