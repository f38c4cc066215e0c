"""Production cars that can be steered through the library opendbc: which there are, by what, from which speed."""

import importlib.util
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from importlib import import_module
from typing import Any

import numpy as np

from steerkit._support.errors import nearest, require
from steerkit.estimators.torque_map import LateralMap

INSTALL = (
    "a production car is steered through the library opendbc, which is not installed: "
    "pip install 'steerkit-control[production]' (Python 3.11 or 3.12)"
)
NOT_CARS = ("mock", "body")
"""Makers in the library's list whose platforms are no cars."""


@dataclass(frozen=True, eq=False)
class Platform:
    """A production car as opendbc knows it. Raises ValueError for one that is unknown, or only a dashcam."""

    name: str
    """Such as TESLA_MODEL_3."""
    params: Any
    """opendbc's `CarParams`."""

    @property
    def maker(self) -> str:
        """opendbc's folder for it: toyota is also Lexus."""
        return str(self.params.brand)

    @property
    def obstacle(self) -> str:
        """Why it cannot be steered through the library; "" for a car that can."""
        if self.params.dashcamOnly:
            return "opendbc only looks at this car (dashcam) and does not steer it"
        if self.params.secOcRequired:
            return "this car takes only frames that are signed with a key of its own (SecOC)"
        if self.maker == "volkswagen" and str(self.params.safetyConfigs[-1].safetyModel) == "volkswagenMlb":
            return "opendbc 0.3.1 does not read whether this car's cruise control is engaged"
        return ""

    @property
    def steered_by(self) -> str:
        """What its interface takes: `angle`, `curvature` or `torque`."""
        if self.maker == "ford":
            return "curvature"
        return str(self.params.steerControlType)

    @property
    def slowest(self) -> float:
        """Slowest speed at which its steering takes commands [m/s]."""
        return max(0.0, float(self.params.minSteerSpeed))

    @property
    def delay(self) -> float:
        """From a command to the wheel, as the library assumes it [s]."""
        return float(self.params.steerActuatorDelay)

    @property
    def can_fd(self) -> bool:
        """Are its messages those of the maker's cars with CAN FD? Of Hyundai's and Kia's only."""
        return self.maker == "hyundai" and str(self.params.safetyConfigs[-1].safetyModel) == "hyundaiCanfd"

    @cached_property
    def controls(self) -> Any:
        """opendbc's `CarControllerParams`: the limits of its port."""
        kind = import_module(f"opendbc.car.{self.maker}.values").CarControllerParams
        return kind if kind.__init__ is object.__init__ else kind(self.params)

    @cached_property
    def full(self) -> float:
        """The code of its largest torque, where it is steered by one."""
        return float(getattr(self.controls, "STEER_MAX", 1.0)) if self.steered_by == "torque" else 1.0

    def full_at(self, v: float) -> float:
        """The same at v [m/s]: some makers' grows as the car slows down."""
        lookup = getattr(self.controls, "STEER_MAX_LOOKUP", None)
        return self.full if lookup is None else float(np.interp(v, *lookup))

    @cached_property
    def lateral(self) -> LateralMap:
        """What its largest torque does to the car, as the library has measured or borrowed it; 1 for other cars."""
        if self.steered_by != "torque":
            return LateralMap(gain=1.0, friction=0.0)
        row = import_module("opendbc.car.interfaces").get_torque_params()[self.name]
        return LateralMap(gain=float(row["LAT_ACCEL_FACTOR"]), friction=float(row["FRICTION"]))

    @property
    def play(self) -> float:
        """By how much a curvature's lateral acceleration has to turn round before the port follows [m/s^2].

        Source: opendbc `car/ford/carcontroller.py`, anti_overshoot, which is for these two.
        """
        return 0.1 if self.name in ("FORD_BRONCO_SPORT_MK1", "FORD_F_150_MK14") else 0.0

    @cached_property
    def motor_scale(self) -> float:
        """Torque of the motor over its code in the frames [1], of Toyota."""
        scales = getattr(import_module(f"opendbc.car.{self.maker}.values"), "EPS_SCALE", None)
        return 1.0 if scales is None else float(scales[self.name]) / 100.0

    def code_of(self, message: str, signal: str, label: str) -> float:
        """The code of a signal that its DBC calls so; 0 where it has none."""
        table = import_module(f"opendbc.car.{self.maker}.values").DBC[self.name]
        return _code(str(next(iter(table.values()))), message, signal, label)

    def interface(self) -> Any:
        """A new `CarInterface` of the library, which knows its messages already."""
        made = _interfaces()[self.name](self.params)
        made.update([(0, [])])  # which messages it wants shows when it asks for them
        return made


@cache
def _code(dbc_name: str, message: str, signal: str, label: str) -> float:
    from opendbc.can import CANDefine

    labels = CANDefine(dbc_name).dv.get(message, {}).get(signal, {})
    return float(next((code for code, text in labels.items() if text == label), 0))


def _interfaces() -> Mapping[str, Any]:
    if importlib.util.find_spec("opendbc") is None:
        raise ValueError(INSTALL)
    try:
        found = import_module("opendbc.car.car_helpers").interfaces
    except ImportError as error:
        version = ".".join(map(str, sys.version_info[:2]))
        raise ValueError(f"opendbc is installed, but cannot be imported by Python {version} ({error})") from error
    return dict(found)


@cache
def listed() -> dict[str, Platform]:
    """All cars by name, in alphabetical order, those that are only looked at included; ValueError without opendbc."""
    every = [Platform(name, kind.get_non_essential_params(name)) for name, kind in sorted(_interfaces().items())]
    return {found.name: found for found in every if found.maker not in NOT_CARS}


def platform(name: str) -> Platform:
    """The platform of that name; raises ValueError for one that is unknown or never steered, or without opendbc."""
    where, found = f"[port] opendbc = {name!r}", listed().get(name)
    if found is None:
        raise ValueError(f"{where}: not known{nearest(name, listed())}; valid: those of `steerkit car platforms`")
    require(not found.obstacle, where, found.obstacle)
    return found
