"""Each template works as it was written."""

import runpy
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from steerkit.cli.lists import _FILES
from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.gym import Task


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


def test_the_agent_drives_before_and_after_it_was_trained_again(folder: Path, cli: Any) -> None:
    """What is trained here for 30 s drives somehow; the law by hand holds the path."""
    by_hand = Network(layers=((np.array([[-0.6, -1.0, 0.0, 0.0, -0.3, 0.0]]), np.zeros(1)),), head="clip")
    PolicyBlock(policy=by_hand, description=Task(description=agent().SEEN).description).save(folder / "agent-0.npz")
    short = ("--course", "circle", "--rounds", "0.2", "--json", "-q")
    drives = cli("drive", "my_agent.py:make", "stanley", *short).json["drives"]
    assert [drive["held"] for drive in drives] == [True, True]
    assert "agent-2.npz" in cli("drive", "my_agent.py:make_2", *short, code=2).err
    pytest.importorskip("stable_baselines3")
    file = folder / "my_agent.py"
    file.write_text(file.read_text().replace("CARS = 256", "CARS = 16"))
    block = agent().trained(1, 1000)
    assert [len(w) for w, _ in block.policy.layers] == [64, 64, 1]
    block.save(folder / "agent-0.npz")
    assert cli("drive", "my_agent.py:make", *short).json["rms_e"] != drives[0]["rms_e"]


def agent() -> Any:
    """The module my_agent.py, as `python my_agent.py` runs it but for its last lines."""
    return SimpleNamespace(**runpy.run_path("my_agent.py"))


def test_what_is_there_is_left_as_it_is(folder: Path, cli: Any) -> None:
    assert "is there already" in cli("new", "controller", code=2).err
    assert "a course's file ends in .csv" in cli("new", "course", "--out", "a.txt", code=2).err
    assert "valid: controller, agent, vehicle, course" in cli("new", "car", code=2).err
