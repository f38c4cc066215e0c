"""Every kind of file gives the same drive; what is none teaches."""

import gzip
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from steerkit.diagram.units import degrees_of
from steerkit.identification import Drive, read_drive
from steerkit.logs import tables
from tests.support.recorded_cars import by_rate, driven


def recorded_frames(file: Path, columns: dict[str, Any], *, spoilt: int = 0) -> None:
    """Frames of the shipped configuration, written as the car server writes them; every `spoilt`-th has a bit
    that turned over on the way."""
    from steerkit.car import recording
    from steerkit.car.config import load
    from steerkit.car.core import Frame

    car = load("dbw-kit.toml")
    recorder = recording.Recording(file, {f"file:{name}": text for name, text in car.texts.items()})
    writers = car.readers
    for k in range(len(columns["t"])):
        t = 100.0 + columns["t"][k]
        values = {name: float(columns[name][k]) for name in ("delta_sw", "v", "r")}
        values |= {"psi": float((columns["psi"][k] + np.pi) % (2.0 * np.pi) - np.pi)}
        for writer in writers:
            full = {name: values.get(name, 0.0) for name in writer.mappings}
            data = writer.write(full, count=k)
            if spoilt and k % spoilt == spoilt - 1 and writer.crc:
                data = bytes([data[0], data[1] ^ 0x10, *data[2:]])
            recorder.event(Frame(t, t, writer.message.frame_id, data), [])
    recorder.close()


def test_a_recording_of_the_real_cars_server(tmp_path: Path) -> None:
    """As it was written, cut off at the end, and with one bit turned in every 40th frame, which its check sum tells."""
    pytest.importorskip("mcap")
    columns = driven(seconds=30.0)
    recorded_frames(tmp_path / "a.mcap", columns)
    recorded_frames(tmp_path / "spoilt.mcap", columns, spoilt=40)
    whole = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: int(0.9 * len(whole))])
    drive, cut = (read_drive(tmp_path / name) for name in ("a.mcap", "cut.mcap"))
    same = Drive.of(columns)
    assert abs(len(drive.v) - len(same.v)) <= 1
    n = min(len(drive.v), len(same.v)) - 1
    np.testing.assert_allclose(drive.r[:n], same.r[:n], atol=2e-3)
    np.testing.assert_allclose(drive.delta_sw[:n], same.delta_sw[:n], atol=2e-3)
    spoilt = read_drive(tmp_path / "spoilt.mcap")
    assert any("left out" in note and "broken" in note for note in spoilt.notes)
    np.testing.assert_allclose(spoilt.delta_sw[:n], same.delta_sw[:n], atol=0.02)
    assert len(cut.v) < len(drive.v)
    assert any("cut short" in note for note in cut.notes)


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.csv", b"", "the file is empty"),
        ("a.csv", b"t,v,yaw\n1,2,3\n2,3,4\n", r"which column is delta_sw, r or psi\? Columns: v, yaw"),
        ("a.mat", b"MATLAB 5.0 or so", "no MATLAB file, or cut off"),
        ("a.npz", b"PK broken", "a.npz"),
        ("a.parquet", b"PAR1", "no Parquet file, or cut off"),
        ("a.csv.gz", b"hello", "broken, or not what its name says .*gzip"),
        ("a.csv.gz", b"\x1f\x8b", r"a\.csv\.gz: no rows under a row of names"),
    ],
)
def test_a_file_that_is_none_teaches(name: str, content: bytes, says: str, tmp_path: Path) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=says):
        read_drive(tmp_path / name)
    with pytest.raises(ValueError, match="cannot be read"):
        read_drive(tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("text", "rows", "told"),
    [
        ("\ufefft,v,w\n# 9,9,9\n\n1,2,3\r\n4,5\n6,7,8\n", [[1, 2, 3], [6, 7, 8]], "1 rows .* in the middle"),
        (f"t,v,w\n1,2,3\n4,5,x\n{'7' * 140_000},8,9\n", [[1, 2, 3], [4, 5, np.nan]], "1 rows .* the last one"),
        ("t;v,m;w\n1;2,5;3\n4;5;6\n", [[1, 2.5, 3], [4, 5, 6]], ""),
    ],
)
def test_rows_of_another_length_are_told_and_left_out(text: str, rows: Any, told: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text, encoding="utf-8", newline="")
    notes: list[str] = []
    table = tables.read_csv(tmp_path / "a.csv", (), notes)
    np.testing.assert_array_equal(list(table.columns.values()), np.transpose(rows))
    assert re.fullmatch(f"dropped {told}.*", notes[0]) if told else not notes


def test_a_file_of_an_old_program_is_read_byte_by_byte(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_bytes("t [s],Lenkwinkel [°],wz [°/s]\n1,2,3\n4,5,6\n".encode("latin-1"))
    table = tables.read_csv(tmp_path / "a.csv", (), [])
    assert table.units == {"t": "s", "Lenkwinkel": "°", "wz": "°/s"}


def test_of_arrays_those_are_read_that_hold_numbers_and_of_the_commonest_length(tmp_path: Path) -> None:
    word, long = np.array(["a", "b"]), np.arange(9.0)
    np.savez(tmp_path / "a.npz", t=[0.0, 1.0], on=[True, False], n=[3, 4], word=word, one=[1.0], long=long)
    notes: list[str] = []
    table = tables.read_npz(tmp_path / "a.npz", (), notes)
    assert {name: values.tolist() for name, values in table.columns.items()} == {"t": [0, 1], "on": [1, 0], "n": [3, 4]}
    assert notes == ["left out long (9): not of the others' length, 2"]


def test_of_an_mdf_file_those_channels_are_read_that_hold_numbers_each_with_its_time() -> None:
    def signal(*samples: Any, t: Any = (0.0, 0.1), **more: Any) -> SimpleNamespace:
        about = {"invalidation_bits": None, "unit": "m"} | more
        return SimpleNamespace(samples=np.array(samples), timestamps=t, **about)

    held = {"t": signal(0.0, 0.1), "v": signal(1, 2, invalidation_bits=[0, 1]), "word": signal("a", "b")}
    held |= {"r": signal(3.0, 4.0, unit=None), "pairs": signal([1, 2], [3, 4])} | {k: signal(1.0) for k in ("p", "q")}
    for name, one in held.items():
        one.name = name
    groups = [SimpleNamespace(channels=held, channel_group=SimpleNamespace(flags=flags)) for flags in (0x1, 0x2)]
    file = SimpleNamespace(groups=groups, masters_db={0: 0}, get=lambda group, index: list(held.values())[index])
    notes: list[str] = []
    v, r = tables._channels(file, notes)
    np.testing.assert_array_equal([v.values, r.values], [[1.0, np.nan], [3.0, 4.0]])
    assert [(one.name, one.unit) for one in (v, r)] == [("v", "m"), ("r", "")]
    assert v.t.tolist() == [0.0, 0.1]
    assert r.t is v.t
    assert notes == ["left out 2 channels that have not as many values as times"]


def test_files_cut_off_are_used_up_to_there(clean: dict[str, Any], tmp_path: Path) -> None:
    rows = [f"{t:.3f},{d:.6f},{v:.6f},{r:.6f}" for t, d, v, r in zip(*(clean[k] for k in ("t", "delta_sw", "v", "r")))]
    text = "\n".join(["t,delta_sw,v,r", *rows])
    (tmp_path / "a.csv").write_text(text[:-12])
    drive = read_drive(tmp_path / "a.csv")
    assert "left out the last line, which no line end closes: it may be cut off" in drive.notes[1]
    packed = gzip.compress(text.encode())
    (tmp_path / "b.csv.gz").write_bytes(packed[: len(packed) // 2])
    assert any("cut off" in note for note in read_drive(tmp_path / "b.csv.gz").notes)
    savemat(tmp_path / "c.mat", {key: value for key, value in clean.items() if key != "psi"})
    whole = (tmp_path / "c.mat").read_bytes()
    (tmp_path / "c.mat").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"c\.mat"):
        read_drive(tmp_path / "c.mat")


def test_files_of_different_rates_on_one_clock_are_one_drive(clean: dict[str, Any], tmp_path: Path) -> None:
    """Each quantity in a file of its own, each with its own times, units in names or in brackets."""
    t = clean["t"]
    for name, head, every, values in (
        ("wheel", "t_s,steering_wheel_deg", 1, degrees_of(clean["delta_sw"])),
        ("speed", "time [ms],speed [km/h]", 4, 3.6 * clean["v"]),
        ("gyro", "t,yaw_rate", 2, clean["r"]),
    ):
        clock = t * 1000.0 if name == "speed" else t
        rows = [f"{a!r},{b!r}" for a, b in zip(clock[::every].tolist(), values[::every].tolist())]
        (tmp_path / f"{name}.csv").write_text("\n".join([head, *rows, ""]))
    files = [tmp_path / f"{name}.csv" for name in ("wheel", "speed", "gyro")]
    drive, same = read_drive(files), Drive.of(by_rate(clean))
    assert "delta_sw = steering_wheel_deg [deg], v = speed [km/h], r = yaw_rate [rad/s]" in drive.notes[0]
    assert "one clock of 50 Hz for channels of delta_sw 50, v 12.5, r 25 Hz" in drive.notes
    n = len(drive.v)
    np.testing.assert_allclose(drive.delta_sw, same.delta_sw[:n], atol=1e-12)
    np.testing.assert_allclose(drive.v, same.v[:n], atol=1e-3)
    np.testing.assert_allclose(drive.r, same.r[:n], atol=0.01)


def test_the_time_is_the_column_that_is_named(clean: dict[str, Any], tmp_path: Path) -> None:
    rows = zip(*(column.tolist() for column in (1e3 * clean["t"], *(clean[k] for k in ("delta_sw", "v", "r")))))
    text = ["stamp,delta_sw,v,r", *(",".join(map(repr, row)) for row in rows)]
    (tmp_path / "a.csv").write_text("\n".join([*text, ""]))
    drive = read_drive(tmp_path / "a.csv", {"t": {"column": "stamp", "unit": "ms"}})
    np.testing.assert_allclose(drive.delta_sw, Drive.of(by_rate(clean)).delta_sw, atol=1e-9)


def test_a_clock_may_pass_midnight(tmp_path: Path) -> None:
    t = np.arange(0.0, 30.0, 0.05)
    clock = pd.to_datetime(86390.0 + t, unit="s").strftime("%H:%M:%S.%f")
    signals = {"steering_angle_deg": 20.0 * np.sin(t), "speed_kmh": 36.0, "yaw_rate_degs": 5.0 * np.sin(t)}
    pd.DataFrame({"time": clock, **signals}).to_csv(tmp_path / "night.csv", index=False)
    drive = read_drive(tmp_path / "night.csv")
    assert len(drive.v) == pytest.approx(len(t), abs=2)


def test_a_signal_on_rows_of_its_own_is_read_with_the_others_from_a_spreadsheets_file(tmp_path: Path) -> None:
    t = np.arange(0.0, 30.0, 0.01)
    columns = {"time [s]": t, "Steering Angle (deg)": 20.0 * np.sin(t), "yaw_rate_degs": 5.0 * np.sin(t)}
    slow = pd.DataFrame({"time [s]": t[::5] + 0.003, "speed (km/h)": 36.0})
    rows = pd.concat([pd.DataFrame(columns), slow]).sort_values("time [s]")
    file = tmp_path / "own_rows.csv"
    file.write_text("sep=;\n" + rows.to_csv(sep=";", decimal=",", index=False))
    drive = read_drive(file, dt=0.01)
    n = len(drive.v) - 2
    assert n > 2900
    assert drive.v[:n] == pytest.approx(10.0)
    assert degrees_of(np.max(drive.delta_sw)) == pytest.approx(20.0, abs=0.05)
