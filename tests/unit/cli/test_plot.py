"""`steerkit plot`: a picture of a log's signals, and a table of all."""

from __future__ import annotations

from pathlib import Path

import pytest

from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from tests.support.command_lines import run
from tests.support.parts import Count


@pytest.fixture
def log(tmp_path: Path) -> Path:
    simulate(Loop(blocks={"car": Count()}, wires=[]), 1.0).save(tmp_path / "drive.npz")
    return tmp_path / "drive.npz"


def test_picture_and_table(log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("plot", str(log), "car.n", "--table", str(log.with_suffix(".csv")), monkeypatch=monkeypatch) == 0
    assert (log.parent / "drive-signals.png").read_bytes()[:4] == b"\x89PNG"
    head, *rows = log.with_suffix(".csv").read_text().splitlines()
    assert head == "t [s],car.n [m]"
    assert len(rows) == len(Log.load(log).t) == 20
    assert "drive-signals.png, table: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("path.e",), "no signal 'path.e' in the log; recorded: car.n"),
        (("--out", "a.gif"), "--out a.gif: expected a name that ends in .png, .svg, .pdf"),
        (("--table", "a.xlsx"), "--table a.xlsx: expected a name that ends in .csv or .parquet"),
    ],
)
def test_mistakes_are_one_line(
    words: tuple[str, ...], says: str, log: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("plot", str(log), *words, monkeypatch=monkeypatch) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert len(error.splitlines()) == 1
    assert [file.name for file in log.parent.iterdir()] == ["drive.npz"]
