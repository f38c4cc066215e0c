"""Scenarios in files: as a TOML file of their own, and as the tables in which runs and results keep them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import require
from steerkit._support.files import read_toml
from steerkit.paths.importers.reading import is_road
from steerkit.scenario.scenario import CONDITIONS, Scenario

FORMAT = "steerkit scenario 1"


def read_scenario(file: str | FilePath) -> Scenario:
    """The scenario in a TOML file; courses and cars from files are looked for beside it, or are in it.

    Raises ValueError naming the file, the key and the valid keys.
    """
    place = FilePath(file)
    table = read_toml(place, f"scenario {file}")
    format_ = table.pop("format", None)
    require(format_ == FORMAT, f"{file}", f"format = {format_!r}, expected {FORMAT!r} in the first line")
    texts = table.get("files", {})
    fits = isinstance(texts, dict) and all(isinstance(text, str) for text in texts.values())
    require(fits, f"{file}", "[files], expected the text of a file under each name")
    for key in ("course", "vehicle"):
        name = table.get(key)
        if not isinstance(name, str) or name in texts:
            continue
        if name.endswith((".csv", ".toml")) or (key == "course" and is_road(name)):
            table[key] = str(place.parent / name)
    return of_table({**table, "files": tuple(texts.items())}, f"{file}")


def write_scenario(scenario: Scenario, file: str | FilePath) -> None:
    """Write a scenario as TOML, with the files that it needs in it; `read_scenario` gives it back bit for bit."""
    rows = [f"format = {json.dumps(FORMAT)}"]
    for field in fields(scenario):
        value = getattr(scenario, field.name)
        if field.name != "files" and value is not None:
            rows.append(f"{field.name} = {_value(value)}")
    if scenario.files:
        rows += ["", "[files]", *(f"{_value(name)} = {_value(text)}" for name, text in scenario.files)]
    FilePath(file).write_text("\n".join(rows) + "\n", encoding="utf-8")


def of_table(table: Mapping[str, Any], where: str, made: type[Scenario] = Scenario) -> Scenario:
    """The scenario whose fields these are; missing ones take their defaults, `kind` is passed over.

    made: the class, one of your own that extends `Scenario`. A table of a `World`, as runs kept it before there were
    scenarios, is read as one. Raises ValueError, beginning with
    `where`, for an unknown field, naming the valid ones, and for values that make no scenario.
    """
    values = _renewed(table) if table.get("kind") == "World" else {k: v for k, v in table.items() if k != "kind"}
    valid = [field.name for field in fields(made)]
    for key in values:
        require(key in valid, where, f"a scenario has no field '{key}'; valid: {', '.join(valid)}")
    try:
        return made(**values)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _renewed(table: Mapping[str, Any]) -> dict[str, Any]:
    """A world's table as a scenario's: `noise` was yes or no, and meant latency too."""
    values = {key: value for key, value in table.items() if key not in ("kind", "noise", "vehicle_name")}
    if "vehicle_name" in table:
        values["vehicle"] = table["vehicle_name"]
    if table.get("noise"):
        values |= {key: CONDITIONS["hard"][key] for key in ("noise", "latency")}
    return values


def _value(value: Any) -> str:
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    require(math.isfinite(value), "scenario", f"{value} cannot be written")
    return repr(float(value))
