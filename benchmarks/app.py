"""The benchmarks' command line: `steerkit bench`, and the same as `python -m benchmarks`.

What is slow to load is imported by the command that needs it.
"""

import json
import math
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

import typer

from benchmarks import studies
from benchmarks.run.compare import Change
from benchmarks.run.compare import compare as compared
from benchmarks.run.results import Results, load_results
from benchmarks.run.spread import WorkersDiedError
from benchmarks.tables import show
from steerkit._support.console import console
from steerkit._support.errors import in_one_line

app = typer.Typer(
    help="Learned against analytic steering controllers, in numbers. All drives are simulated.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)
Machine = Annotated[bool, typer.Option("--json", help="Print one JSON object as the last line.")]
LEADERBOARD = ("rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y", "max_jerk")
"""Metrics that are shown after a run."""
Place = Annotated[Path, typer.Argument(help="Directory of results, as `run` wrote it.")]


def _say(text: str) -> None:
    """A line for people, as long as it is."""
    console.print(text, markup=False, soft_wrap=True, highlight=False)


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

    suites = [suite(name) for name in SUITES]
    columns = ("suite", "cases", "seeds", "scenarios", "controllers", "what")
    rows = [(s.name, len(jobs([s])), s.seeds, len(s.scenarios), len(s.controllers), s.about) for s in suites]
    show("", [dict(zip(columns, row)) for row in rows])
    if scenarios:
        names = dict.fromkeys(scene.name for one in suites for scene in one.scenarios)
        _say(f"scenarios: {', '.join(names)}\n")
        for controller in CONTROLLERS.values():
            _say(f"{controller.name:22s} {controller.about}")


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
    _leaderboard(results)
    done = [case for case in results.cases if case.status == "done"]
    errors = [case for case in results.cases if case.status == "error"]
    for case in errors[:10]:
        _say(f"error in {case.id}: {case.error}")
    absent = {case.controller: case.error for case in results.cases if case.status == "not installed"}
    for name, why in absent.items():
        _say(f"{name}: {why}")
    _say(f"{len(done)} cases in {place}; python -m benchmarks report {place}")
    if as_json:
        cpu = sum(case.cpu_seconds for case in results.cases if math.isfinite(case.cpu_seconds))
        told = {"out": str(place), "done": len(done), "errors": len(errors), "absent": sorted(absent)}
        print(json.dumps(told | {"cpu_seconds": cpu}))
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

    _say(f"written: {write_report(load_results(place), out or place / 'report.html')}")


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
    comparison = compared(load_results(a), load_results(b), rel=rel, absolute=absolute)
    for key, (one, two) in comparison.provenance.items():
        _say(f"{key}: {one} -> {two}")
    for label, names in (("only in A", comparison.only_a), ("only in B", comparison.only_b)):
        if names:
            _say(f"{label}: {len(names)} cases: {', '.join(names[:5])}")
    for name, one, two in comparison.status[:most]:
        _say(f"{name}: {one} -> {two}")
    if not comparison.changes:
        _say(f"all {comparison.compared} numbers of the common cases are the same")
    _show(comparison.changes[:most], f"{len(comparison.changes)} of {comparison.compared} numbers differ")
    if as_json:
        told = {"same": comparison.same, "compared": comparison.compared, "changed": len(comparison.changes)}
        print(json.dumps(told | {"only_a": len(comparison.only_a), "only_b": len(comparison.only_b)}))
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

    place = kept.FILE
    try:
        old, tolerances = kept.kept(place)
    except ValueError:
        if not update:
            raise
        old, tolerances = {}, kept.TOLERANCES
    new = kept.numbers(kept.measured())
    changes = kept.difference(new, old, tolerances)
    if not changes:
        _say(f"all {sum(map(len, old.values()))} golden numbers hold")
    _show(changes, f"{len(changes)} numbers differ from the golden ones")
    if update:
        kept.update(new, place)
        _say(f"written: {place}")
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
        heads = ("controller", "drives", "held", *[f"{m.label} [{parts.unit(m)}]" for m in columns])
        told = [(row.controller, *[cell.text for cell in row.cells]) for row in rows]
        show(f"{name}: medians over the seeds", [dict(zip(heads, row)) for row in told])


def _show(changes: Sequence[Change], title: str) -> None:
    """A table of numbers that have changed."""
    rows = []
    for change in changes:
        part = f"{change.relative:.1e}" if math.isfinite(change.relative) else "-"
        numbers = {"before": f"{change.before:.9g}", "after": f"{change.after:.9g}", "change": part}
        rows.append({"case": change.case, "metric": change.metric} | numbers)
    show(title, rows)


def main() -> None:
    """Run the command line; a mistake of the user's is one line on stderr and exit code 2."""
    try:
        app()
    except (ValueError, KeyError, OSError) as error:
        print(f"benchmarks: {in_one_line(error)}", file=sys.stderr)
        raise SystemExit(2) from None
