"""`steerkit courses` and `steerkit vehicles`."""

from typing import Any

import pytest

from steerkit.paths.courses import names
from steerkit.vehicles import VEHICLES, fleet


def test_courses_as_a_table_and_as_json(cli: Any) -> None:
    rows = {row["course"]: row for row in cli("courses", "--json").json["courses"]}
    assert tuple(rows) == names()
    assert rows["circle"]["tightest_radius_m"] == pytest.approx(30.0)
    assert rows["straight"]["tightest_radius_m"] is None
    printed = cli("courses").out
    assert all(name in printed for name in (*names(), "30.0", "straight", "random-7", "FILE.xodr"))


def test_vehicles_as_a_table_and_as_json(monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    rows = {row["vehicle"]: row for row in cli("vehicles", "--json").json["vehicles"]}
    assert set(rows) == {*VEHICLES, *fleet()}
    assert (rows["kia-ceed"]["steer_delay_s"], rows["kia-ceed"]["interface"]) == (0.1, "torque")
    assert rows["kia-ceed"]["mass_kg"] == fleet()["kia-ceed"].vehicle.m
    assert rows["vw-passat"]["steer_delay_s"] is None
    printed = cli("vehicles", "RAV4").out
    assert "toyota-rav4-prime" in printed
    assert "kia" not in printed
    for columns in ("80", "40"):
        monkeypatch.setenv("COLUMNS", columns)
        printed = cli("vehicles").out
        assert all(name in printed for name in (*VEHICLES, *fleet(), "wheel-", "steer", "torque", "(m/s)"))
        assert "…" not in printed
        assert max(map(len, printed.splitlines())) <= 80
