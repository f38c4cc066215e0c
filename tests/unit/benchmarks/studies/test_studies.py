"""Studies are called in one way; each has a quick form, which runs as a process here and prints figures."""

from __future__ import annotations

import argparse
import json
import math
import re
import shlex
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from benchmarks import studies
from tests.support import programs
from tests.support.compilers import optimising
from tests.support.places import ROOT

KEYS = {
    "calibration": {
        *("delay_error_ms", "delay_yaw_error_ms", "delay_seconds", "offset_error_deg", "ratio_error_pct"),
        *("friction_error_pct", "play_error_pct", "coverage_pct"),
        *("adaptive_x_oracle", "adaptive_worst_x", "adaptive_x_unadapted_worst", "adaptive_max_e_m"),
    },
    "car_calibration": {"rows", "faults", "worst_e_m", "coverage_pct", "steer_ratio_error", "delay_lag_valid_pct"},
    "car_kill": {"kills", "controller", "server", "trainer"},
    "car_realtime": {"steps", "misses", "jitter_p99_ms", "rms_e_m", "frames_replayed_exactly", "recording_mb"},
    "gym_steps": {"conditions", "steps_per_cpu_second", "vector_steps_per_second", "x_sync_vector_env"},
    "learning": {"setting", "seeds", "good_share", "good_median", "final_rms_e_worst", "outcomes"},
    "mpc_solve": {
        *("ltv20_ms", "ltv20_p99_ms", "ltv40_ms", "nmpc20_ms", "nmpc40_ms", "ltv20_unsolved"),
        *("ltv20_raw_qp_ms", "nmpc20_raw_qp_ms", "ltv20_x_raw_qp", "nmpc20_x_raw_qp"),
    },
    "nfq_iteration": {
        "seconds",
        "seconds_torch",
        "vs_torch_rprop_x",
        "equal_work",
        "memory_x_data",
        "decision_numpy_us",
    },
    "safety": {
        *("departures", "runs", "good_median_s", "interventions_pct", "final_rms_x", "filter_p99_ms"),
        "adversary_max_e",
    },
    "throughput": {
        *("interpreted_x", "simulate_x", "compiled_c_x", "batch_x"),
        *("batch_linear_x", "steps_per_second", "base", "against", "largest_difference_m"),
        *("batch_car_steps_per_second", "batch_car_steps_per_second_x_one_function"),
    },
    "tune_stanley": {"predicted", "plain"},
    "vehicle_state": {
        *("rms_x", "wheel_x", "wheel_noise_x", "innovation_ok_pct", "nis_mean", "side_coverage_pct"),
        *(
            "wrong_belief_x",
            "wrong_belief_x_raw",
            "wrong_belief_innovation_ok_pct",
            "wrong_belief_nis_mean",
            "wrong_belief_max_e_m",
        ),
        *("outage_coverage_pct", "outage_said_pct", "jump_said_pct"),
    },
}
"""What each prints, at least."""
DRIVEN_FOR_LONG = ("throughput", "vehicle_state")
"""Studies whose loops drive for longer, in their quick forms, than it takes to optimise them."""


def called(*words: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return programs.python("-m", "benchmarks", "study", *words, folder=folder)


def test_the_list_says_what_each_measures_and_imports_none() -> None:
    code = "import sys; from benchmarks.app import main; sys.argv[1:] = ['study', '--list']\n"
    code += "try: main()\nfinally: print([n for n in sys.modules if n.startswith('benchmarks.studies.')])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    *lines, imported = done.stdout.splitlines()
    assert imported == "[]"
    assert {line.split()[0] for line in lines} == set(KEYS) == set(studies.NAMES)
    assert all(len(line.split()) > 5 and line.endswith((".", "?")) for line in lines)


@pytest.mark.parametrize("name", sorted(KEYS))
def test_the_quick_form_runs_as_a_process_and_prints_its_figures_last(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name in DRIVEN_FOR_LONG:
        monkeypatch.setenv("CC", optimising())
    if name == "gym_steps":
        pytest.importorskip("gymnasium")
    done = called(name, "--quick", "--json", folder=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    figures = json.loads(done.stdout.splitlines()[-1], parse_constant=lambda word: pytest.fail(f"{word} is no JSON"))
    assert figures.keys() >= KEYS[name]
    assert len(done.stdout.splitlines()) > 3, "tables for people come first"
    SENSIBLE[name](figures)
    assert list(tmp_path.iterdir()) == [], "a study leaves no files behind unless asked to"


def sensible_calibration(figures: Any) -> None:
    """Four drives of 20 s say little of how well it works, all of whether."""
    assert figures["drives"] == 4
    assert figures["table"]["delay + lag, wheel"]["median"] < 10.0
    assert figures["table"]["delay + lag, yaw rate"]["median"] < 30.0
    assert figures["coverage_pct"] > 70.0
    assert figures["adaptive_worst_x"] < 2.0  # one car, and not settled yet
    assert figures["adaptive_x_unadapted_worst"] < 1.0
    assert figures["adaptive_max_e_m"] < 0.5


def sensible_throughput(figures: Any) -> None:
    assert figures["largest_difference_m"] < 1e-11
    assert min(figures["steps_per_second"].values()) > 0.0
    assert set(figures["against"]) == {f"python-control, {n}" for n in ("same diagram", "one function")}


def sensible_cars(figures: Any) -> None:
    (row,) = figures["rows"]  # exact: a clock of its own
    assert row["driven"] == pytest.approx(600, abs=5)
    assert row["faults"] == []
    assert row["worst_e_m"] < 0.5
    assert figures["coverage_pct"] == 100.0
    assert figures["steer_ratio_error"]["worst"] < 2.0


def sensible_kills(figures: Any) -> None:
    assert figures["kills"] == 3
    assert all(figures[victim]["kills"] == 1 for victim in ("controller", "server", "trainer"))
    assert all(figures[victim]["ok_store"] == 1 for victim in ("controller", "server"))  # the rest is how fast


def sensible_drive(figures: Any) -> None:
    assert figures["frames_replayed_exactly"] == figures["frames_sent"] > 0
    assert figures["requests_replayed_exactly"] == figures["requests"]
    least = 60 - figures["misses"]  # a busy machine leaves steps out; one that stands still loses the car
    assert least <= figures["steps"] <= 60 or figures["lost"]


def sensible_rates(figures: Any) -> None:
    assert all(rate > 0.0 for rates in figures["steps_per_cpu_second"].values() for rate in rates.values())
    assert figures["x_sync_vector_env"] > 3.0


def sensible_safety(figures: Any) -> None:
    assert (figures["runs"], figures["departures"], figures["departures_without"]) == (1, 0, 1)
    assert 0.3 < figures["adversary_max_e"] < 0.5
    assert figures["filter_p99_ms"] is None or figures["filter_p99_ms"] > 0.0


def sensible_learning(figures: Any) -> None:
    assert (figures["seeds"], figures["minutes"], len(figures["outcomes"])) == (1, 0.5, 1)
    assert figures["outcomes"][0]["transitions"] > 100


def sensible_state(figures: Any) -> None:
    assert figures["outage_said_pct"] == figures["jump_said_pct"] == 100.0
    assert figures["outage_false_pct"] == 0.0
    assert 0.5 < figures["nis_mean"] < 1.5


SENSIBLE = {
    "calibration": sensible_calibration,
    "car_calibration": sensible_cars,
    "car_kill": sensible_kills,
    "car_realtime": sensible_drive,
    "gym_steps": sensible_rates,
    "learning": sensible_learning,
    "mpc_solve": lambda f: (
        (min(f["ltv20_x_raw_qp"], f["nmpc20_x_raw_qp"]) > 0.0 and f["ltv20_unsolved"] == 0) or pytest.fail(f)
    ),
    "nfq_iteration": lambda f: f["equal_work"] or pytest.fail(f),
    "safety": sensible_safety,
    "throughput": sensible_throughput,
    "tune_stanley": lambda f: 0.0 < f["predicted"]["chosen"]["rms_e_m"] < 0.1 or pytest.fail(f),
    "vehicle_state": sensible_state,
}


def module(**figures: Any) -> ModuleType:
    """A study that measures nothing."""
    made = ModuleType("benchmarks.studies.tune_stanley", "Says numbers.")
    made.add_options = lambda parser: parser.add_argument("--factor", type=float, default=1.0)  # type: ignore[attr-defined]
    made.measure = lambda options: {**figures, "quick": options.quick, "factor": options.factor}  # type: ignore[attr-defined]
    return made


def test_figures_are_strict_json(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    fake = module(e=[1.0, math.inf], rates={20: math.nan}, name="x", count=3)
    monkeypatch.setattr(studies, "import_module", lambda name: fake)
    figures = studies.carry_out("tune_stanley", ["--quick", "--factor", "2", "--json"])
    assert figures == {"e": [1.0, None], "rates": {"20": None}, "name": "x", "count": 3, "quick": True, "factor": 2.0}
    assert json.loads(capsys.readouterr().out) == figures
    studies.carry_out("tune_stanley")
    assert capsys.readouterr().out == ""


def test_figures_that_do_not_count_end_with_why(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fake = module()
    fake.objection = lambda figures: "too slow" if figures["factor"] > 1.0 else ""  # type: ignore[attr-defined]
    monkeypatch.setattr(studies, "import_module", lambda name: fake)
    studies.carry_out("tune_stanley")
    with pytest.raises(SystemExit, match="study tune_stanley: too slow"):
        studies.carry_out("tune_stanley", ["--factor", "2", "--json"])
    assert json.loads(capsys.readouterr().out)["factor"] == 2.0


def test_work_that_is_not_equal_does_not_count() -> None:
    study = import_module("benchmarks.studies.nfq_iteration")
    assert study.objection({"equal_work": True}) == ""
    assert "did not do equal work" in study.objection({"equal_work": False})


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (["trougput"], 2, "did you mean 'throughput'"),
        (["tune_stanley", "--fast"], 2, "unrecognized arguments: --fast"),
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


def test_what_several_studies_need_is_named_with_its_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    def measure(options: argparse.Namespace) -> dict[str, Any]:
        raise ModuleNotFoundError("No module named 'joblib'", name="joblib")

    study = SimpleNamespace(__doc__="None.", add_options=lambda parser: None, measure=measure)
    monkeypatch.setattr(studies, "import_module", lambda name: study)
    with pytest.raises(ValueError, match=r"study learning: joblib is not installed: pip install '.*\[bench\]'"):
        studies.carry_out("learning")
