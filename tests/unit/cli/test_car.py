"""`steerkit car`: results where they are expected, and mistakes answered in one line with exit code 2."""

import re
from collections.abc import Callable
from pathlib import Path

import pytest

from steerkit.car import recording as recordings
from steerkit.car.config import shipped
from steerkit.car.server import CarServer
from tests.support import command_lines
from tests.support.recordings import LINES, chunks_of, flipped, small

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """`steerkit car` with these words: exit code, what it printed, and its errors."""

    def run(*words: object) -> tuple[int, str, str]:
        code = command_lines.run("car", *map(str, words), monkeypatch=monkeypatch)
        return code, *capsys.readouterr()

    return run


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A whole recording."""
    (tmp_path / "drive.mcap").write_bytes(small())
    return tmp_path / "drive.mcap"


def test_check_prints_what_is_read_and_written(run: Run) -> None:
    code, printed, _ = run("check", "dbw-kit.toml")
    assert code == 0
    for word in ("STEERING_REPORT (0x65)", "STEERING_CMD (0x64)", "path     paper", "no mistakes found"):
        assert word in printed
    bounds = re.findall(r"(\d) m/s, (straight|bend): a pose that lies unnoticed leads .* off: in (.*) s", printed)
    seconds = [float(bound) for *_, bound in bounds]
    assert [where for *where, _ in bounds] == [[v, where] for v in "259" for where in ("straight", "bend")]
    assert seconds[::2] == sorted(seconds[::2], reverse=True)  # the faster, the sooner; and sooner in bends
    assert all(0.1 < bend < straight for straight, bend in zip(seconds[::2], seconds[1::2]))


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("check", "mine.toml"), "shipped: dbw-kit.toml"),
        (("order", "GO"), "valid: ARM, ENGAGE, DISENGAGE, ACKNOWLEDGE, OFF"),
        (("order", "ENGAGE", "--socket", "/nowhere/socket"), "no car server answers there"),
        (("replay", "/dev/zero"), "/dev/zero: is a device or a pipe, expected a file"),
        (("check", "/dev/zero"), "/dev/zero: is a device or a pipe, expected a file"),
        (
            ("server", "--channel", "spy:///dev/ttyS0?file=X"),
            "[bus] channel 'spy:///dev/ttyS0?file=X': expected a serial",
        ),
        (("simulate", "--ratio", "9"), "steer_ratio = 140.4 [1], expected 1 to 50"),
        (("calibrate", "--out", "mine.csv"), "a vehicle file ends in .toml"),
        (("calibrate", "--minutes", "0"), "expected 0.1 to 60 of driving"),
        (("calibrate", "--controller", "mcp"), "valid: stanley"),
        (("calibrate", "--from", "none.mcap"), "No such file"),
        (("calibrate", "--from", __file__), "no recording of steerkit"),
    ],
)
def test_mistakes_are_one_line_and_exit_code_2(words: tuple[str, ...], says: str, run: Run) -> None:
    code, _, error = run(*words)
    assert code == 2
    assert says in error
    assert len(error.strip().splitlines()) == 1


def test_a_controller_that_is_not_known_names_the_valid_ones() -> None:
    from steerkit.car.config import load
    from steerkit.car.loop import controller_named
    from steerkit.car.processes import fault_of

    with pytest.raises(ValueError, match=r"valid: stanley, .*nfq \(the newest net in runs/car\), a learning run's"):
        controller_named("stanly", load("dbw-kit.toml"))
    fault = fault_of("delay pose 2 0.2", 5.0)
    assert (fault.kind, fault.target, fault.start, fault.length, fault.amount) == ("delay", "pose", 5.0, 2.0, 0.2)
    with pytest.raises(ValueError, match="valid: drop, delay"):
        fault_of("dorp pose", 0.0)


def test_a_recording_that_is_whole_replays_with_exit_code_0(drive: Path, run: Run) -> None:
    code, printed, _ = run("replay", drive, "--controller", "stanley")
    assert code == 0
    count = len(recordings.read(drive).messages)
    assert printed.startswith(f"{count} of {count} messages, ")
    assert "READY -> ENGAGED: operator: engage" in printed
    frames, same = re.search(r"server: (\d+) of (\d+) frames the same", printed).groups()  # type: ignore[union-attr]
    assert frames == same != "0"
    assert "stanley: " in printed
    assert [f.name for f in drive.parent.iterdir()] == ["drive.mcap"]
    code, printed, _ = run("replay", drive)
    assert code == 2
    assert "cannot be replayed: the recording does not name who steered" in printed


def test_a_damaged_recording_is_replayed_around_the_damage_with_exit_code_1(drive: Path, run: Run) -> None:
    hurt = flipped(small(), 8 * (chunks_of(small())[-2].begin + 300))
    drive.write_bytes(hurt)
    code, printed, _ = run("replay", drive, "--controller", "stanley")
    assert code == 1
    assert f"{LINES} messages are missing between" in printed
    assert "what follows missing messages may replay differently" in printed
    assert drive.read_bytes() == hurt


def test_a_recording_with_nothing_but_a_damaged_index_has_lost_nothing(drive: Path, run: Run) -> None:
    drive.write_bytes(small()[:-3])
    code, printed, _ = run("replay", drive, "--controller", "stanley")
    assert code == 0
    assert "no message is missing" in printed


def test_a_recording_that_has_to_be_kept_has_to_be_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    text = shipped("dbw-kit.toml").read_text()
    (tmp_path / "car.toml").write_text(text.replace("keep_recording = false", "keep_recording = true"))
    monkeypatch.setattr(CarServer, "run", CarServer.close)  # should it get there
    words = ("--config", tmp_path / "car.toml", "--channel", "virtual:x", "--socket", tmp_path / "socket")
    code, _, error = run("server", *words)
    assert code == 2
    assert "keep_recording = true, but nothing is recorded; give --recording" in error


def test_a_drive_that_told_nothing_of_the_car_is_exit_code_1_and_leaves_what_is_there(drive: Path, run: Run) -> None:
    out = drive.with_name("mine.toml")
    words = ("calibrate", "--from", drive, "--out", out)
    code, printed, error = run(*words)
    assert code == 1
    assert "nothing was learned, no vehicle file is written; the wheel has to move to and fro" in error
    assert "steering ratio" in printed
    assert [f.name for f in drive.parent.iterdir()] == ["drive.mcap"]
    assert run(*words, "--json", "-q")[:2] == (1, "")
    out.write_text("mine", encoding="utf-8")
    assert run(*words)[0] == 2
    assert out.read_text(encoding="utf-8") == "mine"
