"""Tables of a TOML file: their keys and entries are checked, and mistakes are collected."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any


class Tables:
    """The tables of a file, `data`, and the mistakes found in them so far."""

    def __init__(self, data: dict[str, Any]):
        self.data = data
        self.mistakes: list[str] = []

    def wrong(self, what: str) -> None:
        self.mistakes.append(what)

    def known(self, where: str, table: dict[str, Any], valid: Iterable[str]) -> None:
        valid = list(valid)
        for key in table:
            if key not in valid:
                near = difflib.get_close_matches(key, valid, n=1)
                hint = f"; did you mean '{near[0]}'?" if near else ""
                self.wrong(f"{f'[{where}] ' if where else ''}{key}: not known{hint} (valid: {', '.join(valid)})")

    def table(
        self, name: str, valid: Iterable[str] | None = None, inside: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        table = (self.data if inside is None else inside).get(name.split(".")[-1], {})
        if not isinstance(table, dict):
            self.wrong(f"{name} = {table!r}, expected a table [{name}]")
            return {}
        if valid is not None:
            self.known(name, table, valid)
        return table

    def entry(self, where: str, table: dict[str, Any], key: str, kind: type, default: Any = None) -> Any:
        value = table.get(key, default)
        if value is None:
            self.wrong(f"[{where}] {key}: missing, expected {_kind(kind)}")
            return kind()
        numeric = kind is float and isinstance(value, int) and not isinstance(value, bool)
        if not (isinstance(value, kind) or numeric) or (kind in (int, float) and isinstance(value, bool)):
            self.wrong(f"[{where}] {key} = {value!r}, expected {_kind(kind)}")
            return kind()
        return float(value) if kind is float else value


def _kind(kind: type) -> str:
    return {
        str: "a text",
        int: "a whole number",
        float: "a number",
        bool: "true or false",
        list: "a list",
        dict: "a table",
    }[kind]
