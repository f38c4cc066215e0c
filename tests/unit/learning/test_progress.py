"""What a person sees of a run while it learns."""

from __future__ import annotations

import io
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from steerkit.learning import progress, report, rundir
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.progress import HEIGHT, Picture, in_lines, spoken
from steerkit.scenario import Scenario
from tests.support.short_run import SHORT


def drawn(picture: Picture, width: int, encoding: str = "utf-8") -> list[str]:
    """The picture on a terminal of that width, line by line."""
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding)
    console = Console(width=width, force_terminal=True, no_color=True, file=stream, legacy_windows=False)
    with console.capture() as captured:
        console.print(picture.drawn(console))
    return [line.rstrip() for line in re.sub(r"\x1b\[[0-9;]*m", "", captured.get()).splitlines()]


@pytest.mark.parametrize(
    ("seconds", "words"),
    [(0.4, "0 s"), (41.2, "41 s"), (59.7, "1 min 0 s"), (130.0, "2 min 10 s"), (12000.0, "3 h 20 min")],
)
def test_times_are_told_in_words(seconds: float, words: str) -> None:
    assert spoken(seconds) == words


def test_the_picture_shows_what_the_run_has_counted_and_how_long_it_takes() -> None:
    now = [100.0]
    picture = Picture(SHORT, note="look there", clock=lambda: now[0])
    assert any("begins" in line for line in drawn(picture, 80))
    assert math.isnan(picture.to_go())
    told: list[str] = []

    def watch(what: str, run: LearningRun) -> None:
        told.append(what)
        picture.see(run)

    run = LearningRun(SHORT, watch)
    while run.t < 24.0:
        now[0] += 0.5 / 20.0  # two seconds of driving in one of computing
        run.drive()
    assert told.count("second") == 24
    counts = run.counts
    rms, share, failures = picture.curve.over([0.0, picture.curve.t])
    samples = sum(one.samples for one in counts.episodes)
    assert rms[0] == pytest.approx(math.sqrt(sum(one.sum_e2 for one in counts.episodes) / samples))
    assert 0.5 < share[0] < 1.0
    assert failures[0] == counts.failures > 0
    assert picture.to_go() == pytest.approx((48.0 - run.t) / 2.0, abs=1.0)
    for width in (60, 80, 200):
        lines = drawn(picture, width)
        assert max(map(len, lines)) <= min(width, 107)
        text = "\n".join(lines)
        assert f"failures {counts.failures}, rounds 0, nets trained {counts.updates}, transitions " in text
        assert "the learner steers, for " in text
        assert "0.4 of 0.8 min, 12 s to go" in text
        assert lines[-1] == "look there"
        steers = next(line for line in lines if line.startswith(" steers"))
        half = len(steers) / (min(width, 100) - 3)
        assert 0.45 < half < 0.6  # half of the minutes are driven
        assert "×" in steers
        assert "━" in steers
        plotted = [line[7:] for line in lines[1 : HEIGHT + 1]]
        assert any("⠀" < sign <= "⣿" for line in plotted for sign in line[: width // 2])
    drawn(picture, 80, "ascii")[0].encode("ascii")
    "\n".join(drawn(picture, 80, "ascii")[:10]).encode("ascii")


def test_the_time_to_go_is_taken_from_the_speed_of_late() -> None:
    now = [0.0]
    picture = Picture(replace(SHORT, minutes=20.0), clock=lambda: now[0])
    run = LearningRun(SHORT)
    for second in range(600, 1000):  # a run that goes on: first slowly, then two seconds of driving in one
        run.counts.k = second * run.ticks * 20
        now[0] += 3.0 if second < 700 else 0.5
        picture.see(run)
    assert run.t == 999.0
    assert picture.to_go() == pytest.approx(201.0 * 0.5, rel=0.01)


def test_a_recovery_that_lasts_is_shown_as_who_steers() -> None:
    picture = Picture(Experiment(scenario=Scenario(course="circle"), minutes=1.0))
    run = LearningRun(picture.experiment)
    while not run.counts.failures:
        run.drive()
    run.drive()
    picture.see(run)
    assert any("the recovery controller steers" in line for line in drawn(picture, 80))


def test_the_curve_of_a_run_that_goes_on_begins_at_its_beginning(kept: Path) -> None:
    before = report._before(kept)
    assert before is not None
    run = rundir.load(kept)
    samples = sum(one.samples for one in run.counts.episodes)
    rms, share, failures = before.over([0.0, before.t])
    assert before.t == pytest.approx(run.t, abs=0.051)
    assert rms[0] == pytest.approx(math.sqrt(sum(one.sum_e2 for one in run.counts.episodes) / samples))
    assert share[0] == pytest.approx(0.05 * samples / before.t)
    assert failures[0] == run.counts.failures
    picture = Picture(replace(run.experiment, minutes=1.6), before=before)
    steers = next(line for line in drawn(picture, 80) if line.startswith(" steers"))
    assert 35 <= len(steers) - 7 <= 36  # half of the minutes are driven
    longer = LearningRun(run.experiment)
    longer.learner_state.counts = run.counts
    picture.see(longer)
    assert picture.curve.t == pytest.approx(run.t)
    assert report._before(kept / "nowhere") is None


def test_a_curve_stands_at_its_height_on_the_scale() -> None:
    for value, row in ((1.0, 0), (5.0, 0), (0.1, 2), (0.01, 4), (0.001, 6), (1e-9, 6)):
        signs = progress._dots(np.full(6, value), ascii_only=False)
        assert [k for k, line in enumerate(signs) if any(sign > "⠀" for sign in line)] == [row]
    jump = progress._dots(np.array([0.001, 1.0]), ascii_only=False)
    assert [line != " " for line in jump] == HEIGHT * [True]  # joined by a line
    gap = progress._dots(np.array([0.001, np.nan, np.nan, 1.0]), ascii_only=True)
    assert gap == [" *", "  ", "  ", "--", "  ", "  ", "* "]
    assert progress._dots(np.full(4, np.nan), ascii_only=False)[3] == "┄┄"


def test_without_a_terminal_rounds_and_every_fifth_failure_are_a_line() -> None:
    said: list[str] = []
    run = LearningRun(Experiment(scenario=Scenario(course="circle"), minutes=1.0), in_lines(said.append))
    watch = run.watch
    assert watch is not None
    for failures in range(1, 11):
        run.counts.steered(float(failures), progress=0.0, e=0.1)
        run.counts.ended(failures + 0.5, failed=True)
        watch("failed", run)
    assert [line.split(",")[0] for line in said] == ["failed: episode 5", "failed: episode 10"]
    run.counts.steered(20.0, progress=0.0, e=0.1)
    for rounds, words in ((1, "first learned round: episode 11, "), (2, "round: episode 11, ")):
        run.counts.steered(20.0 + rounds, progress=100.0 * rounds, e=0.1, round_length=100.0)
        watch("round", run)
        assert said[-1].startswith(words)
    run.counts.stuck.append("it is stuck")
    for what in ("stuck", "second", "trained", "lost"):
        watch(what, run)
    assert said[-1] == "it is stuck"
    assert len(said) == 5
