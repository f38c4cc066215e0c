"""CAN logs: what the DBC says, to the last decimal; frames that were spoilt are left out."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from steerkit.logs import read_drive, read_log
from tests.support.places import SUPPORT
from tests.support.written_logs import DBC, driven, written

pytest.importorskip("can")
pytest.importorskip("cantools")
RAV4 = SUPPORT / "rav4"
FILES = [RAV4 / name for name in ("can.log.gz", "steering.csv.gz", "speed.csv.gz", "gyro.csv.gz", "gnss.csv.gz")]
MAKER = "toyota_nodsu_pt_generated"


def test_a_real_car_by_the_makers_dbc_agrees_with_its_separate_sensors() -> None:
    """25 s of a production car: its bus, the steering and speed that others read from it, a telephone's gyro, GNSS."""
    pytest.importorskip("opendbc")
    log = read_log(FILES, dbc=MAKER)
    wheel, recorded = (
        log.channels["STEER_ANGLE_SENSOR.STEER_ANGLE + STEER_FRACTION"],
        log.channels["steering_wheel_deg"],
    )
    np.testing.assert_array_equal(wheel.t, recorded.t)
    np.testing.assert_array_equal(wheel.values, recorded.values)
    speed = log.channels["WHEEL_SPEEDS.mean"]
    np.testing.assert_allclose(speed.values / 3.6, log.channels["speed_mps"].values, atol=5.1e-5)  # it has four digits
    drive = read_drive(FILES, dbc=MAKER)
    assert drive.x is not None
    assert drive.y is not None
    known = np.isfinite(drive.x) & np.isfinite(drive.y)
    way = float(np.sum(np.hypot(np.diff(drive.x[known]), np.diff(drive.y[known]))))
    assert way == pytest.approx(float(np.sum(drive.v[known]) * drive.dt), rel=0.02)


def test_frames_that_do_not_hold_their_check_sum_are_left_out(tmp_path: Path) -> None:
    file, how = written("candump", tmp_path, driven())
    lines = file.read_text().splitlines()
    spoilt = [line[:-17] + "7" + line[-16:] if k % 50 == 7 and "#0" in line else line for k, line in enumerate(lines)]
    assert spoilt != lines
    file.write_text("\n".join(spoilt))
    drive = read_drive(file, **how)
    assert any("check sum or length are wrong" in note for note in drive.notes)
    np.testing.assert_allclose(drive.v[:490], driven()["v"][:490], atol=0.03)


def test_a_candump_line_that_lost_a_character_is_no_frame_and_an_error_frame_is_none(tmp_path: Path) -> None:
    """python-can reads each of them, as a frame of another time, identifier or data."""
    file, how = written("candump", tmp_path, driven())
    whole = read_log(file, **how)
    time, _, frame = file.read_text().split()[:3]
    good, broken = f"can0 {frame}", f"{time} can0"
    lost = [f"{time[1:]} {good}", f"{time[:-1]} {good}", f"{broken} {frame[:-1]}", f"{broken} -{frame}", broken]
    error = f"{time} can0 20000025#0004000000000000"
    packed = file.with_suffix(".log.gz")
    packed.write_bytes(gzip.compress("\n".join([*lost, error, file.read_text()]).encode()))
    log = read_log(packed, **how)
    assert log.notes == ("left out 5 lines that are no frames",)
    assert {name: len(channel.t) for name, channel in log.channels.items()} == {
        name: len(channel.t) for name, channel in whole.channels.items()
    }


@pytest.mark.parametrize(
    ("dbc", "says"),
    [
        ("", r"identifiers \(0x25 \(500\), 0x26 \(500\)\); say what is in them with --dbc FILE.dbc"),
        ("none.dbc", "cannot be read"),
        ("toyota_nodsu_pt_generate", r"did you mean 'toyota_nodsu_pt_generated'"),
        ("other.dbc", "none of its identifiers .* is in"),
        ("broken.dbc", "no DBC"),
    ],
)
def test_a_wrong_dbc_teaches(dbc: str, says: str, tmp_path: Path) -> None:
    if dbc.startswith("toyota"):
        pytest.importorskip("opendbc")
    file, _ = written("candump", tmp_path, driven())
    (tmp_path / "other.dbc").write_text(DBC.replace("BO_ 37", "BO_ 700").replace("BO_ 38", "BO_ 701"))
    (tmp_path / "broken.dbc").write_text("BO_ 37 WHEEL 8 CAR\n")
    with pytest.raises(ValueError, match=says):
        read_log(file, dbc=[str(tmp_path / dbc) if dbc.endswith(".dbc") else dbc] if dbc else ())


def test_lines_of_trc_that_are_no_frames_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, how = written("trc", tmp_path, driven())
    lines = file.read_text().splitlines()
    lines[100], lines[300] = lines[100][:20], "garbage"
    file.write_text("\n".join(lines))
    assert "left out 2 lines that are no frames" in read_drive(file, **how).notes
    assert not capsys.readouterr().err
