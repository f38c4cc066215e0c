"""Templates work as they were written; pages for users run those of a controller, a vehicle, a course and an agent."""

from pathlib import Path
from typing import Any

import pytest


def test_a_plant_and_a_scenario_drive_as_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    monkeypatch.chdir(tmp_path)
    for kind in ("plant", "scenario"):
        assert "next: " in cli("new", kind).out
    words = ("drive", "stanley", "--scenario", "my_scenario.toml", "--rounds", "0.2", "--json", "-q")
    usual = cli(*words).json
    text = Path("my_scenario.toml").read_text()
    Path("my_scenario.toml").write_text(text.replace('# plant = "my_plant', 'plant = "my_plant'))
    own = cli("--code", "my_plant.py", *words).json
    assert own["held"]
    assert usual["held"]
    assert 1e-4 < abs(own["rms_e"] - usual["rms_e"]) < 0.05  # another car
