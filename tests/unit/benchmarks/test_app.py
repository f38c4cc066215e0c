"""The benchmarks' command line."""

import importlib.util
import json
import sys
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from benchmarks.app import app, main
from benchmarks.run import golden
from benchmarks.run.results import Results
from benchmarks.suites import SUITES
from tests.support.tiny_suite import TINY


def test_command_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, reference: Results) -> None:
    monkeypatch.setitem(SUITES, "golden", lambda: TINY)
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
        (["report", "nowhere"], "there are no such results"),
        (["compare", "a", "b"], "there are no such results"),
        (["run", "golden", "--only", "xyz"], "--only xyz: no scenario or controller"),
        (["run", "trackin"], "did you mean 'tracking'"),
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


def test_the_same_commands_under_steerkit_bench() -> None:
    from steerkit.cli import app as cli

    assert "learning-curve" in CliRunner().invoke(cli.app, ["bench", "list"]).output
    mine: Any = typer.main.get_command(app)
    assert mine.commands.keys() == cli.loaded("bench").commands.keys()


@pytest.mark.parametrize(
    ("words", "missing", "said"),
    [
        (["run", "golden"], {"joblib"}, "joblib is not installed"),
        (["golden"], {"joblib"}, "joblib is not installed"),
        (["report", "x"], {"jinja2"}, "jinja2 is not installed"),
        (
            ["run", "golden", "--backend", "dask", "--address", "tcp://x:1"],
            {"joblib", "distributed"},
            "joblib, distributed are not installed",
        ),
    ],
)
def test_without_the_extra_it_says_what_to_install(words, missing, said, tmp_path, monkeypatch, capsys) -> None:
    there = importlib.util.find_spec
    monkeypatch.setattr("benchmarks.app.find_spec", lambda name: None if name in missing else there(name))
    monkeypatch.setattr(sys, "argv", ["benchmarks", *words])
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 2
    assert capsys.readouterr().err == f"benchmarks: {said}: pip install 'steerkit-control[bench]'\n"
    assert list(tmp_path.iterdir()) == []


def test_golden_numbers_that_are_not_there_are_told(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"x\.json is missing, .*; `python -m benchmarks golden --update` makes it"):
        golden.kept(tmp_path / "x.json")


@pytest.mark.parametrize(("factor", "words", "code"), [(1.0, [], 0), (2.0, [], 1), (2.0, ["--update"], 0)])
def test_golden_numbers_that_moved_end_with_1_unless_they_are_renewed(
    factor: float, words: list[str], code: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    golden.update({"a": {"rms_e": 1.0}}, tmp_path / "golden.json")
    monkeypatch.setattr(golden, "FILE", tmp_path / "golden.json")
    monkeypatch.setattr(golden, "measured", lambda: None)
    monkeypatch.setattr(golden, "numbers", lambda results: {"a": {"rms_e": factor}})
    ended = CliRunner().invoke(app, ["golden", "--json", *words])
    assert ended.exit_code == code, ended.output
    told = json.loads(ended.output.splitlines()[-1])
    assert (len(told["changed"]), told["updated"]) == (int(factor != 1.0), bool(words))
    kept = golden.kept(tmp_path / "golden.json")[0]["a"]["rms_e"]
    assert kept == (factor if words else 1.0)
