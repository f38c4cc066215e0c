"""Production cars that can be steered through the library opendbc: which, by what, from which speed, how far."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import nearest, optional, require
from steerkit._support.files import write_text
from steerkit.diagram.units import radians_of
from steerkit.estimators.torque_map import LateralMap
from steerkit.task import A_Y_MAX, JERK_MAX
from steerkit.vehicles import Vehicle, vehicle
from steerkit.vehicles.rollout import GateLimits

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
    what = "a production car (Python 3.11 or 3.12)"
    return dict(optional("opendbc.car.car_helpers", what, "production").interfaces)


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


CONTROL_HZ = 100.0
"""Frames of a port's counter in a second."""
SPEEDS = (10.0, 31.0)
"""Between which a production car is driven by a lane keeping system [m/s]."""
WITHIN = 0.95
"""The gate stays within this share of a port's limits: the port's own frames, and their rounding, lie between."""
_KEPT = 0.5
"""Of a slow torque controllers count on this share: the rest is what it takes to turn friction round. With all of it
told, LQR and MPC swing by a metre on the slowest (0.6 of the largest torque in a second)."""
OFF = 0.3
"""How far beside its path a car may come while its steering takes over in a bend [m]."""
_WORST_ROLL = 0.06 * 9.81  # m/s^2: opendbc `safety/lateral.h`, AVERAGE_ROAD_ROLL


@dataclass(frozen=True, kw_only=True)
class PortLimits:
    """The limits of a port and of its safety model on a command, as bounds on the steering wheel of that car.

    By an angle, with the rates that are allowed at some speeds (`safety/lateral.h`, steer_angle_cmd_checks),

        |delta_sw| <= delta_max,  |delta_sw'| <= rates(v),

    or with a model of the car (steer_angle_cmd_checks_vm), kappa = tan(delta_sw/steer_ratio)/(L + K v^2),

        |v^2 kappa| <= a_y_max,  |v^2 kappa'| <= jerk_max;

    by a curvature as by the first, and besides within a_y_max; by a torque u
    (steer_torque_cmd_checks), whose largest change in a frame is up,

        |a_y| <= gain (1 - friction),  |a_y'| <= gain up/frame.

    Source: opendbc 0.3.1, `safety/lateral.h` and `car/MAKER/values.py`.
    """

    delta_max: float = math.inf
    """[rad]"""
    rate_max: float = math.inf
    """[rad/s]"""
    rates: tuple[tuple[float, float], ...] = ()
    """(v [m/s], rate of the steering wheel [rad/s])"""
    a_y_max: float = A_Y_MAX
    """[m/s^2]"""
    jerk_max: float = JERK_MAX
    """[m/s^3]"""
    turning: float = math.inf
    """Fastest change of the lateral acceleration by the table, at the worst of `SPEEDS` [m/s^3]."""
    understeer: float = 0.0
    """What the gate may count on of the car's K [rad s^2/m]: by torque, which cannot do more, and by curvature."""
    slew: float | None = None
    """Of a car steered by torque: fastest change of its lateral acceleration that controllers count on [m/s^3]."""
    torque_limit: float | None = None
    """And the largest [m/s^2]."""
    late: float = 0.0
    """And what turning its friction round takes in the mean [s], for controllers more lag."""
    a_y_engage: float = math.inf
    """And the largest to engage at (`taken_over_from`) [m/s^2]."""

    def within(self, limits: GateLimits) -> GateLimits:
        """A gate's limits, no wider than these."""
        fields = type(limits).__dataclass_fields__
        least = {name: fields[name].metadata["number"][1] for name in ("delta_sw_max", "rate_max", "a_y_max")}
        return replace(
            limits,
            delta_sw_max=max(least["delta_sw_max"], min(limits.delta_sw_max, self.delta_max)),
            rate_max=max(least["rate_max"], min(limits.rate_max, WITHIN * self.rate_max)),
            rates=tuple([(v, WITHIN * rate) for v, rate in self.rates]),
            a_y_max=max(least["a_y_max"], min(limits.a_y_max, WITHIN * self.a_y_max)),
            jerk_max=min(limits.jerk_max, WITHIN * self.jerk_max),
            understeer=self.understeer,
        )


def _turning(rates: tuple[tuple[float, float], ...], car: Vehicle) -> float:
    """rates(v) v^2/(steer_ratio (L + K v^2)) at the worst speed [m/s^3]."""
    v = np.arange(*SPEEDS)
    length = float(car.wheelbase) + float(car.understeer_gradient) * v * v
    rate = np.interp(v, [at for at, _ in rates], [fast for _, fast in rates])
    return float(np.min(rate * v * v / (float(car.steer_ratio) * length)))


def taken_over_from(slew: float, late: float, most: float) -> float:
    """The largest lateral acceleration a in which a torque can take over, within OFF of the path [m/s^2].

    The human lets go: a_y falls to 0, waits for `late` [s] and rises by `slew` [m/s^3] up to `most` [m/s^2]. Until it
    is a again, the car is e aside at a speed w; what is left, m = most - a, then brakes that, for T while it rises:

        e = a late^2/2 + a^2 late/slew + a^3/(3 slew^2),  w = a late + a^2/(2 slew),  T = min(m/slew, sqrt(2 w/slew)),
        off = e + w T - slew T^3/6 + (w - slew T^2/2)^2/(2 m)
    """
    a = most * np.linspace(0.0, 1.0, 200, endpoint=False)
    e, w, m = a * late**2 / 2.0 + a**2 * late / slew + a**3 / (3.0 * slew**2), a * late + a**2 / (2.0 * slew), most - a
    t = np.minimum(m / slew, np.sqrt(2.0 * w / slew))
    off = e + w * t - slew * t**3 / 6.0 + (w - slew * t**2 / 2.0) ** 2 / (2.0 * m)
    return float(a[off <= OFF].max())


def limits_of(platform: Platform, vehicle: Vehicle) -> PortLimits:
    """The limits of a platform's port, for a car of these numbers."""
    controls = platform.controls
    step = float(getattr(controls, "STEER_STEP", 1))
    frame = step / CONTROL_HZ
    if platform.steered_by == "torque":
        share = float(controls.STEER_DELTA_UP) / (1.0 if platform.maker == "honda" else platform.full * frame)
        lateral = platform.lateral
        most = lateral.gain * (1.0 - lateral.friction)
        slew = min(JERK_MAX, share * lateral.gain)
        late = 0.5 * lateral.gain * lateral.friction / slew
        return PortLimits(
            a_y_max=min(A_Y_MAX, most),
            jerk_max=slew,
            understeer=float(vehicle.understeer_gradient),
            slew=_KEPT * slew,
            torque_limit=most,
            late=late,
            a_y_engage=taken_over_from(slew, platform.delay + late, most),
        )
    angles: Any = controls.ANGLE_LIMITS
    if getattr(angles, "MAX_LATERAL_ACCEL", 0.0):
        return PortLimits(
            delta_max=radians_of(angles.STEER_ANGLE_MAX),
            rate_max=radians_of(angles.MAX_ANGLE_RATE) / frame,
            a_y_max=float(angles.MAX_LATERAL_ACCEL),
            jerk_max=float(angles.MAX_LATERAL_JERK),
        )
    speeds, rates = (np.asarray(column, float) for column in angles.ANGLE_RATE_LIMIT_UP)
    if platform.steered_by == "angle":
        table = tuple(zip(map(float, speeds), map(float, np.radians(rates) / frame)))
        turning = _turning(table, vehicle)
        return PortLimits(
            delta_max=radians_of(angles.STEER_ANGLE_MAX), rate_max=table[0][1], rates=table, turning=turning
        )
    length, ratio = vehicle.wheelbase, vehicle.steer_ratio
    table = tuple(zip(map(float, speeds), [float(ratio * length * rate / frame) for rate in rates]))
    return PortLimits(
        delta_max=float(ratio * math.atan(length * angles.STEER_ANGLE_MAX)),
        rate_max=table[0][1],
        rates=table,
        turning=_turning(table, vehicle),
        a_y_max=A_Y_MAX - _WORST_ROLL,
        understeer=float(vehicle.understeer_gradient),
    )


AT = 15.0
"""Speed at which the table gives limits [m/s]."""


def rows() -> list[dict[str, Any]]:
    """A row for each platform, SI: name, maker, by, slowest [m/s], delay [s], the largest lateral acceleration [m/s^2]
    and its fastest change [m/s^3] at `AT`, and why it cannot be steered, or "". Raises ValueError without opendbc."""
    table = list[dict[str, Any]]()
    for found in listed().values():
        row = {"name": found.name, "maker": found.maker, "by": found.steered_by, "slowest": found.slowest}
        row |= {"delay": found.delay, "a_y": None, "jerk": None, "obstacle": found.obstacle}
        if not found.obstacle:
            car = vehicle(found.name.lower().replace("_", "-"))
            limits = limits_of(found, car)
            length = car.wheelbase + car.understeer_gradient * AT * AT
            per_wheel = AT * AT / (float(car.steer_ratio) * float(length))
            speeds, rates = np.reshape(limits.rates, (-1, 2)).T
            turning = float(np.interp(AT, speeds, rates)) if limits.rates else limits.rate_max
            row["a_y"] = min(limits.a_y_max, limits.delta_max * per_wheel)
            row["jerk"] = min(limits.jerk_max, turning * per_wheel)
        table.append(row)
    return table


def lines(those: Sequence[dict[str, Any]]) -> list[str]:
    """The table for people."""
    head = f"{'platform':36} {'by':10} {'from':>8} {'delay':>7} {'a_y':>10} {'a_y rate':>11}"
    text = [head]
    for row in those:
        start = f"{row['name']:36} {row['by']:10}"
        if row["obstacle"]:
            text.append(f"{start} not steered: {row['obstacle']}")
            continue
        text.append(
            f"{start} {row['slowest']:4.1f} m/s {row['delay']:5.2f} s {row['a_y']:4.1f} m/s^2 {row['jerk']:5.1f} m/s^3"
        )
    drives = sum(not row["obstacle"] for row in those)
    return [*text, f"{drives} of {len(those)} can be steered; a_y and its rate: at most, at {AT:g} m/s"]


def write(name: str, out: Path) -> None:
    """Write a car's file for that platform; raises ValueError for one that cannot be steered, or a file that exists."""
    require(bool(name), "--out", "expected the name of a platform too, such as TESLA_MODEL_3")
    found = platform(name)
    require(not out.exists(), f"{out}", "exists already; choose another name")
    text = Path(__file__).parents[1].joinpath("kits", "production-car.toml").read_text(encoding="utf-8")
    write_text(out, re.sub(r'(?m)^opendbc = "\w+"', f'opendbc = "{found.name}"', text))
