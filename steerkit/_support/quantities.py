"""The quantities of a drive: their units as files spell them, and the names that columns of them have."""

from __future__ import annotations

import re

from steerkit.diagram.units import FACTORS, RAD_PER_DEG

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
and psi, or both), and where it was, if the log knows."""

UNITS: dict[str, dict[str, float]] = {**FACTORS, "deg": {"deg": 1.0, "rad": 1.0 / RAD_PER_DEG}}
"""SI unit (degrees for a place on Earth) to the units that a column may have, and what one of them is in it."""

_SPELLINGS = {
    "s": "s sec seconds",
    "ms": "ms",
    "us": "us",
    "ns": "ns",
    "m": "m meter metre",
    "km": "km",
    "cm": "cm",
    "mm": "mm",
    "kn": "kn knots",
    "m/s": "mps m_s m/sec",
    "km/h": "kmh kph km/hr",
    "mph": "mph",
    "deg": "deg ° degree degrees grad",
    "deg/s": "deg_s degs dps °/s deg/sec degrees/s deg/second",
    "rad": "rad radian radians",
    "rad/s": "rad_s radps rads rad/sec",
}
SPELT = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split()}
"""Units as files spell them, or as names end in them."""

COMMANDS = "safety.delta_sw supervisor.delta_sw doe.delta_sw controller.delta_sw"
_KNOWN_AS = {
    "t": "t time timestamp timestamps stamp time_stamp elapsed_time log_time t_abs",
    "delta_sw": f"{COMMANDS} delta_sw steering_wheel_angle steering_wheel steer_wheel_angle steering_angle "
    "steer_angle sw_angle str_ang lws_angle sas_angle",
    "delta": "delta steering_tire_angle steering_tyre_angle road_wheel_angle tire_angle df",
    "v": "v sensors.v car.v wheel_speeds.mean vehicle_speed longitudinal_velocity veh_spd v_ego speed velocity v_x vx "
    "linear.x",
    "r": "r wz yaw_rate sensors.r car.r yawrate heading_rate psi_dot yaw_dot w_z omega_z gyro_z angular.z "
    "angular_velocity.z",
    "psi": "psi sensors.psi car.psi orientation.yaw",
    "x": "x car.x position.x pos_x position_x",
    "y": "y car.y position.y pos_y position_y",
    "lat_deg": "lat latitude gps_lat gps_latitude",
    "lon_deg": "lon lng longitude gps_lon gps_longitude",
}
NAMES = {quantity: tuple(names.split()) for quantity, names in _KNOWN_AS.items()}
"""Names that need no map, best first; those with a dot are the end of a longer one, or steerkit's own signals, the
command before the angle. Capitals, blanks and dashes do not count, nor does a unit at the end."""


def place(quantity: str, name: str) -> int | None:
    """Where in the list of known names this one stands: whole, or its last parts."""
    parts = re.split(r"[./]", words(name).strip("./"))
    tails = [".".join(parts[k:]) for k in range(len(parts))]
    units = [ending for ending, unit in SPELT.items() if unit in UNITS[QUANTITIES[quantity]]]
    for place, name_there in enumerate(NAMES[quantity]):
        whole = tails if len(name_there) > 1 else tails[:1]  # a letter alone is the end of many names
        if any(tail == name_there or tail in [f"{name_there}_{unit}" for unit in units] for tail in whole):
            return place
    return None


def words(name: str) -> str:
    """`SteeringWheelAngle`, `steering-wheel angle` and `STEERING_WHEEL_ANGLE` are one name."""
    parted = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", name)
    return re.sub(r"[^0-9a-z./]+", "_", parted.lower()).strip("_")


def ended_unit(quantity: str, name: str) -> str:
    """The unit that a name ends in, if it is one of that quantity; else empty."""
    lower, units = name.lower(), UNITS[QUANTITIES[quantity]] if quantity in QUANTITIES else {}
    ends = [unit for ending, unit in SPELT.items() if lower.endswith(f"_{ending}")]
    return max((unit for unit in ends if unit in units), key=len, default="")
