"""`steerkit car`: results where they are expected, and mistakes answered in one line with exit code 2."""

from __future__ import annotations

import fcntl
import re
from pathlib import Path

import pytest

from steerkit.car import recording as recordings
from steerkit.car.config import shipped
from steerkit.car.server import CarServer
from tests.support import command_lines
from tests.support.recordings import LINES, chunks_of, flipped, small


def run(*words: str, monkeypatch: pytest.MonkeyPatch) -> int:
    return command_lines.run("car", *words, monkeypatch=monkeypatch)


def test_check_prints_what_is_read_and_written(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("check", "dbw-kit.toml", monkeypatch=monkeypatch) == 0
    printed = capsys.readouterr().out
    for word in ("STEERING_REPORT (0x65)", "STEERING_CMD (0x64)", "path     paper", "no mistakes found"):
        assert word in printed


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("check", "mine.toml"), "shipped: dbw-kit.toml"),
        (("order", "GO"), "valid: ARM, ENGAGE, DISENGAGE, ACKNOWLEDGE, OFF"),
        (("order", "ENGAGE", "--socket", "/nowhere/socket"), "no car server answers there"),
        (("replay", "/dev/null"), "no recording of steerkit"),
        (("simulate", "--listen", "0.0.0.0:0"), "only 127.0.0.1"),
        (("simulate", "--ratio", "9"), "steer_ratio = 140.4 [1], expected 1 to 50"),
        (("calibrate", "mine.toml"), "shipped: dbw-kit.toml"),
        (("calibrate", "--out", "mine.csv"), "a vehicle file ends in .toml"),
        (("calibrate", "--minutes", "0"), "expected 0.1 to 60 of driving"),
        (("calibrate", "--controller", "mcp"), "valid: stanley"),
        (("calibrate", "--from", "none.mcap"), "No such file"),
        (("calibrate", "--from", "/dev/null"), "no recording of steerkit"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(
    words: tuple[str, ...], says: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(*words, monkeypatch=monkeypatch) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert len(error.splitlines()) == 1


def test_check_knows_the_courses(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "car.toml"
    file.write_text(shipped("dbw-kit.toml").read_text().replace('name = "paper"', 'name = "papre"'))
    assert run("check", str(file), monkeypatch=monkeypatch) == 2
    assert f"{file}: [course] name: course: 'papre' is not known; did you mean 'paper'?" in capsys.readouterr().err


def test_a_controller_that_is_not_known_names_the_valid_ones(tmp_path: Path) -> None:
    from steerkit.car.config import load
    from steerkit.car.loop import controller_named
    from steerkit.car.processes import fault_of

    with pytest.raises(ValueError, match=r"valid: stanley, .*nfq \(the newest net in runs/car\), a learning run's"):
        controller_named("stanly", load("dbw-kit.toml"))
    with pytest.raises(ValueError, match="nor a place with a trained policy"):
        controller_named(str(tmp_path), load("dbw-kit.toml"))
    fault = fault_of("delay pose 2 0.2", 5.0)
    assert (fault.kind, fault.target, fault.start, fault.length, fault.amount) == ("delay", "pose", 5.0, 2.0, 0.2)
    with pytest.raises(ValueError, match="valid: drop, delay"):
        fault_of("dorp pose", 0.0)


def test_a_recording_that_is_whole_replays_with_exit_code_0(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "drive.mcap"
    file.write_bytes(small())
    assert run("replay", str(file), "--controller", "stanley", monkeypatch=monkeypatch) == 0
    printed = capsys.readouterr().out
    count = len(recordings.read(file).messages)
    assert printed.startswith(f"{count} of {count} messages, ")
    assert "READY -> ENGAGED: operator: engage" in printed
    frames, same = re.search(r"server: (\d+) of (\d+) frames the same", printed).groups()  # type: ignore[union-attr]
    assert frames == same != "0"
    assert "stanley: " in printed
    assert [f.name for f in tmp_path.iterdir()] == ["drive.mcap"]
    assert run("replay", str(file), monkeypatch=monkeypatch) == 2
    assert "cannot be replayed: the recording does not name who steered" in capsys.readouterr().out


def test_a_damaged_recording_is_repaired_into_a_new_file_with_exit_code_1(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, words = tmp_path / "drive.mcap", ("--controller", "stanley")
    hurt = flipped(small(), 8 * (chunks_of(small())[-2].begin + 300))
    file.write_bytes(hurt)
    assert run("replay", str(file), *words, monkeypatch=monkeypatch) == 1
    printed = capsys.readouterr().out
    assert f"{LINES} messages are missing between" in printed
    assert f"drive.repaired.mcap; {file} is as it was" in printed
    assert "what follows missing messages may replay differently" in printed
    assert file.read_bytes() == hurt
    repaired = tmp_path / "drive.repaired.mcap"
    repaired.write_bytes(b"mine")
    assert run("replay", str(file), *words, monkeypatch=monkeypatch) == 1
    assert "not repaired: " in capsys.readouterr().out
    assert repaired.read_bytes() == b"mine"
    assert run("replay", str(file), *words, "--overwrite", monkeypatch=monkeypatch) == 1
    assert run("replay", str(repaired), *words, monkeypatch=monkeypatch) == 1  # what was missing before still is
    assert f"{LINES} messages are missing between" in capsys.readouterr().out
    assert sorted(f.name for f in tmp_path.iterdir()) == ["drive.mcap", "drive.repaired.mcap"]


def test_a_recording_with_nothing_but_a_damaged_index_has_lost_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "drive.mcap"
    file.write_bytes(small()[:-3])
    out = tmp_path / "new.mcap"
    assert run("replay", str(file), "--controller", "stanley", "--out", str(out), monkeypatch=monkeypatch) == 0
    assert "no message is missing" in capsys.readouterr().out
    assert recordings.read(out).whole


def test_a_recording_in_use_is_only_looked_into(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "drive.mcap"
    file.write_bytes(small()[:-3])
    with file.open("rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        assert run("replay", str(file), "--controller", "stanley", monkeypatch=monkeypatch) == 0
        assert "being written by a car server: this is what is there so far" in capsys.readouterr().out
        assert run("replay", str(file), "--out", str(tmp_path / "new.mcap"), monkeypatch=monkeypatch) == 2
        assert "repair it when that has ended" in capsys.readouterr().err
    assert [f.name for f in tmp_path.iterdir()] == ["drive.mcap"]


def test_a_recording_that_has_to_be_kept_has_to_be_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = shipped("dbw-kit.toml").read_text()
    (tmp_path / "car.toml").write_text(text.replace("keep_recording = false", "keep_recording = true"))
    monkeypatch.setattr(CarServer, "run", CarServer.close)  # should it get there
    words = ("--config", str(tmp_path / "car.toml"), "--channel", "virtual:x", "--socket", str(tmp_path / "socket"))
    assert run("server", *words, monkeypatch=monkeypatch) == 2
    assert "keep_recording = true, but nothing is recorded; give --recording" in capsys.readouterr().err


def test_a_drive_that_told_nothing_of_the_car_is_exit_code_1_and_leaves_what_is_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, out = tmp_path / "drive.mcap", tmp_path / "mine.toml"
    file.write_bytes(small())
    words = ("calibrate", "--from", str(file), "--out", str(out))
    assert run(*words, monkeypatch=monkeypatch) == 1
    told = capsys.readouterr()
    assert "nothing was learned, no vehicle file is written; the wheel has to move to and fro" in told.err
    assert "steering ratio" in told.out
    assert [f.name for f in tmp_path.iterdir()] == ["drive.mcap"]
    assert run(*words, "--json", "-q", monkeypatch=monkeypatch) == 1
    assert capsys.readouterr().out == ""
    out.write_text("mine", encoding="utf-8")
    assert run(*words, monkeypatch=monkeypatch) == 2
    assert out.read_text(encoding="utf-8") == "mine"
