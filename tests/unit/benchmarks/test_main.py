"""The benchmarks' command line."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from benchmarks.__main__ import app, main
from benchmarks.run.results import Results
from benchmarks.suites import SUITES
from tests.support.tiny_suite import TINY


def test_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reference: Results) -> None:
    monkeypatch.setitem(SUITES, "golden", TINY)
    monkeypatch.chdir(tmp_path)
    say = CliRunner().invoke
    listed = say(app, ["list", "--scenarios"]).output
    assert "robustness" in listed
    assert "nonlinear-mpc" in listed
    ran = say(app, ["run", "golden", "--jobs", "1", "--quiet", "--json", "--only", "textbook"])
    assert ran.exit_code == 0, ran.output
    told = json.loads(ran.output.splitlines()[-1])
    assert (told["out"], told["done"], told["errors"]) == ("runs/benchmarks/golden", 3, 0)
    compared = say(app, ["compare", str(reference.place), "runs/benchmarks/golden", "--json", "--strict"])
    assert compared.exit_code == 1
    assert json.loads(compared.output.splitlines()[-1]) == {
        "same": False,
        "compared": 72,
        "changed": 0,
        "only_a": 3,
        "only_b": 0,
    }
    assert "Nothing to compare" in say(app, ["verdict", str(reference.place)]).output


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "papr"], "did you mean 'paper'"),
        (["report", "nowhere"], "there are no such results"),
        (["compare", "a", "b"], "there are no such results"),
        (["run", "golden", "--only", "xyz"], "--only xyz: no scenario or controller"),
    ],
)
def test_mistakes_are_one_line(words, message, tmp_path, monkeypatch, capsys) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["benchmarks", *words])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    told = capsys.readouterr().err.strip()
    assert message in told
    assert "\n" not in told
