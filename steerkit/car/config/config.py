"""The TOML file that describes a car: its bus, its signals, its limits; checked whole before anything is opened."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from functools import cached_property
from importlib.resources import files
from pathlib import Path as File
from typing import Any

from steerkit.car.frames.codec import CommandWriter, FrameReader, Mapping
from steerkit.car.gate import GateLimits
from steerkit.car.motion import MotionLimits
from steerkit.car.state_machine import StateLimits
from steerkit.diagram.units import degrees_of
from steerkit.vehicles import Vehicle

FORMAT = "steerkit car 1"
REPORT = ("delta_sw", "v_kit", "torque", "echo", "enabled", "override", "timeout", "brake", "accelerator")
POSE = ("x", "y", "lat", "lon", "psi", "v", "r", "beta", "a_y", "quality", "stamp")
NEEDED = ("delta_sw", "v_kit", "torque", "enabled", "override", "psi", "v", "r")
DIMENSION = {
    "delta_sw": "rad",
    "echo": "rad",
    "psi": "rad",
    "beta": "rad",
    "lat": "rad",
    "lon": "rad",
    "v": "m/s",
    "v_kit": "m/s",
    "x": "m",
    "y": "m",
    "r": "rad/s",
    "torque": "N m",
    "a_y": "m/s^2",
    "stamp": "s",
}
ANGLES = {
    *("delta_sw_max", "rate_max", "follow_angle", "psi_e_engage", "psi_e_max", "delta_engage"),
    *("motion_across", "heading_slack", "heading_rate", "wheel_slack", "wheel_rate"),
}
"""Limits that the file gives in degrees, as `..._deg`."""
DERIVED = {"steer_ratio", "wheelbase", "arm", "quantum"}
"""Fields of the gate's limits that follow from the car and the DBC."""
KINDS = {
    "rad": ("deg", "rad"),
    "m": ("m", "cm", "mm"),
    "m/s": ("m/s", "km/h", "mph"),
    "rad/s": ("deg/s", "rad/s"),
    "N m": ("Nm", "N m"),
    "m/s^2": ("m/s^2", "m/s2", "g"),
    "s": ("s", "ms", "us"),
}


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
            p = reader.protection
            period = f"{reader.period:g} s" if reader.period else ""
            parts = (("counter", p.counter), ("CRC-8 0x2F", p.crc), ("period", period))
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
    folder = File(str(files("steerkit.car.config")))
    if not (folder / name).is_file():
        known = ", ".join(sorted(f.name for f in folder.iterdir() if f.suffix in (".toml", ".dbc")))
        raise ConfigError(f"{name}: no such file, beside the configuration or shipped; shipped: {known}")
    return folder / name
