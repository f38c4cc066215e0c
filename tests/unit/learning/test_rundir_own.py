"""Parts of one's own in a run: found again when it is read, or refused before the first second."""

import json
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from steerkit._support.plugins import imported, mine, name_of
from steerkit.cli.drive import driven
from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment
from steerkit.learning.learn import learn
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import PAPER, Setting
from steerkit.scenario import Scenario
from tests.support import own_parts
from tests.support.own_parts import Dear, Geared, Patient, Yard

HOME = "tests.support.own_parts"


def test_own_place_setting_cost_and_element_are_kept_and_found_again(tmp_path: Path) -> None:
    setting = Patient(fit=FitSetting(epochs=20), cost=Dear(price=4.0), doe=f"{HOME}:Geared", name="mine")
    experiment = Experiment(scenario=Yard(radius=30.0), setting=setting, minutes=0.1)
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
    setting = replace(PAPER, fit=FitSetting(epochs=20), retrain_every_m=20.0)
    short = Experiment(setting=setting, scenario=Scenario(course="circle"), minutes=0.15)
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
