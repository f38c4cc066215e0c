"""The vehicle file of a drive: what was found, what was not, what was known before, and what has changed."""

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from steerkit.car import calibration as module
from steerkit.car import recording as recordings
from steerkit.car.calibration import Calibrated, NothingLearned
from steerkit.car.estimates import CarEstimators, known_in
from steerkit.car.protocol import ESTIMATES, Snapshot
from steerkit.car.state_machine import Mode
from steerkit.estimators.estimate import Estimated
from steerkit.plants.steering_actuator import steering_of
from steerkit.vehicles import vehicle
from tests.support.calibrated_car import CONFIG, DELAY, LAG, RATIO, Made
from tests.support.command_lines import run
from tests.support.recordings import small

PRIOR = CarEstimators(CONFIG).found()


def after(before: dict[str, Estimated] | None = None, **found: tuple[float, float, float]) -> Calibrated:
    said = {name: Estimated(*numbers) for name, numbers in found.items()}
    return Calibrated(config=CONFIG, found=PRIOR | said, before=before or {}, log="d.mcap", digest="0")


@pytest.fixture(scope="session")
def made(calibration: Made) -> Calibrated:
    """What is found in the recording of that drive, which takes seconds to work out."""
    return module.of_recording(calibration.record)


@pytest.fixture
def record(calibration: Made, made: Calibrated, monkeypatch: pytest.MonkeyPatch) -> Path:
    """That recording, of which is known already what is found in it."""
    monkeypatch.setattr(module, "of_recording", {calibration.record: made}.__getitem__)
    return calibration.record


def test_the_file_is_a_car_and_its_steering(calibration: Made, record: Path, tmp_path: Path) -> None:
    out = tmp_path / "mine.toml"
    figures = module.from_recording(record, out)
    car = vehicle(str(out))
    assert car.steer_ratio == pytest.approx(RATIO * CONFIG.vehicle.steer_ratio, rel=0.03)
    assert car == replace(CONFIG.vehicle, name="vw-passat-calibrated", steer_ratio=car.steer_ratio)
    motor = steering_of(out)
    assert motor.delay + float(motor.lag) + motor.dt == pytest.approx(DELAY + LAG, abs=0.04)
    data = tomllib.loads(out.read_text(encoding="utf-8"))
    assert data["provenance"]["log"] == "drive.mcap"
    assert len(data["provenance"]["sha256"]) == 64
    assert data["estimates"]["steer_ratio"]["source"] == "drive"
    assert data["estimates"]["steer_ratio"]["low"] < car.steer_ratio < data["estimates"]["steer_ratio"]["high"]
    sheet = {"value": CONFIG.vehicle.understeer_gradient, "unit": "rad s^2/m", "source": "data sheet"}
    assert data["estimates"]["understeer"] == sheet
    assert "understeer" in data["provenance"]["notes"][-1]
    assert figures["estimates"]["understeer"]["valid"] is False
    assert known_in(out.read_text(encoding="utf-8")).keys() == {
        name for name, q in calibration.world.watched.found.items() if q.valid > 0.5
    }


def test_a_second_drive_keeps_what_it_does_not_find_and_reports_what_has_changed(
    record: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.toml"
    row = {"unit": "1", "source": "drive"}
    earlier = {"understeer": {"value": 0.002, "low": 0.0015, "high": 0.0025, **row}}
    earlier["steer_ratio"] = {"value": 15.0, "low": 14.9, "high": 15.1, **row}
    out.write_text(module.vehicle_text(CONFIG.vehicle, estimates=earlier), encoding="utf-8")
    figures = module.from_recording(record, out)
    (said,) = figures["changes"]
    assert said.startswith("changed since the last calibration: steering ratio 15.00 [14.90, 15.10] then, 17.")
    assert said in capsys.readouterr().out
    data = tomllib.loads(out.read_text(encoding="utf-8"))
    assert data["estimates"]["understeer"]["value"] == 0.002
    assert data["estimates"]["understeer"]["source"] == "an earlier drive"
    assert data["provenance"]["changes"] == [said]
    again = module.from_recording(record, out)
    assert again["changes"] == []
    assert tomllib.loads(out.read_text(encoding="utf-8"))["estimates"]["understeer"]["source"] == "an earlier drive"


def test_a_drive_that_finds_nothing_writes_nothing(tmp_path: Path) -> None:
    out = tmp_path / "mine.toml"
    recordings.Recording(tmp_path / "t.mcap", recordings.described(CONFIG)).close()
    with pytest.raises(ValueError, match="there is no drive in it"):
        module.from_recording(tmp_path / "t.mcap", out)
    assert not out.exists()
    (tmp_path / "t.mcap").write_bytes(small())
    row = {"value": 15.0, "low": 14.9, "high": 15.1, "unit": "1", "source": "drive"}
    out.write_text(module.vehicle_text(CONFIG.vehicle, estimates={"steer_ratio": row}), encoding="utf-8")
    before = out.read_bytes()
    with pytest.raises(NothingLearned, match="nothing was learned, no vehicle file is written"):
        module.from_recording(tmp_path / "t.mcap", out)
    assert out.read_bytes() == before
    assert after().learned == 0
    assert after({"lag": Estimated(0.3, 0.01, 1.0)}).learned == 0
    assert issubclass(NothingLearned, ValueError)


def test_a_drive_that_ended_in_a_fault_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimators, record = CarEstimators(CONFIG), tmp_path / "drive.mcap"
    record.write_bytes(small())
    monkeypatch.setattr(module.replays, "replayed_estimates", lambda *_: (estimators, 0))
    for mode, why in ((Mode.FAULT, "a FAULT ended this drive"), (Mode.STANDBY, "the wheel has to move to and fro")):
        estimators.sample(Snapshot(t=0.0, mode=mode))
        with pytest.raises(NothingLearned, match=why):
            module.from_recording(record, tmp_path / "mine.toml", say=False)


def test_dead_time_and_lag_are_given_as_a_pair() -> None:
    sheet = {"delay": CONFIG.delay, "lag": CONFIG.lag, "offset": 0.0}
    assert after().steering == sheet
    pair = after(delay=(0.2, 0.1, 0.0), lag=(0.13, 0.1, 0.0), delay_lag=(0.33, 0.004, 1.0), offset=(0.02, 0.001, 1.0))
    assert pair.steering == {"delay": 0.2, "lag": 0.13, "offset": 0.02}
    assert after(delay=(-0.01, 0.1, 0.0), delay_lag=(0.1, 0.004, 1.0)).steering["delay"] == 0.0
    assert after(delay=(0.2, 0.1, 0.0), offset=(0.02, 0.1, 0.0)).steering == sheet
    assert after({"offset": Estimated(0.03, 0.001, 1.0)}).steering == sheet | {"offset": 0.03}


def test_a_disk_that_is_full_leaves_the_old_file_and_names_the_recording(
    record: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module, "write_text", full)
    with pytest.raises(OSError, match="No space") as error:
        module.from_recording(record, tmp_path / "mine.toml", say=False)
    assert f"--from {record}" in error.value.__notes__[0]


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("mine.txt", None, "a vehicle file ends in .toml"),
        ("none/mine.toml", None, "there is no folder"),
        ("mine.toml", "colour = 1", "format = None, expected"),
        ("mine.toml", "[", "not TOML"),
        ("mine.toml", 'format = "steerkit car 1"', "format = 'steerkit car 1', expected"),
    ],
)
def test_nothing_but_a_vehicle_file_is_written_over(tmp_path: Path, name: str, text: str | None, says: str) -> None:
    if text is not None:
        (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=says):
        module.check_place(tmp_path / name)


def test_from_the_command_line_as_json(
    record: Path, made: Calibrated, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "mine.toml"
    assert run("car", "calibrate", "--from", f"{record}", "--out", f"{out}", "--json", monkeypatch=monkeypatch) == 0
    assert [*made.found] == [*ESTIMATES]
    printed_json = json.loads(capsys.readouterr().out)
    assert (printed_json["vehicle_file"], out.is_file()) == (str(out), True)
    assert printed_json["estimates"]["steer_ratio"]["valid"] is True
    assert run("car", "replay", f"{record}", monkeypatch=monkeypatch) == 0
    printed = capsys.readouterr().out
    estimates, same = re.search(r"estimates: (\d+) of (\d+) the same", printed).groups()  # type: ignore[union-attr]
    assert estimates == same != "0"
    assert "  steering ratio 17." in printed
