"""What the layouts call the signals of a drive, and the scene."""

from __future__ import annotations

import math

from steerkit.logs import messages


def test_the_car_tells_before_the_motor_and_who_was_last_before_the_wheel() -> None:
    names = ["actuator.delta_sw", "controller.delta_sw", "car.delta_sw", "supervisor.delta_sw", "path.e", "x"]
    shown = messages.shown_as(names)
    assert shown["/wheel/delta_sw"] == "car.delta_sw"
    assert shown["/wheel/delta_sw_cmd"] == "supervisor.delta_sw"
    assert (shown["/path/e"], shown["/car/x"]) == ("path.e", "x")
    assert shown["/signals/actuator/delta_sw"] == "actuator.delta_sw"
    assert messages.by_topic({"/path/e": 1, "/path/s": 2}) == {"/path": {"e": 1, "s": 2}}


def test_a_long_way_is_shown_with_fewer_points_and_a_heading_is_a_quaternion() -> None:
    way = messages.way([(float(k), 0.0) for k in range(9000)], 0)["poses"]
    assert messages.MOST <= len(way) <= 2 * messages.MOST
    assert way[-1]["position"]["x"] > 8990.0
    placed = messages.pose(1.0, 2.0, math.pi / 2, 3_000_000_001)
    assert placed["timestamp"] == {"sec": 3, "nsec": 1}
    assert math.isclose(placed["pose"]["orientation"]["z"], math.sqrt(0.5))
    assert messages.packed({"v": messages.number(math.nan)}) == b'{"v":null}'
