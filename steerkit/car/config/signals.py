"""The bus's signals in a car's file: which are read, how their frames are protected, and which are written."""

from __future__ import annotations

import difflib
import math
from typing import Any

from steerkit.car.config.config import DIMENSION, KINDS, NEEDED, POSE, REPORT
from steerkit.car.config.tables import Tables
from steerkit.car.frames.codec import MAX_JUMP, CommandWriter, FrameReader, Mapping, Protection


class Signals(Tables):
    """The tables read, protect and write, checked against the DBC files."""

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
        by_frame: dict[str, dict[str, Mapping]] = {}
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
                by_frame.setdefault(mapping.frame, {})[name] = mapping
        flags = self.faults(database, table, by_frame)
        readers = [self.reader(database, name, mappings) for name, mappings in by_frame.items()]
        report = by_frame.get(str(entries.get("delta_sw", {}).get("frame")), {})
        if report and not self.guarded(next(iter(report.values())).frame) and "echo" not in entries:
            self.wrong(
                "[read] echo: missing; the kit's report has neither counter nor CRC, so its echo of the command "
                "is the only thing that shows when it freezes"
            )
        self.known("protect", self.table("protect"), by_frame)
        self.groups(readers)
        return readers, self.origin(gnss) if gnss else None, flags

    def faults(self, database: Any, table: dict[str, Any], by_frame: dict[str, dict[str, Mapping]]) -> tuple[str, ...]:
        faults = self.table("read.faults", ("frame", "signals"), inside=table)
        message = self.message(database, "read.faults", faults.get("frame")) if faults else None
        if message is None:
            if not faults:
                self.wrong("[read.faults]: missing, expected the frame and the signals that must be 0")
            return ()
        names = []
        for flag in self.entry("read.faults", faults, "signals", list):
            if self.signal(message, "read.faults", flag) is not None:
                by_frame.setdefault(message.name, {})[f"fault:{flag}"] = Mapping(frame=message.name, signal=flag)
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
