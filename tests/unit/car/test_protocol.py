"""Packets between car server and client: there and back, strange ones are told."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.car.protocol import (
    ESTIMATES,
    MAX_PACKET,
    Adapted,
    Beat,
    Command,
    Estimates,
    Filtered,
    Hello,
    Query,
    Refused,
    Remark,
    Request,
    Snapshot,
    decode,
    encode,
)
from steerkit.car.state_machine import Mode, Order
from tests.support.car_messages import messages


@given(message=messages)
def test_packets_there_and_back(message: Any) -> None:
    assert repr(decode(encode(message))) == repr(message)


@pytest.mark.parametrize("message", [Remark("net.npz: ä"), Refused("no"), Adapted(0.1 + 0.2, 1 / 3)])
def test_words_and_what_is_believed_come_back(message: Any) -> None:
    assert decode(encode(message)) == message


def test_a_remark_that_fills_a_packet_is_refused() -> None:
    assert decode(encode(Remark("x" * (MAX_PACKET - 1)))) == Remark("x" * (MAX_PACKET - 1))
    with pytest.raises(ValueError, match=f"remark of {MAX_PACKET} bytes, expected less"):
        encode(Remark("x" * MAX_PACKET))


@given(numbers=st.lists(st.floats(), min_size=19, max_size=19), mode=st.sampled_from(Mode), text=st.text(max_size=200))
def test_snapshots_there_and_back(numbers: list[float], mode: Mode, text: str) -> None:
    snapshot = Snapshot(*numbers[: len(Snapshot._fields) - 2], mode=mode, text=text)
    again = decode(encode(snapshot))
    assert struct.pack("<3d", *again[:3]) == struct.pack("<3d", *snapshot[:3])
    assert (again.mode, again.text) == (mode, text)  # type: ignore[union-attr]


@given(packet=st.binary(max_size=200))
def test_strange_packets_are_value_errors(packet: bytes) -> None:
    try:
        decode(packet)
    except ValueError as error:
        assert "packet" in str(error)  # noqa: PT017


def test_layouts_are_written_down() -> None:
    assert encode(Request(1.5, -0.25, 7)) == b"R" + struct.pack("<ddI", 1.5, -0.25, 7)
    assert encode(Query()) == b"Q"
    assert encode(Hello(True)) == b"H\x01\x03" + bytes(8)
    assert encode(Hello(False, course=b"12345678")) == b"H\x00\x0312345678"
    assert encode(Beat()) == b"B"
    assert [encode(Command(order)) for order in Order] == [b"O" + bytes((k,)) for k in range(5)]


@pytest.mark.parametrize("mode", Mode)
def test_every_number_of_a_snapshot_comes_back_bit_for_bit_in_its_place(mode: Mode) -> None:
    numbers = [1.0 / (k + 3) for k in range(len(Snapshot._fields) - 2)]  # none is a single-precision number
    snapshot = Snapshot(*numbers, mode=mode, text="why: ä")
    assert decode(encode(snapshot)) == snapshot


def test_estimates_are_named_in_their_order_and_come_back_bit_for_bit() -> None:
    numbers = tuple(1.0 / (k + 3) for k in range(3 * len(ESTIMATES)))
    estimates = Estimates(numbers)
    assert decode(encode(estimates)) == estimates
    named = estimates.named()
    assert [*named][:4] == ["delay", "delay_deviation", "delay_valid", "lag"]
    assert [*named.values()] == [*numbers]
    with pytest.raises(ValueError, match="packet b'F'"):
        decode(encode(estimates)[:-1])


def test_what_the_filter_did_comes_back_bit_for_bit_in_its_place() -> None:
    did = Filtered(*[1.0 / (k + 3) for k in range(5)])
    assert decode(encode(did)) == did
    assert did._fields == ("command", "delta_sw", "share", "reach", "reason")
    with pytest.raises(ValueError, match="packet b'C'"):
        decode(encode(did)[:-1])
