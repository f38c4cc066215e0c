"""The TOML file that describes a car: its bus, its signals and its limits, checked whole before anything is opened.

It imports nothing of the learner, so that a car server starts soon and depends on little.
"""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import Field, asdict, dataclass, field, fields, replace
from functools import cached_property, partial
from pathlib import Path as File
from typing import Any

from steerkit._support.errors import in_one_line, known, optional, require
from steerkit._support.files import LARGEST_TEXT, read_bytes, read_text, read_toml, toml_of
from steerkit._support.plugins import is_outside
from steerkit.car.gate import GateLimits
from steerkit.car.motion import MotionLimits
from steerkit.car.ports import MAX_JUMP, CommandWriter, FrameReader, Mapping, checked, python_can, signal_range
from steerkit.car.production import platforms
from steerkit.car.production.platforms import PortLimits, limits_of
from steerkit.car.state_machine import StateLimits
from steerkit.diagram.units import FACTORS, degrees_of, radians_of
from steerkit.paths.courses import course
from steerkit.paths.path import Path
from steerkit.vehicles import Vehicle, vehicle, vehicle_of

FORMAT = "steerkit car 1"
TABLES = (
    *("format", "bus", "files", "course", "vehicle", "kit", "read", "protect", "write", "server", "limits"),
    *("controllers", "port"),
)
_TABLES = read_toml(File(__file__).with_name("quantities.toml"), "quantities")
_REPORT, _POSE = _TABLES["report"], _TABLES["pose"]
"""What the kit reports and what makes the pose: SI unit, and names of signals."""
NEEDED = ("delta_sw", "v_kit", "torque", "enabled", "override", "psi", "v", "r")
DIMENSION = {name: unit for name, (unit, _) in {**_REPORT, **_POSE}.items() if unit}
"""Quantity to SI unit; the others are flags and pure numbers."""
_TELLING = {name: quantity for quantity, (_, names) in {**_REPORT, **_POSE}.items() for name in names.split()}


def _is_angle(limit: Field[Any]) -> bool:
    return bool(limit.metadata["number"][0].startswith("rad"))


LIMITS = {
    f"{f.name}_deg" if _is_angle(f) else f.name: f
    for kind in (GateLimits, StateLimits, MotionLimits)
    for f in fields(kind)
    if "number" in f.metadata  # the others follow from the car and the DBC
}
"""Keys of `[limits]`, and the fields that they set; the file gives angles in degrees."""


@dataclass(frozen=True, kw_only=True)
class CarConfig:
    """A checked configuration."""

    file: str
    """Where it came from."""
    bus: dict[str, Any]
    """Arguments of `can.Bus`."""
    course: Path
    vehicle: Vehicle
    readers: tuple[FrameReader, ...]
    """The frames that are read."""
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
    port: str = ""
    """The platform of opendbc that the car is, such as TESLA_MODEL_3; "" for a car with a kit."""
    line: dict[str, Any] = field(default_factory=dict)
    """How a port reaches its car: see `steerkit.car.production.port`."""
    port_limits: PortLimits | None = None
    """What the port makes of a command."""
    vehicle_file: str = ""
    """Name of the vehicle file that `vehicle` is from; "" for a car by its name."""
    texts: dict[str, str] = field(default_factory=dict, repr=False)
    """The files that it was made from: `config.toml`, DBC files and course by name; for the recording."""

    @cached_property
    def quantities(self) -> dict[str, Mapping]:
        """All that is read, by name."""
        return {name: mapping for reader in self.readers for name, mapping in reader.mappings.items()}

    @cached_property
    def fault_flags(self) -> tuple[str, ...]:
        """Quantities `fault:NAME` that must be 0."""
        return tuple(name for name in self.quantities if name.startswith("fault:"))

    @cached_property
    def report_frames(self) -> frozenset[int]:
        """Ids of the frames that make the kit's report."""
        return self._frames_of({*_REPORT, *self.fault_flags})

    @cached_property
    def pose_frames(self) -> frozenset[int]:
        """Ids of the frames that make the pose."""
        return self._frames_of({*_POSE})

    def _frames_of(self, names: set[str]) -> frozenset[int]:
        return frozenset(reader.frame_id for reader in self.readers if reader.mappings.keys() & names)

    def summary(self) -> list[str]:
        """What will be read and written, one line each."""
        w, never = self.writer, " NEVER: listen only" if self.listen_only else ""
        values = asdict(self.gate) | asdict(self.states) | asdict(self.motion)
        rest = {"enable": w.enable, "clear": w.clear, "counter": w.counter, "CRC": w.crc}
        lines = [
            f"bus      {', '.join(f'{k} = {v!r}' for k, v in self.bus.items())}",
            f"vehicle  {self.vehicle.name}, ratio {self.gate.steer_ratio:g}, L = {self.gate.wheelbase:g} m",
            f"course   {self.course.name}",
        ]
        for reader in self.readers:
            period = f"{reader.period:g} s" if reader.period else ""
            parts = {"counter": reader.counter, "CRC-8 0x2F": reader.crc, "period": period}
            lines.append(f"read     {reader.name} (0x{reader.frame_id:X}), protection: {_listed(parts)}")
            for name, m in reader.mappings.items():
                unit = DIMENSION.get(name, "1")
                lines.append(f"           {name} [{unit}] = {m.gain:.6g} * {m.signal} + {m.offset:g}")
        if self.port:
            by = platforms.platform(self.port).steered_by
            line = ", ".join(f"{k} = {v!r}" for k, v in self.line.items()) or "line = 'panda'"
            lines.append(f"port     opendbc {self.port}, by {by}; {line}")
        return [
            *lines,
            f"write    {w.message.name} (0x{w.message.frame_id:X}){never}",
            f"           {w.angle.signal} = delta_sw / {w.angle.gain:.6g}, steps of {degrees_of(w.quantum):.3g} deg",
            f"           {_listed(rest)}; fixed {dict(w.fixed)}",
            f"kit      lag {self.lag:g} s, delay {self.delay:g} s, for controllers that predict",
            *(
                f"limit    {key} = {degrees_of(values[f.name]) if _is_angle(f) else values[f.name]:g}"
                for key, f in LIMITS.items()
            ),
        ]


def _listed(parts: dict[str, str]) -> str:
    return ", ".join(f"{name} {part}" for name, part in parts.items() if part)


def shipped(name: str) -> File:
    """A configuration or DBC that comes with steerkit; raises ValueError for another name, with the valid ones."""
    folder = File(__file__).parent / "kits"
    if not (folder / name).is_file():
        known = ", ".join(sorted(f.name for f in folder.iterdir() if f.suffix in (".toml", ".dbc")))
        raise ValueError(f"{name}: no such file, beside the configuration or shipped; shipped: {known}")
    return folder / name


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
MEANING = re.compile(r"TYPE|MODE", re.I)
"""Signals of a command that say what it means: an angle, or perhaps a torque."""
SMALLEST, LARGEST = 1e-12, 1e9
_PLAUSIBLE = f"scales from {SMALLEST:g} to {LARGEST:g}, offsets up to {LARGEST:g}"
STEPS = 20
"""A signal has so many steps at least up to what the limits ask about."""


# Each of the four audits yields contradictions, one a line, and raises nothing.


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
    for quantity, mapping in config.quantities.items():
        other = _TELLING.get(mapping.signal.upper(), quantity)
        if quantity not in config.fault_flags and other != quantity:
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
        if reader.frame_id == config.writer.message.frame_id:
            yield f"[read] {reader.name} is the command (0x{reader.frame_id:X}) that [write] sends"
        many = [s.name for s in reader.message.signals if s.is_multiplexer or s.multiplexer_ids]
        if many:
            yield f"[read] {reader.name} is multiplexed ({', '.join(many)}), expected a frame with one layout"
        report, pose = (reader.frame_id in frames for frames in (config.report_frames, config.pose_frames))
        if report and pose:
            rest = "they must come from different frames, as they are checked against each other"
            yield f"[read]: {reader.name} holds both what the kit reports and what makes the pose; {rest}"
        guarded = reader.counter or reader.crc
        if not (0.002 <= reader.period <= 0.1 or (guarded and reader.period == 0.0)):
            rest = ", or none" if guarded else ": with neither counter nor CRC, only their number tells a second sender"
            yield f"[protect] {reader.name}: period = {reader.period:g} s, expected 0.002 to 0.1 s{rest}"
        if "delta_sw" in reader.mappings and not guarded and "echo" not in config.quantities:
            yield (
                "[read] echo: missing; the kit's report has neither counter nor CRC, so its echo of the command "
                "is the only thing that shows when it freezes"
            )


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
        *(("psi", 2.0 * math.pi), ("x", 20.0), ("y", 20.0)),
    ):
        mapping = config.quantities.get(quantity)
        if mapping is None:
            continue
        step = abs(_signal(config, mapping).scale * mapping.gain)
        if step > least / STEPS:
            yield f"[read.{quantity}] {mapping.signal}: steps of {step:.3g} [SI], expected at most {least / STEPS:.3g}"
        if quantity in ("psi", "x", "y"):
            continue
        low, high = _reach(config, mapping)
        one_sided = quantity in ("v", "v_kit")
        if high < least or (low > -least and not one_sided):
            yield (
                f"[read.{quantity}] {mapping.signal} reaches from {low:.4g} to {high:.4g} [SI], expected at least "
                f"{'' if one_sided else '+-'}{least:.4g}, or a tighter limit"
            )
    low, high = _reach(config, config.quantities["psi"])
    if not high - low >= 2.0 * math.pi - 0.02:
        yield f"[read.psi] reaches from {low:.4g} to {high:.4g} rad, expected a whole circle"
    if "x" in config.quantities:
        for name, column in zip("xy", config.course.samples.xy.T):
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
    for name, value in writer.fixed:
        if name in names:
            yield f"[write.fixed] {name} is written by [write] already"
        elif value and DANGEROUS.search(name):
            yield f"[write.fixed] {name} = {value}, expected 0: it switches a protection of the kit off"
        elif value and MEANING.search(name):
            choices = writer.message.get_signal_by_name(name).choices or {}
            if not re.search(r"angle|position", str(choices.get(value, "")), re.I):
                yield f"[write.fixed] {name} = {value}, expected 0, or a value that the DBC (VAL_) names an angle"
    signal = writer.message.get_signal_by_name(writer.angle.signal)
    if not degrees_of(writer.quantum) <= 1.0:
        yield f"[write] {signal.name} has steps of {degrees_of(writer.quantum):.3g} deg, expected at most 1 deg"
    for side in (-largest, largest):
        try:
            writer.write(math.trunc(side / writer.quantum) * writer.quantum, enable=True)
        except ImportError:  # a library is not installed: no mistake of the file
            raise
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


def load(file: str | File, channel: str = "") -> CarConfig:
    """The configuration in a TOML file, or the shipped one of that name.

    channel: another bus than the file's (see `bus_of`); BUS+HOST:PORT with a simulated production car. Raises
    ValueError with the first mistake, or with all contradictions, one a line, each naming the key, what stands there
    and what is valid.
    """
    path = File(file) if File(file).exists() else shipped(str(file))
    try:
        text = read_text(path, "car")
        data = toml_of(text, "car")
    except ValueError as error:
        raise ValueError(f"{path}: cannot be read as TOML ({in_one_line(error)})") from error
    bus, plus, line = channel.partition("+")
    config = Reading(f"{path}", data, {"config.toml": text}, path.parent).config(bus_of(bus))
    return replace(config, line={"line": "socket", "channel": line}) if plus else config


class Reading:
    """One pass over the tables of a car's file; the first mistake raises ValueError.

    where: what errors call it. texts: its own, `config.toml`, and those of files that it names. folder: where the
    others are; None: nowhere, as a recording holds them all.
    """

    def __init__(self, where: str, data: dict[str, Any], texts: dict[str, str], folder: File | None = None):
        self.where, self.data, self.texts, self.folder = where, data, texts, folder

    def config(self, bus: dict[str, Any] | None) -> CarConfig:
        """The configuration, on another bus if there is one; raises ValueError, with all that contradicts itself."""
        self.known("", self.data, TABLES)
        stated = self.data.get("format")
        self.require(stated == FORMAT, f"format = {stated!r}, expected {FORMAT!r} in the first line")
        port, line = self.port()
        database = self.database()
        car, vehicle_file = self.car()
        readers, writer = self.reading(database), self.writing(database)
        gate, states, motion = self.limits(car, writer)
        limits = limits_of(port, car) if port else None
        server = self.table("server", ("listen_only", "keep_recording"))
        config = CarConfig(
            file=self.where,
            bus=self.bus() if bus is None else bus,
            course=self.course(),
            vehicle=car,
            vehicle_file=vehicle_file,
            readers=tuple(readers),
            origin_deg=self.origin(),
            writer=writer,
            gate=limits.within(gate) if limits else gate,
            states=replace(states, a_y_engage=min(states.a_y_engage, limits.a_y_engage)) if limits else states,
            motion=motion,
            controllers=self.controllers(),
            port=port.name if port else "",
            line=line,
            port_limits=limits,
            texts=self.texts,
            **{key: self.entry("server", server, key, bool, False) for key in ("listen_only", "keep_recording")},
            **dict[str, Any](self.kit()),
        )
        if mistakes := [*_signals(config), *_frames(config), *_ranges(config), *_command(config)]:
            raise ValueError("\n".join(f"{self.where}: {m}" for m in mistakes))
        return config

    def text(self, name: str, read: Callable[[File], str]) -> str:
        """The text of a file that the configuration names; raises ValueError or OSError."""
        if name not in self.texts:
            if self.folder is None:
                raise ValueError(f"{name} is not in it: no replay")
            self.texts[name] = read(self.folder / name)
        return self.texts[name]

    def port(self) -> tuple[platforms.Platform | None, dict[str, Any]]:
        """The platform of a production car and the line to it, and what such a car adds to the tables."""
        table = self.table("port", ("opendbc", "line", "channel"))
        if "port" not in self.data:
            return None, {}
        found = self.made("", platforms.platform, self.entry("port", table, "opendbc", str))
        self.one_of(table.get("line", "panda"), LINES, "[port] line")
        self.entry("port", table, "channel", str, "")
        added = read_toml(File(__file__).parent / "production" / "port.toml", "port")
        for name, more in added.items():
            own = self.table(name)
            twice = ", ".join(sorted(own.keys() & more.keys() - {"dbc"}))
            self.require(not twice, f"[{name}] {twice}: the port of {found.name} gives it; leave it out")
            both = {"dbc": [*self.entry(name, own, "dbc", list, []), *more["dbc"]]} if "dbc" in more else more
            self.data[name] = {**own, **both}
        self.data.setdefault("vehicle", {"name": found.name.lower().replace("_", "-")})
        self.data.setdefault("kit", {"lag": 0.1, "delay": found.delay})
        return found, {key: value for key, value in table.items() if key != "opendbc"}

    def bus(self) -> dict[str, Any]:
        table = self.table("bus", ("interface", "channel", "bitrate", "options"))
        interface = self.entry("bus", table, "interface", str)
        channel = table.get("channel")
        named = isinstance(channel, (str, int)) and not isinstance(channel, bool)
        self.require(
            named, f"[bus] channel = {channel!r}, expected a name such as '/dev/ttyACM0' or 'can0', or a number"
        )
        options = self.entry("bus", table, "options", dict, {})
        for key, value in options.items():
            fits = key not in _BUS and isinstance(value, (str, int, float))
            what = f"[bus] options: {key} = {value!r:.50}, expected numbers, texts, none of {', '.join(_BUS)}"
            self.require(fits, what)
        bitrate = {"bitrate": self.entry("bus", table, "bitrate", int)} if "bitrate" in table else {}
        bus: dict[str, Any] = {**options, "interface": interface, "channel": channel, **bitrate}
        return dict(self.made("", checked, bus))

    def controllers(self) -> tuple[str, ...]:
        names = self.entry("controllers", self.table("controllers", ("allow",)), "allow", list, [])
        for name in names:
            own = isinstance(name, str) and is_outside(name)
            self.require(own, f"[controllers] allow: {name!r}, expected names such as 'my_file.py:make'")
        return tuple(names)

    def kit(self) -> dict[str, float]:
        defaults = {"lag": 0.1, "delay": 0.0}
        table = self.table("kit", defaults)
        values = {key: self.entry("kit", table, key, float, default) for key, default in defaults.items()}
        for key, value in values.items():
            self.require(0.0 <= value <= 1.0, f"[kit] {key} = {value:g} s, expected 0 to 1 s")
        return values

    def database(self) -> Any:
        python_can(self.where)
        cantools = optional("cantools", self.where, "car")

        def beside_or_shipped(place: File) -> str:
            return read_bytes(place if place.exists() else shipped(place.name), LARGEST_TEXT).decode("cp1252")

        def add(name: str) -> None:
            database.add_dbc_string(self.text(name, beside_or_shipped))

        database = cantools.database.Database(strict=True)
        for name in map(str, self.entry("files", self.table("files", ("dbc",)), "dbc", list)):
            self.made(f"[files] dbc: {name}: ", add, name, errors=Exception)  # whatever the parser makes of it
        return database

    def car(self) -> tuple[Vehicle, str]:
        """The car, and the name of its vehicle file; "" for a car by its name."""
        name = self.entry("vehicle", self.table("vehicle", ("name",)), "name", str)
        where = "[vehicle] name: "
        if not name.endswith(".toml"):
            return self.made(where, vehicle, name), ""
        text = self.made(where, self.text, name, partial(read_text, where="vehicle"))
        return self.made(where, vehicle_of, text, name), name

    def course(self) -> Any:
        table = self.table("course", ("name", "file", "closed"))
        one = ("name" in table) != ("file" in table)
        self.require(one, "[course]: give either name, such as 'paper', or file, a CSV with the columns x and y")
        if "name" in table:
            return self.made("[course] name: ", course, self.entry("course", table, "name", str))
        name, closed = (self.entry("course", table, key, kind) for key, kind in (("file", str), ("closed", bool)))
        where = f"[course] file = {name!r}: "
        text = self.made(where, self.text, name, partial(read_text, where="course", latin=True))
        from steerkit.paths.importers import course_of  # whose readers of maps most cars do without

        return self.made(where, partial(course_of, text, closed=closed), name)

    def limits(self, car: Vehicle, writer: CommandWriter) -> tuple[GateLimits, StateLimits, MotionLimits]:
        table = self.table("limits", LIMITS)
        values: dict[str, Any] = {}
        for key, value in table.items():
            limit = LIMITS[key]
            value = self.entry("limits", table, key, int if limit.type is int else float)
            _, low, high, _ = limit.metadata["number"]
            values[limit.name] = radians_of(value) if _is_angle(limit) else value
            least, most = (degrees_of(end) if _is_angle(limit) else end for end in (low, high))
            within = low <= values[limit.name] <= high
            self.require(within, f"[limits] {key} = {value:g}, expected {least:g} to {most:g}")
        derived = {"steer_ratio": car.steer_ratio, "wheelbase": car.wheelbase, "arm": car.l_r}
        derived["quantum"] = writer.quantum

        def made(kind: Any, **more: Any) -> Any:
            own = {f.name: values[f.name] for f in fields(kind) if f.name in values}
            return self.made("[limits]: ", partial(kind, **own, **more))

        return made(GateLimits, **derived), made(StateLimits), made(MotionLimits)

    def message(self, database: Any, where: str, name: Any) -> Any:
        self.one_of(name, [m.name for m in database.messages], f"[{where}] frame")
        return database.get_message_by_name(name)

    def signal(self, message: Any, where: str, name: Any) -> Any:
        self.one_of(name, [s.name for s in message.signals], f"[{where}] signal of {message.name}")
        signal = message.get_signal_by_name(name)
        plausible = SMALLEST <= abs(signal.scale) <= LARGEST and abs(signal.offset) <= LARGEST
        numbers = f"scale {signal.scale!s:.20}, offset {signal.offset!s:.20} in the DBC"
        self.require(plausible, f"[{where}] {message.name}.{name}: {numbers}, expected {_PLAUSIBLE}")
        return signal

    def mapping(self, where: str, quantity: str, message: Any, table: dict[str, Any]) -> Mapping:
        signal = self.signal(message, where, table.get("signal"))
        unit = self.entry(where, table, "unit", str, signal.unit or "")
        scale, sign = (self.entry(where, table, key, float, 1.0) for key in ("scale", "sign"))
        offset = self.entry(where, table, "offset", float, 0.0)
        valid = [*FACTORS.get(DIMENSION.get(quantity, ""), ("", "1"))]
        expected = f"expected one of {', '.join(map(repr, valid))}"
        self.require(unit in valid, f"[{where}] unit = {unit!r} for {quantity}, {expected}")
        self.require(sign in (1.0, -1.0), f"[{where}] sign = {sign:g}, expected 1 or -1")
        plausible = SMALLEST <= scale <= LARGEST and abs(offset) <= LARGEST
        what = f"[{where}] scale = {scale}, offset = {offset}, expected scale > 0, {_PLAUSIBLE}"
        self.require(plausible, what)
        return Mapping(frame=message.name, signal=signal.name, unit=unit, scale=scale, sign=sign, offset=offset)

    def reading(self, database: Any) -> list[FrameReader]:
        table = self.table("read", (*_REPORT, *(p for p in _POSE if p not in ("lat", "lon")), "faults", "gnss"))
        gnss = self.table("read.gnss", ("lat", "lon", "origin_deg"), inside=table)
        entries = {k: v for k, v in table.items() if k not in ("faults", "gnss")}
        both = bool(gnss) and bool({"x", "y"} & entries.keys())
        self.require(not both, "[read]: both x, y and gnss, expected one of them")
        entries |= {k: v for k, v in gnss.items() if k in ("lat", "lon")}
        for name in (*NEEDED, *(("lat", "lon") if gnss else ("x", "y"))):
            self.require(name in entries, f"[read] {name}: missing, expected {{ frame = ..., signal = ... }}")
        by_frame: dict[str, dict[str, Mapping]] = {}
        for name, entry in entries.items():
            where = f"read.{name}"
            shaped = isinstance(entry, dict)
            self.require(shaped, f"[{where}] = {entry!r}, expected {{ frame = ..., signal = ... }}")
            self.known(where, entry, ("frame", "signal", "unit", "scale", "sign", "offset"))
            message = self.message(database, where, entry.get("frame"))
            by_frame.setdefault(message.name, {})[name] = self.mapping(where, name, message, entry)
        faults = self.table("read.faults", ("frame", "signals"), inside=table)
        self.require(faults, "[read.faults]: missing, expected the frame and the signals that must be 0")
        message = self.message(database, "read.faults", faults.get("frame"))
        for flag in self.entry("read.faults", faults, "signals", list):
            self.signal(message, "read.faults", flag)
            by_frame.setdefault(message.name, {})[f"fault:{flag}"] = Mapping(frame=message.name, signal=flag)
        self.known("protect", self.table("protect"), by_frame)
        return [self.reader(database, name, mappings) for name, mappings in by_frame.items()]

    def reader(self, database: Any, name: str, mappings: dict[str, Mapping]) -> FrameReader:
        message, where = database.get_message_by_name(name), f"protect.{name}"
        table: Any = self.table("protect").get(name)
        self.require(
            isinstance(table, dict),
            f"[protect] {name} = {table!r}, expected {{ counter = ..., crc = ... }}, or, for a frame that has "
            "neither, { period = ... }: the time between two of them [s], to notice a second sender",
        )
        self.known(where, table, ("counter", "crc", "period"))
        guard = self.named(message, where, table, ("counter", "crc"))
        long = not guard["counter"] or message.get_signal_by_name(guard["counter"]).length >= 3
        self.require(long, f"[{where}] counter = {guard['counter']!r} counts to less than {2 * MAX_JUMP}, too few")
        return FrameReader(message, mappings, **guard, period=self.entry(where, table, "period", float, 0.0))

    def named(self, message: Any, where: str, table: dict[str, Any], roles: Iterable[str]) -> dict[str, str]:
        """The signals of these roles, "" where there is none, each such that it can have its role."""
        names = dict.fromkeys(roles, "")
        for role in [role for role in names if table.get(role)]:
            signal = self.signal(message, f"{where}.{role}", table[role])
            names[role] = signal.name
            what = f"[{where}] {role} = {signal.name!r}"
            first = 0 if signal.byte_order == "little_endian" else 7
            byte = role != "crc" or (signal.length == 8 and signal.start % 8 == first)
            self.require(byte, f"{what} does not fill one byte, as a CRC-8 must")
            plain = role != "counter" or (signal.scale, signal.offset) == (1, 0)
            steps = f"in steps of {signal.scale:g} from {signal.offset:g}"
            self.require(plain, f"{what} counts {steps}, expected 1 from 0")
            self.require(role in ("crc", "counter") or signal.length == 1, f"{what} has more than one bit")
        return names

    def origin(self) -> tuple[float, float] | None:
        gnss = self.table("read.gnss", inside=self.table("read"))
        if not gnss:
            return None
        origin: Any = gnss.get("origin_deg")
        numbers = isinstance(origin, list) and len(origin) == 2 and all(isinstance(o, (int, float)) for o in origin)
        on_earth = numbers and abs(origin[0]) < 90.0 and abs(origin[1]) <= 180.0
        self.require(on_earth, f"[read.gnss] origin_deg = {origin!r}, expected [latitude, longitude] in degrees")
        return float(origin[0]), float(origin[1])

    def writing(self, database: Any) -> CommandWriter:
        roles = ("enable", "clear", "alert", "counter", "crc")
        table = self.table("write", ("frame", "angle", "fixed", *roles))
        message = self.message(database, "write", table.get("frame"))
        angle = self.table("write.angle", ("signal", "unit", "scale", "sign"), inside=table)
        mapping = self.mapping("write.angle", "delta_sw", message, angle)
        enable = "[write] enable: missing, expected the name of the signal that is 1 while steering"
        self.require("enable" in table, enable)
        names = self.named(message, "write", table, roles)
        fixed = self.table("write.fixed", inside=table)
        for name, value in fixed.items():
            bits = self.signal(message, "write.fixed", name).length
            fits = type(value) is int and 0 <= value < 1 << bits
            self.require(fits, f"[write.fixed] {name} = {value!r}, expected a whole number of {bits} bits")
        return CommandWriter(message, mapping, **names, fixed=tuple(fixed.items()))

    def require(self, ok: Any, what: str) -> None:
        require(ok, self.where, what)

    def made(self, where: str, make: Callable[..., Any], *given: Any, errors: Any = None) -> Any:
        """What `make` makes of these; what it raises is a mistake of the file."""
        caught = errors or (ValueError, OSError)
        try:
            return make(*given)
        except caught as error:
            raise ValueError(f"{self.where}: {where}{in_one_line(error)}") from error

    def one_of(self, name: Any, valid: Iterable[str], what: str) -> None:
        self.made("", known, str(name), valid, what)

    def known(self, where: str, table: dict[str, Any], valid: Iterable[str]) -> None:
        for key in table:
            self.one_of(key, valid, f"[{where}] key" if where else "table")

    def table(
        self, name: str, valid: Iterable[str] | None = None, inside: dict[str, Any] | None = None
    ) -> dict[str, Any]:
        table: Any = (self.data if inside is None else inside).get(name.split(".")[-1], {})
        self.require(isinstance(table, dict), f"{name} = {table!r}, expected a table [{name}]")
        if valid is not None:
            self.known(name, table, valid)
        return dict(table)

    def entry(self, where: str, table: dict[str, Any], key: str, kind: type, default: Any = None) -> Any:
        value = table.get(key, default)
        self.require(value is not None, f"[{where}] {key}: missing, expected {_KINDS[kind]}")
        whole = type(value) is int and abs(value) < 1 << 63  # TOML knows no larger ones
        fits = whole if kind is int else isinstance(value, kind) or (kind is float and whole)
        self.require(fits, f"[{where}] {key} = {value!r}, expected {_KINDS[kind]}")
        return float(value) if kind is float else value


LINES = ("panda", "socket")
"""What a port may reach its car by: `[port] line`."""
_BUS = ("interface", "channel", "bitrate", "config_context", "ignore_config")
"""Arguments of `can.Bus` that are no options of an interface."""
_KINDS = {
    str: "a text",
    int: "a whole number",
    float: "a number",
    bool: "true or false",
    list: "a list",
    dict: "a table",
}


def bus_of(channel: str) -> dict[str, Any] | None:
    """`can.Bus` arguments of `INTERFACE:CHANNEL`, or a serial device or socket:// of slcan, `checked`; None for ""."""
    if not channel:
        return None
    other = re.fullmatch(r"([a-z_0-9]+):(?!//)(.+)", channel)
    if other:
        return checked({"interface": other[1], "channel": other[2]})
    return checked({"interface": "slcan", "channel": channel, "bitrate": 500000, "sleep_after_open": 0.0})


def check_pace(time_scale: float, bus: dict[str, Any]) -> None:
    """Raise ValueError for time that runs otherwise than in reality on a bus that a real car may be on.

    Without one are the virtual buses, and slcan on a pseudo-terminal.
    """
    interface, channel = (str(bus.get(key, "")) for key in ("interface", "channel"))
    simulated = {"slcan": "/dev/pts/", "socketcan": "vcan"}
    if time_scale != 1.0 and interface != "virtual" and not channel.startswith(simulated.get(interface, ())):
        where = f"on {interface}:{channel}: a real car has real time; use --simulated, or a simulated car's channel"
        raise ValueError(f"--time-scale {time_scale:g} {where}")
