"""What a replay needs is inside a recording, and what differs from then is told."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from steerkit.car import protocol
from steerkit.car import recording as recording_file
from steerkit.car import recording as recordings
from steerkit.car.config import course_of, load, shipped
from steerkit.vehicles import vehicle
from steerkit.vehicles.file import vehicle_text
from tests.support.car_world import setup
from tests.support.recordings import small

# ---- what a replay needs -----------------------------------------------------------------------------------


def own_files(folder: Path) -> Path:
    """A configuration whose DBCs, course and vehicle are files of its own, in folders of their own."""
    for name in ("can", "places", "cars"):
        (folder / name).mkdir(parents=True)
    text = shipped("dbw-kit.toml").read_text()
    for name in ("dbw_steering.dbc", "pose.dbc"):
        raw = shipped(name).read_bytes() + 'CM_ "f\xfcr Stra\xdfen";\n'.encode("cp1252")
        (folder / "can" / name).with_suffix(".DBC").write_bytes(raw)
        text = text.replace(f'"{name}"', f'"can/{Path(name).stem}.DBC"', 1)
    text = text.replace('name = "paper"', 'file = "places/same.csv"\nclosed = true')
    text = text.replace('name = "vw-passat"', 'name = "cars/own.toml"')
    points = [(60 * math.cos(k / 20 * math.pi), 50 * math.sin(k / 20 * math.pi)) for k in range(40)]
    (folder / "places/same.csv").write_text("x,y\n" + "".join(f"{x},{y}\n" for x, y in points))
    (folder / "cars/own.toml").write_text(vehicle_text(replace(vehicle("vw-passat"), m=1234.5)))
    (folder / "car.toml").write_text(text)
    return folder / "car.toml"


def test_a_replay_depends_on_no_file_but_the_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    config = load(own_files(tmp_path / "here"))
    path = course_of(config)
    recordings.Recording(tmp_path / "t.mcap", recordings.described(config, path, 2.5)).close()
    for file in (tmp_path / "here").rglob("*.*"):
        file.write_text("gone")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    recorded = recordings.read(tmp_path / "t.mcap")
    again = recordings.config_of(recorded)
    assert asdict(again.vehicle) == asdict(config.vehicle)
    assert sorted(text for name, text in again.texts.items() if name.endswith(".DBC")) == sorted(
        text for name, text in config.texts.items() if name.endswith(".DBC")
    )
    assert protocol.digest(course_of(again)) == protocol.digest(path)
    assert [reader.frame_id for reader in again.readers] == [reader.frame_id for reader in config.readers]
    assert again.gate == config.gate
    assert recorded.metadata["time_scale"] == "2.5"
    assert recorded.metadata["protocol"] == str(protocol.VERSION)
    assert {"python", "numpy", "steerkit-control", "cantools"} <= recorded.metadata.keys()
    assert recordings.differences(recorded, again, course_of(again)) == []


@pytest.mark.parametrize("name", ["can/pose.DBC", "places/same.csv", "cars/own.toml"])
def test_a_recording_that_lacks_a_file_says_which(tmp_path: Path, name: str) -> None:
    config = load(own_files(tmp_path / "here"))
    description = recordings.described(config, course_of(config))
    del description[f"file:{name}"]
    recordings.Recording(tmp_path / "t.mcap", description).close()
    with pytest.raises(ValueError, match=f"it lacks {name}, named by its configuration"):
        recordings.config_of(recordings.read(tmp_path / "t.mcap"))


def test_a_recording_without_description_says_that_there_is_no_replay(tmp_path: Path) -> None:
    first = recording_file.contents(small()).chunks[0].begin
    (tmp_path / "t.mcap").write_bytes(small()[:8] + bytes(first - 8) + small()[first:])
    recorded = recordings.read(tmp_path / "t.mcap")
    assert len(recorded.messages) == len(recordings._read_bytes(small())[0].messages)
    with pytest.raises(ValueError, match="its description is damaged or has no configuration"):
        recordings.config_of(recorded)
    assert len(recordings.read(recordings.repair(tmp_path / "t.mcap")[1]).messages) == len(recorded.messages)


def test_what_is_different_from_then_is_told(drive: Path) -> None:
    recorded = recordings.read(drive)
    config, path = setup()
    assert recordings.differences(recorded, config, path) == []
    then = recorded._replace(metadata={**recorded.metadata, "numpy": "0.1", "course": "00", "vehicle": "{}"})
    told = recordings.differences(then, config, path)
    assert any(text.startswith("numpy 0.1, now ") for text in told)
    assert {"the course of that name is another one", "the vehicle of that name is another one"} < set(told)
