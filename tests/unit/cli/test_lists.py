"""`steerkit courses` and `steerkit vehicles`."""

from __future__ import annotations

import json

import pytest

from steerkit.diagram.units import radians_of
from steerkit.paths.courses import names
from steerkit.vehicles import VEHICLES, fleet
from tests.support.command_lines import run


def test_courses_and_car_check_as_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("courses", "--json", monkeypatch=monkeypatch) == 0
    rows = {row["course"]: row for row in json.loads(capsys.readouterr().out)["courses"]}
    assert tuple(rows) == names()
    assert rows["circle"]["tightest_radius_m"] == pytest.approx(30.0)
    assert rows["straight"]["tightest_radius_m"] is None
    assert run("car", "check", "--json", monkeypatch=monkeypatch) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["vehicle"] == "vw-passat"
    assert facts["limits"]["rate_max"] == pytest.approx(radians_of(550.0))
    assert facts["read"]["v_kit"] == {"unit": "m/s", "signal": "VEH_VEL", "gain": pytest.approx(1 / 3.6), "offset": 0.0}


def test_vehicles_as_a_table_and_as_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("vehicles", "--json", monkeypatch=monkeypatch) == 0
    rows = {row["vehicle"]: row for row in json.loads(capsys.readouterr().out)["vehicles"]}
    assert set(rows) == {*VEHICLES, *fleet()}
    assert (rows["kia-ceed"]["steer_delay_s"], rows["kia-ceed"]["interface"]) == (0.1, "torque")
    assert rows["kia-ceed"]["mass_kg"] == fleet()["kia-ceed"].vehicle.m
    assert rows["vw-passat"]["steer_delay_s"] is None
    assert run("vehicles", "RAV4", monkeypatch=monkeypatch) == 0
    printed = capsys.readouterr().out
    assert "toyota-rav4-prime" in printed
    assert "kia" not in printed
    for columns in ("80", "40"):
        monkeypatch.setenv("COLUMNS", columns)
        assert run("vehicles", monkeypatch=monkeypatch) == 0
        printed = capsys.readouterr().out
        assert max(map(len, (*VEHICLES, *fleet()))) > 30
        assert all(name in printed for name in (*VEHICLES, *fleet(), "wheel-", "steer", "torque", "(m/s)"))
        assert "…" not in printed
        assert max(map(len, printed.splitlines())) <= 80
    assert run("vehicles", "trabant", monkeypatch=monkeypatch) == 2
    assert "no name has 'trabant' in it" in capsys.readouterr().err
