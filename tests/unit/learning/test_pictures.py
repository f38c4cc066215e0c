"""The diagnostics show what the run and the policy really are: pictures are read back and compared."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment
from steerkit.learning.learn import learn
from steerkit.learning.pictures import Record, draw_all, replay
from tests.support.short_run import FAST

pytestmark = pytest.mark.usefixtures("without_layout")  # many pictures are drawn


def course_of(figure: Any) -> Any:
    """The map in a figure."""
    return next(axis for axis in figure.axes if axis.get_xlabel() == "x [m]")


def test_a_record_is_what_the_run_was(record: Record, kept: Path) -> None:
    run = rundir.load(kept)
    assert record.name == "run: default on paper"
    assert list(record.episodes) == run.counts.episodes
    assert len(record.transitions) == len(run.transitions)
    assert len(record.failed_at) == run.counts.failures > 2
    e = np.abs(record.log["path.e"])
    assert (e[record.failed_at] > 0.5).all()  # the sample in which the wheel was taken
    assert (e[record.failed_at - 1] <= 0.5).all()
    with pytest.raises(ValueError, match="is no run directory"):
        Record.read(kept.parent)


def test_a_replay_shows_its_episode(record: Record) -> None:
    number = next(k for k, e in enumerate(record.episodes, start=1) if e.failed and e.began > 5.0)
    episode = record.episodes[number - 1]
    assert episode.ended is not None
    figure = replay(record, number)
    assert f"episode {number}, failed after {episode.ended - episode.began:.1f} s" in figure.get_suptitle()
    dots = max(len(c.get_offsets()) for c in course_of(figure).collections)
    assert dots == episode.samples + 1  # and the one it failed in
    assert abs(figure.axes[0].get_lines()[0].get_ydata()[-1]) > 0.5
    last = len(record.episodes)
    for bad in (0, last + 1):
        with pytest.raises(ValueError, match=f"episode {bad} of run.*, expected 1 to {last}"):
            replay(record, bad)
    replay(record, last)


@pytest.mark.usefixtures("undrawn")
def test_all_pictures_of_a_run_are_drawn(kept: Path, tmp_path: Path) -> None:
    learn(Experiment(setting=FAST, minutes=0.005), tmp_path / "new")
    assert draw_all(tmp_path / "new")[0].stem == "policy-map"  # it has just begun
    files = draw_all(kept, tmp_path / "out")
    names = [file.stem for file in files]
    assert names[0] == "policy-map"
    assert all(name.startswith("episode-") for name in names[1:])
    assert 2 <= len(names) <= 3
    assert all(file.read_bytes()[:4] == b"\x89PNG" for file in files)


def test_an_episode_that_ended_otherwise_is_no_failure(record: Record) -> None:
    """At the end of an open course, say: the car was carried back."""
    carried = replace(record, episodes=(replace(record.episodes[0], failed=False), *record.episodes[1:]))
    assert record.episodes[0].failed
    assert len(carried.failed_at) == len(record.failed_at) - 1
    np.testing.assert_array_equal(carried.failed_at, record.failed_at[1:])
