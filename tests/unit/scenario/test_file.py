"""Scenarios in TOML files, and the tables of old runs."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path as FilePath
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.scenario import Scenario
from steerkit.scenario.file import of_table, read_scenario, write_scenario
from steerkit.vehicles import vehicle
from steerkit.vehicles.file import vehicle_text
from tests.support.yard import yard

HEAD = 'format = "steerkit scenario 1"\n'


def test_a_scenario_comes_back_with_its_files(tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "car.toml").write_text(vehicle_text(vehicle("bmw-320i")))
    scenario = Scenario(
        name='a "yard"\n',
        course=str(yard(tmp_path)),
        vehicle=str(tmp_path / "car.toml"),
        closed=False,
        believed_lag=0.2,
    )
    write_scenario(scenario, tmp_path / "scenario.toml")
    (tmp_path / "yard.csv").unlink()
    monkeypatch.chdir("/")
    assert read_scenario(tmp_path / "scenario.toml") == scenario


def test_every_character_comes_back(tmp_path: FilePath) -> None:
    scenario = Scenario(name="".join(map(chr, range(0x180))))
    write_scenario(scenario, tmp_path / "scenario.toml")
    assert read_scenario(tmp_path / "scenario.toml").name == scenario.name


@settings(max_examples=50)
@given(
    name=st.text(max_size=8).filter(lambda text: "--" not in text and text.isprintable()),
    lag=st.floats(0.0, 10.0),
    v_min=st.floats(0.2, 7.0),
    offset_deg=st.floats(-90.0, 90.0),
    gust=st.floats(0.0, 20.0),
    believed_delay=st.none() | st.floats(0.0, 2.0),
)
def test_every_number_comes_back_bit_for_bit(tmp_path_factory: pytest.TempPathFactory, **values: Any) -> None:
    scenario = Scenario(**values)
    file = tmp_path_factory.getbasetemp() / "scenario.toml"
    write_scenario(scenario, file)
    again = read_scenario(file)
    for field in fields(scenario):
        assert repr(getattr(again, field.name)) == repr(getattr(scenario, field.name))


def test_files_are_looked_for_beside_the_scenarios_own(tmp_path: FilePath) -> None:
    yard(tmp_path)
    (tmp_path / "s.toml").write_text(HEAD + 'course = "yard.csv"\nv_max = 9\n')
    assert read_scenario(tmp_path / "s.toml") == Scenario(course=str(tmp_path / "yard.csv"), v_max=9.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lag = 0.1\n", "s.toml: format = None, expected 'steerkit scenario 1'"),
        (HEAD + "lagg = 0.1\n", "s.toml: a scenario has no field 'lagg'; valid: name, course"),
        (HEAD + "lag = -0.1\n", r"s.toml: scenario 'scenario': lag = -0.1 \[s\], expected 0 to 10"),
        (HEAD + 'course = "no.csv"\n', "s.toml: scenario 'scenario': course .*no.csv cannot be read"),
        (HEAD + "lag = \n", "s.toml: not TOML"),
        (HEAD + "files = 3\n", r"s.toml: \[files\], expected"),
    ],
)
def test_mistakes_name_file_key_and_valid_keys(text: str, message: str, tmp_path: FilePath) -> None:
    (tmp_path / "s.toml").write_text(text)
    with pytest.raises(ValueError, match=message) as refused:
        read_scenario(tmp_path / "s.toml")
    assert "\n" not in str(refused.value)


def test_a_missing_file_is_named(tmp_path: FilePath) -> None:
    with pytest.raises(ValueError, match=r"none\.toml: cannot be read"):
        read_scenario(tmp_path / "none.toml")


def test_worlds_of_old_runs_are_read() -> None:
    old = {"kind": "World", "course": "genesis", "vehicle_name": "bmw-320i", "plant": "linear", "reference": "cg"}
    old |= {"lag": 0.15, "delay": 0.1, "rate_limit_deg": 500.0, "noise": True, "v_min": 5.0, "v_max": 6.0}
    assert of_table(old, "run.json") == Scenario(
        course="genesis",
        vehicle="bmw-320i",
        plant="linear",
        reference="cg",
        lag=0.15,
        delay=0.1,
        rate_limit_deg=500.0,
        noise=1.0,
        latency=0.05,
        v_min=5.0,
        v_max=6.0,
    )
    assert of_table({"kind": "World", "noise": False}, "run.json") == Scenario()
    with pytest.raises(ValueError, match=r"run.json: a scenario has no field 'colour'"):
        of_table({"kind": "World", "colour": "red"}, "run.json")
