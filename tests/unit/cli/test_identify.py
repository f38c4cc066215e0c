"""`steerkit identify`."""

import json
from pathlib import Path
from typing import Any

import pytest
from scipy.io import savemat

from steerkit.diagram.units import degrees_of
from steerkit.vehicles import vehicle
from tests.support import command_lines
from tests.support.compilers import optimising
from tests.support.recorded_cars import BASE, driven, noisy


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    return command_lines.run("identify", *words, monkeypatch=monkeypatch)


def test_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("CC", optimising())
    columns = noisy(driven(), 0)
    savemat(
        tmp_path / "lap.mat",
        {"time_s": columns["t"], "angle": -degrees_of(columns["delta_sw"]), "v": columns["v"], "r": columns["r"]},
    )
    (tmp_path / "map.toml").write_text('[columns]\ndelta_sw = { column = "angle", unit = "deg", scale = -1 }\n')
    lap, out, picture = (str(tmp_path / name) for name in ("lap.mat", "car.toml", "fit.png"))
    words = (lap, "--map", str(tmp_path / "map.toml"), "--held-out", lap, "--name", "mine")
    assert run(monkeypatch, *words, "--out", out, "--plot", picture, "--json") == 0
    answer = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert answer["estimates"]["steer_ratio"]["low"] < 14.2 < answer["estimates"]["steer_ratio"]["high"]
    assert answer["held_out"]["rms"] == pytest.approx(answer["fit"]["rms"])
    assert vehicle(out).steer_ratio == answer["estimates"]["steer_ratio"]["value"]
    assert Path(picture).read_bytes()[:4] == b"\x89PNG"
    assert run(monkeypatch, lap, "--column", "delta_sw=angle:deg:-1", "-q", "--fix", "lag=0.09") == 0
    text = capsys.readouterr().out
    (tmp_path / "printed.toml").write_text(text)
    assert vehicle(str(tmp_path / "printed.toml")).m == BASE.m


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("no.csv",), "cannot be read"),
        (("genesis", "--out", "car.json"), "ends in .toml"),
        (("genesis", "--base", "pasat"), "did you mean 'vw-passat'"),
        (("genesis", "--fix", "lag"), "expected NAME=VALUE"),
        (("genesis", "--column", "v=speed"), "column for v 'speed' is not known"),
    ],
)
def test_mistakes_are_one_line(
    words: tuple[str, ...], says: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, *words) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert len(error.splitlines()) == 1


def test_the_car_that_is_given_is_the_one_that_was_described(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from steerkit import identification

    heard: list[Any] = []

    def stopped(drive: Any, car: Any, **options: Any) -> Any:
        heard.append((car, options["fixed"]))
        raise ValueError("enough was heard")

    monkeypatch.setattr(identification, "identify", stopped)
    assert run(monkeypatch, "genesis-rfs", "-q", "--wheelbase", "3.01", "--mass", "2100", "--fix", "lag=0.1") == 2
    assert run(monkeypatch, "genesis-rfs", "-q", "--wheelbase", "3.01") == 2
    assert run(monkeypatch, "genesis-rfs", "-q", "--base", "bmw-320i") == 2
    assert "enough was heard" in capsys.readouterr().err
    (both, held), (long, _), (named, _) = heard
    assert (both.wheelbase, both.m, held) == (pytest.approx(3.01), 2100.0, {"lag": 0.1})
    assert (long.wheelbase, long.m) == (pytest.approx(3.01), vehicle("vw-passat").m)
    assert named == vehicle("bmw-320i")
