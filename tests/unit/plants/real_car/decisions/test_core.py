"""The core against noise."""

from __future__ import annotations

import math
from typing import Any

from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.courses import course
from steerkit.plants.real_car.decisions.core import Core, Frame, Link, Packet, Reply, Send, Tick
from steerkit.plants.real_car.decisions.modes import Machine, Mode
from steerkit.plants.real_car.processes.protocol import Hello, Refused, Snapshot, decode, encode
from tests.support.car_messages import config, messages

ids = st.sampled_from([0x64, 0x65, 0x120, 0x121, 0x122, 0x130, 0x7FF])


pauses = st.floats(0.0, 0.3)


happenings = st.one_of(
    st.tuples(st.just("frame"), pauses, ids, st.binary(max_size=8)),
    st.tuples(st.just("packet"), pauses, st.integers(1, 2), messages.map(encode) | st.binary(max_size=40)),
    st.tuples(st.just("link"), pauses, st.integers(1, 2), st.booleans()),
    st.tuples(st.just("tick"), pauses, st.none(), st.none()),
)


@settings(max_examples=150)
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


def test_time_never_goes_back() -> None:
    core = Core(config(), course("paper"))
    core.handle(Tick(10.0))
    core.handle(Tick(9.0))
    assert core.t == 10.0
