"""Each template works as it was written."""

import runpy
from pathlib import Path
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


def test_an_agent_drives(folder: Path, cli: Any) -> None:
    """With a law by hand; how it is trained is on docs/rl-researcher.md, whose lines are run."""
    seen = runpy.run_path("my_agent.py")["SEEN"]
    by_hand = Network(layers=((np.array([[-0.6, -1.0, 0.0, 0.0, -0.3, 0.0]]), np.zeros(1)),), head="clip")
    PolicyBlock(policy=by_hand, description=Task(description=seen).description).save(folder / "agent-0.npz")
    short = ("--course", "circle", "--rounds", "0.2", "--json", "-q")
    drives = cli("drive", "my_agent.py:make", "stanley", *short).json["drives"]
    assert [drive["held"] for drive in drives] == [True, True]
    assert "agent-2.npz" in cli("drive", "my_agent.py:make_2", *short, code=2).err
