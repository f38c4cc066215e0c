"""`steerkit car`: results where they are expected; its mistakes stand in test_app.py."""

import re
from pathlib import Path
from typing import Any

import pytest

from steerkit.car.config import shipped
from steerkit.car.processes import fault_of
from steerkit.car.server import CarServer
from tests.support.recordings import LINES, chunks_of, flipped, small


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A whole recording."""
    (tmp_path / "drive.mcap").write_bytes(small())
    return tmp_path / "drive.mcap"


def test_check_prints_what_is_read_and_written(cli: Any) -> None:
    printed = cli("car", "check", "dbw-kit.toml").out
    for word in ("STEERING_REPORT (0x65)", "STEERING_CMD (0x64)", "path     paper", "no mistakes found"):
        assert word in printed
    bounds = re.findall(r"(\d) m/s, (straight|bend): a pose that lies unnoticed leads .* off: in (.*) s", printed)
    seconds = [float(bound) for *_, bound in bounds]
    assert [where for *where, _ in bounds] == [[v, where] for v in "259" for where in ("straight", "bend")]
    assert seconds[::2] == sorted(seconds[::2], reverse=True)  # the faster, the sooner; and sooner in bends
    assert all(0.1 < bend < straight for straight, bend in zip(seconds[::2], seconds[1::2]))


def test_a_fault_in_words() -> None:
    fault = fault_of("delay pose 2 0.2", 5.0)
    assert (fault.kind, fault.target, fault.start, fault.length, fault.amount) == ("delay", "pose", 5.0, 2.0, 0.2)
    with pytest.raises(ValueError, match="valid: drop, delay"):
        fault_of("dorp pose", 0.0)


def test_a_damaged_recording_is_replayed_around_the_damage_with_exit_code_1(drive: Path, cli: Any) -> None:
    assert "cannot be replayed: the recording does not name who steered" in cli("car", "replay", drive, code=2).out
    hurt = flipped(small(), 8 * (chunks_of(small())[-2].begin + 300))
    drive.write_bytes(hurt)
    printed = cli("car", "replay", drive, "--controller", "stanley", code=1).out
    assert f"{LINES} messages are missing between" in printed
    assert "what follows missing messages may replay differently" in printed
    assert drive.read_bytes() == hurt


def test_a_recording_to_be_kept_has_to_be_made(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    text = shipped("dbw-kit.toml").read_text()
    (tmp_path / "car.toml").write_text(text.replace("keep_recording = false", "keep_recording = true"))
    monkeypatch.setattr(CarServer, "run", CarServer.close)  # should it get there
    words = ("--config", tmp_path / "car.toml", "--channel", "virtual:x", "--socket", tmp_path / "socket")
    error = cli("car", "server", *words, code=2).err
    assert "keep_recording = true, but nothing is recorded; give --recording" in error


def test_a_drive_that_told_nothing_of_the_car_is_exit_code_1_and_leaves_what_is_there(drive: Path, cli: Any) -> None:
    out = drive.with_name("mine.toml")
    words = ("car", "calibrate", "--from", drive, "--out", out)
    printed, error = cli(*words, code=1)
    assert "nothing was learned, no vehicle file is written; the wheel has to move to and fro" in error
    assert "steering ratio" in printed
    assert [f.name for f in drive.parent.iterdir()] == ["drive.mcap"]
    assert cli(*words, "--json", "-q", code=1).out == ""
    out.write_text("mine", encoding="utf-8")
    cli(*words, code=2)
    assert out.read_text(encoding="utf-8") == "mine"
