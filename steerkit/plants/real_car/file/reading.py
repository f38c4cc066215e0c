"""Reading a car's TOML file, `load`: every table, key and name is checked, and all mistakes are reported at once."""

from __future__ import annotations

import difflib
import importlib.util
import math
import tomllib
from collections.abc import Iterable
from dataclasses import fields
from pathlib import Path as File
from typing import Any

from steerkit.outside import is_outside
from steerkit.path import Path
from steerkit.plants.real_car.decisions.gate import GateLimits
from steerkit.plants.real_car.decisions.modes import StateLimits
from steerkit.plants.real_car.decisions.motion import MotionLimits
from steerkit.plants.real_car.file.audit import audit
from steerkit.plants.real_car.file.bounds import BOUNDS
from steerkit.plants.real_car.file.config import (
    ANGLES,
    DERIVED,
    DIMENSION,
    FORMAT,
    KINDS,
    NEEDED,
    POSE,
    REPORT,
    CarConfig,
    ConfigError,
    shipped,
)
from steerkit.plants.real_car.frames.codec import MAX_JUMP, CommandWriter, FrameReader, Mapping, Protection
from steerkit.units import radians_of
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


class Reading:
    """One pass over a file's tables, collecting mistakes."""

    def __init__(self, path: File, text: str, data: dict[str, Any]):
        self.path, self.data = path, data
        self.texts = {"config.toml": text}
        self.mistakes: list[str] = []

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
            "driver",
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
        course, driver = self.course(), self.table("driver", ("listen_only", "keep_recording"))
        lag, delay = self.kit()
        controllers = self.controllers()
        listen, keep = (self.entry("driver", driver, key, bool, False) for key in ("listen_only", "keep_recording"))
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
            texts=self.texts,
            lag=lag,
            delay=delay,
            controllers=controllers,
        )
        mistakes = audit(config)
        if mistakes:
            raise ConfigError("\n".join(f"{self.path}: {m}" for m in mistakes))
        return config

    # ---- tables ---------------------------------------------------------------------------------------------

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

    def bus(self) -> dict[str, Any]:
        table = self.table("bus", ("interface", "channel", "bitrate", "options"))
        interface = self.entry("bus", table, "interface", str)
        from can.interfaces import BACKENDS

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

    # ---- signals --------------------------------------------------------------------------------------------

    def message(self, database: Any, where: str, name: Any) -> Any:
        names = [m.name for m in database.messages]
        if name not in names:
            near = difflib.get_close_matches(str(name), names, n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            self.wrong(f"[{where}] frame = {name!r}: not in the DBC files{hint} (valid: {', '.join(names) or 'none'})")
            return None
        return database.get_message_by_name(name)

    def signal(self, message: Any, where: str, name: Any) -> Any:
        names = [s.name for s in message.signals]
        if name not in names:
            near = difflib.get_close_matches(str(name), names, n=1)
            hint = f"; did you mean '{near[0]}'?" if near else ""
            self.wrong(f"[{where}]: {message.name} has no signal {name!r}{hint} (valid: {', '.join(names)})")
            return None
        return message.get_signal_by_name(name)

    def mapping(self, where: str, quantity: str, message: Any, table: dict[str, Any]) -> Mapping | None:
        signal = self.signal(message, where, table.get("signal"))
        if signal is None:
            return None
        unit = self.entry(where, table, "unit", str, signal.unit or "")
        scale, sign = (self.entry(where, table, key, float, 1.0) for key in ("scale", "sign"))
        offset = self.entry(where, table, "offset", float, 0.0)
        valid = KINDS.get(DIMENSION.get(quantity, ""), ("", "1"))
        if unit not in valid:
            self.wrong(f"[{where}] unit = {unit!r} for {quantity}, expected one of {', '.join(map(repr, valid))}")
            return None
        if sign not in (1.0, -1.0):
            self.wrong(f"[{where}] sign = {sign:g}, expected 1 or -1")
        if not (math.isfinite(scale) and scale > 0.0 and math.isfinite(offset)):
            self.wrong(f"[{where}] scale = {scale}, offset = {offset}, expected scale > 0 and both finite")
            return None
        return Mapping(frame=message.name, signal=signal.name, unit=unit, scale=scale, sign=sign, offset=offset)

    def reading(self, database: Any) -> tuple[list[FrameReader], tuple[float, float] | None, tuple[str, ...]]:
        table = self.table("read", (*REPORT, *(p for p in POSE if p not in ("lat", "lon")), "faults", "gnss"))
        gnss = self.table("read.gnss", ("lat", "lon", "origin_deg"), inside=table) if "gnss" in table else {}
        entries = {k: v for k, v in table.items() if k not in ("faults", "gnss")}
        entries |= {k: v for k, v in gnss.items() if k in ("lat", "lon")}
        place = ("lat", "lon") if gnss else ("x", "y")
        if gnss and ({"x", "y"} & entries.keys()):
            self.wrong("[read]: both x, y and gnss, expected one of them")
        found: dict[str, dict[str, Mapping]] = {}
        for name in (*NEEDED, *place):
            if name not in entries:
                self.wrong(f"[read] {name}: missing, expected {{ frame = ..., signal = ... }}")
        for name, entry in entries.items():
            where = f"read.{name}"
            if not isinstance(entry, dict):
                self.wrong(f"[{where}] = {entry!r}, expected {{ frame = ..., signal = ... }}")
                continue
            self.known(where, entry, ("frame", "signal", "unit", "scale", "sign", "offset"))
            message = self.message(database, where, entry.get("frame"))
            mapping = self.mapping(where, name, message, entry) if message is not None else None
            if mapping is not None:
                found.setdefault(mapping.frame, {})[name] = mapping
        flags = self.faults(database, table, found)
        readers = [self.reader(database, name, mappings) for name, mappings in found.items()]
        report = found.get(str(entries.get("delta_sw", {}).get("frame")), {})
        if report and not self.guarded(next(iter(report.values())).frame) and "echo" not in entries:
            self.wrong(
                "[read] echo: missing; the kit's report has neither counter nor CRC, so its echo of the command "
                "is the only thing that shows when it freezes"
            )
        self.known("protect", self.table("protect"), found)
        self.groups(readers)
        return readers, self.origin(gnss) if gnss else None, flags

    def faults(self, database: Any, table: dict[str, Any], found: dict[str, dict[str, Mapping]]) -> tuple[str, ...]:
        faults = self.table("read.faults", ("frame", "signals"), inside=table)
        message = self.message(database, "read.faults", faults.get("frame")) if faults else None
        if message is None:
            if not faults:
                self.wrong("[read.faults]: missing, expected the frame and the signals that must be 0")
            return ()
        names = []
        for flag in self.entry("read.faults", faults, "signals", list):
            if self.signal(message, "read.faults", flag) is not None:
                found.setdefault(message.name, {})[f"fault:{flag}"] = Mapping(frame=message.name, signal=flag)
                names.append(f"fault:{flag}")
        return tuple(names)

    def reader(self, database: Any, name: str, mappings: dict[str, Mapping]) -> FrameReader:
        message, where = database.get_message_by_name(name), f"protect.{name}"
        table = self.table("protect").get(name)
        guard, period = {"counter": "", "crc": ""}, 0.0
        if isinstance(table, dict):
            self.known(where, table, (*guard, "period"))
            guard |= {k: v for k, v in table.items() if k in guard and self.signal(message, where, v) is not None}
            period = self.entry(where, table, "period", float, 0.0)
        else:
            self.wrong(
                f"[protect] {name} = {table!r}, expected {{ counter = ..., crc = ... }}, or, for a frame that has "
                "neither, {{ period = ... }}: the time between two of them [s], to notice a second sender"
            )
        self.crc_fits(message, where, guard["crc"])
        if guard["counter"] and message.get_signal_by_name(guard["counter"]).length < 3:
            self.wrong(f"[{where}] counter = {guard['counter']!r} counts to less than {2 * MAX_JUMP}, too few")
            guard["counter"] = ""
        return FrameReader(message, mappings, Protection(**guard), period)

    def guarded(self, frame: str) -> bool:
        table = self.table("protect").get(frame)
        return isinstance(table, dict) and bool(table.keys() & {"counter", "crc"})

    def crc_fits(self, message: Any, where: str, name: str) -> None:
        if name:
            signal = message.get_signal_by_name(name)
            little = signal.byte_order == "little_endian"
            if signal.length != 8 or signal.start % 8 != (0 if little else 7):
                self.wrong(f"[{where}] crc = {name!r} does not fill one byte, as a CRC-8 must")

    def groups(self, readers: list[FrameReader]) -> None:
        for reader in readers:
            report = {n for n in reader.mappings if n in REPORT or n.startswith("fault:")}
            pose = set(reader.mappings) & set(POSE)
            if report and pose:
                self.wrong(
                    f"[read]: {reader.name} holds both {min(report)} (the kit's) and {min(pose)} (the pose's); "
                    "they must come from different frames, as they are checked against each other"
                )

    def origin(self, gnss: dict[str, Any]) -> tuple[float, float]:
        origin = gnss.get("origin_deg")
        numbers = isinstance(origin, list) and len(origin) == 2 and all(isinstance(o, (int, float)) for o in origin)
        if not numbers or not (abs(origin[0]) < 90.0 and abs(origin[1]) <= 180.0):  # type: ignore[index]
            self.wrong(f"[read.gnss] origin_deg = {origin!r}, expected [latitude, longitude] in degrees")
            return 0.0, 0.0
        return float(origin[0]), float(origin[1])  # type: ignore[index]

    def writing(self, database: Any) -> CommandWriter | None:
        table = self.table("write", ("frame", "angle", "enable", "clear", "alert", "counter", "crc", "fixed"))
        message = self.message(database, "write", table.get("frame"))
        angle = self.table("write.angle", ("signal", "unit", "scale", "sign"), inside=table)
        if message is None:
            return None
        mapping = self.mapping("write.angle", "delta_sw", message, angle)
        if "enable" not in table:
            self.wrong("[write] enable: missing, expected the name of the signal that is 1 while steering")
        names = {k: table.get(k, "") for k in ("enable", "clear", "alert", "counter", "crc")}
        for key, name in names.items():
            if name and self.signal(message, f"write.{key}", name) is None:
                names[key] = ""
        self.crc_fits(message, "write", names["crc"])
        fixed = self.table("write.fixed", inside=table)
        for name, value in fixed.items():
            signal = self.signal(message, "write.fixed", name)
            if signal is not None and not (type(value) is int and 0 <= value < 1 << signal.length):
                self.wrong(f"[write.fixed] {name} = {value!r}, expected a whole number of {signal.length} bits")
        if mapping is None:
            return None
        return CommandWriter(message, mapping, **names, fixed=tuple(fixed.items()))

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


def _kind(kind: type) -> str:
    return {
        str: "a text",
        int: "a whole number",
        float: "a number",
        bool: "true or false",
        list: "a list",
        dict: "a table",
    }[kind]
