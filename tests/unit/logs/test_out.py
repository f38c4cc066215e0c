"""Logs out: MCAP that others' readers open, numbers bit for bit, and layouts that name what is in it."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as xml
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit import LinearSingleTrack, Stanley, course, placed, simulate, steering_loop, vehicle
from steerkit.diagram.simulation import Log
from steerkit.logs import Drive, read_drive
from steerkit.logs.out import BEGIN, layout, signals_of, to_mcap, to_ros2
from steerkit.plants.speed_driver import ConstantSpeed
from tests.support.written_logs import driven

pytest.importorskip("mcap")


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
    shown = signals_of(run)
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


def test_a_ros_2_bag_of_a_drive_is_the_drive(tmp_path: Path) -> None:
    pytest.importorskip("rosbags")
    columns = driven()
    place = {"x": 3.0 * columns["t"], "y": -columns["t"], "psi": np.cumsum(columns["r"]) / 20.0}
    drive = Drive.of(**(columns | place), trusted=True)
    counts = to_ros2(drive, tmp_path / "bag.mcap", steer_ratio=14.0)
    assert counts["/odom"] == counts["/vehicle/status/steering_status"] == len(drive.v)
    again = read_drive(tmp_path / "bag.mcap", steer_ratio=14.0, trusted=True)
    assert again.x is not None
    assert drive.x is not None
    n = min(len(again.v), len(drive.v)) - 1
    np.testing.assert_allclose(again.delta_sw[:n], drive.delta_sw[:n], atol=1e-5)
    np.testing.assert_allclose(again.x[:n], drive.x[:n], atol=1e-4)


def test_what_cannot_be_written_teaches(tmp_path: Path) -> None:
    batch = Log(np.arange(3.0), {"car.x": np.zeros((3, 2))}, {"car.x": "m"})
    with pytest.raises(ValueError, match="a batch of cars"):
        to_mcap(batch, tmp_path / "a.mcap")
    with pytest.raises(ValueError, match="the log has no /wheel/delta_sw, /car/v, /car/r"):
        to_ros2(Log(np.arange(3.0), {"a": np.zeros(3)}, {"a": "m"}), tmp_path / "a.mcap", steer_ratio=15.0)
    assert not (tmp_path / "a.mcap").exists()
