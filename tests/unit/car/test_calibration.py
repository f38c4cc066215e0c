"""The guided drive: what it does to the car, who may end it, what its recording gives again, and its vehicle file."""

import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from steerkit.car import calibration as module
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.calibration import SHARES, SLOWEST, Calibrated, NothingLearned, check
from steerkit.car.estimates import CarEstimators, known_in
from steerkit.car.protocol import Snapshot
from steerkit.car.state_machine import Mode, Order
from steerkit.estimators.estimate import Estimated
from steerkit.plants.steering_actuator import steering_of
from steerkit.vehicles import vehicle
from tests.support.calibrated_car import CONFIG, DELAY, LAG, RATIO, CalibratedWorld, Made
from tests.support.recordings import small


def engaged(minutes: float, seconds: float, **more: Any) -> tuple[CalibratedWorld, Any]:
    """A guided drive that was engaged so many seconds ago, and its guide."""
    world = CalibratedWorld(minutes=minutes, **more)
    world.order(Order.ARM, then=0.2)
    world.order(Order.ENGAGE)
    world.until(world.t + seconds)
    return world, world.guided


def test_all_waves_are_driven_within_the_gates_limits_and_near_the_course(calibration: Made) -> None:
    world = calibration.world
    assert world.over
    assert world.mode is Mode.ENGAGED
    world.check_bus()
    driven = [s for s in world.seen if s.mode is Mode.ENGAGED]
    assert len(driven) == pytest.approx(0.5 * 60.0 * 20.0, abs=5)
    assert max(abs(s.e) for s in driven) < 0.6
    assert max(abs(s.a_y) for s in driven) < 3.0


def test_its_recording_says_which_wave_was_on_top_and_replays_bit_for_bit(calibration: Made) -> None:
    recorded = recordings.read(calibration.record)
    config = recordings.config_of(recorded)
    (drive,) = replays.drives(recorded)
    assert [steers.name for _, steers in drive.remarks] == [f"stanley+{wave}" for wave in SHARES]
    same = replays.replayed_requests(drive, config)
    assert same == len(drive.requests) > 600


def test_the_estimates_are_recorded_once_a_second_and_come_out_bit_for_bit_again(calibration: Made) -> None:
    recorded = recordings.read(calibration.record)
    (drive,) = replays.drives(recorded)
    estimators, same = replays.replayed_estimates(drive, recordings.config_of(recorded))
    recorded_estimates = recorded.of("/estimates")
    assert same == len(drive.estimates) == len(recorded_estimates) > 25
    assert estimators.found() == calibration.world.watched.estimators.found()
    last = calibration.world.watched.found
    assert {name: recorded_estimates[-1][name] for name in last} == {name: q.value for name, q in last.items()}
    assert {recorded_estimates[-1][f"{name}_valid"] for name in last} == {0.0, 1.0}
    one = drive.samples[400]
    assert one is not None
    drive.samples[400] = one._replace(r=one.r + 1e-9)  # which the replay notices
    assert 0 < replays.replayed_estimates(drive, recordings.config_of(recorded))[1] < same


def test_the_clock_stands_while_the_human_has_the_wheel_and_the_wave_goes_on_later() -> None:
    world, guided = engaged(0.4, 3.0)
    driven = guided.driven
    assert driven == pytest.approx(3.0, abs=0.1)
    assert guided.status().startswith("sine, the wheel swings slowly: 3 s of driving left, then steps")
    world.fault("override", length=0.1, then=1.0)
    assert world.mode is Mode.OVERRIDE
    assert guided.driven == pytest.approx(driven, abs=0.1)
    assert "until you engage" in guided.status()
    world.order(Order.ACKNOWLEDGE, then=0.2)
    assert world.mode is Mode.READY, "nothing engages by itself"
    world.order(Order.ENGAGE, then=1.0)
    assert guided.wave == "sine"
    assert guided.driven == pytest.approx(4.0, abs=0.2)
    world.check_bus()


def test_below_3_metres_a_second_the_clock_stands_and_says_so() -> None:
    world, guided = engaged(0.4, 1.0, v=(2.5, 2.6))
    assert world.mode is Mode.ENGAGED
    assert guided.driven == 0.0
    assert f"below {SLOWEST:g} m/s" in guided.status()


def test_the_operator_is_warned_before_the_end(calibration: Made) -> None:
    said = calibration.world.said
    assert any("HANDS ON THE WHEEL" in text for text in said)
    assert said[-1] == "all is driven: take the wheel"
    assert not any("HANDS" in text for text in said if text.startswith(("sine", "steps")))


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"minutes": 0.0}, "minutes = 0, expected 0.1 to 60"),
        ({"minutes": float("nan")}, "minutes = nan, expected 0.1 to 60"),
        ({"base": "stanly"}, "did you mean 'stanley'"),
        ({"base": "nfq"}, "calibrate: controller"),
    ],
)
def test_what_cannot_be_driven_is_refused(more: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        check(**({"base": "stanley", "minutes": 4.0} | more))
    for minutes in (0.1, 60.0):
        check("stanley", minutes)


PRIOR = CarEstimators(CONFIG).found()


def after(before: dict[str, Estimated] | None = None, **found: tuple[float, float, float]) -> Calibrated:
    said = {name: Estimated(*numbers) for name, numbers in found.items()}
    return Calibrated(config=CONFIG, found=PRIOR | said, before=before or {}, log="d.mcap", digest="0")


found_in = cache(module.of_recording)
"""It takes seconds."""


@pytest.fixture
def record(calibration: Made, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The recording of that drive."""
    monkeypatch.setattr(module, "of_recording", found_in)
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
