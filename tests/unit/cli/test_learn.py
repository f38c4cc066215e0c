"""`steerkit learn`, and what its run directory is for: `show` and `drive`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from steerkit.learning import report
from steerkit.learning.experiment import Experiment
from steerkit.scenario import Scenario
from tests.support.command_lines import run


def test_learn_from_a_config_then_show_and_drive_its_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config, place = tmp_path / "my.toml", tmp_path / "run"
    config.write_text("minutes = 0.2\nseed = 2\n[scenario]\ncourse = 'circle'\n[setting.fit]\nnets = 1\nepochs = 30\n")
    words = ("learn", "--config", str(config), "--out", str(place), "--json")
    assert run(*words, monkeypatch=monkeypatch) == 0
    merit = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert merit["seed"] == 2
    assert merit["course"] == "circle"
    assert 0.2 <= merit["driving_minutes"] < 0.21
    assert {p.name for p in place.glob("*.png")} == {"learning.png", "round.png"}
    assert run("show", str(place), "-q", "--json", monkeypatch=monkeypatch) == 0
    shown = json.loads(capsys.readouterr().out)  # nothing else on stdout
    assert shown["failures"] == merit["failures"]
    assert [drive["controller"] for drive in shown["drives"]] == ["learned", "stanley"]
    film = tmp_path / "film.gif"
    assert run("show", str(place), "--film", str(film), "--film-lasts", "2", "-q", monkeypatch=monkeypatch) == 0
    assert film.stat().st_size > 10_000
    assert f"film: {film}" in capsys.readouterr().out
    assert run("show", str(place), "--film", str(tmp_path / "film.avi"), monkeypatch=monkeypatch) == 2
    assert "ends in .gif" in capsys.readouterr().err
    assert run("show", str(place), str(place), "--film", str(film), monkeypatch=monkeypatch) == 2
    assert "show --film: takes one run" in capsys.readouterr().err
    assert run("show", str(place), str(place), "--json", monkeypatch=monkeypatch) == 0
    out, err = capsys.readouterr()
    assert [row["failures"] for row in json.loads(out)["runs"]] == 2 * [merit["failures"]]
    assert json.loads(out)["runs"][0]["drive"]["rms_e"] == shown["drives"][0]["rms_e"]
    assert "2 runs" in err
    assert run("show", str(place), str(place), "--diagnostics", monkeypatch=monkeypatch) == 2
    assert run("learn", "--out", str(place), "--minutes", "+0.1", "-q", "--json", monkeypatch=monkeypatch) == 0
    longer = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert (longer["course"], longer["seed"]) == ("circle", 2)
    assert 0.3 <= longer["driving_minutes"] < 0.31
    assert run("learn", "--out", str(place), "--course", "paper", monkeypatch=monkeypatch) == 2
    assert "another experiment: its scenario differs" in capsys.readouterr().err
    words = ("drive", str(place), "--course", "circle", "--rounds", "0.1", "--out", str(tmp_path / "d"), "-q")
    assert run(*words, monkeypatch=monkeypatch) == 0
    config.write_text("minuts = 3\n")
    assert run("learn", "--config", str(config), monkeypatch=monkeypatch) == 2
    assert "no field 'minuts'; valid: setting, scenario, minutes" in capsys.readouterr().err


def test_a_run_that_was_never_trained_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("learn", "--course", "circle", "--minutes", "0.01", "--out", str(tmp_path / "run"), "-q")
    assert run(*words, "--stream", "0", monkeypatch=monkeypatch) == 0
    said = capsys.readouterr().out
    assert "a net that was never trained" in said
    assert "live in Foxglove: open a connection to ws://127.0.0.1:" in said
    assert "left out" not in said


def test_the_options_of_learning_are_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[tuple[Experiment, Path]] = []

    def learned(experiment: Experiment, place: Path, *, quiet: bool, live: bool, each: object) -> None:
        heard.append((experiment, place))

    monkeypatch.setattr(report, "learn_with_progress", learned)
    monkeypatch.setattr(report, "show", lambda *_, **__: {})
    words = ["learn", "--setting", "paper", "--with", "fit.nets=3", "--with", "calm=0.7", "--minutes", "2.5"]
    words += ["--seed", "6", "--rounds", "4", "--course", "circle", "--conditions", "hard", "-q"]
    assert run(*words, "--out", str(tmp_path / "here"), monkeypatch=monkeypatch) == 0
    ((experiment, place),) = heard
    assert (experiment.setting.name, experiment.setting.fit.nets, experiment.setting.calm) == ("paper", 3, 0.7)
    assert (experiment.minutes, experiment.seed, experiment.rounds) == (2.5, 6, 4)
    assert experiment.scenario == Scenario.under("hard", course="circle")
    assert place == tmp_path / "here"


def test_options_change_the_experiment_of_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: list[Experiment] = []
    monkeypatch.setattr(report, "learn_with_progress", lambda experiment, place, **_: heard.append(experiment))
    monkeypatch.setattr(report, "show", lambda *_, **__: {})
    config = tmp_path / "my.toml"
    scenario = "[scenario]\ncourse = 'circle'\nsensors.noise = 1.0\nsteering.lag = 0.3\n"
    config.write_text(f"minutes = 0.2\nseed = 2\n{scenario}[setting]\ncalm = 0.6\n")
    for words in (
        (),
        ("--course", "slalom", "--seed", "7", "--minutes", "3"),
        ("--conditions", "clean"),
        ("--rounds", "2"),
    ):
        assert run("learn", "--config", str(config), *words, "-q", monkeypatch=monkeypatch) == 0
    as_it_is, changed, clean, rounds = heard
    assert (as_it_is.scenario.course.name, as_it_is.seed, as_it_is.minutes, as_it_is.setting.calm) == (
        "circle",
        2,
        0.2,
        0.6,
    )
    assert (changed.scenario.course.name, changed.seed, changed.minutes, changed.setting.calm) == (
        "slalom",
        7,
        3.0,
        0.6,
    )
    assert (changed.scenario.sensors.noise, clean.scenario.sensors.noise, clean.scenario.steering.lag) == (
        1.0,
        0.0,
        0.3,
    )
    assert (rounds.rounds, rounds.scenario) == (2, as_it_is.scenario)
