"""`steerkit drive` in simulation: results where they are expected, and what is one's own is driven too."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from steerkit._support.console import console
from steerkit.cli import demo
from steerkit.cli import drive as command
from steerkit.diagram.simulation import simulate
from steerkit.learning import report
from steerkit.learning.experiment import Experiment
from steerkit.learning.learner_state import Counts
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from steerkit.scenario.catalogue import CONTROLLERS
from steerkit.scenario.scenario import write_scenario
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
    write_scenario(Scenario.under("hard", course={"name": "yard.csv", "rounds": 0.3}, vehicle="car.toml"), "yard.toml")
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
    scenario = Scenario(steering={"delay": 0.1})
    steering = evaluate.controller(name, scenario)
    log = simulate(evaluate.drive_loop(scenario, steering), 6.0, record=["path.e"])
    assert abs(log["path.e"]).max() < 0.3
    assert name in command._CONTROLLERS.split(", ")


def test_the_options_of_a_drive_are_heard(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    heard: dict[str, Any] = {}

    def driven(names: list[str], scenario: Scenario, place: Path, **options: Any) -> list[Any]:
        heard.update(names=names, scenario=scenario, place=place, **options)
        return []

    monkeypatch.setattr(command, "driven", driven)
    where = ("--course", "circle", "--conditions", "hard", "--delay", "0.07")
    words = ("drive", "lqr", *where, "--rounds", "2.5", "--seed", "7", "-q", "--out")
    assert run(*words, str(tmp_path), monkeypatch=monkeypatch) == 0
    assert (heard["names"], heard["rounds"], heard["seed"], heard["quiet"]) == (["lqr"], 2.5, 7, True)
    assert heard["place"] == tmp_path
    hard = Scenario.under("hard", course="circle")
    assert heard["scenario"] == hard.with_(steering={"delay": 0.07})
    write_scenario(Scenario(course="circle", steering={"delay": 0.03, "lag": 0.2}), tmp_path / "mine.toml")
    for given, lag, noise in (((), 0.2, 0.0), (("--conditions", "hard"), 0.15, 1.0)):
        words = ("drive", "lqr", "--scenario", str(tmp_path / "mine.toml"), *given, "-q", "--out")
        assert run(*words, str(tmp_path), monkeypatch=monkeypatch) == 0
        steering, sensors = heard["scenario"].steering, heard["scenario"].sensors
        assert (steering.delay, steering.lag, sensors.noise) == (0.03, lag, noise)


def test_the_output_element_of_a_learned_drive_ends_at_the_cars_stops(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "car.toml").write_text(vehicle_text(replace(VEHICLES["bmw-320i"], delta_sw_max=9.9)))
    scenario = Scenario(vehicle=str(tmp_path / "car.toml"))
    limits = []

    class Seen(Exception):
        pass

    def driven(scenario: Scenario, policy: Any, *, doe: Any, **options: Any) -> Any:
        limits.append(doe.limit)
        raise Seen

    run = SimpleNamespace(experiment=Experiment(scenario=scenario), t=0.0, counts=Counts(), transitions=())
    monkeypatch.setattr(evaluate, "drive", driven)
    monkeypatch.setattr(report.rundir, "final_policy", lambda place, updates=None: None)
    monkeypatch.setattr(report.rundir, "experiment_of", lambda place: run.experiment)
    monkeypatch.setattr(report.rundir, "load", lambda place: run)
    monkeypatch.setattr(demo, "learn", lambda *words, **options: run)
    for test_drive in (
        lambda: report.show(tmp_path),
        lambda: command.driven([str(tmp_path)], scenario, tmp_path, rounds=None, seed=0),
        lambda: demo._part(("a", run.experiment, tmp_path, 0, None)),
    ):
        with pytest.raises(Seen):
            test_drive()
    assert limits == [9.9, 9.9, 9.9]


def test_with_json_only_json_is_on_standard_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(console, "stderr", False)
    words = ["drive", "stanley", "--course", "circle", "--rounds", "0.1", "--json", "--out"]
    assert run(*words, str(tmp_path), monkeypatch=monkeypatch) == 0
    out, err = capsys.readouterr()
    assert json.loads(out)["controller"] == "stanley"  # all of it
    assert "RMS e" in err


def test_several_controllers_are_one_table_one_picture_and_a_log_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("--course", "circle", "--rounds", "0.05", "-q")
    assert run("drive", "stanley", "lqr", *words, "--json", monkeypatch=monkeypatch) == 0
    out, err = capsys.readouterr()
    assert [row["controller"] for row in json.loads(out)["drives"]] == ["stanley", "lqr"]
    assert err.count("RMS e") == 1
    place = tmp_path / "runs" / "drive-stanley+lqr-circle-clean-seed0"
    assert sorted(file.name for file in place.iterdir()) == ["drive.json", "drive.png", "lqr.npz", "stanley.npz"]
    for wrong, says in (
        (("stanley", "stanley"), "a controller stands twice"),
        (("stanley", "lqr", "--animate", "a.gif"), "films one controller"),
        (("stanley", "lqr", "--car", "dbw-kit.toml"), "2 controllers (stanley, lqr), expected one on a car"),
    ):
        given = () if "--car" in wrong else words
        assert run("drive", *wrong, *given, monkeypatch=monkeypatch) == 2
        assert says in capsys.readouterr().err


def test_no_drive_is_written_over_by_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ("drive", "stanley", "--course", "circle", "-q", "--rounds")
    for more in (("0.05",), ("0.05", "--delay", "0.1"), ("0.05",), ("0.1",), ("0.05", "--delay", "0.1")):
        assert run(*words, *more, monkeypatch=monkeypatch) == 0
    places = sorted(place.name for place in (tmp_path / "runs").iterdir())
    first = "drive-stanley-circle-clean-seed0"
    assert places == [first, f"{first}-2", f"{first}-3"]
    kept = [json.loads((tmp_path / "runs" / place / "drive.json").read_text()) for place in places]
    assert [(note["rounds"], note["scenario"]["steering"]["delay"]) for note in kept] == [
        (0.05, 0.0),
        (0.05, 0.1),
        (0.1, 0.0),
    ]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--speed", "5"), ("wander", 5.0, 5.0)),
        (("--v-max", "12"), ("wander", 4.0, 12.0)),
        (("--v-max", "3"), ("wander", 3.0, 3.0)),
        (("--speed", "recorded", "--course", "genesis", "--v-max", "9"), ("recorded", 4.0, 9.0)),
        (("--speed", "v.csv"), ("v.csv", 4.0, 11.0)),
        (("--speed", "5", "--v-max", "9"), "a steady speed; leave --v-max out"),
        (("--speed", "v.csv", "--v-max", "6"), "speed v.csv: 5 to 10.9842 m/s, expected v_min to v_max, 4 to 6"),
        (("--speed", "fast"), "speed 'fast'; valid: wander, recorded, limit, FILE.csv"),
        (("--speed", "w.csv"), "speed w.csv cannot be read (No such file or directory)"),
        (("--speed", "x.csv"), "x.csv: columns x, v; valid: s [m], v [m/s]"),
        (("--speed", "far.csv"), "far.csv: s to 999 m, on a course of 188.5 m"),
    ],
)
def test_speeds(
    words: tuple[str, ...],
    expected: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, text in (("v", "s,v\n0,5\n60,11\n120,5\n"), ("x", "x,v\n0,5\n"), ("far", "s,v\n0,5\n999,5\n")):
        Path(f"{name}.csv").write_text(text)
    heard: list[Scenario] = []
    monkeypatch.setattr(command, "driven", lambda names, scenario, place, **options: heard.append(scenario) or [])
    course = () if "--course" in words else ("--course", "circle")
    code = run("drive", "stanley", *course, *words, "-q", monkeypatch=monkeypatch)
    if isinstance(expected, str):
        assert code == 2
        assert expected in capsys.readouterr().err
    else:
        assert code == 0
        assert (heard[0].driver.speed, heard[0].driver.v_min, heard[0].driver.v_max) == expected


def test_a_speed_profile_is_driven_round_after_round(tmp_path: Path) -> None:
    (tmp_path / "v.csv").write_text("s,v\n0,5\n60,8\n120,5\n")
    scenario = Scenario(
        course={"name": "circle", "rounds": 1.5}, driver={"speed": str(tmp_path / "v.csv"), "v_max": 8.0}
    )
    (tmp_path / "v.csv").unlink()  # the scenario has kept it
    log = evaluate.drive(scenario, evaluate.controller("stanley", scenario))
    length = scenario.path().length
    assert log["path.progress"][-1] >= 1.5 * length
    expected = np.interp(log["path.progress"] % length, [0.0, 60.0, 120.0, length], [5.0, 8.0, 5.0, 5.0])
    np.testing.assert_allclose(log["driver.v"], expected, atol=0.15)


def test_a_vehicle_beside_a_scenarios_file_brings_its_steering(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    text = vehicle_text(VEHICLES["bmw-320i"]) + "\n[steering]\ndelay = 0.05\nlag = 0.2\noffset = 0.01\n"
    (tmp_path / "car.toml").write_text(text)
    write_scenario(Scenario(course="circle", disturbances={"wind": 0.2}), tmp_path / "mine.toml")
    heard: list[Scenario] = []
    monkeypatch.setattr(command, "driven", lambda names, world, place, **options: heard.append(world) or [])
    words = ("drive", "stanley", "--scenario", str(tmp_path / "mine.toml"), "--vehicle", str(tmp_path / "car.toml"))
    told = Scenario.under("clean", vehicle=str(tmp_path / "car.toml"))
    assert told.steering.delay > 0.0
    for more in ((), ("--delay", "0.07")):
        assert run(*words, *more, "-q", monkeypatch=monkeypatch) == 0
    assert [(world.steering.delay, world.steering.lag, world.disturbances.wind) for world in heard] == [
        (told.steering.delay, 0.2, 0.2),
        (0.07, 0.2, 0.2),
    ]
