"""One process at a time learns in a directory; whoever reads meanwhile sees a whole checkpoint."""

import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.rundir import held, holder
from steerkit.learning.settings import MODEL_FREE, changed
from steerkit.scenario import Scenario
from tests.support.places import ROOT

SHORT = Experiment(scenario=Scenario(course="circle"), minutes=0.1)
OWNER = """
import sys, time
from pathlib import Path
from steerkit.learning.rundir import held

with held(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(600.0)
"""


def test_a_second_learner_is_refused_and_told_which_process_it_is_until_that_is_killed(tmp_path: Path) -> None:
    words = [sys.executable, "-c", OWNER, str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, cwd=ROOT) as owner:
        try:
            assert owner.stdout is not None
            assert owner.stdout.readline() == "held\n"
            with pytest.raises(ValueError, match=rf"is being learned by process {owner.pid} \(.*\) since .*wait for"):
                learn(SHORT, tmp_path)
            assert not (tmp_path / "run.json").exists()
        finally:
            os.kill(owner.pid, signal.SIGKILL)
            owner.wait()
    assert holder(tmp_path).startswith(f"process {owner.pid}")  # what a kill leaves holds nobody up
    assert learn(SHORT, tmp_path).done()
    assert holder(tmp_path) == "another process"


def test_one_process_cannot_hold_a_directory_twice(tmp_path: Path) -> None:
    with held(tmp_path), pytest.raises(ValueError, match=rf"by process {os.getpid()} "), held(tmp_path):
        pass
    with held(tmp_path):
        assert not [file for file in tmp_path.iterdir() if file.name not in (rundir.LOCK, rundir.HOLDER)]


def test_reading_beside_a_learner_sees_whole_checkpoints_only(tmp_path: Path) -> None:
    """The learner writes a checkpoint in every other sample; a reader reads all the time."""
    setting = changed(MODEL_FREE, ["retrain_every_m=0.5", "fit_seconds=0.0"])
    setting = changed(setting, [f"fit.{name}={value}" for name, value in (("epochs", 1), ("nets", 1))])
    assert isinstance(setting.fit, FitSetting)
    run = LearningRun(Experiment(setting=setting, scenario=Scenario(course="circle"), minutes=0.06))
    rundir.keep_in(run, tmp_path)
    read: list[int] = []
    faults: list[BaseException] = []
    over = threading.Event()

    def reader() -> None:
        while not over.is_set() or not read:
            try:
                seen = rundir.load(tmp_path)
                rundir.final_policy(tmp_path, seen.counts.updates)
                log = rundir.drive_log(tmp_path, until=seen.t)
                assert len(log.t) == seen.counts.k // seen.ticks
                read.append(seen.counts.updates)
            except BaseException as fault:
                faults.append(fault)
                return

    thread = threading.Thread(target=reader)
    thread.start()
    while not run.done() or len(read) < 3:
        run.drive() if not run.done() else rundir.save(run, tmp_path)
        if faults:
            break
    over.set()
    thread.join()
    assert not faults, faults
    assert run.counts.updates > 10
    assert read == sorted(read)


def test_a_checkpoint_taken_away_while_it_is_read_is_no_fault(
    kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    run = rundir.resumed(tmp_path)
    whole = rundir._load
    tries: list[int] = []

    def overtaken(place: Path, data: dict[str, object]) -> LearningRun:
        tries.append(int(str(data["checkpoint"])))
        if len(tries) == 1:
            for _ in range(2):
                rundir.save(run, place)
        return whole(place, data)

    monkeypatch.setattr(rundir, "_load", overtaken)
    assert rundir.load(tmp_path).t == run.t
    assert tries == [tries[0], tries[0] + 2]
    (tmp_path / f"state-{tries[1]}.npz").unlink()
    with pytest.raises(ValueError, match=r"is not whole: state-\d+.npz is missing"):
        rundir.load(tmp_path)
