"""What cannot go out as an ONNX model is said; what can, pages for users show."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from steerkit.learning import rundir
from tests.support.short_run import published_on_a_circle


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return published_on_a_circle(tmp_path_factory.mktemp("run"))


def test_what_onnx_cannot_hold_is_said(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    """Of a policy as the default setting learns it; whether or not onnx is installed."""
    policy = replace(rundir.final_policy(run), continuous=True)
    monkeypatch.setattr(rundir, "final_policy", lambda _: policy)
    monkeypatch.setitem(sys.modules, "onnx", None)
    said = cli("export", run, "--csv", tmp_path / "drive.csv", "--onnx", tmp_path / "p.onnx", code=2).err
    assert "learn with --setting model-free or --with fit.dead_time=0 --with continuous=false" in said
    assert not [*tmp_path.iterdir()]
    monkeypatch.setattr(rundir, "final_policy", lambda _: replace(policy, continuous=False))
    assert "needs onnx: pip install 'steerkit-control[export]'" in cli("export", run, "--onnx", "p.onnx", code=2).err


@pytest.mark.parametrize("gap", [1e-3, float("nan")])
def test_a_wrong_model_fails(gap: float, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    monkeypatch.setattr("steerkit.export.onnx.check_onnx", lambda *_, **__: {"action": 0.0, "q": gap})
    assert "its q differs from the policy's by" in cli("export", run, "--onnx", tmp_path / "p.onnx", code=2).err
    assert not (tmp_path / "p.onnx").exists()
