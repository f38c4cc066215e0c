"""The driver's core against noise, and its recording against every cut."""

from __future__ import annotations

import math
import struct
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.courses import course
from steerkit.plants.real_car import recording as tapes
from steerkit.plants.real_car.decisions.core import Core, Frame, Link, Packet, Reply, Send, Tick
from steerkit.plants.real_car.decisions.modes import Machine, Mode, Order
from steerkit.plants.real_car.file.config import CarConfig
from steerkit.plants.real_car.file.reading import load
from steerkit.plants.real_car.processes.client import RealCar, ReplayLink
from steerkit.plants.real_car.processes.protocol import (
    Command,
    Hello,
    Query,
    Refused,
    Request,
    Snapshot,
    decode,
    encode,
)


@cache
def config() -> CarConfig:
    return load("dbw-kit.toml")


ids = st.sampled_from([0x64, 0x65, 0x120, 0x121, 0x122, 0x130, 0x7FF])
messages = st.one_of(
    st.builds(Hello, st.booleans(), st.sampled_from([1, 2])),
    st.just(Query()),
    st.builds(Command, st.sampled_from(Order)),
    st.builds(Request, st.floats(), st.floats(), st.integers(0, 2**32 - 1)),
)
pauses = st.floats(0.0, 0.3)
happenings = st.one_of(
    st.tuples(st.just("frame"), pauses, ids, st.binary(max_size=8)),
    st.tuples(st.just("packet"), pauses, st.integers(1, 2), messages.map(encode) | st.binary(max_size=40)),
    st.tuples(st.just("link"), pauses, st.integers(1, 2), st.booleans()),
    st.tuples(st.just("tick"), pauses, st.none(), st.none()),
)


@settings(max_examples=150, deadline=None)
@given(story=st.lists(happenings, max_size=60), engaged=st.booleans())
def test_noise_raises_nothing_and_moves_nothing(story: list[Any], engaged: bool) -> None:
    core, t = Core(config(), course("paper")), 5.0
    core.handle(Link(t, 1, True))
    core.handle(Packet(t, 1, encode(Hello(True))))
    if engaged:  # put there by force: it must get out by itself
        core.senses.values |= {"v": 5.0, "v_kit": 5.0, "delta_sw": 0.0}
        core.machine = Machine(Mode.ENGAGED, "force", t)
    for kind, pause, where, what in story:
        t += pause
        match kind:
            case "frame":
                out = core.handle(Frame(t, t, where, what))
            case "packet":
                out = core.handle(Packet(t, where, what))
            case "link":
                out = core.handle(Link(t, where, what))
            case _:
                out = core.handle(Tick(t))
        for sent in out:
            if isinstance(sent, Send):
                angle, enable, _ = config().writer.read(sent.data)
                assert not enable  # without a pose it can never be engaged for as much as one frame
                assert abs(angle) <= config().gate.delta_sw_max + 1e-9
            if isinstance(sent, Reply):
                assert isinstance(decode(sent.data), (Snapshot, Refused))
        assert core.machine.mode is not Mode.ENGAGED or not story
        assert core.wake > core.t
        assert math.isfinite(core.wake)


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


def test_time_never_goes_back() -> None:
    core = Core(config(), course("paper"))
    core.handle(Tick(10.0))
    core.handle(Tick(9.0))
    assert core.t == 10.0


def test_a_car_that_is_traced_or_batched_says_so() -> None:
    import casadi

    car = RealCar(link=ReplayLink([]))
    with pytest.raises(TypeError, match="one car"):
        car.init((3,))
    with pytest.raises(TypeError, match="cannot be traced"):
        car.output(casadi.SX.sym("t"), (), ())
    assert not car.pure


def written(folder: Path) -> bytes:
    tape = tapes.Recording(folder / "tape.mcap", {"file:config.toml": "x"})
    core = Core(config(), course("paper"))
    for k in range(5):
        for event in (Frame(0.01 * k, 0.01 * k, 0x65, bytes(8)), Tick(0.01 * k), Link(0.01 * k, k, True)):
            tape.event(event, core.handle(event))
    tape.close()
    return (folder / "tape.mcap").read_bytes()


def test_a_recording_cut_anywhere_opens_with_all_that_came_before(tmp_path: Path) -> None:
    whole = written(tmp_path)
    every = tapes.read(tmp_path / "tape.mcap")
    assert every.whole
    assert len(every.messages) >= 15
    counts = []
    for length in range(0, len(whole), 7):
        (tmp_path / "cut.mcap").write_bytes(whole[:length])
        try:
            cut = tapes.read(tmp_path / "cut.mcap")
        except ValueError as error:
            assert "recording" in str(error)  # noqa: PT017
            assert not counts
            continue
        counts.append(len(cut.messages))
        assert [repr(m) for m in cut.messages] == [repr(m) for m in every.messages[: len(cut.messages)]]
    assert counts == sorted(counts)
    assert counts[-1] == len(every.messages)


def test_numbers_of_a_recording_come_back_bit_for_bit(tmp_path: Path) -> None:
    tape = tapes.Recording(tmp_path / "t.mcap", {"a": "b"})
    odd = [0.1, 1 / 3, 5e-324, -0.0, math.inf, -math.inf, 1.7976931348623157e308]
    for value in odd:
        tape._queue.put(("/command", {"t": 1.0, "request": value, "sent": math.nan, "why": ""}))
    tape.close()
    read = tapes.read(tmp_path / "t.mcap").of("/command")
    assert [struct.pack("<d", v["request"]) for v in read] == [struct.pack("<d", value) for value in odd]
    assert all(math.isnan(v["sent"]) for v in read)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.mcap").write_text("hello")
    with pytest.raises(ValueError, match="no recording of steerkit"):
        tapes.read(tmp_path / "x.mcap")
