"""The benchmarks' command line: `steerkit bench`, and the same as `python -m benchmarks`.

What is slow to load is imported by the command that needs it.
"""

import json
import math
import sys
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks import studies
from benchmarks.run.compare import compare as compared
from benchmarks.run.results import Results, load_results
from benchmarks.run.spread import WorkersDiedError
from steerkit._support.errors import in_one_line

app = typer.Typer(
    help="Learned against analytic steering controllers, in numbers. All drives are simulated.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
Machine = Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line.")]
EXTRA = ("joblib", "pandas", "jinja2", "distributed")
"""What the extra `bench` brings."""
LEADERBOARD = ("rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y", "max_jerk")
"""Metrics that are shown after a run."""
Place = Annotated[Path, typer.Argument(help="Directory of results, as `run` wrote it.")]


def _console() -> Any:
    return Console() if Console().is_terminal else Console(width=120)


def _require_extra(*modules: str) -> None:
    """Raise ValueError that says what to install, before hours of computing, if any of them is missing."""
    missing = [name for name in modules if find_spec(name) is None]
    if missing:
        said = f"{', '.join(missing)} {'is' if len(missing) == 1 else 'are'} not installed"
        raise ValueError(f"{said}: pip install 'steerkit-control[bench]'")


@app.command("list")
def list_(scenarios: Annotated[bool, typer.Option(help="Also every scenario and controller.")] = False) -> None:
    """List the suites, with how many cases each is."""
    from benchmarks.entries import CONTROLLERS
    from benchmarks.suites import SUITES, jobs, suite

    console = _console()
    table = Table("suite", "cases", "seeds", "scenarios", "controllers", "what")
    suites = [suite(name) for name in SUITES]
    for one in suites:
        sizes = (len(jobs([one])), one.seeds, len(one.scenarios), len(one.controllers))
        table.add_row(one.name, *map(str, sizes), one.about)
    console.print(table)
    if scenarios:
        names = dict.fromkeys(scene.name for one in suites for scene in one.scenarios)
        console.print(f"scenarios: {', '.join(names)}\n", markup=False)
        for controller in CONTROLLERS.values():
            console.print(f"{controller.name:22s} {controller.about}", markup=False, highlight=False)


@app.command()
def run(
    suites: Annotated[list[str], typer.Argument(metavar="SUITE...", help="Suites to run: see `list`.")],
    seeds: Annotated[int | None, typer.Option(min=1, help="Seeds 0 to N-1; default: the suite's own.")] = None,
    workers: Annotated[int, typer.Option("--jobs", "-j", help="Processes at once; -1: one a core.")] = -1,
    backend: Annotated[str, typer.Option(help="loky: processes here; dask: the workers of a cluster.")] = "loky",
    address: Annotated[str | None, typer.Option(help="Of the Dask scheduler, tcp://HOST:PORT.")] = None,
    out: Annotated[Path | None, typer.Option(help="Directory; unfinished results there are gone on with.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="Cases with this in scenario or controller.")] = None,
    controllers: Annotated[
        list[str] | None,
        typer.Option("--controller", help="Your own beside the suite's: my_file.py:make, package.module:make."),
    ] = None,
    course: Annotated[str, typer.Option(help="Name or CSV file, for scenarios that have no course of their own.")] = "",
    vehicle: Annotated[str, typer.Option(help="Name or vehicle file, for scenarios without a car of their own.")] = "",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")] = False,
    as_json: Machine = False,
) -> None:
    """Run suites; what has finished is kept at once, and the same command goes on after a stop."""
    _require_extra("joblib", *(["distributed"] if backend == "dask" else []))
    from benchmarks.run.runner import run as carry_out
    from benchmarks.suites import elsewhere, suite
    from steerkit.scenario import Scenario
    from steerkit.scenario.catalogue import make_controller

    chosen = [elsewhere(suite(name), course=course, vehicle=vehicle, controllers=controllers or ()) for name in suites]
    for name in controllers or ():
        make_controller(name, Scenario().design_model())  # what is wrong with it is said before anything is driven
    place = out or Path("runs") / "benchmarks" / "+".join(suites)
    try:
        results = carry_out(
            chosen, place, seeds=seeds, only=only or (), workers=workers, backend=backend, address=address, quiet=quiet
        )
    except KeyboardInterrupt:
        print(f"stopped; finished cases are in {place}, and the same command goes on", file=sys.stderr)
        raise SystemExit(130) from None
    except WorkersDiedError as error:
        raise ValueError(f"{error}; finished cases are kept, and the same command goes on") from error
    console = _console()
    _leaderboard(results)
    done = [case for case in results.cases if case.status == "done"]
    errors = [case for case in results.cases if case.status == "error"]
    for case in errors[:10]:
        console.print(f"error in {case.id}: {case.error}", markup=False, soft_wrap=True)
    absent = {case.controller: case.error for case in results.cases if case.status == "not installed"}
    for name, why in absent.items():
        console.print(f"{name}: {why}", markup=False, soft_wrap=True)
    console.print(f"{len(done)} cases in {place}; python -m benchmarks report {place}", soft_wrap=True, markup=False)
    if as_json:
        cpu = sum(case.cpu_seconds for case in results.cases if math.isfinite(case.cpu_seconds))
        print(
            json.dumps(
                {
                    "out": str(place),
                    "done": len(done),
                    "errors": len(errors),
                    "absent": sorted(absent),
                    "cpu_seconds": cpu,
                }
            )
        )
    if errors:
        raise SystemExit(1)


@app.command()
def report(
    place: Place,
    out: Annotated[Path | None, typer.Option(help="File to write; default: report.html in the results.")] = None,
) -> None:
    """Write the results as one self-contained HTML page."""
    _require_extra("jinja2")
    from benchmarks.report.page import write_report

    _console().print(f"written: {write_report(load_results(place), out or place / 'report.html')}", soft_wrap=True)


@app.command()
def verdict(place: Place, of: Annotated[str | None, typer.Option("--suite", help="Of one suite only.")] = None) -> None:
    """Say by which metrics learned beats analytic, by which it does not, and by how much."""
    from benchmarks.report.verdict import verdict as text

    print(text(load_results(place), suite=of))


@app.command()
def compare(
    a: Place,
    b: Place,
    rel: Annotated[float, typer.Option(min=0.0, help="Relative difference that is none.")] = 1e-9,
    absolute: Annotated[float, typer.Option("--abs", min=0.0, help="Difference that is none, in the unit.")] = 1e-12,
    most: Annotated[int, typer.Option(min=1, help="Rows to show.")] = 30,
    strict: Annotated[bool, typer.Option(help="Exit with 1 if anything differs.")] = False,
    as_json: Machine = False,
) -> None:
    """Compare two results case by case and say what changed; computing times are left out."""

    console = _console()
    comparison = compared(load_results(a), load_results(b), rel=rel, absolute=absolute)
    for key, (one, two) in comparison.provenance.items():
        console.print(f"{key}: {one} -> {two}", markup=False, soft_wrap=True, highlight=False)
    for label, names in (("only in A", comparison.only_a), ("only in B", comparison.only_b)):
        if names:
            console.print(f"{label}: {len(names)} cases: {', '.join(names[:5])}", markup=False, soft_wrap=True)
    for name, one, two in comparison.status[:most]:
        console.print(f"{name}: {one} -> {two}", markup=False, soft_wrap=True)
    if comparison.changes:
        console.print(
            _changes(comparison.changes[:most], f"{len(comparison.changes)} of {comparison.compared} numbers differ")
        )
    else:
        console.print(f"all {comparison.compared} numbers of the common cases are the same")
    if as_json:
        print(
            json.dumps(
                {
                    "same": comparison.same,
                    "compared": comparison.compared,
                    "changed": len(comparison.changes),
                    "only_a": len(comparison.only_a),
                    "only_b": len(comparison.only_b),
                }
            )
        )
    if strict and not comparison.same:
        raise SystemExit(1)


@app.command()
def golden(
    update: Annotated[bool, typer.Option(help="Make the new numbers the golden ones.")] = False,
    as_json: Machine = False,
) -> None:
    """Run the golden suite and print what differs from the numbers that the tests hold."""
    _require_extra("joblib")
    from benchmarks.run import golden as kept

    console, place = _console(), kept.file()
    try:
        old, tolerances = kept.kept(place)
    except ValueError:
        if not update:
            raise
        old, tolerances = {}, kept.TOLERANCES
    new = kept.numbers(kept.measured())
    changes = kept.difference(new, old, tolerances)
    if changes:
        console.print(_changes(changes, f"{len(changes)} numbers differ from the golden ones"))
    else:
        console.print(f"all {sum(map(len, old.values()))} golden numbers hold")
    if update:
        kept.update(new, place)
        console.print(f"written: {place}", soft_wrap=True)
    if as_json:
        print(json.dumps({"changed": [asdict(change) for change in changes], "updated": update}).replace("NaN", "null"))
    if changes and not update:
        raise SystemExit(1)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []})
def study(
    ctx: typer.Context,
    name: Annotated[str, typer.Argument(help="Study to carry out: see --list.")] = "",
    names: Annotated[bool, typer.Option("--list", help="Say what each study measures.")] = False,
) -> None:
    """Carry out a single measurement: study NAME, then --quick, --json or its options; study NAME --help lists them."""
    if names:
        width = max(map(len, studies.NAMES))
        for one in studies.NAMES:
            print(f"{one:{width}s}  {studies.about(one)}")
    elif name in ("", "--help"):
        print(ctx.get_help())
    else:
        studies.carry_out(name, ctx.args)


def _leaderboard(results: Results) -> None:
    """The leaderboards of the report, by fewer metrics."""
    from benchmarks.report import parts

    for name in parts.suites(results):
        cases = [case for case in results.cases if case.suite == name and case.kind == "drive"]
        columns, rows = parts.leaderboard(cases, LEADERBOARD)
        heads = [escape(f"{m.label} [{parts.unit(m)}]") for m in columns]
        table = Table("controller", "drives", "held", *heads, title=f"{name}: medians over the seeds")
        for row in rows:
            table.add_row(row.controller, *[cell.text for cell in row.cells])
        if rows:
            _console().print(table)


def _changes(changes: Any, title: str) -> Table:
    table = Table("case", "metric", "before", "after", "change", title=title)
    for change in changes:
        part = f"{change.relative:.1e}" if math.isfinite(change.relative) else "-"
        table.add_row(change.case, change.metric, f"{change.before:.9g}", f"{change.after:.9g}", part)
    return table


def main() -> None:
    """Run the command line; a mistake of the user's is one line on stderr and exit code 2."""
    try:
        app()
    except (ValueError, KeyError, OSError) as error:
        print(f"benchmarks: {in_one_line(error)}", file=sys.stderr)
        raise SystemExit(2) from None
