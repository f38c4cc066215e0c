"""What a configuration says against itself, its DBC and its course: each part may be valid and the whole be none."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator
from typing import Any

from steerkit.car.config.config import CarConfig
from steerkit.car.frames.codec import Mapping, signal_range
from steerkit.diagram.units import degrees_of

TELLING = {
    "delta_sw": ("ANGLE", "SWA", "STEERING_ANGLE"),
    "echo": ("CMD", "SCMD", "COMMAND"),
    "v_kit": ("VEH_VEL", "VEHICLE_SPEED"),
    "torque": ("TORQUE", "TRQ"),
    "enabled": ("ENABLED",),
    "override": ("OVERRIDE", "OVR"),
    "timeout": ("TMOUT", "TIMEOUT"),
    "brake": ("BRAKE", "BRAKE_PRESSED"),
    "accelerator": ("ACCELERATOR", "GAS", "THROTTLE"),
    "x": ("X", "EAST", "POS_X"),
    "y": ("Y", "NORTH", "POS_Y"),
    "lat": ("LAT", "LATITUDE"),
    "lon": ("LON", "LONGITUDE"),
    "psi": ("PSI", "HEADING", "YAW"),
    "v": ("V", "SPEED", "VELOCITY"),
    "r": ("R", "YAW_RATE", "YAWRATE"),
    "beta": ("BETA", "SIDESLIP"),
    "a_y": ("A_Y", "AY", "LAT_ACC"),
    "quality": ("QUALITY", "FIX"),
    "stamp": ("STAMP", "TIME", "TIMESTAMP"),
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
        guards = [name for name in (reader.protection.counter, reader.protection.crc) if name]
        for name in sorted(set(guards)):
            if guards.count(name) > 1 or (reader.name, name) in homes:
                each = "expected a signal each for counter, CRC and what is read"
                yield f"[protect] {reader.name}: {name} has two parts, {each}"
    own = {name: quantity for quantity, names in TELLING.items() for name in names}
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
        guarded = reader.protection.counter or reader.protection.crc
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
        *((f"protect.{r.name}", r.message, r.protection.counter) for r in config.readers),
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
