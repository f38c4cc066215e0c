"""`steerkit log`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from steerkit.logs import read_drive
from tests.support import command_lines
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
