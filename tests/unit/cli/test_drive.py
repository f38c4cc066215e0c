"""`steerkit drive` in simulation: results where they are expected, and what is one's own is driven too."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from steerkit.catalogue import CONTROLLERS
from steerkit.cli import demo
from steerkit.cli import drive as command
from steerkit.learning import report
from steerkit.learning.counts import Counts
from steerkit.learning.experiment import Experiment
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from steerkit.scenario.file import write_scenario
from steerkit.simulation import simulate
from steerkit.vehicles import VEHICLES
from steerkit.vehicles.file import vehicle_text
from tests.support.command_lines import run
from tests.support.own_controller import own_controller
from tests.support.yard import yard


def test_drive_reports_as_json_and_keeps_log_and_picture(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ("drive", "stanley", "--course", "genesis-rfs", "--rounds", "0.2", "--out", str(tmp_path), "--json", "-q")
    assert run(*words, monkeypatch=monkeypatch) == 0
    row = json.loads(capsys.readouterr().out.strip().splitlines()[-1])
    assert row["controller"] == "stanley"
    assert row["held"] is True
    assert 0.0 < row["rms_e"] < 0.05
    assert (tmp_path / "drive.npz").stat().st_size > 1000
    assert (tmp_path / "drive.png").read_bytes()[:4] == b"\x89PNG"


def test_ones_own_controller_course_car_and_scenario(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    yard(tmp_path)
    steering = {"delay": 0.11, "lag": 0.1, "offset": 0.0}
    (tmp_path / "car.toml").write_text(vehicle_text(VEHICLES["bmw-320i"], steering=steering))
    own_controller(tmp_path)
    monkeypatch.chdir(tmp_path)
    write_scenario(Scenario.under("hard", course="yard.csv", vehicle="car.toml", rounds=0.3), "yard.toml")
    by_options = ("--course", "yard.csv", "--vehicle", "car.toml", "--conditions", "hard", "--rounds", "0.3")
    rows = []
    for words in (by_options, ("--scenario", "yard.toml"), ("--scenario", "yard.toml", "--delay", "0")):
        assert run("drive", "my_file.py:make", *words, "--json", "-q", monkeypatch=monkeypatch) == 0
        rows.append(json.loads(capsys.readouterr().out.strip().splitlines()[-1]))
    assert rows[0]["controller"] == "my_file.py:make"
    assert rows[0] == rows[1]
    assert rows[0]["rms_e"] != rows[2]["rms_e"]
    assert (tmp_path / "runs/drive-my_file.py-make-yard-hard-seed0/drive.npz").exists()


@pytest.mark.parametrize("name", sorted(CONTROLLERS))
def test_every_analytic_controller_drives_with_delay(name: str) -> None:
    """The first 6 s of the course with 0.1 s delay; the textbook form already swings, but stays near."""
    world = Scenario(delay=0.1)
    steering = evaluate.controller(name, world)
    log = simulate(evaluate.drive_loop(world, steering), 6.0, record=["path.e"])
    assert abs(log["path.e"]).max() < 0.3
    assert name in command._CONTROLLERS.split(", ")


def test_the_options_of_a_drive_are_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: dict[str, Any] = {}

    def driven(name: str, world: Scenario, place: Path, **options: Any) -> dict[str, Any]:
        heard.update(name=name, world=world, place=place, **options)
        return {}

    monkeypatch.setattr(report, "drive_and_draw", driven)
    where = ("--course", "circle", "--conditions", "hard", "--delay", "0.07")
    words = ("drive", "lqr", *where, "--rounds", "2.5", "--seed", "7", "-q", "--out")
    assert run(*words, str(tmp_path), monkeypatch=monkeypatch) == 0
    assert (heard["name"], heard["rounds"], heard["seed"], heard["quiet"]) == ("lqr", 2.5, 7, True)
    assert heard["place"] == tmp_path
    hard = Scenario.under("hard", course="circle")
    assert (heard["world"].course, heard["world"].delay, heard["world"].lag) == ("circle", 0.07, hard.lag)
    write_scenario(Scenario(course="circle", delay=0.03, lag=0.2), tmp_path / "mine.toml")
    for given, lag, noise in (((), 0.2, 0.0), (("--conditions", "hard"), 0.15, 1.0)):
        words = ("drive", "lqr", "--scenario", str(tmp_path / "mine.toml"), *given, "-q", "--out")
        assert run(*words, str(tmp_path), monkeypatch=monkeypatch) == 0
        world = heard["world"]
        assert (world.course, world.delay, world.lag, world.noise) == ("circle", 0.03, lag, noise)


def test_the_output_element_of_a_learned_drive_ends_at_the_cars_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "car.toml").write_text(vehicle_text(replace(VEHICLES["bmw-320i"], delta_sw_max=9.9)))
    world = Scenario(vehicle=str(tmp_path / "car.toml"))
    limits = []

    class Seen(Exception):
        pass

    def driven(world: Scenario, policy: Any, *, doe: Any, **options: Any) -> Any:
        limits.append(doe.limit)
        raise Seen

    run = SimpleNamespace(experiment=Experiment(world=world), t=0.0, counts=Counts(), transitions=())
    monkeypatch.setattr(evaluate, "drive", driven)
    monkeypatch.setattr(report.rundir, "final_policy", lambda place, updates=None: None)
    monkeypatch.setattr(report.rundir, "experiment_of", lambda place: run.experiment)
    monkeypatch.setattr(report.rundir, "load", lambda place: run)
    monkeypatch.setattr(demo, "learn_with_progress", lambda *words, **options: run)
    for test_drive in (
        lambda: report.show(tmp_path),
        lambda: report.drive_and_draw(str(tmp_path), world, tmp_path, rounds=None, seed=0),
        lambda: demo._part(("a", run.experiment, tmp_path, 0, True)),
    ):
        with pytest.raises(Seen):
            test_drive()
    assert limits == [9.9, 9.9, 9.9]


def test_with_json_only_json_is_on_standard_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(report.console, "stderr", False)
    words = ["drive", "stanley", "--course", "circle", "--rounds", "0.1", "--json", "--out"]
    assert run(*words, str(tmp_path), monkeypatch=monkeypatch) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["controller"] == "stanley"  # all of it
    assert "RMS e" in err
