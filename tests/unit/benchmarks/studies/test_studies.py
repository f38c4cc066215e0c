"""Studies are called in one way; each has a quick form, which runs as a process here and prints figures."""

import argparse
import json
import math
import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks import studies
from benchmarks.studies import nfq_iteration
from tests.support import programs
from tests.support.compilers import optimising
from tests.support.places import ROOT

KEPT = {"foreign": "drives.jsonl", "safety": "learners.jsonl"}
"""Asked to leave a file."""
SHORTER = {
    "car_kill": ("--victims", "controller,server,trainer,proving.controller"),  # the other one takes 10 s more
    "from_logs": ("--seconds", "60"),
    "learning": ("--course", "circle"),  # each net is test-driven over a whole round, which takes longer than to learn
    "production_cars": ("--ports", "TESLA_MODEL_3"),  # others: tests/unit/car/production
}


def called(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return programs.python("-m", "benchmarks", "study", *words, folder=folder)


def test_the_list_says_what_each_measures_and_imports_none() -> None:
    code = "import sys; from benchmarks.app import main; sys.argv[1:] = ['study', '--list']\n"
    code += "try: main()\nfinally: print([n for n in sys.modules if n.startswith('benchmarks.studies.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    *lines, imported = done.stdout.splitlines()
    assert imported == "[]"
    assert {line.split()[0] for line in lines} == set(studies.NAMES)
    assert all(len(line.split()) > 5 and line.endswith((".", "?")) for line in lines)


@pytest.mark.parametrize("name", studies.NAMES)
def test_the_quick_form_runs_as_a_process_and_prints_its_figures_last(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "throughput":  # its loops drive for longer, in the quick form, than it takes to optimise them
        monkeypatch.setenv("CC", optimising())
    if name == "gym_steps":
        pytest.importorskip("gymnasium")
    keep = ["--keep", KEPT[name]] if name in KEPT else []
    done = called(name, "--quick", "--json", *keep, *SHORTER.get(name, ()), folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout.splitlines()[-1], parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert len(done.stdout.splitlines()) > 3, "tables for people come first"
    sensible(name, figures)
    assert [file.name for file in tmp_path.iterdir()] == keep[1:], "a study leaves no files behind unless asked to"


def sensible(name: str, f: Any) -> None:
    """Short forms say little of how well something works, all of whether."""
    match name:
        case "throughput":
            assert f["largest_difference_m"] < 1e-11
            assert min(f["steps_per_second"].values()) > 0.0
            assert set(f["against"]) == {f"python-control, {n}" for n in ("same diagram", "one function")}
        case "car_kill":
            victims = ("controller", "server", "trainer", "proving.controller")
            assert f["kills"] == 4
            assert all(f[victim]["kills"] == 1 for victim in victims)
            assert f["proving.controller"]["worst_silent_after_ms"] <= 150.0
            assert f["proving.controller"]["ok_let_go"] == f["proving.controller"]["ok_run"] == 1
            assert f["controller"]["ok_store"] == f["server"]["ok_store"] == 1  # the rest is how fast
        case "car_realtime":
            assert f["frames_replayed_exactly"] == f["frames_sent"] > 0
            assert f["requests_replayed_exactly"] == f["requests"]
            # a busy machine leaves steps out; one that stands still loses the car
            assert 60 - f["misses"] <= f["steps"] <= 60 or f["lost"]
        case "foreign":
            (row,) = f["rows"]
            assert (row["controller"], row["car"], row["told"]) == ("auto", "torque", "1")
            assert len(f["drives"]) == f["recovery_drives"] == 1
            assert f["recovery_lost"] == 0
            assert 0.01 < f["recovery_max_e"] < 3.0
            assert 1.0 <= f["adaptive_spread"] < 2.0
            (run,), (change,) = f["learner_runs"], f["changes_rows"]
            assert (f["learners"], run["car"], run["nets"] > 0) == (1, "torque", True)
            assert (change["car"], change["change"], change["best"]) == ("passat", "tyres", "lqr")
            assert f["codes"] == 1
        case "from_logs":
            (log,) = f["logs"]
            assert (f["good"], f["refused"]) == (log["good"], 0)  # after one update it is good on some processors only
            assert 0.001 < log["rms_e"] < 0.5
        case "gym_steps":
            assert min(f["steps_per_cpu_second"].values()) > 0.0
            assert f["x_sync_vector_env"] > 3.0
        case "production_cars":
            assert f["ports"] == f["drives"] == f["drives_held"] == 1
            assert f["honest_rejected"] == f["altered_passed"] == f["departures"] == 0
            assert 0.0 < f["attacked_max_e"] < 0.5
            assert f["frames"] > 1500
            assert f["altered"] > 50
            assert f["update_ms"] > 0.0
        case "safety":
            assert (f["runs"], f["departures"], f["departures_without"]) == (1, 0, 1)
            assert 0.3 < f["adversary_max_e"] < 0.5
            assert 0.3 < f["beyond"][0]["found"] == f["beyond_max_e"] < 0.5
            assert f["filter_p99_ms"] is None or f["filter_p99_ms"] > 0.0
        case "learning":
            assert (f["seeds"], f["minutes"], len(f["outcomes"])) == (1, 0.25, 1)
            assert f["outcomes"][0]["transitions"] > 100
        case "mpc_solve":
            assert min(f["ltv20_x_raw_qp"], f["nmpc20_x_raw_qp"]) > 0.0
            assert f["ltv20_unsolved"] == 0
        case "nfq_iteration":
            assert f["equal_work"]
        case _:
            pytest.fail(f"{name}: nobody looks at its figures")


def replaced(monkeypatch: pytest.MonkeyPatch, measure: Any, **more: Any) -> None:
    """Every study is one that measures this."""
    add_options = lambda parser: parser.add_argument("--factor", type=float, default=1.0)  # noqa: E731
    made = SimpleNamespace(__doc__="Says numbers.", add_options=add_options, measure=measure, **more)
    monkeypatch.setattr(studies, "import_module", lambda name: made)


def test_figures_are_strict_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    found: Any = {"e": [1.0, math.inf], "rates": {20: math.nan}, "name": "x", "count": 3}
    replaced(monkeypatch, lambda options: found | {"quick": options.quick, "factor": options.factor})
    figures = studies.carry_out("throughput", ["--quick", "--factor", "2", "--json"])
    assert figures == {"e": [1.0, None], "rates": {"20": None}, "name": "x", "count": 3, "quick": True, "factor": 2.0}
    assert json.loads(capsys.readouterr().out) == figures
    studies.carry_out("throughput")
    assert capsys.readouterr().out == ""


def test_figures_that_do_not_count_end_with_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    replaced(monkeypatch, lambda options: {"equal_work": False}, objection=nfq_iteration.objection)
    assert nfq_iteration.objection({"equal_work": True}) == ""
    with pytest.raises(SystemExit, match="study throughput: the engines did not do equal work"):
        studies.carry_out("throughput", ["--json"])
    assert json.loads(capsys.readouterr().out)["equal_work"] is False


def test_what_several_studies_need_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def measure(options: argparse.Namespace) -> None:
        raise ModuleNotFoundError("No module named 'joblib'", name="joblib")

    replaced(monkeypatch, measure)
    with pytest.raises(ValueError, match=r"study learning: joblib is not installed: pip install '.*\[bench\]'"):
        studies.carry_out("learning")


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["trougput"], 2, "did you mean 'throughput'"),
        (["throughput", "--fast"], 2, "unrecognized arguments: --fast"),
        (["learning", "--setting", "defaul"], 2, "invalid choice: 'defaul'"),
    ],
)
def test_mistakes(words: list[str], code: int, message: str, tmp_path: Path) -> None:
    done = called(*words, folder=tmp_path)
    assert done.returncode == code
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_every_study_that_the_documentation_calls_knows_its_options() -> None:
    """In README, docs and docstrings: `python -m benchmarks study NAME ...` parses."""
    pages = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    lines = [(page, text) for page in pages for text in page.read_text(encoding="utf-8").splitlines()]
    calls = [(page, *re.findall(r"python -m benchmarks study ([^`#|)]*)", text)) for page, text in lines]
    found = [(page, shlex.split(call)) for page, *inside in calls for call in inside]
    assert len(found) > 15
    for page, (name, *words) in found:
        if name == "NAME" or "--list" in [name, *words]:
            continue
        parser = studies.parser_of(name, import_module(f"benchmarks.studies.{name}"))
        words = [word for word in words if word not in ("...", "and", "so", "on")]
        options = parser.parse_args([word.replace("[", "").replace("]", "").rstrip(",;:") for word in words])
        assert isinstance(options, argparse.Namespace), page
