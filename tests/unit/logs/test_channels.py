"""Names, units and column maps are read as those who wrote them meant them, and wrong ones teach."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit._support.quantities import ended_unit, place, words
from steerkit.logs import Channel, Column, ColumnMap
from steerkit.logs.channels import candidates, unit_of


def channel(name: str, unit: str = "", means: str = "", rate: float = 100.0) -> Channel:
    t = np.arange(50) / rate
    return Channel(name=name, t=t, values=np.zeros(50), unit=unit, means=means)


def table(*channels: Channel) -> dict[str, Channel]:
    return {one.name: one for one in channels}


@pytest.mark.parametrize(
    ("quantity", "name", "unit"),
    [
        ("delta_sw", "SteeringWheelAngle", ""),
        ("delta_sw", "steering_wheel_deg", "deg"),
        ("delta_sw", "STEER_ANGLE_SENSOR.STEER_ANGLE", ""),
        ("delta", "/vehicle/status/steering_status.steering_tire_angle", ""),
        ("v", "speed_mps", "m/s"),
        ("v", "Vehicle Speed", ""),
        ("r", "yawRate", ""),
        ("r", "yaw_rate_deg_s", "deg/s"),
        ("lat_deg", "lat_deg", "deg"),
    ],
)
def test_well_known_names(quantity: str, name: str, unit: str) -> None:
    assert candidates(quantity, table(channel(name), channel("torque"))) == [name]
    assert ended_unit(quantity, name) == unit


def test_a_measurement_goes_before_a_wish_a_known_kind_before_a_name_and_often_before_seldom() -> None:
    wish, report = channel("/control/command.yaw_rate"), channel("/status.yaw_rate", rate=10.0)
    assert candidates("r", table(wish, report)) == [report.name, wish.name]
    kind = channel("/imu.angular_velocity.z", means="r")
    assert candidates("r", table(channel("r"), kind))[0] == kind.name
    assert candidates("v", table(channel("/x.speed", means="r"))) == []
    slow, fast = channel("/a.yaw_rate", rate=10.0), channel("/b.yaw_rate", rate=50.0)
    assert candidates("r", table(slow, fast)) == [fast.name, slow.name]


def test_a_letter_is_no_end_of_a_longer_name_and_a_channel_in_a_unit_of_something_else_is_no_candidate() -> None:
    assert candidates("x", table(channel("/odom.orientation.x"), channel("x"))) == ["x"]
    assert candidates("v", table(channel("speed", "rpm"), channel("gps.speed", "km/h"))) == ["gps.speed"]


@pytest.mark.parametrize(
    ("quantity", "unit", "same"),
    [
        ("v", "kph", "km/h"),
        ("v", "KM/H", "km/h"),
        ("r", "°/s", "deg/s"),
        ("delta_sw", "Degrees", "deg"),
        ("v", "Nm", ""),
        ("v", "", ""),
    ],
)
def test_units_as_they_are_spelt(quantity: str, unit: str, same: str) -> None:
    assert unit_of(quantity, channel("c", unit)) == same


def test_names_of_times() -> None:
    assert None not in [place("t", name) for name in ("t", "time_s", "Timestamp", "timestamp_ms", "t_s")]
    assert {place("t", name) for name in ("temperature", "torque", "tt")} == {None}
    assert words("Steering-Wheel angle") == words("STEERING_WHEEL_ANGLE") == "steering_wheel_angle"


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"deltasw": "x"}, r"quantity 'deltasw' is not known \(did you mean 'delta_sw'\?\); valid: t, delta_sw"),
        ({"v": {"column": "x", "unit": "knots"}}, "unit 'knots' is not known; valid: m/s, km/h"),
        ({"v": {"column": "x", "units": "m/s"}}, r"key of v 'units' is not known \(did you mean 'unit'\?\); valid: "),
        ({"v": {"unit": "m/s"}}, "give a name or"),
        ({"v": {"column": "x", "scale": 0}}, "scale = 0"),
    ],
)
def test_a_wrong_map_teaches(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        ColumnMap.of(table)


def test_column_words() -> None:
    words = ColumnMap.parsed(["delta_sw=df:rad:15.87", "v=speed:km/h", "r=wz"]).columns
    assert (words["delta_sw"].scale, words["v"].unit, words["r"].name) == (15.87, "km/h", "wz")
    with pytest.raises(ValueError, match="expected QUANTITY=COLUMN"):
        ColumnMap.parsed(["delta_sw"])
    with pytest.raises(ValueError, match="scale 'x' is no number"):
        ColumnMap.parsed(["delta_sw=a:rad:x"])


@pytest.mark.parametrize(
    ("quantity", "unit", "si"),
    [
        ("v", "mph", 1760.0 * 0.9144 / 3600.0),  # a mile is 1760 yards of 0.9144 m
        ("t", "ns", 1.0 / 1000.0**3),
        ("delta_sw", "deg", math.pi / 180.0),
        ("lat_deg", "rad", 180.0 / math.pi),
    ],
)
def test_units_are_what_their_definitions_say(quantity: str, unit: str, si: float) -> None:
    values = Column("c", unit, scale=-2.0, offset=0.5).in_si(quantity, np.array([0.0, 3.0]), "test")
    np.testing.assert_allclose(values, [0.5, 0.5 - 6.0 * si], rtol=1e-14)  # the offset is in SI
