"""Reading a car's TOML file, `load`: every table, key and name is checked, and all mistakes are reported at once."""

from __future__ import annotations

import difflib
import importlib.util
import tomllib
from dataclasses import fields
from pathlib import Path as File
from typing import Any

from steerkit._support.plugins import is_outside
from steerkit.car.config.audit import audit
from steerkit.car.config.bounds import BOUNDS
from steerkit.car.config.config import ANGLES, DERIVED, FORMAT, POSE, REPORT, CarConfig, ConfigError, shipped
from steerkit.car.config.signals import Signals
from steerkit.car.frames.codec import CommandWriter
from steerkit.car.frames.python_can import python_can
from steerkit.car.gate import GateLimits
from steerkit.car.motion import MotionLimits
from steerkit.car.state_machine import StateLimits
from steerkit.diagram.units import radians_of
from steerkit.paths.path import Path
from steerkit.vehicles import Vehicle, vehicle


def load(file: str | File, *, bus: dict[str, Any] | None = None) -> CarConfig:
    """The configuration in a TOML file, or the shipped one of that name.

    bus: arguments of `can.Bus` that replace the file's (the simulated car's port). Raises ConfigError with all
    mistakes, each naming the key, what stands there and what is valid.
    """
    path = File(file) if File(file).exists() else shipped(str(file))
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read as TOML ({error})") from error
    for name in ("can", "cantools"):
        if importlib.util.find_spec(name) is None:
            raise ConfigError(f"{path}: a car needs the package {name}: pip install 'steerkit-control[car]'")

    return Reading(path, text, data).config(bus)


class Reading(Signals):
    """One pass over a file's tables, collecting mistakes."""

    def __init__(self, path: File, text: str, data: dict[str, Any]):
        super().__init__(data)
        self.path = path
        self.texts = {"config.toml": text}
        self.vehicle_file = ""

    def config(self, bus: dict[str, Any] | None) -> CarConfig:
        tables = (
            "format",
            "bus",
            "files",
            "course",
            "vehicle",
            "kit",
            "read",
            "protect",
            "write",
            "server",
            "limits",
            "controllers",
        )
        self.known("", self.data, tables)
        if self.data.get("format") != FORMAT:
            raise ConfigError(
                f"{self.path}: format = {self.data.get('format')!r}, expected {FORMAT!r} in the first line"
            )
        database = self.database()
        car = self.car()
        readers, origin, flags = self.reading(database)
        writer = self.writing(database)
        gate, states, motion = self.limits(car, writer)
        course, server = self.course(), self.table("server", ("listen_only", "keep_recording"))
        lag, delay = self.kit()
        controllers = self.controllers()
        listen, keep = (self.entry("server", server, key, bool, False) for key in ("listen_only", "keep_recording"))
        arguments = self.bus() if bus is None else bus
        if self.mistakes:
            raise ConfigError("\n".join(f"{self.path}: {m}" for m in self.mistakes))
        assert writer is not None
        ids = {r.frame_id: set(r.mappings) for r in readers}
        config = CarConfig(
            file=str(self.path),
            bus=arguments,
            course=course,
            vehicle=car,
            readers=tuple(readers),
            report_frames=frozenset(i for i, names in ids.items() if names & {*REPORT, *flags}),
            pose_frames=frozenset(i for i, names in ids.items() if names & set(POSE)),
            fault_flags=flags,
            origin_deg=origin,
            writer=writer,
            gate=gate,
            states=states,
            motion=motion,
            listen_only=listen,
            keep_recording=keep,
            vehicle_file=self.vehicle_file,
            texts=self.texts,
            lag=lag,
            delay=delay,
            controllers=controllers,
        )
        mistakes = audit(config)
        if mistakes:
            raise ConfigError("\n".join(f"{self.path}: {m}" for m in mistakes))
        return config

    def bus(self) -> dict[str, Any]:
        table = self.table("bus", ("interface", "channel", "bitrate", "options"))
        interface = self.entry("bus", table, "interface", str)
        BACKENDS = python_can().interfaces.BACKENDS
        if interface and interface not in BACKENDS:
            near = difflib.get_close_matches(interface, BACKENDS, n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            self.wrong(
                f"[bus] interface = {interface!r}: python-can has none of that name{hint} "
                f"(valid: {', '.join(sorted(BACKENDS))})"
            )
        channel = table.get("channel")
        if not isinstance(channel, (str, int)) or isinstance(channel, bool):
            self.wrong(f"[bus] channel = {channel!r}, expected a name such as '/dev/ttyACM0' or 'can0', or a number")
        options = self.entry("bus", table, "options", dict, {})
        bitrate = {"bitrate": self.entry("bus", table, "bitrate", int)} if "bitrate" in table else {}
        return {"interface": interface, "channel": channel, **bitrate, **options}

    def controllers(self) -> tuple[str, ...]:
        names = self.entry("controllers", self.table("controllers", ("allow",)), "allow", list, [])
        for name in names:
            if not (isinstance(name, str) and is_outside(name)):
                self.wrong(f"[controllers] allow: {name!r}, expected names such as 'my_file.py:make'")
        return tuple(map(str, names))

    def kit(self) -> tuple[float, float]:
        table = self.table("kit", ("lag", "delay"))
        values = [self.entry("kit", table, key, float, default) for key, default in (("lag", 0.1), ("delay", 0.0))]
        for key, value in zip(("lag", "delay"), values):
            if not 0.0 <= value <= 1.0:
                self.wrong(f"[kit] {key} = {value:g} s, expected 0 to 1 s")
        return values[0], values[1]

    def database(self) -> Any:
        python_can()
        import cantools

        table = self.table("files", ("dbc",))
        names = self.entry("files", table, "dbc", list)
        database = cantools.database.Database(strict=True)
        for name in names:
            try:
                beside = self.path.parent / str(name)
                text = (beside if beside.is_file() else shipped(str(name))).read_text(encoding="cp1252")
                database.add_dbc_string(text)
                self.texts[str(name)] = text
            except (ConfigError, cantools.database.Error, OSError, ValueError) as error:
                self.wrong(f"[files] dbc: {name}: {error}")
        return database

    def car(self) -> Vehicle:
        table = self.table("vehicle", ("name",))
        name = self.entry("vehicle", table, "name", str)
        try:
            if not name.endswith(".toml"):
                return vehicle(name)
            place = self.path.parent / name
            car = vehicle(str(place))
            self.texts[name] = place.read_text(encoding="utf-8")
            self.vehicle_file = name
            return car
        except ValueError as error:
            self.wrong(f"[vehicle] name: {error}")
            return vehicle("vw-passat")

    def course(self) -> dict[str, Any]:
        table = self.table("course", ("name", "file", "closed"))
        if ("name" in table) == ("file" in table):
            self.wrong("[course]: give either name, such as 'paper', or file, a CSV with the columns x and y")
        if "file" in table:
            place = self.path.parent / str(table["file"])
            if not place.is_file():
                self.wrong(f"[course] file = {table['file']!r}: there is no {place}")
                return {}
            self.texts[str(table["file"])] = place.read_text(encoding="utf-8")
            try:
                path = Path.from_csv(place, closed=self.entry("course", table, "closed", bool))
            except ValueError as error:
                self.wrong(f"[course] file: {error}")
                return {}
            return {"file": str(table["file"]), "path": path}
        return {"name": self.entry("course", table, "name", str)}

    def limits(self, car: Vehicle, writer: CommandWriter | None) -> tuple[GateLimits, StateLimits, MotionLimits]:
        kinds = (GateLimits, StateLimits, MotionLimits)
        valid = {f.name: f for kind in kinds for f in fields(kind) if f.name not in DERIVED}
        keys = {f"{name}_deg" if name in ANGLES else name: name for name in valid}
        table = self.table("limits", keys)
        values: dict[str, Any] = {}
        for key, name in keys.items():
            if key in table:
                value = self.entry("limits", table, key, int if valid[name].type == "int" else float)
                low, high = BOUNDS[key]
                if not low <= value <= high:
                    self.wrong(f"[limits] {key} = {value:g}, expected {low:g} to {high:g}")
                else:
                    values[name] = radians_of(value) if name in ANGLES else value
        derived = {"steer_ratio": car.steer_ratio, "wheelbase": car.wheelbase, "arm": car.l_r}
        if writer is not None:
            derived["quantum"] = writer.quantum

        def made(kind: Any, **more: Any) -> Any:
            try:
                return kind(**{f.name: values[f.name] for f in fields(kind) if f.name in values}, **more)
            except ValueError as error:
                self.wrong(f"[limits]: {error}")
                return kind()

        return made(GateLimits, **derived), made(StateLimits), made(MotionLimits)
