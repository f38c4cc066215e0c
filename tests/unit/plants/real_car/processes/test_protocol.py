"""Packets between car server and client: there and back, strange ones are told."""

from __future__ import annotations

import struct
from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from steerkit.plants.real_car.decisions.modes import Mode
from steerkit.plants.real_car.processes.protocol import Snapshot, decode, encode
from tests.support.car_messages import messages


@given(message=messages)
def test_packets_there_and_back(message: Any) -> None:
    assert repr(decode(encode(message))) == repr(message)


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
