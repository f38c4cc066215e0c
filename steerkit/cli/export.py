"""The command `steerkit export`: learning runs and logs, for other programs."""

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from steerkit.cli.log import record_of
from steerkit.cli.options import written
from steerkit.controllers.network_policy import PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.logs.foxglove import LAYOUTS, to_mcap
from steerkit.logs.foxglove import layout as write_layout
from steerkit.logs.tables import write_mf4


def export(
    run: Annotated[Path, typer.Argument(help="A learning run's directory; AGENT.npz; any program's log.")],
    onnx: Annotated[Path | None, typer.Option(help="File for the final policy as an ONNX model.")] = None,
    minari: Annotated[
        str | None, typer.Option(help="Name for the transitions as a Minari data set, such as steerkit/paper-v0.")
    ] = None,
    mcap: Annotated[
        Path | None, typer.Option(help="A log, or a run's last drive, for Foxglove and PlotJuggler.")
    ] = None,
    csv: Annotated[Path | None, written("The same as a table", ".csv", ".parquet")] = None,
    mf4: Annotated[Path | None, written("The same as MDF 4", ".mf4")] = None,
    layout: Annotated[Path | None, written("The layout for it of Foxglove, or of PlotJuggler", *LAYOUTS)] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line.")] = False,
) -> None:
    """Export a learning run (policy to ONNX, transitions to Minari) or a log (MCAP, CSV, MF4)."""
    wanted = (onnx, minari, mcap, csv, mf4, layout)
    if all(one is None for one in wanted):
        raise ValueError(
            "export: nothing to do; give --onnx FILE or --minari NAME of a run, "
            "or --mcap, --csv, --mf4 or --layout FILE of a log"
        )
    console, done = Console(quiet=quiet, soft_wrap=True), dict[str, Any]()
    if onnx is not None:
        done["onnx"] = _to_onnx(run, onnx)
        text = ", ".join(f"{name} {value:.2g}" for name, value in done["onnx"]["largest_difference"].items())
        console.print(f"policy: {onnx}; checked on {done['onnx']['states']} states, largest difference: {text}")
    if minari is not None:
        done["minari"] = _to_minari(run, minari)
        console.print("transitions: {name}, {episodes} episodes, {steps} steps".format(**done["minari"]))
    writers: dict[str, Callable[[Log, Path], Any]] = {"mcap": to_mcap, "csv": Log.save, "mf4": write_mf4}
    if logs := {kind: file for kind, file in zip(writers, (mcap, csv, mf4)) if file is not None}:
        record = record_of(run)
        done |= {kind: writers[kind](record, file) or str(file) for kind, file in logs.items()}
        console.print(f"log: {', '.join(map(str, logs.values()))}")
    if layout is not None:
        console.print(f"layout for {write_layout(layout)}: {layout}")
    if as_json:
        print(json.dumps(done))


def _to_onnx(run: Path, file: Path) -> dict[str, Any]:
    from steerkit.export import onnx  # here, as the extra `export` may not be there

    policy = PolicyBlock.load(run) if run.suffix == ".npz" else rundir.final_policy(run)
    states, exact = 10_000, "q" if isinstance(policy, NfqPolicy) else "action"  # of equal q either action is as good
    onnx.export_onnx(policy, file)
    difference = onnx.check_onnx(policy, file, states=states)
    if not (worst := difference[exact]) <= 1e-6:
        file.unlink()
        raise ValueError(f"{file}: its {exact} differs from the policy's by {worst:.2g}, expected <= 1e-06")
    return {"file": str(file), "states": states, "largest_difference": difference}


def _to_minari(run: Path, name: str) -> dict[str, Any]:
    from steerkit.export.minari import to_minari  # here, as the extra `gym` may not be there
    from steerkit.gym.task import Task

    experiment = rundir.experiment_of(run)
    setting = experiment.setting
    task = Task(
        scenario=asdict(experiment.scenario), actions=setting.actions, doe=setting.doe, cost=rundir.plain(setting.cost)
    )
    data = to_minari(rundir.load(run).transitions, name, task, description=f"steerkit learn: {experiment}")
    return {"name": name, "episodes": int(data.total_episodes), "steps": int(data.total_steps)}
