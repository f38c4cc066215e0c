"""What the live page shows is what stands in the run's directory."""

from __future__ import annotations

import json
import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import degrees_of
from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.live import snapshot
from steerkit.learning.live.snapshot import GRID, Reader
from steerkit.learning.settings import BANG_BANG, changed
from steerkit.scenario import Scenario
from steerkit.task import TRIP
from tests.support.short_run import SHORT


def test_the_numbers_are_those_of_the_run(kept: Path) -> None:
    told, run, log = Reader(kept).read(), rundir.load(kept), rundir.drive_log(kept)
    json.dumps(told, allow_nan=False)
    assert told["name"] == "default on paper, seed 3"
    assert told["t"] == pytest.approx(run.t, abs=0.051)
    counts = run.counts
    assert (told["failures"], told["rounds"], told["updates"]) == (counts.failures, counts.rounds, counts.updates)
    assert told["driven_km"] == counts.driven / 1000.0
    assert told["ends"] == {"minutes": 0.8, "rounds": 0, "episodes": 1000}
    assert told["written"] == (kept / "run.json").stat().st_mtime
    assert told["learner"] is None
    learns = log["supervisor.learning"] > 0.5
    e = log["path.e"][learns][-200:]
    assert told["curve"]["lately"] == pytest.approx(math.sqrt((e**2).mean()), abs=1e-5)
    assert told["curve"]["failed"] == [round(one.ended, 2) for one in counts.episodes if one.failed and one.ended]
    shaded = sum(ended - began for began, ended in told["curve"]["recovery"])
    assert shaded == pytest.approx(0.05 * (~learns).sum(), abs=0.1)
    last = (log.t > told["t"] - snapshot.WINDOW) & learns
    assert told["curve"]["rms"][-1] == pytest.approx(math.sqrt((log["path.e"][last] ** 2).mean()), rel=0.02)
    assert any(value is None for value in told["curve"]["rms"])  # while the recovery controller steers
    seen = told["map"]
    assert seen["car"] == [round(float(log[name][-1]), 2) for name in ("car.x", "car.y")]
    assert seen["learning"] == bool(learns[-1])
    for number, t in enumerate(told["curve"]["failed"]):
        k = int(np.searchsorted(log.t, t - 1e-6))
        assert seen["failed"][number] == [round(float(log[name][k]), 2) for name in ("car.x", "car.y")]
    assert len(seen["recovery"]) >= counts.failures
    path = run.experiment.scenario.path().samples.xy
    assert np.ptp(np.array(seen["path"]), axis=0) == pytest.approx(np.ptp(path, axis=0), rel=0.02)


def test_the_policys_map_shows_what_the_policy_in_the_loop_does(kept: Path) -> None:
    told = Reader(kept).read()["policy"]
    policy = rundir.load(kept).policy
    v, middle = told["v"], GRID // 2
    actions = np.array(told["action_deg"])
    assert actions.shape == (GRID, GRID)
    for row, column in ((middle, 0), (middle, GRID - 1), (0, middle), (GRID - 1, 3)):
        e, psi = told["e"][column], math.radians(told["psi_e_deg"][row])
        plain = replace(policy, forecast=None, preview_points=0)
        u = plain.U(e=e, e_dot=v * math.sin(psi), v=v, psi_e=psi, r_e=0.0, doe=0.0)
        assert actions[row, column] == pytest.approx(degrees_of(plain.output(1.0, (), u).action), abs=2.0)
    assert (told["e"][0], told["e"][-1]) == (-TRIP, TRIP)
    assert actions[middle, 0] > 0.0 > actions[middle, -1]  # left of the path it turns right, + is left
    assert told["largest_deg"] == pytest.approx(degrees_of(max(policy.actions)), abs=0.1)


def test_reading_on_is_the_same_as_reading_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    setting = changed(BANG_BANG, ["fit.epochs=2", "fit.nets=1", "fit.dead_time=0"])
    run = LearningRun(Experiment(setting=setting, scenario=Scenario(course="circle"), minutes=0.4))
    rundir.keep_in(run, tmp_path)
    reader, loaded = Reader(tmp_path), list[Path]()
    load: Callable[..., Any] = snapshot.Log.load
    told = reader.read()  # at the first moment there is nothing but a path and a net
    assert (told["t"], told["map"]["car"], told["map"]["learning"], told["curve"]["lately"]) == (0.0, None, None, None)
    json.dumps(told, allow_nan=False)
    monkeypatch.setattr(snapshot.Log, "load", lambda file: loaded.append(file) or load(file))  # type: ignore[func-returns-value]
    readings = 0
    while not run.done():
        before = run.counts.updates
        run.drive()
        if run.counts.updates > before:
            one, all_ = reader.read(), Reader(tmp_path).read()
            assert one == all_
            readings += 1
    assert readings > 2
    numbers = [int(file.stem) for file in loaded]
    assert len(numbers) == readings + sum(range(2, readings + 2))  # the first reader took up one more each time
    assert one["policy"]["element"] == "plain"
    assert set(np.abs(one["policy"]["action_deg"]).ravel()) <= {one["policy"]["largest_deg"]}


def test_another_run_in_the_same_directory_is_not_taken_for_the_old_one(kept: Path, tmp_path: Path) -> None:
    place = tmp_path / "run"
    shutil.copytree(kept, place)
    reader = Reader(place)
    before = reader.read()
    shutil.rmtree(place)
    with pytest.raises(ValueError, match="no run directory"):
        reader.read()
    learn(replace(SHORT, seed=4, minutes=0.3), place)
    after = reader.read()
    assert after == Reader(place).read() != before


def test_a_broken_run_is_refused_and_read_again_when_it_is_whole(kept: Path, tmp_path: Path) -> None:
    place = tmp_path / "run"
    shutil.copytree(kept, place)
    reader, last = Reader(place), max((place / "drive").glob("*.npz"))
    whole = last.read_bytes()
    for broken in (whole[: len(whole) // 2], b""):
        last.write_bytes(broken)
        with pytest.raises((ValueError, OSError)):
            reader.read()
    last.write_bytes(whole)
    assert reader.read()["t"] == pytest.approx(48.0, abs=0.1)


def test_a_car_that_is_put_back_does_not_drive_there(tmp_path: Path) -> None:
    """At the end of an open course it stands where it began again."""
    length = Scenario(course="straight").path().length
    run = LearningRun(replace(SHORT, scenario=Scenario(course="straight", start=length - 60.0)))
    rundir.keep_in(run, tmp_path)
    i, j = run.loop.locate("path.s")
    before = 0.0
    while run.y[i][j] > before - 5.0:
        before = run.y[i][j]
        run.drive()
    for _ in range(40):
        run.drive()
    rundir.save(run, tmp_path)
    seen = Reader(tmp_path).read()["map"]
    way = [np.array(part) for who in ("learner", "recovery") for part in seen[who] if len(part) > 1]
    assert max(np.hypot(*np.diff(part, axis=0).T).max() for part in way) < 5.0
    assert np.ptp(np.concatenate(way), axis=0).max() > 20.0
