"""Packets between car server and client: there and back, strange ones are told."""

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.car.protocol import ESTIMATES, MAX_PACKET, Message, Refused, Remark, Request, Snapshot, decode, encode
from steerkit.car.state_machine import Mode
from tests.support.car_messages import messages

snapshots = st.builds(
    lambda numbers, mode, holder, text: Snapshot(*numbers, mode, holder, text),
    st.lists(st.floats(), min_size=len(Snapshot._fields) - 3, max_size=len(Snapshot._fields) - 3),
    st.sampled_from(Mode),
    st.text(max_size=80),
    st.text(max_size=200),
)
words = st.one_of(st.builds(Remark, st.text(max_size=200)), st.builds(Refused, st.text(max_size=200)))


@given(message=st.one_of(messages, snapshots, words))
def test_messages_come_back_bit_for_bit(message: Message) -> None:
    again = decode(encode(message))
    assert type(again) is type(message)
    assert repr(again) == repr(message)


def test_a_remark_that_fills_a_packet_is_refused_and_words_for_people_are_cut() -> None:
    room = MAX_PACKET - len(encode(Remark("")))
    assert decode(encode(Remark("x" * room))) == Remark("x" * room)
    with pytest.raises(ValueError, match=f"Remark of {MAX_PACKET + 1} bytes, expected at most {MAX_PACKET}"):
        encode(Remark("x" * (room + 1)))
    assert decode(encode(Refused("\U0001f697" * MAX_PACKET))) == Refused("\U0001f697" * 2000)


@given(packet=st.binary(max_size=200))
def test_strange_packets_are_value_errors(packet: bytes) -> None:
    with pytest.raises(ValueError, match=f"packet .* of {len(packet)} bytes is not known"):
        decode(packet)


REQUEST = json.loads(encode(Request(1.5, -0.25, 7)))
FOUND = [1.0 / (k + 3) for k in range(3 * len(ESTIMATES))]
STRANGE: list[Any] = [
    *([], 3, {}, {"Query": 1}, None, ["Reqest", *REQUEST[1:]], REQUEST[:-1], [*REQUEST, 1.0]),
    *(["Request", value, 0.0, 0] for value in ("x", "1.5", "nan", True, None, [], {}, 10**400)),
    *(["Request", 0.0, 0.0, value] for value in (1.5, True, "1", None, -1, 1 << 32, 10**4299)),
    *([["Command", "FASTER"], ["Command", []], ["Remark", 1], ["Hello", 1, 7, "", ""], ["Hello", True, 7, None, ""]]),
    *(["Hello", True, *rest] for rest in ([], ["4"], [7], [7, ""], [7, "", None], [7, "", "", ""])),
    *(["Estimates", value] for value in (FOUND[1:], [*FOUND, 0.0], 1.0, "1" * len(FOUND), [*FOUND[1:], True])),
]


@pytest.mark.parametrize("packet", [*map(json.dumps, STRANGE), "[" * (MAX_PACKET - 1)])
def test_what_is_json_and_no_message_is_a_value_error(packet: str) -> None:
    with pytest.raises(ValueError, match=f"of {len(packet)} bytes is not known"):
        decode(packet.encode())
