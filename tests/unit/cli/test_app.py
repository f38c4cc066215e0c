"""The command line: results where they are expected, and mistakes answered in one line with exit code 2."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from steerkit.catalogue import CONTROLLERS
from steerkit.cli import app as cli
from steerkit.scenario import Scenario
from steerkit.scenario import drive as evaluate
from steerkit.scenario.file import write_scenario
from steerkit.simulation import simulate
from steerkit.vehicles import VEHICLES
from steerkit.vehicles.file import vehicle_text
from tests.support.own_controller import own_controller
from tests.support.yard import yard


def run(*words: str, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr("sys.argv", ["steerkit", *words])
    try:
        cli.main()
    except SystemExit as stop:
        return int(stop.code or 0)
    return 0


CAR = ("--car", "dbw-kit.toml")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("drive", "stanly"), "valid: stanley, stanley-textbook"),
        (("drive", "stanley", "--course", "papr"), "did you mean 'paper'"),
        (("learn", "--setting", "defualt"), "valid: default, paper"),
        (("learn", "--config", "/does/not/exist.toml"), "cannot be read"),
        (("learn", "--with", "fit.nest=3"), "no 'nest' there; valid: discount, epochs"),
        (("show", "/"), "no run directory"),
        (("drive",), "with which controller? valid: stanley"),
        (("drive", "stanley", "--controller", "nfq"), "two controllers, 'stanley' and --controller nfq"),
        (("drive", "nfq", "--course", "circle"), "there is no runs/default-circle-clean-seed0"),
        (("drive", "stanley", "--minutes", "2"), "--minutes is for a car; name its file: --car dbw-kit.toml"),
        (("drive", "stanley", "--time-scale", "2"), "--time-scale is for a car"),
        (("learn", "--simulated"), "--simulated is for a car"),
        (("learn", "--recovery", "stanley"), "--recovery is for a car"),
        (("drive", "stanley", *CAR, "--rounds", "2"), "--rounds is for simulations: say --minutes"),
        (("drive", "stanley", *CAR, "--seed", "2"), "--seed is for simulations"),
        (("learn", *CAR, "--course", "paper"), "the car's file names the course, under [course]"),
        (("learn", *CAR, "--conditions", "hard"), "a car brings its own noise"),
        (("learn", *CAR, "--setting", "defualt"), "valid: default, paper"),
        (("drive", *CAR), "with which controller? valid: stanley"),
        (("drive", "stanly", *CAR), "nor a place with a trained policy; valid: stanley"),
        (("drive", "nfq", *CAR), "no net in runs/car; learn one first: steerkit learn --car FILE"),
        (("drive", "stanley", "--car", "mine.toml"), "shipped: dbw-kit.toml"),
        (("drive", "stanley", *CAR, "--recovery", "prayer"), "--recovery 'prayer' is not known; valid: stanley"),
        (("drive", "stanley", *CAR, "--time-scale", "2"), "a real car has real time; use --simulated"),
        (("drive", "stanley", *CAR, "--simulated", "--channel", "/dev/x"), "leave --channel out"),
        (("drive", "stanley", *CAR, "--recording", "there.mcap"), "recordings are not overwritten"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(
    words: tuple[str, ...],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.mcap").touch()
    assert run(*words, monkeypatch=monkeypatch) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert len(error.splitlines()) == 1


def test_help_and_courses(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    for words in ((), ("--help",), ("learn", "--help"), ("courses",)):
        assert run(*words, monkeypatch=monkeypatch) in (0, 2)
    out = capsys.readouterr().out
    assert all(word in out for word in ("learn", "drive", "show", "demo", "--seed", "--config", "genesis"))


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
    assert name in cli._CONTROLLERS.split(", ")


def test_learn_from_a_config_then_show_and_drive_its_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    config, place = tmp_path / "my.toml", tmp_path / "run"
    config.write_text("minutes = 0.2\nseed = 2\n[world]\ncourse = 'circle'\n[setting.fit]\nnets = 1\nepochs = 30\n")
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
    words = ("drive", str(place), "--course", "circle", "--rounds", "0.1", "--out", str(tmp_path / "d"), "-q")
    assert run(*words, monkeypatch=monkeypatch) == 0
    config.write_text("minuts = 3\n")
    assert run("learn", "--config", str(config), monkeypatch=monkeypatch) == 2
    assert "no field 'minuts'; valid: setting, world, minutes" in capsys.readouterr().err
