"""`steerkit identify`; its mistakes stand in test_app.py."""

from pathlib import Path
from typing import Any

import pytest
from scipy.io import savemat

from steerkit.diagram.units import degrees_of
from steerkit.vehicles import vehicle
from tests.support.compilers import optimising
from tests.support.recorded_cars import BASE, driven, noisy


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    monkeypatch.setenv("CC", optimising())
    columns = noisy(driven(seconds=60.0), 0)
    savemat(
        tmp_path / "lap.mat",
        {"time_s": columns["t"], "angle": -degrees_of(columns["delta_sw"]), "v": columns["v"], "r": columns["r"]},
    )
    (tmp_path / "map.toml").write_text('[columns]\ndelta_sw = { column = "angle", unit = "deg", scale = -1 }\n')
    lap, out, picture = (str(tmp_path / name) for name in ("lap.mat", "car.toml", "fit.png"))
    words = (lap, "--map", str(tmp_path / "map.toml"), "--held-out", lap, "--name", "mine")
    page = tmp_path / "page.html"
    answer = cli("identify", *words, "--out", out, "--plot", picture, "--report", str(page), "--json").json
    ahead = answer["ahead"]
    assert (ahead["seconds"], list(ahead["errors"])) == ([0.2, 0.5, 1.0, 2.0], ["v_x", "r", "longitudinal", "lateral"])
    lateral = ahead["errors"]["lateral"]
    assert lateral["model"][-1] < lateral["kinematics"][-1] < lateral["persistence"][-1]
    assert "v_y is not in the log" in ahead["note"]
    printed = page.read_text()
    row = next(line for line in printed.splitlines() if "lateral [m]" in line and "persistence" in line)
    assert all(f"{miss:.3f}" in row for miss in lateral["persistence"])
    for sentence in (ahead["note"], "ratio_wheelbase", "log and prior", "yaw rate of"):
        assert sentence in printed
    assert answer["estimates"]["steer_ratio"]["low"] < 14.2 < answer["estimates"]["steer_ratio"]["high"]
    assert answer["held_out"]["rms"] == pytest.approx(answer["fit"]["rms"])
    assert vehicle(out).steer_ratio == answer["estimates"]["steer_ratio"]["value"]
    assert Path(picture).read_bytes()[:4] == b"\x89PNG"
    text = cli("identify", lap, "--column", "delta_sw=angle:deg:-1", "-q", "--fix", "lag=0.09").out
    (tmp_path / "printed.toml").write_text(text)
    assert vehicle(str(tmp_path / "printed.toml")).m == BASE.m
    assert vehicle(str(tmp_path / "printed.toml")).name == "lap-car"


def test_the_car_that_is_given_is_the_one_that_was_described(monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    heard: list[Any] = []

    def stopped(drive: Any, car: Any, **options: Any) -> Any:
        heard.append((car, options["fixed"]))
        raise ValueError("enough was heard")

    monkeypatch.setattr("steerkit.identification.identify", stopped)
    scaled = ("--wheelbase", "3.01")
    for words in ((*scaled, "--mass", "2100", "--fix", "lag=0.1"), scaled, ("--base", "bmw-320i")):
        assert "enough was heard" in cli("identify", "genesis-rfs", "-q", *words, code=2).err
    (both, held), (long, _), (named, _) = heard
    assert (both.wheelbase, both.m, held) == (pytest.approx(3.01), 2100.0, {"lag": 0.1})
    assert (long.wheelbase, long.m) == (pytest.approx(3.01), vehicle("vw-passat").m)
    assert named == vehicle("bmw-320i")
