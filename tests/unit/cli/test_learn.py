"""`steerkit learn`, and `show` of its run directory."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from steerkit.learning import report
from steerkit.learning.experiment import Experiment
from steerkit.learning.pictures import film_of
from steerkit.scenario import Scenario


def test_learn_from_a_config_then_show_it_and_go_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    monkeypatch.setitem(film_of.__kwdefaults__, "fps", 2.0)
    config, place, film = tmp_path / "my.toml", tmp_path / "run", tmp_path / "film.gif"
    course = "scenario.course = {name = 'circle', rounds = 0.1}"
    config.write_text(f"minutes = 0.15\nseed = 2\n{course}\nsetting.fit = {{nets = 1, epochs = 30}}\n")
    merit = cli("learn", "--config", config, "--out", place, "--json").json
    assert (merit["seed"], merit["course"]) == (2, "circle")
    assert 0.15 <= merit["driving_minutes"] < 0.16
    assert {p.name for p in place.glob("*.png")} == {"learning.png", "round.png", "data.png"}
    said = cli("show", place, "--film", film, "--film-lasts", 2, "--json")
    shown = json.loads(said.out)  # nothing else on stdout
    assert shown["failures"] == merit["failures"]
    assert [drive["controller"] for drive in shown["drives"]] == ["learned", "stanley"]
    assert f"film: {film}" in said.err
    assert film.stat().st_size > 10_000
    assert "ends in .gif" in cli("show", place, "--film", tmp_path / "film.avi", code=2).err
    assert "show --film: takes one run" in cli("show", place, place, "--film", film, code=2).err
    assert "takes one run" in cli("show", place, place, "--diagnostics", code=2).err
    other = shutil.copytree(place, tmp_path / "other")
    both = cli("show", place, other, "--json")
    assert [row["failures"] for row in both.json["runs"]] == 2 * [merit["failures"]]
    assert both.json["runs"][0]["drive"]["rms_e"] == shown["drives"][0]["rms_e"]
    assert "2 runs" in both.err
    longer = cli("learn", "--out", place, "--minutes", "+0.02", "-q", "--json").json
    assert (longer["course"], longer["seed"]) == ("circle", 2)
    assert 0.17 <= longer["driving_minutes"] < 0.18
    other = cli("learn", "--out", place, "--course", "paper", code=2)
    assert "another experiment: its scenario differs" in other.err


def test_a_run_that_was_never_trained_says_so(tmp_path: Path, cli: Any) -> None:
    (tmp_path / "short.toml").write_text("scenario.course = {name = 'circle', rounds = 0.1}\n")
    words = ("learn", "--config", tmp_path / "short.toml", "--minutes", 0.01, "--out", tmp_path / "run")
    words += ("-q", "--stream", 0)
    said = cli(*words).out
    assert "a net that was never trained" in said
    assert "live in Foxglove: open a connection to ws://127.0.0.1:" in said
    assert "left out" not in said


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Experiment, Path]]:
    """What would be learned, and where."""
    heard: list[tuple[Experiment, Path]] = []
    monkeypatch.setattr(report, "learn_with_progress", lambda one, place, **_: heard.append((one, place)))
    monkeypatch.setattr(report, "show", lambda *_, **__: {})
    return heard


def test_the_options_of_learning_are_heard(tmp_path: Path, cli: Any, heard: list[tuple[Experiment, Path]]) -> None:
    words = ["learn", "--setting", "paper", "--with", "fit.nets=3", "--with", "calm=0.7", "--minutes", "2.5"]
    words += ["--seed", "6", "--rounds", "4", "--course", "circle", "--conditions", "hard", "-q"]
    cli(*words, "--out", tmp_path / "here")
    ((experiment, place),) = heard
    assert (experiment.setting.name, experiment.setting.fit.nets, experiment.setting.calm) == ("paper", 3, 0.7)
    assert (experiment.minutes, experiment.seed, experiment.rounds) == (2.5, 6, 4)
    assert experiment.scenario == Scenario.under("hard", course="circle")
    assert place == tmp_path / "here"


def test_options_change_a_files_experiment(tmp_path: Path, cli: Any, heard: list[tuple[Experiment, Path]]) -> None:
    config = tmp_path / "my.toml"
    scenario = "[scenario]\ncourse = 'circle'\nsensors.noise = 1.0\nsteering.lag = 0.3\n"
    config.write_text(f"minutes = 0.2\nseed = 2\n{scenario}[setting]\ncalm = 0.6\n")
    other = ("--course", "slalom", "--seed", "7", "--minutes", "3", "--rounds", "2")
    for words in ((), other, ("--conditions", "clean")):
        cli("learn", "--config", config, *words, "-q")
    told = [(e.scenario.course.name, e.seed, e.minutes, e.rounds, e.scenario.sensors.noise) for e, _ in heard]
    assert told == [("circle", 2, 0.2, 0, 1.0), ("slalom", 7, 3.0, 2, 1.0), ("circle", 2, 0.2, 0, 0.0)]
    assert {(e.setting.calm, e.scenario.steering.lag) for e, _ in heard} == {(0.6, 0.3)}
