"""Frames and values: against cantools, the published CRC, around every code; python-can; the end of an slcan line."""

import math
import os
import subprocess
import sys
import time
import tty
from pathlib import Path

import cantools
import pytest
import scipy.constants
from hypothesis import given
from hypothesis import strategies as st

from steerkit.car.config import load, shipped
from steerkit.car.ports import (
    UNIT_FACTORS,
    CommandWriter,
    FrameReader,
    Mapping,
    SlcanPort,
    frame_crc,
    open_bus,
    signal_range,
)
from steerkit.diagram.units import degrees_of, radians_of

CONFIG = load("dbw-kit.toml")
READERS = {r.name: r for r in CONFIG.readers}
DBC = cantools.database.load_file(shipped("dbw_steering.dbc"))


@pytest.mark.parametrize("at", [0, 1])
def test_crc_check_value_of_autosar(at: int) -> None:
    def crc(covered: bytes) -> int:
        data, frame_id = covered[:-2], covered[-2] + 256 * covered[-1]
        return frame_crc(data[:at] + b"\xff" + data[at:], at, frame_id)

    assert crc(b"123456789") == 0xDF
    # AUTOSAR, Specification of CRC Routines, table of CRC8H2F examples
    assert crc(bytes(4)) == 0x12
    assert crc(bytes((0xF2, 0x01, 0x83))) == 0xC2
    assert crc(bytes((0x0F, 0xAA, 0x00, 0x55))) == 0xC6


GOLDEN = {  # made with cantools 41 and the Crc8Autosar of crccheck 1.3
    "POSE_POSITION": ("3930007be5ff9406", {"x": 12.345, "y": -6.789, "quality": 4.0}, 9),
    "POSE_MOTION": ("b4e27c15e204e032", {"psi": -0.75, "v": 5.5, "r": 0.125}, 14),
}


@pytest.mark.parametrize("name", GOLDEN)
def test_frames_of_another_program_are_read_and_written(name: str) -> None:
    text, values, count = GOLDEN[name]
    data = bytes.fromhex(text)
    checked = READERS[name].read(data, None)
    assert (checked.error, checked.counter) == ("", count)
    assert checked.values == pytest.approx(values, abs=1e-9)
    assert READERS[name].write(values, count=count) == data


def test_a_frame_of_another_id_or_length_is_refused() -> None:
    position, motion = (bytes.fromhex(GOLDEN[name][0]) for name in ("POSE_POSITION", "POSE_MOTION"))
    assert "CRC" in READERS["POSE_MOTION"].read(position, None).error
    assert "CRC" in READERS["POSE_POSITION"].read(motion, None).error
    for name, reader in READERS.items():
        good = reader.write({})
        for data in (good + b"\x00", good[:-1], b""):
            assert f"{name}: {len(data)} bytes, expected 8" in reader.read(data, None).error


@given(data=st.binary(min_size=7, max_size=7), bit=st.integers(0, 63), second=st.integers(0, 63))
def test_every_error_of_one_or_two_bits_is_found(data: bytes, bit: int, second: int) -> None:
    flips = 1 << bit ^ (1 << second if second != bit else 0)
    good = data + bytes([frame_crc(data + b"\0", 7, 0x120)])
    checked = READERS["POSE_POSITION"].read((int.from_bytes(good, "little") ^ flips).to_bytes(8, "little"), None)
    assert "CRC" in checked.error
    assert not checked.values


@given(delta_sw=st.integers(-5200, 5200), enable=st.booleans(), count=st.integers(0, 1000))
def test_command_is_what_cantools_reads(delta_sw: int, enable: bool, count: int) -> None:
    data = CONFIG.writer.write(radians_of(0.1 * delta_sw), enable=enable, count=count)
    read = DBC.decode_message("STEERING_CMD", data)
    assert read["SCMD"] == pytest.approx(0.1 * delta_sw, abs=1e-9)
    assert (read["EN"], read["COUNT"], read["CLEAR"]) == (enable, count % 256, 0)
    back, enabled, clear = CONFIG.writer.read(data)
    assert (round(degrees_of(back) * 10), enabled, clear) == (delta_sw, enable, False)


def test_command_refuses_what_does_not_fit() -> None:
    with pytest.raises(ValueError, match="beyond the DBC's range"):
        CONFIG.writer.write(radians_of(4000.0), enable=True)
    assert CONFIG.writer.quantum == pytest.approx(radians_of(0.1))


@given(data=st.binary(max_size=12), counter=st.none() | st.integers(0, 15))
def test_reading_raises_nothing(data: bytes, counter: int | None) -> None:
    for reader in CONFIG.readers:
        checked = reader.read(data, counter)
        assert bool(checked.error) is not bool(checked.values)


def test_counter_rule() -> None:
    reader = READERS["POSE_MOTION"]
    for jump in range(16):
        checked = reader.read(reader.write({"psi": 0.1, "v": 5.0, "r": 0.0}, count=9 + jump), 9)
        assert (checked.error == "") is (1 <= jump <= 3)
        assert checked.error == "" or f"counter {(9 + jump) % 16} after 9" in checked.error
        assert checked.counter == (9 + jump) % 16  # so that one error is one error


def test_code_0x8000_is_no_value() -> None:
    reader = READERS["STEERING_REPORT"]
    good = reader.write({"delta_sw": 1.0, "v_kit": 5.0, "torque": 0.0})
    assert math.isfinite(reader.read(good, None).values["delta_sw"])
    values = reader.read(b"\x00\x80" + good[2:], None).values
    assert math.isnan(values["delta_sw"])
    assert math.isfinite(values["v_kit"])
    bad = reader.write({"delta_sw": math.nan, "v_kit": 5.0})
    assert bad[:2] == b"\x00\x80"


def test_a_quantity_is_sign_scale_unit_and_offset() -> None:
    message = DBC.get_message_by_name("STEERING_REPORT")
    mappings = {
        "v_kit": Mapping(frame="STEERING_REPORT", signal="VEH_VEL", unit="km/h", scale=2.0),
        "delta_sw": Mapping(frame="STEERING_REPORT", signal="ANGLE", unit="deg", sign=-1.0, offset=0.5),
    }
    data = message.encode({s.name: 0 for s in message.signals} | {"VEH_VEL": 36.0, "ANGLE": 90.0})
    values = FrameReader(message, mappings).read(data, None).values
    assert values == pytest.approx({"v_kit": 20.0, "delta_sw": 0.5 - math.pi / 2})


def test_units_are_those_of_the_tables() -> None:
    prefixes = {"cm": "centi", "mm": "milli", "ms": "milli", "us": "micro"}
    tables = {"mph": "mph", "km/h": "kmh", "g": "g", "deg": "degree", "deg/s": "degree", **prefixes}
    for unit, name in tables.items():
        assert UNIT_FACTORS[unit] == pytest.approx(getattr(scipy.constants, name), rel=1e-14), unit


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("zero", "reach"), [(0.0, "0|0"), (-100.0, "0|0"), (-100.0, "-120|120")])
def test_offsets_of_the_file_and_of_the_dbc(sign: float, zero: float, reach: str) -> None:
    """delta_sw = sign*SCMD + offset, and SCMD [deg] = 0.1 code + zero: both ends agree with cantools."""
    text = shipped("dbw_steering.dbc").read_text().replace("(0.1,0) [-3276.7|3276.7]", f"(0.1,{zero:g}) [{reach}]")
    message = cantools.database.load_string(text, "dbc").get_message_by_name("STEERING_CMD")
    mapping = Mapping(frame="STEERING_CMD", signal="SCMD", unit="deg", sign=sign, offset=radians_of(7.5))
    writer = CommandWriter(message, mapping, "EN")
    data = writer.write(radians_of(20.0), enable=True)
    assert message.decode(data)["SCMD"] == pytest.approx(sign * (20.0 - 7.5))
    reader = FrameReader(message, {"delta_sw": mapping})
    assert reader.read(data, None).values["delta_sw"] == pytest.approx(radians_of(20.0))
    assert reader.write({"delta_sw": radians_of(20.0)}) == writer.write(radians_of(20.0), enable=False)
    if zero == 0.0:
        assert writer.read(data)[0] == pytest.approx(radians_of(20.0))


def test_the_simulated_cars_frames_are_saturated() -> None:
    reader = READERS["POSE_MOTION"]
    for value, bound in ((1e9, 32.767), (-1e9, -32.767)):
        values = reader.read(reader.write({"psi": 0.0, "v": value, "r": 0.0}), None).values
        assert values["v"] == pytest.approx(bound, abs=1e-3)


def test_range_of_a_signal_without_one_in_the_dbc() -> None:
    text = 'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|16@1- (0.5,1) [0|0] "m" A\n SG_ U : 16|8@1+ (1,0) [0|0] "" A\n'
    message = cantools.database.load_string(text, "dbc").get_message_by_name("M")
    low, high = signal_range(message.get_signal_by_name("S"))
    assert low == pytest.approx(1 - 32767 / 2, abs=1e-5)
    assert high == pytest.approx(1 + 32767 / 2, abs=1e-5)
    assert signal_range(message.get_signal_by_name("U"))[1] == pytest.approx(255.0, abs=1e-5)
    reader = FrameReader(message, {"s": Mapping(frame="M", signal="S"), "u": Mapping(frame="M", signal="U")})
    for code in (-32767, 32767):  # the ends are values; the code below them is that of `not available`
        assert reader.read(message.encode({"S": code, "U": 255}, scaling=False), None).values["s"] == 1.0 + code / 2
    assert math.isnan(reader.read(message.encode({"S": -32768, "U": 0}, scaling=False), None).values["s"])
    assert reader.read(message.encode({"S": 0, "U": 255}, scaling=False), None).values["u"] == 255.0


def test_it_does_not_load_asammdf_which_stays_there_for_who_asks_for_it() -> None:
    text = """
import sys
from steerkit.car.ports import python_can
can = python_can()
assert can.Message(arbitration_id=3, data=b"ab").dlc == 2
import cantools
assert "asammdf" not in sys.modules  # it takes seconds
assert python_can() is can
"""
    subprocess.run([sys.executable, "-c", text], check=True)


def test_frames_as_text_in_both_directions() -> None:
    port = SlcanPort()
    fd = os.open(port.channel, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(fd)
        port.send(0x1AB, b"\x01\xfe")
        assert os.read(fd, 100) == b"t1AB201FE\r"
        port.send(0x5, b"")
        assert os.read(fd, 100) == b"t0050\r"
        # a good one; 3 bytes said, 2 there; open; no number; a half; its rest
        os.write(fd, b"t1002AABB\rt1003AABB\rO\rt1002XXYY\rt06")
        frames = port.wait(5.0)
        os.write(fd, b"41FF\r")
        end = time.monotonic() + 30.0
        while len(frames) < 2 and time.monotonic() < end:
            frames += port.wait(1.0)
        assert frames == [(0x100, b"\xaa\xbb"), (0x064, b"\xff")]
    finally:
        os.close(fd)
        port.close()


def test_nothing_is_read_from_python_cans_own_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "can.conf").write_text("[default]\nreceive_own_messages = True\n")
    monkeypatch.setenv("HOME", f"{tmp_path}")
    with open_bus({"interface": "virtual", "channel": f"{tmp_path}"}) as bus:
        assert bus.receive_own_messages is False
