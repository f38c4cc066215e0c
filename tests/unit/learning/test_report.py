"""What a person sees of a run while it learns."""

import io
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.report import Lately, in_lines, in_tensorboard, in_words, learn_with_progress, on_terminal
from steerkit.scenario import Scenario
from tests.support.short_run import SHORT


def test_the_figures_of_late_are_those_of_the_last_ten_seconds() -> None:
    lately, run = Lately(), LearningRun(SHORT)
    run.watch = lambda what, run: lately.see(run) if what == "second" else None
    while run.t < 30.0:
        run.drive()
    log = run.recorder.log()
    late = log.t > 20.0 - 0.01
    learns = late & (log["supervisor.learning"] > 0.5)
    rms, share = lately.figures()
    assert rms == pytest.approx(np.sqrt(np.mean(log["path.e"][learns] ** 2)))
    assert share == pytest.approx(learns.sum() / late.sum(), abs=0.006)
    who = "learner" if log["supervisor.learning"][-1] > 0.5 else "recovery"
    assert f"0.5 of 0.8 min: {who} steers, RMS e {rms:.3f} m; failures {run.counts.failures}, " in in_words(run, rms)
    run.counts.ended(run.t, failed=True)
    assert "recovery steers; failures" in in_words(run, math.nan)


def test_a_terminal_has_a_bar_with_words_and_what_is_stuck() -> None:
    stream = io.StringIO()
    console = Console(width=140, force_terminal=True, no_color=True, file=stream)
    with on_terminal(replace(SHORT, minutes=0.2), console) as watch:
        run = LearningRun(replace(SHORT, minutes=0.2), watch)
        while not run.done():
            run.drive()
        run.counts.stuck.append("it cannot hand over")
        watch("stuck", run)
        run.doubted = "all is late"
        watch("doubted", run)
    shown = stream.getvalue()
    assert "0.2 of 0.2 min: " in shown
    assert "it cannot hand over" in shown
    assert ": all is late" in shown


def scalars(place: Path) -> dict[str, list[tuple[int, float]]]:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    events = EventAccumulator(str(place))
    events.Reload()
    return {tag: [(one.step, one.value) for one in events.Scalars(tag)] for tag in events.Tags()["scalars"]}


def test_curves_are_event_files_and_a_run_that_goes_on_continues_them(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard")
    place = tmp_path / "run"
    for minutes in (0.3, 0.5):
        run = learn_with_progress(replace(SHORT, minutes=minutes), place, quiet=True, live=True)
    curves = scalars(place)
    assert [step for step, _ in curves["failures"]] == list(range(1, 31))
    assert curves["failures"][-1][1] == run.counts.failures > 0
    assert curves["transitions"][-1][1] == pytest.approx(len(run.transitions), abs=20)
    assert all(0.0 < value < 0.6 for _, value in curves["rms_e [m]"])
    assert max(value for _, value in curves["learner steers [share of the time]"]) <= 1.0 + 1e-6


def test_without_tensorboard_what_to_install_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    with pytest.raises(ValueError, match=r"learn --live needs tensorboard: pip install"):
        in_tensorboard(tmp_path).__enter__()


def test_without_a_terminal_rounds_and_every_fifth_failure_are_a_line() -> None:
    said: list[str] = []
    watch: Any = in_lines(said.append)
    run = LearningRun(Experiment(scenario=Scenario(course="circle"), minutes=1.0), watch)
    for failures in range(1, 11):
        run.counts.steered(float(failures), progress=0.0, e=0.1)
        run.counts.ended(failures + 0.5, failed=True)
        watch("failed", run)
    end = "recovery steers, RMS e 0.100 m; failures {}, rounds 0, trainings 0"
    assert said == [f"failed: 0.0 of 1 min: {end.format(failures)}" for failures in (5, 10)]
    run.counts.steered(20.0, progress=0.0, e=0.1)
    for rounds in (1, 2):
        run.counts.steered(20.0 + rounds, progress=100.0 * rounds, e=0.1, round_length=100.0)
        watch("round", run)
        assert said[-1].startswith("round: ")
        assert f"learner steers, RMS e 0.100 m; failures 10, rounds {rounds}, " in said[-1]
    run.counts.stuck.append("it is stuck")
    for what in ("stuck", "second", "trained", "lost"):
        watch(what, run)
    assert said[-1] == "it is stuck"
    assert len(said) == 5
    run.doubted = "all is late"
    watch("doubted", run)
    assert said[-1] == "safety filter, at 0.0 s: all is late"
