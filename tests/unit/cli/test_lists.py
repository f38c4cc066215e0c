"""`steerkit courses` and `steerkit vehicles`."""

from pathlib import Path
from typing import Any

import pytest

from steerkit.paths.courses import names
from steerkit.vehicles import VEHICLES, fleet


def test_courses_as_a_table_and_as_json(cli: Any) -> None:
    rows = {row["course"]: row["tightest_radius_m"] for row in cli("courses", "--json").json["courses"]}
    assert tuple(rows) == names()
    assert (rows["circle"], rows["straight"]) == (pytest.approx(30.0), None)
    printed = cli("courses").out
    assert all(name in printed for name in (*names(), "30.0", "straight", "random-7", "FILE.xodr"))


def test_vehicles_as_a_table_and_as_json(monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    rows = {row["vehicle"]: row for row in cli("vehicles", "--json").json["vehicles"]}
    assert set(rows) == {*VEHICLES, *fleet()}
    assert (rows["kia-ceed"]["steer_delay_s"], rows["kia-ceed"]["interface"]) == (0.1, "torque")
    assert rows["kia-ceed"]["mass_kg"] == fleet()["kia-ceed"].vehicle.m
    assert rows["vw-passat"]["steer_delay_s"] is None
    for columns in ("80", "40"):
        monkeypatch.setenv("COLUMNS", columns)
        printed = cli("vehicles").out
        assert all(name in printed for name in (*VEHICLES, *fleet(), "wheel-", "steer", "torque", "(m/s)"))
        assert "…" not in printed
        assert max(map(len, printed.splitlines())) <= 80


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
