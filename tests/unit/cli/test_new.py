"""Each template works as it was written."""

from pathlib import Path
from typing import Any

import pytest

from steerkit.cli.new import _FILES


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> Path:
    monkeypatch.chdir(tmp_path)
    for kind in _FILES:
        assert "next: " in cli("new", kind).out
    return tmp_path


def test_each_template_drives_as_it_is(folder: Path, cli: Any) -> None:
    short = ("--rounds", "0.2", "--json", "-q")
    mine = cli("drive", "my_controller.py:make", "--vehicle", "my_vehicle.toml", "--course", "my_course.csv", *short)
    assert mine.json["held"]
    assert mine.json["max_e"] < 0.3
    assert cli("courses", "my_course.csv", "--json").json["length_m"] == pytest.approx(291.0, abs=1.0)
    text = (folder / "my_scenario.toml").read_text()
    (folder / "my_scenario.toml").write_text(text.replace('# plant = "my_plant', 'plant = "my_plant'))
    own = cli("--code", "my_plant.py", "drive", "stanley", "--scenario", "my_scenario.toml", *short).json
    (folder / "my_scenario.toml").write_text(text)
    usual = cli("drive", "stanley", "--scenario", "my_scenario.toml", *short).json
    assert own["held"]
    assert usual["held"]
    assert 1e-4 < abs(own["rms_e"] - usual["rms_e"]) < 0.05  # another car


def test_what_is_there_is_left_as_it_is(folder: Path, cli: Any) -> None:
    assert "is there already" in cli("new", "controller", code=2).err
    assert "a course's file ends in .csv" in cli("new", "course", "--out", "a.txt", code=2).err
    assert "valid: controller, vehicle, course" in cli("new", "car", code=2).err
