"""Names and units are read as those who wrote them meant them."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.logs import Channel
from steerkit.logs.channels import candidates, ended_unit, is_time, unit_of, words


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


def test_a_measurement_goes_before_a_wish_and_a_known_kind_before_a_name() -> None:
    wish, report = channel("/control/command.yaw_rate"), channel("/status.yaw_rate", rate=10.0)
    assert candidates("r", table(wish, report)) == [report.name, wish.name]
    kind = channel("/imu.angular_velocity.z", means="r")
    assert candidates("r", table(report, kind))[0] == kind.name
    assert candidates("v", table(channel("/x.speed", means="r"))) == []


def test_a_letter_alone_is_no_end_of_a_longer_name() -> None:
    assert candidates("x", table(channel("/odom.orientation.x"), channel("x"))) == ["x"]


def test_of_two_of_one_name_the_one_that_was_sampled_more_often_goes_first() -> None:
    slow, fast = channel("/a.yaw_rate", rate=10.0), channel("/b.yaw_rate", rate=50.0)
    assert candidates("r", table(slow, fast)) == [fast.name, slow.name]


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


def test_a_channel_in_a_unit_of_something_else_is_no_candidate() -> None:
    assert candidates("v", table(channel("speed", "rpm"), channel("gps.speed", "km/h"))) == ["gps.speed"]


def test_names_of_times() -> None:
    assert all(map(is_time, ("t", "time_s", "Timestamp", "timestamp_ms", "t_s")))
    assert not any(map(is_time, ("temperature", "torque", "tt")))
    assert words("Steering-Wheel angle") == words("STEERING_WHEEL_ANGLE") == "steering_wheel_angle"
