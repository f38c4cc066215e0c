"""The quantities of a drive: their units as files spell them, and the names that columns of them have."""

import re
import tomllib
from pathlib import Path

from steerkit.diagram.units import FACTORS, RAD_PER_DEG

_TABLE = tomllib.loads(Path(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
QUANTITIES: dict[str, str] = _TABLE["si"]
"""What a drive is made of, and its unit: time, steering-wheel angle (or delta, the road wheels'), speed, yaw rate,
heading (one of r and psi, or both), where it was and its lateral velocity, if the log knows."""
UNITS: dict[str, dict[str, float]] = {**FACTORS, "deg": {"deg": 1.0, "rad": 1.0 / RAD_PER_DEG}}
"""SI unit (degrees for a place on Earth) to the units that a column may have, and what one of them is in it."""
SPELT = {spelling: unit for unit, spellings in _TABLE["spelt"].items() for spelling in spellings.split()}
"""Units as files spell them, or as names end in them."""
COMMANDS: str = _TABLE["commands"]
NAMES = {quantity: tuple(names.split()) for quantity, names in _TABLE["names"].items()}
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
