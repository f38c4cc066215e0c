"""`steerkit log` and `steerkit plot`."""

import json
from pathlib import Path

import numpy as np
import pytest

from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from steerkit.logs import read_drive
from tests.support import command_lines
from tests.support.parts import Count
from tests.support.written_logs import driven, written


def run(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    return command_lines.run("log", *words, monkeypatch=monkeypatch)


def test_a_log_is_shown_drawn_and_written_as_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, _ = written("csv", tmp_path, driven())
    picture, table = tmp_path / "a.png", tmp_path / "drive-again.csv"
    assert run(monkeypatch, str(file), "--plot", str(picture), "--csv", str(table)) == 0
    printed = capsys.readouterr().out
    assert "a drive of 24.9 s at 20 Hz" in printed or "a drive of 25.0 s at 20 Hz" in printed
    assert f"next: steerkit identify {file} --out my-car.toml" in printed
    assert picture.read_bytes()[:4] == b"\x89PNG"
    np.testing.assert_allclose(read_drive(table).delta_sw, read_drive(file).delta_sw, rtol=1e-12)
    assert run(monkeypatch, str(file), "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    assert [row["quantity"] for row in answer["channels"]] == ["delta_sw", "v", "r"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("none.csv",), "cannot be read"),
        (("a.csv", "--plot", "a.txt"), "a picture ends in"),
        (("a.csv", "--csv", "a.txt"), "a table ends in .csv"),
        (("a.csv", "--csv", "b.csv"), "there is no drive in it: .*which column is delta_sw"),
    ],
)
def test_mistakes_are_one_line(
    words: tuple[str, ...],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    import re

    monkeypatch.chdir(tmp_path)
    Path("a.csv").write_text("t,v\n" + "".join(f"{k},1\n" for k in range(50)))
    assert run(monkeypatch, *words) == 2
    assert re.search(says, capsys.readouterr().err)


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    simulate(Loop(blocks={"car": Count()}, wires=[]), 1.0).save(tmp_path / "drive.npz")
    return tmp_path / "drive.npz"


def test_plot_draws_signals_and_writes_a_table(
    drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        command_lines.run(
            "plot", str(drive), "car.n", "--table", str(drive.with_suffix(".csv")), monkeypatch=monkeypatch
        )
        == 0
    )
    assert (drive.parent / "drive-signals.png").read_bytes()[:4] == b"\x89PNG"
    head, *rows = drive.with_suffix(".csv").read_text().splitlines()
    assert head == "t [s],car.n [m]"
    assert len(rows) == len(Log.load(drive).t) == 20
    assert "drive-signals.png, table: " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("path.e",), "no signal 'path.e' in the log; recorded: car.n"),
        (("--out", "a.gif"), "--out a.gif: expected a name that ends in .png, .pdf, .svg"),
        (("--table", "a.xlsx"), "--table a.xlsx: expected a name that ends in .csv or .parquet"),
    ],
)
def test_mistakes_in_plot_are_one_line(
    words: tuple[str, ...], says: str, drive: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert command_lines.run("plot", str(drive), *words, monkeypatch=monkeypatch) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert len(error.splitlines()) == 1
    assert [file.name for file in drive.parent.iterdir()] == ["drive.npz"]
