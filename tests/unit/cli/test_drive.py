"""`steerkit drive` in simulation: options are heard, and what is one's own is driven too."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit._support.console import console
from steerkit.cli import drive as command
from steerkit.scenario import Scenario, write_scenario
from steerkit.scenario import drive as evaluate
from steerkit.vehicles import VEHICLES, vehicle_text
from tests.support.own_controller import own_controller
from tests.support.yard import yard


def test_json_stands_alone_on_stdout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    monkeypatch.setattr(console, "stderr", False)
    said = cli("drive", "stanley", "--course", "circle", "--rounds", 0.05, "--out", tmp_path, "--json")
    assert json.loads(said.out)["controller"] == "stanley"
    assert "RMS e" in said.err


def test_ones_own_controller_course_car_and_scenario(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    yard(tmp_path)
    steering = {"delay": 0.11, "lag": 0.1, "offset": 0.0}
    (tmp_path / "car.toml").write_text(vehicle_text(VEHICLES["bmw-320i"], steering=steering))
    own_controller(tmp_path)
    monkeypatch.chdir(tmp_path)
    write_scenario(Scenario.under("hard", course={"name": "yard.csv", "rounds": 0.1}, vehicle="car.toml"), "yard.toml")
    by_options = ("--course", "yard.csv", "--vehicle", "car.toml", "--conditions", "hard", "--rounds", "0.1")
    ways = (by_options, ("--scenario", "yard.toml"), ("--scenario", "yard.toml", "--delay", "0"))
    rows = [cli("drive", "my_file.py:make", *words, "--json", "-q").json for words in ways]
    assert rows[0]["controller"] == "my_file.py:make"
    assert rows[0] == rows[1]
    assert rows[0]["rms_e"] != rows[2]["rms_e"]
    agent = cli("drive", "my_file.py:agent", "--course", "genesis-rfs", "--rounds", "0.05", "--json", "-q").json
    assert agent["held"]  # a policy with its output element
    assert (tmp_path / "runs/drive-my_file.py-make-yard-hard-seed0/drive.npz").exists()


@pytest.fixture
def heard(monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """What would be driven."""
    heard: list[dict[str, Any]] = []

    def driven(names: list[str], scenario: Scenario, place: Path, **options: Any) -> list[Any]:
        heard.append({"names": names, "scenario": scenario, "place": place, **options})
        return []

    monkeypatch.setattr(command, "driven", driven)
    return heard


def test_the_options_of_a_drive_are_heard(tmp_path: Path, cli: Any, heard: list[dict[str, Any]]) -> None:
    where = ("--course", "circle", "--conditions", "hard", "--delay", "0.07")
    cli("drive", "lqr", *where, "--rounds", "2.5", "--seed", "7", "-q", "--out", tmp_path)
    scenario = Scenario.under("hard", course="circle", steering={"delay": 0.07})
    told = {"names": ["lqr"], "scenario": scenario, "place": tmp_path, "rounds": 2.5, "seed": 7, "quiet": True}
    assert told.items() <= heard[0].items()
    write_scenario(Scenario(course="circle", steering={"delay": 0.03, "lag": 0.2}), tmp_path / "mine.toml")
    for given, lag, noise in (((), 0.2, 0.0), (("--conditions", "hard"), 0.15, 1.0)):
        cli("drive", "lqr", "--scenario", tmp_path / "mine.toml", *given, "-q", "--out", tmp_path)
        steering, sensors = heard[-1]["scenario"].steering, heard[-1]["scenario"].sensors
        assert (steering.delay, steering.lag, sensors.noise) == (0.03, lag, noise)


def test_no_drive_is_written_over_by_another(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    monkeypatch.chdir(tmp_path)
    for delay in ("0", "0.1", "0.1"):
        cli("drive", "stanley", "--course", "circle", "-q", "--rounds", "0.05", "--delay", delay)
    first = "drive-stanley-circle-clean-seed0"
    places = sorted((tmp_path / "runs").iterdir())
    assert [place.name for place in places] == [first, f"{first}-2", f"{first}-3"]
    plain, late, again = ((place / "drive.npz").read_bytes() for place in places)
    assert plain != late == again


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (("--speed", "5"), ("wander", 5.0, 5.0)),
        (("--v-max", "12"), ("wander", 4.0, 12.0)),
        (("--v-max", "3"), ("wander", 3.0, 3.0)),
        (("--speed", "recorded", "--course", "genesis", "--v-max", "9"), ("recorded", 4.0, 9.0)),
        (("--speed", "v.csv"), ("v.csv", 4.0, 11.0)),
        (("--speed", "5", "--v-max", "9"), "a steady speed; leave --v-max out"),
        (("--speed", "w.csv"), "speed: w.csv cannot be read (No such file or directory)"),
        (("--speed", "x.csv"), "x.csv: columns x, v; valid: s [m], v [m/s]"),
    ],
)
def test_speeds(
    words: tuple[str, ...], expected: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any, heard: list[Any]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("v.csv").write_text("s,v\n0,5\n60,11\n120,5\n")
    Path("x.csv").write_text("x,v\n0,5\n")
    course = () if "--course" in words else ("--course", "circle")
    said = cli("drive", "stanley", *course, *words, "-q", code=2 if isinstance(expected, str) else 0)
    if isinstance(expected, str):
        assert expected in said.err
    else:
        driver = heard[0]["scenario"].driver
        assert (driver.speed, driver.v_min, driver.v_max) == expected


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


def test_a_vehicle_beside_a_scenario_has_its_steering(tmp_path: Path, cli: Any, heard: list[dict[str, Any]]) -> None:
    text = vehicle_text(VEHICLES["bmw-320i"]) + "\n[steering]\ndelay = 0.05\nlag = 0.2\noffset = 0.01\n"
    (tmp_path / "car.toml").write_text(text)
    write_scenario(Scenario(course="circle", disturbances={"wind": 0.2}), tmp_path / "mine.toml")
    words = ("drive", "stanley", "--scenario", tmp_path / "mine.toml", "--vehicle", tmp_path / "car.toml")
    for more in ((), ("--delay", "0.07")):
        cli(*words, *more, "-q")
    driven = [one["scenario"] for one in heard]
    told = [(one.steering.delay, one.steering.lag, one.disturbances.wind) for one in driven]
    own = Scenario.under(vehicle=str(tmp_path / "car.toml")).steering.delay
    assert own > 0.0
    assert told == [(own, 0.2, 0.2), (0.07, 0.2, 0.2)]


def test_a_target_of_lateral_acceleration_instead_of_a_course(tmp_path: Path, cli: Any) -> None:
    """Ours, and a file of the challenge, which asks for the target as it is."""
    (tmp_path / "theirs.py").write_text("class Controller:\n    def update(self, target, *_):\n        return target\n")
    (tmp_path / "t.csv").write_text("t,a_y,v\n0,0,12\n2,1.5,12\n4,-1,14\n6,0,14\n")
    name, words = f"{tmp_path / 'theirs.py'}:Controller", ("--target", tmp_path / "t.csv", "--json", "-q")
    rows = cli("drive", "lqr", "mpc", name, *words, "--out", tmp_path / "logs").json["drives"]
    assert [row["controller"] for row in rows] == ["lqr", "mpc", name]
    assert 0.0 < rows[1]["total_cost"] <= rows[0]["total_cost"] + 1e-9
    assert rows[1]["total_cost"] < 0.8 * rows[2]["total_cost"]
    assert len(list((tmp_path / "logs").glob("*.npz"))) == 3
    assert cli("drive", "mpc", *words).json == rows[1]


def test_a_controller_of_the_challenge_drives_no_car(tmp_path: Path, cli: Any) -> None:
    (tmp_path / "theirs.py").write_text("class Controller:\n    def update(self, *_):\n        return 0.0\n")
    said = cli("drive", f"{tmp_path / 'theirs.py'}:Controller", "--car", "dbw-kit.toml", code=2).err
    assert "theirs.py:Controller" in said


def test_the_command_drives_as_drive_does(tmp_path: Path, cli: Any) -> None:
    """The value that the controller has by itself gives the row that `drive` gives."""
    name, course = own_controller(tmp_path), ("--course", "circle", "--conditions", "hard", "--seed", 3, "--json", "-q")
    said = cli("sweep", name, "--set", "gain=1:2.5:3", *course, "--out", tmp_path / "swept").json
    drive = cli("drive", name, *course, "--out", tmp_path / "driven").json
    for metric in ("rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y"):
        assert said["columns"][metric][2] == pytest.approx(drive[metric], rel=1e-9)
    table = np.genfromtxt(tmp_path / "swept/sweep.csv", delimiter=",", names=True, deletechars="")
    np.testing.assert_array_equal(table["controller.gain"], [1.0, 1.75, 2.5])
    assert (tmp_path / "swept/sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_the_command_finds_the_field_inside_a_wrapper_and_says_what_is_wrong(tmp_path: Path, cli: Any) -> None:
    where = ("--course", "circle", "--seconds", 2, "--json", "-q", "--out", tmp_path / "swept")
    said = cli("sweep", "stanley-delay", "--set", "k=1:4:3:log", "--set", "car.vehicle.m=1500,1700", *where).json
    assert said["columns"]["controller.block.k"] == pytest.approx([1.0, 1.0, 2.0, 2.0, 4.0, 4.0])
    assert said["columns"]["car.vehicle.m"] == [1500.0, 1700.0] * 3
    assert [*said["best"]] == ["rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y"]
