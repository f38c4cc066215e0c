"""Which names are known: what a drive is made of, the units that it may be in, and what others call it."""

from __future__ import annotations

import re
from collections.abc import Mapping

from steerkit.diagram.units import RAD_PER_DEG
from steerkit.logs.channels import Channel

QUANTITIES = {
    "t": "s",
    "delta_sw": "rad",
    "delta": "rad",
    "v": "m/s",
    "r": "rad/s",
    "psi": "rad",
    "x": "m",
    "y": "m",
    "lat_deg": "deg",
    "lon_deg": "deg",
}
"""What a drive is made of: time, steering-wheel angle (or delta, the road wheels'), speed, yaw rate, heading (one of r
and psi, or both), and where it was, if the log tells."""

UNITS: dict[str, dict[str, float]] = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "rad": {"rad": 1.0, "deg": RAD_PER_DEG},
    "m/s": {"m/s": 1.0, "km/h": 1.0 / 3.6, "mph": 0.44704, "kn": 1852.0 / 3600.0},
    "rad/s": {"rad/s": 1.0, "deg/s": RAD_PER_DEG, "mrad/s": 1e-3},
    "m": {"m": 1.0, "km": 1e3, "cm": 1e-2, "mm": 1e-3},
    "deg": {"deg": 1.0, "rad": 1.0 / RAD_PER_DEG},
}
"""SI unit (degrees for a place on Earth) to the units that a column may have, and what one of them is in it."""

_ENDINGS = {
    "deg": "deg",
    "deg_s": "deg/s",
    "degs": "deg/s",
    "dps": "deg/s",
    "kmh": "km/h",
    "kph": "km/h",
    "mph": "mph",
    "ms": "ms",
    "us": "us",
    "ns": "ns",
    "s": "s",
    "sec": "s",
    "mps": "m/s",
    "m_s": "m/s",
    "rad": "rad",
    "rad_s": "rad/s",
    "radps": "rad/s",
    "rads": "rad/s",
    "m": "m",
}
"""How a name may end, and the unit that it then says."""

_SPELT = {
    "°": "deg",
    "degree": "deg",
    "degrees": "deg",
    "grad": "deg",
    "radian": "rad",
    "radians": "rad",
    "°/s": "deg/s",
    "deg/sec": "deg/s",
    "degrees/s": "deg/s",
    "deg/second": "deg/s",
    "rad/sec": "rad/s",
    "radps": "rad/s",
    "kph": "km/h",
    "kmh": "km/h",
    "km/hr": "km/h",
    "mps": "m/s",
    "m/sec": "m/s",
    "meter": "m",
    "metre": "m",
    "sec": "s",
    "seconds": "s",
}
"""Units as files spell them."""

_NAMES: dict[str, tuple[str, ...]] = {
    "t": ("t", "time", "timestamp", "timestamps", "stamp", "time_stamp", "elapsed_time", "log_time", "t_abs"),
    "delta_sw": (
        "delta_sw",
        "supervisor.delta_sw",
        "doe.delta_sw",
        "controller.delta_sw",
        "actuator.delta_sw",
        "car.delta_sw",
        "steering_wheel_angle",
        "steering_wheel",
        "steer_wheel_angle",
        "steering_angle",
        "steer_angle",
        "sw_angle",
        "str_ang",
        "lws_angle",
        "sas_angle",
    ),
    "delta": ("delta", "steering_tire_angle", "steering_tyre_angle", "road_wheel_angle", "tire_angle", "df"),
    "v": (
        "v",
        "sensors.v",
        "car.v",
        "wheel_speeds.mean",
        "vehicle_speed",
        "longitudinal_velocity",
        "veh_spd",
        "v_ego",
        "speed",
        "velocity",
        "v_x",
        "vx",
        "linear.x",
    ),
    "r": (
        "r",
        "wz",
        "yaw_rate",
        "sensors.r",
        "car.r",
        "yawrate",
        "heading_rate",
        "psi_dot",
        "yaw_dot",
        "w_z",
        "omega_z",
        "gyro_z",
        "angular.z",
        "angular_velocity.z",
    ),
    "psi": ("psi", "sensors.psi", "car.psi", "orientation.yaw"),
    "x": ("x", "car.x", "position.x", "pos_x", "position_x"),
    "y": ("y", "car.y", "position.y", "pos_y", "position_y"),
    "lat_deg": ("lat", "latitude", "gps_lat", "gps_latitude"),
    "lon_deg": ("lon", "lng", "longitude", "gps_lon", "gps_longitude"),
}
"""Names that need no map, best first; those with a dot are the end of a longer one, or steerkit's own signals, the
command before the angle. Capitals, blanks and dashes do not count, nor does a unit at the end."""

_WISHES = ("cmd", "command", "desired", "target", "request", "setpoint", "control", "trajectory", "planning")
"""Words in the name of a topic or message that tells what was wanted, not what was."""


def candidates(quantity: str, channels: Mapping[str, Channel]) -> list[str]:
    """The channels that may be that quantity, best first: by kind of message, by name, then by rate."""
    ranked = [
        (rank, -channel.rate, k, name)
        for k, (name, channel) in enumerate(channels.items())
        if (rank := _rank(quantity, channel)) is not None
    ]
    return [name for *_, name in sorted(ranked)]


def is_time(name: str) -> bool:
    """Does a column of that name hold the time?"""
    return _place("t", name) is not None


def _rank(quantity: str, channel: Channel) -> int | None:
    place = _place(quantity, channel.name)
    if channel.means:
        place = -1 if channel.means == quantity else None
    if place is None or (channel.unit and not told_unit(quantity, channel)):
        return None
    own = words(channel.name) in _NAMES[quantity]
    wished = not own and any(word in re.split(r"[^a-z0-9]", words(channel.name)) for word in _WISHES)
    return place + 100 * wished


def _place(quantity: str, name: str) -> int | None:
    """Where in the list of known names this one stands: whole, or its last parts."""
    parts = re.split(r"[./]", words(name).strip("./"))
    tails = [".".join(parts[k:]) for k in range(len(parts))]
    units = [ending for ending, unit in _ENDINGS.items() if unit in UNITS[QUANTITIES[quantity]]]
    for place, known in enumerate(_NAMES[quantity]):
        whole = tails if len(known) > 1 else tails[:1]  # a letter alone is the end of many names
        if any(tail == known or tail in [f"{known}_{unit}" for unit in units] for tail in whole):
            return place
    return None


def words(name: str) -> str:
    """`SteeringWheelAngle`, `steering-wheel angle` and `STEERING_WHEEL_ANGLE` are one name."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return re.sub(r"[^0-9a-z./]+", "_", parted.lower()).strip("_")


def told_unit(quantity: str, channel: Channel) -> str:
    """The channel's unit as the table of units has it; empty where the file says none, or one of something else."""
    unit = channel.unit.strip()
    unit = _SPELT.get(unit.lower(), unit if unit in UNITS[QUANTITIES[quantity]] else unit.lower())
    return unit if unit in UNITS[QUANTITIES[quantity]] else ""


def ended_unit(quantity: str, name: str) -> str:
    """The unit that a name ends in, if it is one of that quantity; else empty."""
    lower, units = name.lower(), UNITS[QUANTITIES[quantity]] if quantity in QUANTITIES else {}
    ends = [unit for ending, unit in _ENDINGS.items() if lower.endswith(f"_{ending}")]
    return max((unit for unit in ends if unit in units), key=len, default="")
