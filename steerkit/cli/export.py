"""The command `steerkit export`: what a learning run has made, for other programs."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer


def export(
    run: Annotated[Path, typer.Argument(help="Directory of a learning run.")],
    onnx: Annotated[Path | None, typer.Option(help="File for the final policy as an ONNX model.")] = None,
    single: Annotated[bool, typer.Option(help="The ONNX model in float32 instead of float64.")] = False,
    minari: Annotated[
        str | None, typer.Option(help="Name for the transitions as a Minari data set, such as steerkit/paper-v0.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line.")] = False,
) -> None:
    """Export a learning run: its final policy to ONNX, its transitions to a Minari data set."""
    from rich.console import Console

    if onnx is None and minari is None:
        raise ValueError("export: nothing to do; give --onnx FILE, --minari NAME, or both")
    console, done = Console(quiet=quiet, soft_wrap=True), {}
    if onnx is not None:
        done["onnx"] = _to_onnx(run, onnx, single)
        text = ", ".join(f"{name} {value:.2g}" for name, value in done["onnx"]["largest_difference"].items())
        console.print(f"policy: {onnx}; checked on {done['onnx']['states']} states, largest difference: {text}")
    if minari is not None:
        done["minari"] = _to_minari(run, minari)
        console.print("transitions: {name}, {episodes} episodes, {steps} steps".format(**done["minari"]))
    if as_json:
        print(json.dumps(done))


def _to_onnx(run: Path, file: Path, single: bool) -> dict[str, Any]:
    from steerkit.export.onnx import check_onnx, export_onnx
    from steerkit.learning import rundir

    policy = rundir.final_policy(run)
    export_onnx(policy, file, single=single)
    states = 10_000
    difference = check_onnx(policy, file, states=states)
    bound = 1e-4 if single else 1e-6
    if not difference["q"] <= bound:
        file.unlink()
        raise ValueError(f"{file}: its q differs from the policy's by {difference['q']:.2g}, expected <= {bound}")
    return {"file": str(file), "states": states, "largest_difference": difference}


def _to_minari(run: Path, name: str) -> dict[str, Any]:
    from steerkit.export.minari import to_minari
    from steerkit.gym.task import Task
    from steerkit.learning import rundir

    experiment = rundir.experiment_of(run)
    setting = experiment.setting
    task = Task(
        scenario=asdict(experiment.scenario), actions=setting.actions, doe=setting.doe, cost=rundir.plain(setting.cost)
    )
    data = to_minari(rundir.load(run).transitions, name, task, description=f"steerkit learn: {experiment}")
    return {"name": name, "episodes": int(data.total_episodes), "steps": int(data.total_steps)}
