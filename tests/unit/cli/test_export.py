"""A learning run goes out as an ONNX model and as a Minari data set that its own environment can be recovered from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from steerkit.learning import rundir
from tests.support import command_lines
from tests.support.short_run import published_on_a_circle


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return published_on_a_circle(tmp_path_factory.mktemp("run"))


@pytest.fixture(autouse=True)
def sets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    return tmp_path / "sets"


def command(*words: str, monkeypatch: pytest.MonkeyPatch) -> int:
    return command_lines.run("export", *words, monkeypatch=monkeypatch)


def test_both_in_one_command(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = (str(run), "--onnx", str(tmp_path / "p.onnx"), "--minari", "steerkit/circle-v0", "--json")
    assert command(*words, monkeypatch=monkeypatch) == 0
    done = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert (tmp_path / "p.onnx").stat().st_size > 1000
    assert max(done["onnx"]["largest_difference"].values()) <= 1e-6
    transitions = rundir.load(run).transitions
    assert done["minari"]["steps"] == len(transitions) > 50
    assert done["minari"]["episodes"] >= len(np.unique(transitions.episode))


def test_mistakes_are_named(run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert command(str(run), monkeypatch=monkeypatch) == 2
    assert "give --onnx FILE or --minari NAME of a run" in capsys.readouterr().err
    assert command("/", "--onnx", "p.onnx", monkeypatch=monkeypatch) == 2
    assert "no run directory" in capsys.readouterr().err


@pytest.mark.parametrize("gap", [1e-3, float("nan")])
def test_a_model_that_says_something_else_is_no_success(
    gap: float, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("steerkit.cli.export.check_onnx", lambda *_, **__: {"action": 0.0, "q": gap})
    assert command(str(run), "--onnx", str(tmp_path / "p.onnx"), monkeypatch=monkeypatch) == 2
    assert "its q differs from the policy's by" in capsys.readouterr().err
    assert not (tmp_path / "p.onnx").exists()
