"""Frames and values: against cantools, against the published CRC, and around every code."""

from __future__ import annotations

import math

import cantools
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.plants.real_car.file.config import shipped
from steerkit.plants.real_car.file.reading import load
from steerkit.plants.real_car.frames.codec import (
    MAX_JUMP,
    CommandWriter,
    FrameReader,
    Mapping,
    Protection,
    SignalEncoder,
    crc8_2f,
    frame_crc,
    signal_range,
)
from steerkit.units import degrees_of, radians_of

CONFIG = load("dbw-kit.toml")
READERS = {r.name: r for r in CONFIG.readers}
DBC = cantools.database.load_file(shipped("dbw_steering.dbc"))
POSE = cantools.database.load_file(shipped("pose.dbc"))


def test_crc_check_value_of_autosar() -> None:
    assert crc8_2f(b"123456789") == 0xDF
    assert crc8_2f(b"") == 0x00
    # AUTOSAR, Specification of CRC Routines, table of CRC8H2F examples
    assert crc8_2f(bytes(4)) == 0x12
    assert crc8_2f(bytes((0xF2, 0x01, 0x83))) == 0xC2
    assert crc8_2f(bytes((0x0F, 0xAA, 0x00, 0x55))) == 0xC6


@given(data=st.binary(min_size=8, max_size=8), bit=st.integers(0, 63), second=st.integers(0, 63))
def test_crc_finds_every_one_and_two_bit_error(data: bytes, bit: int, second: int) -> None:
    flips = (1 << bit) ^ (1 << second if second != bit else 0)
    broken = (int.from_bytes(data, "little") ^ flips).to_bytes(8, "little")
    good = bytearray(data)
    good[7] = frame_crc(data, 7, 0x120)
    broken = (int.from_bytes(good, "little") ^ flips).to_bytes(8, "little")
    assert broken[7] != frame_crc(broken, 7, 0x120)


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


def test_command_with_the_other_sign() -> None:
    mapping = Mapping(frame="STEERING_CMD", signal="SCMD", unit="deg", sign=-1.0)
    writer = CommandWriter(DBC.get_message_by_name("STEERING_CMD"), mapping, "EN")
    data = writer.write(radians_of(10.0), enable=True)
    assert DBC.decode_message("STEERING_CMD", data)["SCMD"] == pytest.approx(-10.0)
    assert writer.read(data)[0] == pytest.approx(radians_of(10.0))


@given(x=st.floats(-8000, 8000), y=st.floats(-8000, 8000), count=st.integers(0, 15), quality=st.integers(0, 15))
def test_pose_there_and_back(x: float, y: float, count: int, quality: int) -> None:
    reader = READERS["POSE_POSITION"]
    data = SignalEncoder(reader).write({"x": x, "y": y, "quality": quality}, count=count)
    checked = reader.read(data, (count - 1) % 16)
    assert checked.error == ""
    assert checked.counter == count
    assert checked.values["x"] == pytest.approx(x, abs=0.0005 + 1e-9)
    assert checked.values["quality"] == quality
    assert POSE.decode_message("POSE_POSITION", data)["Y"] == pytest.approx(y, abs=0.0005 + 1e-9)


@given(data=st.binary(max_size=12), counter=st.none() | st.integers(0, 15))
def test_reading_raises_nothing(data: bytes, counter: int | None) -> None:
    for reader in CONFIG.readers:
        checked = reader.read(data, counter)
        assert bool(checked.error) is not bool(checked.values)


@pytest.mark.parametrize("jump", range(16))
def test_counter_rule(jump: int) -> None:
    reader = READERS["POSE_MOTION"]
    data = SignalEncoder(reader).write({"psi": 0.1, "v": 5.0, "r": 0.0}, count=9 + jump)
    checked = reader.read(data, 9)
    assert (checked.error == "") is (1 <= jump <= MAX_JUMP)
    if checked.error:
        assert f"counter {(9 + jump) % 16} after 9" in checked.error
        assert checked.counter == (9 + jump) % 16  # so that one error is one error


def test_code_0x8000_is_no_value() -> None:
    reader = READERS["STEERING_REPORT"]
    good = SignalEncoder(reader).write({"delta_sw": 1.0, "v_kit": 5.0, "torque": 0.0})
    assert math.isfinite(reader.read(good, None).values["delta_sw"])
    values = reader.read(b"\x00\x80" + good[2:], None).values
    assert math.isnan(values["delta_sw"])
    assert math.isfinite(values["v_kit"])
    bad = SignalEncoder(reader).write({"delta_sw": math.nan, "v_kit": 5.0})
    assert bad[:2] == b"\x00\x80"


def test_units_and_signs() -> None:
    message = DBC.get_message_by_name("STEERING_REPORT")
    mappings = {
        "v_kit": Mapping(frame="STEERING_REPORT", signal="VEH_VEL", unit="km/h"),
        "delta_sw": Mapping(frame="STEERING_REPORT", signal="ANGLE", unit="deg", sign=-1.0, offset=0.5),
    }
    data = message.encode({s.name: 0 for s in message.signals} | {"VEH_VEL": 36.0, "ANGLE": 90.0})
    values = FrameReader(message, mappings, Protection()).read(data, None).values
    assert values["v_kit"] == pytest.approx(10.0)
    assert values["delta_sw"] == pytest.approx(0.5 - math.pi / 2)


def test_range_of_a_signal_without_one_in_the_dbc() -> None:
    text = 'VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|16@1- (0.5,1) [0|0] "m" A\n SG_ U : 16|8@1+ (1,0) [0|0] "" A\n'
    message = cantools.database.load_string(text, "dbc").get_message_by_name("M")
    low, high = signal_range(message.get_signal_by_name("S"))
    assert low == pytest.approx(1 - 32767 / 2, abs=1e-5)
    assert high == pytest.approx(1 + 32767 / 2, abs=1e-5)
    assert signal_range(message.get_signal_by_name("U"))[1] == pytest.approx(255.0, abs=1e-5)
