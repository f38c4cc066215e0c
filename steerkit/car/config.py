"""The TOML file that describes a car: its bus, its signals and its limits, checked whole before anything is opened.

It imports nothing of the learner, so that a car server starts soon and depends on little.
"""

from __future__ import annotations

import difflib
import importlib.util
import math
import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from importlib.resources import files
from pathlib import Path as File
from typing import Any

from steerkit._support.plugins import is_outside
from steerkit.car.frames import MAX_JUMP, CommandWriter, FrameReader, Mapping, signal_range
from steerkit.car.gate import GateLimits
from steerkit.car.motion import MotionLimits
from steerkit.car.ports import python_can
from steerkit.car.state_machine import StateLimits
from steerkit.diagram.units import FACTORS, degrees_of, radians_of
from steerkit.paths.courses import course
from steerkit.paths.path import Path
from steerkit.task import STOP_DEG
from steerkit.vehicles import Vehicle, vehicle

FORMAT = "steerkit car 1"
TABLES = ("format", "bus", "files", "course", "vehicle", "kit", "read", "protect", "write", "server", "limits")
REPORT = ("delta_sw", "v_kit", "torque", "echo", "enabled", "override", "timeout", "brake", "accelerator")
POSE = ("x", "y", "lat", "lon", "psi", "v", "r", "beta", "a_y", "quality", "stamp")
NEEDED = ("delta_sw", "v_kit", "torque", "enabled", "override", "psi", "v", "r")
_OF_UNIT = {
    "rad": "delta_sw echo psi beta lat lon",
    "m/s": "v v_kit",
    "m": "x y",
    "rad/s": "r",
    "N m": "torque",
    "m/s^2": "a_y",
    "s": "stamp",
}
DIMENSION = {name: unit for unit, names in _OF_UNIT.items() for name in names.split()}
"""Quantity to SI unit; the others are flags and pure numbers."""
ANGLES = {
    *("delta_sw_max", "rate_max", "follow_angle", "psi_e_engage", "psi_e_max", "delta_engage"),
    *("motion_across", "heading_slack", "heading_rate", "wheel_slack", "wheel_rate"),
}
"""Limits that the file gives in degrees, as `..._deg`."""
DERIVED = {"steer_ratio", "wheelbase", "arm", "quantum"}
"""Fields of the gate's limits that follow from the car and the DBC."""


class ConfigError(ValueError):
    """A configuration that cannot be used, with every mistake found, one a line."""


@dataclass(frozen=True, kw_only=True)
class CarConfig:
    """A checked configuration."""

    file: str
    """Where it came from."""
    bus: dict[str, Any]
    """Arguments of `can.Bus`."""
    course: dict[str, Any]
    """`name` of a built-in course; or `file`, and the `path` in it."""
    vehicle: Vehicle
    readers: tuple[FrameReader, ...]
    """The frames that are read."""
    report_frames: frozenset[int]
    """Ids of the frames that make the kit's report."""
    pose_frames: frozenset[int]
    """Ids of the frames that make the pose."""
    fault_flags: tuple[str, ...]
    """Quantities `fault:NAME` that must be 0."""
    origin_deg: tuple[float, float] | None
    """Latitude and longitude of x = y = 0, for receivers that send degrees."""
    writer: CommandWriter
    gate: GateLimits
    states: StateLimits
    motion: MotionLimits = field(default_factory=MotionLimits)
    listen_only: bool = False
    keep_recording: bool = False
    """Does a recording that fails end the drive?"""
    lag: float = 0.1
    """Time constant of the kit's motor [s], for controllers that predict; so is `delay`."""
    delay: float = 0.0
    """From a command to the motor's answer [s]."""
    controllers: tuple[str, ...] = ()
    """Controllers of a user's own that may drive this car, by name, such as `my_file.py:make`."""
    vehicle_file: str = ""
    """Name of the vehicle file that `vehicle` is from; "" for a car by its name."""
    texts: dict[str, str] = field(default_factory=dict, repr=False)
    """The files that it was made from: `config.toml`, DBC files and course by name; for the recording."""

    @cached_property
    def quantities(self) -> dict[str, Mapping]:
        """All that is read, by name."""
        return {name: mapping for reader in self.readers for name, mapping in reader.mappings.items()}

    def facts(self) -> dict[str, Any]:
        """What a program may want to know: what is read and written, and every limit [SI]."""
        quantities = {
            name: {"unit": DIMENSION.get(name, "1"), "signal": m.signal, "gain": m.gain, "offset": m.offset}
            for name, m in self.quantities.items()
        }
        limits = asdict(self.gate) | asdict(self.states) | asdict(self.motion)
        return {
            "file": self.file,
            "vehicle": self.vehicle.name,
            "listen_only": self.listen_only,
            "read": quantities,
            "write": {"message": self.writer.message.name, "signal": self.writer.angle.signal},
            "limits": {name: value for name, value in limits.items() if name not in DERIVED},
        }

    def summary(self) -> list[str]:
        """What will be read and written, one line each."""
        lines = [f"bus      {', '.join(f'{k} = {v!r}' for k, v in self.bus.items())}"]
        lines.append(f"vehicle  {self.vehicle.name}, ratio {self.gate.steer_ratio:g}, L = {self.gate.wheelbase:g} m")
        lines.append(f"course   {self.course.get('name') or self.course['file']}")
        for reader in self.readers:
            period = f"{reader.period:g} s" if reader.period else ""
            parts = (("counter", reader.counter), ("CRC-8 0x2F", reader.crc), ("period", period))
            guard = ", ".join(f"{k} {v}" for k, v in parts if v)
            lines.append(f"read     {reader.name} (0x{reader.frame_id:X}), protection: {guard}")
            for name, mapping in reader.mappings.items():
                unit = DIMENSION.get(name, "1")
                lines.append(f"           {name} [{unit}] = {mapping.gain:.6g} * {mapping.signal} + {mapping.offset:g}")
        w = self.writer
        lines.append(f"write    {w.message.name} (0x{w.frame_id:X}){' NEVER: listen only' if self.listen_only else ''}")
        lines.append(
            f"           {w.angle.signal} = delta_sw / {w.angle.gain:.6g}, steps of {degrees_of(w.quantum):.3g} deg"
        )
        rest = {"enable": w.enable, "clear": w.clear, "counter": w.counter, "CRC": w.crc}
        lines.append(f"           {', '.join(f'{k} {v}' for k, v in rest.items() if v)}; fixed {dict(w.fixed)}")
        lines.append(f"kit      lag {self.lag:g} s, delay {self.delay:g} s, for controllers that predict")
        for limits in (self.gate, self.states, self.motion):
            for f in fields(limits):
                if f.name not in DERIVED:
                    value = getattr(limits, f.name)
                    shown = f"{f.name}_deg = {degrees_of(value):g}" if f.name in ANGLES else f"{f.name} = {value:g}"
                    lines.append(f"limit    {shown}")
        return list(dict.fromkeys(lines))


def shipped(name: str) -> File:
    """A configuration or DBC that comes with steerkit; raises ConfigError for another name, with the valid ones."""
    folder = File(str(files("steerkit.car") / "kits"))
    if not (folder / name).is_file():
        known = ", ".join(sorted(f.name for f in folder.iterdir() if f.suffix in (".toml", ".dbc")))
        raise ConfigError(f"{name}: no such file, beside the configuration or shipped; shipped: {known}")
    return folder / name


BOUNDS: dict[str, tuple[float, float]] = {
    # the gate
    "delta_sw_max_deg": (5.0, STOP_DEG),
    "rate_max_deg": (10.0, 1000.0),
    "a_y_max": (0.2, 5.0),
    "jerk_max": (0.2, 10.0),
    "v_floor": (0.5, 5.0),
    "v_max": (0.5, 40.0),
    "dt_min": (0.004, 0.02),
    "dt_max": (0.02, 0.1),
    # ages and times [s]
    "report_age": (0.02, 0.15),
    "pose_age": (0.02, 0.15),
    "request_age": (0.052, 0.09),
    "request_lost": (0.06, 0.3),
    "lateness": (0.005, 0.1),
    "echo_age": (0.03, 0.5),
    "follow_time": (0.1, 2.0),
    "enable_time": (0.05, 2.0),
    "heartbeat": (0.15, 0.5),
    "still_time": (0.2, 5.0),
    "foreign_enable": (0.1, 1.0),
    "end_warning": (1.0, 20.0),
    # counts
    "torque_reports": (1, 10),
    "integrity_errors": (1, 10),
    "misses": (1, 20),
    # sizes
    "e_max": (0.1, 5.0),
    "e_growth": (0.2, 2.0),
    "e_engage": (0.05, 2.0),
    "psi_e_engage_deg": (1.0, 60.0),
    "psi_e_max_deg": (5.0, 90.0),
    "delta_engage_deg": (1.0, 90.0),
    "follow_angle_deg": (5.0, 120.0),
    "v_mismatch": (0.1, 3.0),
    "v_reverse": (0.05, 1.0),
    "v_still": (0.05, 1.0),
    "v_engage_min": (0.1, 20.0),
    "v_engage_max": (0.2, 40.0),
    "torque_max": (0.3, 10.0),
    "quality": (0.5, 100.0),
    "end_margin": (0.5, 50.0),
    # dead reckoning
    "pose_jump": (0.05, 0.5),
    "motion_along": (0.005, 0.15),
    "motion_across_deg": (0.1, 3.0),
    "heading_slack_deg": (0.5, 5.0),
    "heading_rate_deg": (0.05, 2.0),
    "wheel_slack_deg": (1.0, 10.0),
    "wheel_rate_deg": (0.5, 8.0),
    "wheel_share": (0.05, 0.8),
}
"""(smallest, largest) that `[limits]` may ask for, in the file's units."""


TELLING = {
    "delta_sw": "ANGLE SWA STEERING_ANGLE",
    "echo": "CMD SCMD COMMAND",
    "v_kit": "VEH_VEL VEHICLE_SPEED",
    "torque": "TORQUE TRQ",
    "enabled": "ENABLED",
    "override": "OVERRIDE OVR",
    "timeout": "TMOUT TIMEOUT",
    "brake": "BRAKE BRAKE_PRESSED",
    "accelerator": "ACCELERATOR GAS THROTTLE",
    "x": "X EAST POS_X",
    "y": "Y NORTH POS_Y",
    "lat": "LAT LATITUDE",
    "lon": "LON LONGITUDE",
    "psi": "PSI HEADING YAW",
    "v": "V SPEED VELOCITY",
    "r": "R YAW_RATE YAWRATE",
    "beta": "BETA SIDESLIP",
    "a_y": "A_Y AY LAT_ACC",
    "quality": "QUALITY FIX",
    "stamp": "STAMP TIME TIMESTAMP",
}
"""Names of signals that say which quantity they are: one that bears another's is taken for a swap."""
DANGEROUS = re.compile(r"IGN|CAL|TEST|DIAG|QUIET|BYPASS|OVERRIDE|DISABLE", re.I)
"""Signals of a command that switch protection off: they stay 0, and are none of ours."""
WRITTEN = {
    "enable": re.compile(r"^(EN|.*ENABLED?)$", re.I),
    "clear": re.compile(r"^(CLEAR|CLR|RESET).*", re.I),
    "alert": re.compile(r".*(ALERT|WARN|CHIME).*", re.I),
    "counter": re.compile(r".*(COUNT|CNT|ALIVE).*", re.I),
    "crc": re.compile(r".*(CRC|CHECKSUM).*", re.I),
}
"""The same of the signals that we write, by their part in the command."""


def audit(config: CarConfig) -> list[str]:
    """All contradictions, one a line; empty for a sound configuration. Raises nothing."""
    return [*_signals(config), *_frames(config), *_ranges(config), *_command(config)]


def _signals(config: CarConfig) -> Iterator[str]:
    homes = Counter((m.frame, m.signal) for reader in config.readers for m in reader.mappings.values())
    for (frame, signal), number in homes.items():
        if number > 1:
            yield f"[read] {frame}.{signal} is read as {number} quantities, expected one each"
    for reader in config.readers:
        guards = [name for name in (reader.counter, reader.crc) if name]
        for name in sorted(set(guards)):
            if guards.count(name) > 1 or (reader.name, name) in homes:
                each = "expected a signal each for counter, CRC and what is read"
                yield f"[protect] {reader.name}: {name} has two parts, {each}"
    own = {name: quantity for quantity, names in TELLING.items() for name in names.split()}
    for quantity, mapping in config.quantities.items():
        other = own.get(mapping.signal.upper(), quantity)
        if quantity in TELLING and other != quantity:
            yield f"[read.{quantity}] signal = {mapping.signal!r} is named like {other}; are the two swapped?"
    if not config.fault_flags:
        yield "[read.faults] signals = [], expected at least one flag that is 1 when the kit is broken"
    for quantity in ("enabled", "override", "timeout", "brake", "accelerator", *config.fault_flags):
        flag = config.quantities.get(quantity)
        if flag and _signal(config, flag).length > 4:
            yield f"[read.{quantity}] signal = {flag.signal!r} has {_signal(config, flag).length} bits, it is no flag"


def _frames(config: CarConfig) -> Iterator[str]:
    together = ("lat", "lon") if config.origin_deg else ("x", "y")
    frames = {config.quantities[name].frame for name in together}
    if len(frames) > 1:
        yield f"[read] {together[0]} and {together[1]} come in {' and '.join(sorted(frames))}, expected one frame"
    for reader in config.readers:
        if reader.frame_id == config.writer.frame_id:
            yield f"[read] {reader.name} is the command (0x{reader.frame_id:X}) that [write] sends"
        many = [s.name for s in reader.message.signals if s.is_multiplexer or s.multiplexer_ids]
        if many:
            yield f"[read] {reader.name} is multiplexed ({', '.join(many)}), expected a frame with one layout"
        guarded = reader.counter or reader.crc
        if guarded and reader.period != 0.0 and not 0.002 <= reader.period <= 0.1:
            yield f"[protect] {reader.name}: period = {reader.period:g} s, expected 0.002 to 0.1 s, or none"
        if not guarded and not 0.002 <= reader.period <= 0.1:
            yield (
                f"[protect] {reader.name}: period = {reader.period:g} s, expected 0.002 to 0.1 s: with neither counter "
                "nor CRC, only their number tells a second sender"
            )
        for signal in reader.message.signals:
            if not (math.isfinite(signal.scale) and signal.scale != 0.0):
                yield f"{reader.name}.{signal.name}: scale {signal.scale} in the DBC, expected one that is not 0"


def _ranges(config: CarConfig) -> Iterator[str]:
    """Can each signal say what the limits ask about?"""
    limits, states = config.gate, config.states
    for quantity, least in (
        ("delta_sw", limits.delta_sw_max),
        ("echo", limits.delta_sw_max),
        ("v", states.v_max),
        ("v_kit", states.v_max),
        ("torque", 1.2 * states.torque_max),
        ("r", 0.5),
    ):
        mapping = config.quantities.get(quantity)
        if mapping is None:
            continue
        low, high = _reach(config, mapping)
        one_sided = quantity in ("v", "v_kit")
        if high < least or (low > -least and not one_sided):
            unit = "N m" if quantity == "torque" else "SI"
            yield (
                f"[read.{quantity}] {mapping.signal} reaches from {low:.4g} to {high:.4g} [{unit}], expected at least "
                f"{'' if one_sided else '+-'}{least:.4g}, or a tighter limit"
            )
    low, high = _reach(config, config.quantities["psi"])
    if not high - low >= 2.0 * math.pi - 0.02:
        yield f"[read.psi] reaches from {low:.4g} to {high:.4g} rad, expected a whole circle"
    path = config.course.get("path")
    if path is not None and "x" in config.quantities:
        for name, column in (("x", path.samples.xy[:, 0]), ("y", path.samples.xy[:, 1])):
            low, high = _reach(config, config.quantities[name])
            if column.min() < low or column.max() > high:
                yield f"[read.{name}] reaches from {low:.4g} to {high:.4g} m, the course further"


def _command(config: CarConfig) -> Iterator[str]:
    writer, largest = config.writer, config.gate.delta_sw_max
    names = [
        n for n in (writer.angle.signal, writer.enable, writer.clear, writer.alert, writer.counter, writer.crc) if n
    ]
    for name, number in Counter(names).items():
        if number > 1:
            yield f"[write] {name} has {number} roles, expected one"
    for role, own in WRITTEN.items():
        name = getattr(writer, role)
        other = next((r for r, pattern in WRITTEN.items() if r != role and pattern.match(name)), "")
        if other and not own.match(name):
            yield f"[write] {role} = {name!r} is named like {other}; are the two swapped?"
        elif name and DANGEROUS.search(name) and not own.match(name):
            yield f"[write] {role} = {name!r} switches a protection of the kit off; expected the signal for {role}"
    for where, message, name in [
        ("write", writer.message, writer.counter),
        *((f"protect.{r.name}", r.message, r.counter) for r in config.readers),
    ]:
        counter = message.get_signal_by_name(name) if name else None
        if counter and (counter.scale, counter.offset) != (1, 0):
            steps = f"in steps of {counter.scale:g} from {counter.offset:g}"
            yield f"[{where}] counter = {name!r} counts {steps}, expected 1 from 0"
    for role in ("enable", "clear", "alert"):
        name = getattr(writer, role)
        if name and writer.message.get_signal_by_name(name).length != 1:
            yield f"[write] {role} = {name!r} has more than one bit"
    for name, value in writer.fixed:
        if name in names:
            yield f"[write.fixed] {name} is written by [write] already"
        elif value and DANGEROUS.search(name):
            yield f"[write.fixed] {name} = {value}, expected 0: it switches a protection of the kit off"
    signal = writer.message.get_signal_by_name(writer.angle.signal)
    if not (math.isfinite(signal.scale) and signal.scale != 0.0):
        yield f"[write] {signal.name}: scale {signal.scale} in the DBC, expected one that is not 0"
        return
    if not degrees_of(writer.quantum) <= 1.0:
        yield f"[write] {signal.name} has steps of {degrees_of(writer.quantum):.3g} deg, expected at most 1 deg"
    for side in (-largest, largest):
        try:
            writer.write(math.trunc(side / writer.quantum) * writer.quantum, enable=True)
        except Exception as error:  # whatever the DBC library says of a value that does not fit
            low, high = signal_range(signal)
            yield (
                f"[limits] delta_sw_max_deg = {degrees_of(largest):g} is more than {signal.name} of "
                f"{writer.message.name} can say ({low:g} to {high:g} {signal.unit or ''}): {error}"
            )
            break


def _signal(config: CarConfig, mapping: Mapping) -> Any:
    return next(r for r in config.readers if r.name == mapping.frame).message.get_signal_by_name(mapping.signal)


def _reach(config: CarConfig, mapping: Mapping) -> tuple[float, float]:
    """Lowest and highest value that a quantity can have [SI]."""
    low, high = signal_range(_signal(config, mapping))
    ends = sorted(value * mapping.gain + mapping.offset for value in (low, high))
    return ends[0], ends[1]


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
    """One pass over the tables of a car's file; mistakes are collected."""

    def __init__(self, path: File, text: str, data: dict[str, Any]):
        self.path, self.data = path, data
        self.mistakes: list[str] = []
        self.texts = {"config.toml": text}
        self.vehicle_file = ""

    def config(self, bus: dict[str, Any] | None) -> CarConfig:
        self.known("", self.data, (*TABLES, "controllers"))
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
        if interface:
            known = sorted(python_can().interfaces.BACKENDS)
            self.one_of(interface, known, f"[bus] interface = {interface!r}: python-can has none of that name")
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

    def message(self, database: Any, where: str, name: Any) -> Any:
        names = [m.name for m in database.messages]
        there = self.one_of(name, names, f"[{where}] frame = {name!r}: not in the DBC files")
        return database.get_message_by_name(name) if there else None

    def signal(self, message: Any, where: str, name: Any) -> Any:
        names = [s.name for s in message.signals]
        there = self.one_of(name, names, f"[{where}]: {message.name} has no signal {name!r}")
        return message.get_signal_by_name(name) if there else None

    def mapping(self, where: str, quantity: str, message: Any, table: dict[str, Any]) -> Mapping | None:
        signal = self.signal(message, where, table.get("signal"))
        if signal is None:
            return None
        unit = self.entry(where, table, "unit", str, signal.unit or "")
        scale, sign = (self.entry(where, table, key, float, 1.0) for key in ("scale", "sign"))
        offset = self.entry(where, table, "offset", float, 0.0)
        valid = [*FACTORS.get(DIMENSION.get(quantity, ""), ("", "1"))]
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
        return FrameReader(message, mappings, **guard, period=period)

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

    def wrong(self, what: str) -> None:
        self.mistakes.append(what)

    def one_of(self, name: Any, valid: Iterable[str], says: str) -> bool:
        """Is the name one of these? If not, that is a mistake: what `says` says, with the nearest and all that are."""
        valid = list(valid)
        near = difflib.get_close_matches(str(name), valid, n=1)
        if name not in valid:
            hint = f"; did you mean '{near[0]}'?" if near else ""
            self.wrong(f"{says}{hint} (valid: {', '.join(valid) or 'none'})")
        return name in valid

    def known(self, where: str, table: dict[str, Any], valid: Iterable[str]) -> None:
        valid = list(valid)
        for key in table:
            self.one_of(key, valid, f"{f'[{where}] ' if where else ''}{key}: not known")

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
            self.wrong(f"[{where}] {key}: missing, expected {_KINDS[kind]}")
            return kind()
        numeric = kind is float and isinstance(value, int) and not isinstance(value, bool)
        if not (isinstance(value, kind) or numeric) or (kind in (int, float) and isinstance(value, bool)):
            self.wrong(f"[{where}] {key} = {value!r}, expected {_KINDS[kind]}")
            return kind()
        return float(value) if kind is float else value


_KINDS = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    list: "a list",
    dict: "a table",
}


def loaded(config: str, channel: str = "") -> tuple[CarConfig, Path]:
    """A configuration, on another bus if `channel` says so, and its course."""
    loaded_config = load(config, bus=bus_of(channel))
    return loaded_config, course_of(loaded_config)


def bus_of(channel: str) -> dict[str, Any] | None:
    """The arguments of `can.Bus` for `INTERFACE:CHANNEL`, or for a serial device or socket:// of slcan; None for ""."""
    if not channel:
        return None
    other = re.fullmatch(r"([a-z_0-9]+):(?!//)(.+)", channel)
    if other:
        return {"interface": other[1], "channel": other[2]}
    return {"interface": "slcan", "channel": channel, "bitrate": 500000, "sleep_after_open": 0.0}


def course_of(config: CarConfig) -> Path:
    """The path that a configuration names; raises ValueError, saying where, for a name that is not known."""
    if "name" not in config.course:
        return config.course["path"]
    try:
        return course(config.course["name"])
    except ValueError as error:
        raise ValueError(f"{config.file}: [course] name: {error}") from error
