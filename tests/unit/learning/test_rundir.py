"""Run directories: going on, broken and foreign ones, an experiment's plain form; parts of one's own; one learner at a
time, and readers beside it."""

import json
import os
import shutil
import signal
import subprocess
import sys
import threading
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from steerkit._support.plugins import imported, mine, name_of
from steerkit.cli.drive import driven
from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.rundir import held, holder
from steerkit.learning.settings import MODEL_FREE, PAPER, SETTINGS, Setting, changed, setting
from steerkit.scenario import Scenario
from tests.support import own_parts
from tests.support.own_parts import Dear, Geared, Patient, Yard
from tests.support.places import ROOT
from tests.support.short_run import SHORT
from tests.support.stores import ARRAYS
from tests.support.yard import yard


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("steerkit run", "other"), "format 'other"),
        (('"pending"', '"pendimg"'), r"run\.json: damaged, without pending"),
        (('"ended"', '"en$ed"'), r"run\.json: damaged counts \(.*'en\$ed'"),
        (("", ""), "not whole"),
    ],
)
def test_broken_and_foreign_ones_are_named(change: tuple[str, str], why: str, kept: Path, tmp_path: Path) -> None:
    (tmp_path / "run.json").write_text((kept / "run.json").read_text().replace(*change))
    with pytest.raises(ValueError, match=why):
        rundir.load(tmp_path)


@pytest.mark.parametrize("name", SETTINGS)
def test_an_experiment_survives_its_plain_form(name: str) -> None:
    experiment = Experiment(setting=setting(name), scenario=Scenario.under("hard"), seed=5)
    data = json.loads(json.dumps(rundir.plain(experiment)))
    assert rundir.from_plain(data, "test") == experiment


CURT = replace(SHORT.setting, fit=FitSetting(epochs=3, mirror=True, nets=1), fit_seconds=0.5)
RUNS = {
    "carried back": Experiment(setting=replace(CURT, after_failure="reset", reset_seconds=5.0), minutes=0.5, seed=3),
    "corrected": Experiment(
        setting=replace(CURT, retrain_every_m=2.0, safe=True, corrected_seconds=1.0),
        scenario=Scenario.under("hard"),
        minutes=0.1,
        seed=3,
    ),
    "an open course": Experiment(
        setting=replace(CURT, retrain_every_m=4.0), scenario=Scenario(course="slalom"), minutes=0.15, seed=5
    ),
}


@pytest.mark.parametrize(
    ("name", "trusted"), [("carried back", {False}), ("corrected", {True}), ("an open course", {False, True})]
)
def test_a_run_resumed_at_any_checkpoint_is_the_run_that_went_on(name: str, trusted: set[bool], tmp_path: Path) -> None:
    """Checkpoints, each with a training under way, after a failure (nobody is trusted) and in the middle of driving."""
    experiment, place, copies = RUNS[name], tmp_path / "run", list[Path]()
    seen: set[tuple[bool, bool]] = set()
    run = LearningRun(experiment)
    place.mkdir()
    rundir.keep_in(run, place)
    write = run.keep
    assert write is not None

    def keep(run: LearningRun) -> None:
        write(run)
        what = (run.learner_state.before is not None, run.learner_state.trusted)
        if what not in seen:
            assert run.trainer.pending is not None
            seen.add(what)
            copies.append(Path(shutil.copytree(place, tmp_path / f"copy{len(copies)}")))

    run.keep = keep
    while not run.done():
        run.drive()
    assert any(before for before, _ in seen) is (experiment.setting.after_failure != "reset")  # half a transition
    assert {steers for _, steers in seen} == trusted
    for copy in copies:
        again = learn(experiment, copy)
        for rows in ARRAYS:
            np.testing.assert_array_equal(getattr(again.transitions, rows), getattr(run.transitions, rows))
        assert replace(again.counts, train_seconds=0.0) == replace(run.counts, train_seconds=0.0)
        assert again.x == run.x


def test_a_run_on_files_is_carried_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = yard(tmp_path)
    experiment = Experiment(scenario=Scenario(course=str(file)), minutes=0.05, seed=1)
    learn(experiment, tmp_path / "here" / "run")
    file.unlink()
    (tmp_path / "here").rename(tmp_path / "there")
    monkeypatch.chdir("/")
    run = rundir.load(tmp_path / "there" / "run")
    assert run.experiment == experiment
    assert run.path.length == experiment.scenario.path().length
    yard(tmp_path, radius=30.0)
    other = Experiment(scenario=Scenario(course=str(file)), minutes=0.05, seed=1)
    with pytest.raises(ValueError, match="a run of another experiment"):
        learn(other, tmp_path / "there" / "run")


# ---- parts of one's own

HOME = "tests.support.own_parts"


def test_own_place_setting_cost_and_element_are_kept_and_found_again(tmp_path: Path) -> None:
    patient = Patient(fit=FitSetting(epochs=20), cost=Dear(price=4.0), doe=f"{HOME}:Geared", name="mine")
    experiment = Experiment(scenario=Yard(radius=30.0), setting=patient, minutes=0.1)
    learn(experiment, tmp_path / "run")
    kept = json.loads((tmp_path / "run" / "run.json").read_text())["experiment"]
    assert (kept["scenario"]["kind"], kept["setting"]["kind"]) == (f"{HOME}:Yard", f"{HOME}:Patient")
    run = rundir.load(tmp_path / "run")
    assert run.experiment == experiment
    assert run.path.length == pytest.approx(2.0 * 3.14159 * 30.0, rel=1e-4)
    assert isinstance(run.loop.blocks["doe"], Geared)
    assert learn(experiment, tmp_path / "run").t == run.t  # it resumes
    (row,) = driven([str(tmp_path / "run")], experiment.scenario, tmp_path / "drive", rounds=0.1, seed=0, quiet=True)
    assert row["controller"] == str(tmp_path / "run")


def test_a_part_that_could_not_be_found_again_is_refused_before_the_first_second(tmp_path: Path) -> None:
    @dataclass(frozen=True, kw_only=True)
    class Here(Scenario):
        """In a function: nobody can import it."""

    experiment = Experiment(scenario=Here(), minutes=0.1)
    with pytest.raises(ValueError, match=r"a Here of your own .*could not find again; put the class into a module"):
        learn(experiment, tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_a_part_in_a_file_is_kept_by_the_files_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(own_parts.__file__, tmp_path / "mine.py")
    kind = imported("mine.py:Yard", "test")
    data = rundir.plain(Experiment(scenario=kind(radius=40.0)))
    assert data["scenario"]["kind"] == "mine.py:Yard"
    assert rundir.from_plain(data, "test").scenario.path().length == pytest.approx(251.3, abs=0.1)
    (tmp_path / "mine.py").unlink()
    with pytest.raises(ValueError, match=r"test.scenario 'mine.py:Yard': mine.py cannot be read"):
        rundir.from_plain(data, "test")


@pytest.mark.parametrize("kind", ["os:system", "pathlib:Path", "steerkit.paths.path:Path", "dataclasses:dataclass"])
def test_nothing_but_a_part_of_an_experiment_is_made(kind: str) -> None:
    data = rundir.plain(Experiment())
    data["scenario"] = {"kind": kind}
    with pytest.raises(ValueError, match=f"kind '{kind}' is no part of an experiment, expected a dataclass that"):
        rundir.from_plain(data, "run.json")


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("geared", "element 'geared' is not known; valid: integrator, low-pass, plain, my_file.py:Class"),
        ("steerkit.doe:OutputElement", "the class OutputElement, expected a subclass of OutputElement"),
        ("steerkit.doe:Corrected", "the class Corrected, expected a subclass of OutputElement"),
        ("mine.py:Geared", "element 'mine.py:Geared': mine.py cannot be read"),
    ],
)
def test_an_element_that_is_none_is_refused_with_the_setting(name: str, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Setting(doe=name)


def test_a_finished_run_learns_on_with_the_numbers_of_a_longer_one(tmp_path: Path) -> None:
    paper = replace(PAPER, fit=FitSetting(epochs=20), retrain_every_m=20.0)
    short = Experiment(setting=paper, scenario=Scenario(course="circle"), minutes=0.15)
    learn(short, tmp_path / "run")
    longer = replace(short, minutes=0.3)
    run, whole = learn(longer, tmp_path / "run"), learn(longer)
    assert run.x == whole.x
    assert len(run.transitions) == len(whole.transitions) > 50
    assert replace(run.counts, train_seconds=0.0) == replace(whole.counts, train_seconds=0.0)
    assert rundir.experiment_of(tmp_path / "run").minutes == 0.3
    assert len(rundir.drive_log(tmp_path / "run").t) == 360
    with pytest.raises(ValueError, match=r"holds a run of more: minutes 0.3, now 0.15; give as much or more"):
        learn(short, tmp_path / "run")
    with pytest.raises(ValueError, match=r"another experiment: its setting and seed differ"):
        learn(replace(longer, setting=PAPER, seed=4), tmp_path / "run")


@pytest.mark.parametrize("table", [{"setting": {"doe": "{}:Geared"}}, {"scenario": {"kind": "{}:Yard"}}])
@pytest.mark.parametrize("ending", [".py", ""])
def test_what_a_run_names_is_not_run_unless_the_user_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, table: dict[str, dict[str, str]], ending: str
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    Path(f"{tmp_path.name}.py").write_text(f"open('ran', 'w')\n{Path(own_parts.__file__).read_text()}")
    home = f"{tmp_path.name}{ending}"
    part, (key, name) = next((part, *given.items()) for part, given in table.items())
    data = {"format": rundir.FORMAT, **{key: {} for key in rundir.KEYS}, "experiment": rundir.plain(Experiment())}
    data["experiment"][part][key] = name.format(home)
    (tmp_path / "run.json").write_text(json.dumps(data))
    with pytest.raises(ValueError, match=r"nothing that a file names is run; if you trust it: steerkit --code "):
        rundir.experiment_of(tmp_path)
    assert not Path("ran").exists()
    mine(home)
    assert name_of(type(getattr(rundir.experiment_of(tmp_path), part))) or key == "doe"
    (tmp_path / "run.json").write_text(json.dumps({**data, "code": {home: "0" * 16}}))
    with pytest.raises(ValueError, match=f"{home} has changed since .*run.json was written: another SHA-256"):
        rundir.experiment_of(tmp_path)


# ---- who learns and who reads

BRIEF = Experiment(scenario=Scenario(course="circle"), minutes=0.1)
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
                learn(BRIEF, tmp_path)
            assert not (tmp_path / "run.json").exists()
        finally:
            os.kill(owner.pid, signal.SIGKILL)
            owner.wait()
    assert holder(tmp_path).startswith(f"process {owner.pid}")  # what a kill leaves holds nobody up
    assert learn(BRIEF, tmp_path).done()
    assert holder(tmp_path) == "another process"


def test_one_process_cannot_hold_a_directory_twice(tmp_path: Path) -> None:
    with held(tmp_path), pytest.raises(ValueError, match=rf"by process {os.getpid()} "), held(tmp_path):
        pass
    with held(tmp_path):
        assert not [file for file in tmp_path.iterdir() if file.name not in (rundir.LOCK, rundir.HOLDER)]


def test_reading_beside_a_learner_sees_whole_checkpoints_only(tmp_path: Path) -> None:
    """The learner writes a checkpoint in every other sample; a reader reads all the time."""
    often = changed(MODEL_FREE, ["retrain_every_m=0.5", "fit_seconds=0.0", "fit.epochs=1", "fit.nets=1"])
    run = LearningRun(Experiment(setting=often, scenario=Scenario(course="circle"), minutes=0.06))
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
