"""A learning run goes out as an ONNX model and as a Minari data set that its own environment can be recovered from."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.learning import rundir
from tests.support.short_run import published_on_a_circle


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return published_on_a_circle(tmp_path_factory.mktemp("run"))


def test_both_in_one_command(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    done = cli("export", run, "--onnx", tmp_path / "p.onnx", "--minari", "steerkit/circle-v0", "--json").json
    assert (tmp_path / "p.onnx").stat().st_size > 1000
    assert max(done["onnx"]["largest_difference"].values()) <= 1e-6
    transitions = rundir.load(run).transitions
    assert done["minari"]["steps"] == len(transitions) > 30
    assert done["minari"]["episodes"] >= len(np.unique(transitions.episode))


def test_an_agents_file_goes_out_as_onnx(tmp_path: Path, cli: Any) -> None:
    net = Network(layers=((np.full((1, 6), -0.3), np.zeros(1)),), head="clip")
    PolicyBlock(policy=net).save(tmp_path / "agent-0.npz")
    done = cli("export", tmp_path / "agent-0.npz", "--onnx", tmp_path / "p.onnx", "--json").json["onnx"]
    assert done["largest_difference"]["action"] <= 1e-12
    assert (tmp_path / "p.onnx").stat().st_size > 500


def test_what_onnx_cannot_hold_is_said_before_anything_else(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any
) -> None:
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
def test_a_model_that_says_something_else_is_no_success(
    gap: float, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any
) -> None:
    monkeypatch.setattr("steerkit.export.onnx.check_onnx", lambda *_, **__: {"action": 0.0, "q": gap})
    assert "its q differs from the policy's by" in cli("export", run, "--onnx", tmp_path / "p.onnx", code=2).err
    assert not (tmp_path / "p.onnx").exists()
