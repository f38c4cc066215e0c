"""Logs out: MCAP that others' readers open, numbers bit for bit, and layouts that name what is in it."""

from __future__ import annotations

import json
import math
import re
import xml.etree.ElementTree as xml
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit import LinearSingleTrack, Stanley, course, placed, simulate, steering_loop, vehicle
from steerkit.diagram.simulation import Log
from steerkit.logs import foxglove
from steerkit.logs.foxglove import BEGIN, layout, shown_as, to_mcap
from steerkit.plants.speed_driver import ConstantSpeed

pytest.importorskip("mcap")
pytest.importorskip("foxglove")


def messages(file: Path) -> dict[str, list[tuple[int, Any]]]:
    from mcap.reader import make_reader

    found: dict[str, list[tuple[int, Any]]] = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    return found


@pytest.fixture(scope="module")
def run() -> Log:
    path, passat = course("circle"), vehicle("vw-passat")
    car = placed(LinearSingleTrack(vehicle=passat, v0=5.0), path)
    driver, stanley = ConstantSpeed(speed=5.0), Stanley.of(passat)
    return simulate(steering_loop(car=car, path=path, driver=driver, controller=stanley), 3.0)


def test_a_simulated_run_is_read_back_bit_for_bit(run: Log, tmp_path: Path) -> None:
    counts = to_mcap(run, tmp_path / "run.mcap")
    found = messages(tmp_path / "run.mcap")
    assert set(counts) == set(found) - {"/scene/driven"}
    for topic, field, signal in (
        ("/path", "e", "path.e"),
        ("/car", "v", "car.v"),
        ("/wheel", "delta_sw", "car.delta_sw"),
    ):
        assert [values[field] for _, values in found[topic]] == run[signal].tolist()
    assert [when for when, _ in found["/path"]] == [BEGIN + round(t * 1e9) for t in run.t.tolist()]
    pose = found["/scene/pose"][-1][1]["pose"]
    assert (pose["position"]["x"], pose["position"]["y"]) == (run["car.x"][-1], run["car.y"][-1])
    half = np.arctan2(pose["orientation"]["z"], pose["orientation"]["w"])
    assert np.sin(2.0 * half) == pytest.approx(np.sin(run["car.psi"][-1]))


def test_the_layouts_show_what_is_there(run: Log, tmp_path: Path) -> None:
    shown = shown_as(run.columns())
    text = layout("foxglove", tmp_path / "l.json").read_text()
    paths = set(re.findall(r'"value": "(/[^"]+)"', text))
    assert paths
    assert {path.replace(".", "/") for path in paths} <= shown.keys()
    assert set(re.findall(r'"(?:first|second)": "([^"]+)"', text)) == set(json.loads(text)["configById"])
    curves = xml.parse(layout("plotjuggler", tmp_path / "l.xml")).iter("curve")
    names = {curve.get(key) for curve in curves for key in ("name", "curve_x", "curve_y")} - {None, "/car/[x;y]"}
    assert names <= shown.keys()
    with pytest.raises(ValueError, match=r"layout 'rviz' is not known.*valid: foxglove, plotjuggler"):
        layout("rviz", tmp_path / "l")


def test_what_cannot_be_written_teaches(tmp_path: Path) -> None:
    batch = Log(np.arange(3.0), {"car.x": np.zeros((3, 2))}, {"car.x": "m"})
    with pytest.raises(ValueError, match="a batch of cars"):
        to_mcap(batch, tmp_path / "a.mcap")
    assert not (tmp_path / "a.mcap").exists()


def test_the_car_tells_before_the_motor_and_who_was_last_before_the_wheel() -> None:
    names = ["actuator.delta_sw", "controller.delta_sw", "car.delta_sw", "supervisor.delta_sw", "path.e", "x"]
    shown = foxglove.shown_as(names)
    assert shown["/wheel/delta_sw"] == "car.delta_sw"
    assert shown["/wheel/delta_sw_cmd"] == "supervisor.delta_sw"
    assert (shown["/path/e"], shown["/car/x"]) == ("path.e", "x")
    assert shown["/signals/actuator/delta_sw"] == "actuator.delta_sw"
    assert foxglove.by_topic({"/path/e": 1, "/path/s": 2}) == {"/path": {"e": 1, "s": 2}}


def test_a_long_way_is_shown_with_fewer_points_and_a_heading_is_a_quaternion() -> None:
    way = foxglove.way([(float(k), 0.0) for k in range(9000)], 0)["poses"]
    assert foxglove.MOST <= len(way) <= 2 * foxglove.MOST
    assert way[-1]["position"]["x"] > 8990.0
    placed = foxglove.pose(1.0, 2.0, math.pi / 2, 3_000_000_001)
    assert placed["timestamp"] == {"sec": 3, "nsec": 1}
    assert math.isclose(placed["pose"]["orientation"]["z"], math.sqrt(0.5))
    assert foxglove.packed({"v": foxglove.number(math.nan)}) == b'{"v":null}'
