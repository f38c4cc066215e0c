"""The core against noise."""

import json
import math
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.car.core import Core, End, Frame, Link, Note, Packet, Reply, Send, Tick
from steerkit.car.protocol import (
    ESTIMATES,
    Adapted,
    Beat,
    Command,
    Estimates,
    Filtered,
    Hello,
    Refused,
    Request,
    Snapshot,
    decode,
    encode,
)
from steerkit.car.state_machine import Machine, Mode, Order
from tests.support.car_messages import config, messages
from tests.support.car_world import World

ids = st.sampled_from([0x64, 0x65, 0x120, 0x121, 0x122, 0x130, 0x7FF])
pauses = st.floats(0.0, 0.3)
happenings = st.one_of(
    st.tuples(st.just("frame"), pauses, ids, st.binary(max_size=8)),
    st.tuples(st.just("packet"), pauses, st.integers(1, 2), messages.map(encode) | st.binary(max_size=40)),
    st.tuples(st.just("link"), pauses, st.integers(1, 2), st.booleans()),
    st.tuples(st.just("tick"), pauses, st.none(), st.none()),
)


@settings(max_examples=30)
@given(learner_state=st.lists(happenings, max_size=60), engaged=st.booleans())
def test_noise_raises_nothing_and_moves_nothing(learner_state: list[Any], engaged: bool) -> None:
    core, t = Core(config()), 5.0
    core.handle(Link(t, 1, True))
    core.handle(Packet(t, 1, encode(Hello(True))))
    if engaged:  # put there by force: it must get out by itself
        core.senses.values |= {"v": 5.0, "v_kit": 5.0, "delta_sw": 0.0}
        core.machine = Machine(Mode.ENGAGED, "force", t)
    for kind, pause, where, what in learner_state:
        t += pause
        events = {"frame": Frame, "packet": Packet, "link": Link}
        event: Any = Tick(t) if kind == "tick" else events[kind](*([t, t] if kind == "frame" else [t]), where, what)
        out = core.handle(event)
        for sent in out:
            if isinstance(sent, Send):
                angle, enable, _ = config().writer.read(sent.data)
                assert not enable  # without a pose it can never be engaged for as much as one frame
                assert abs(angle) <= config().gate.delta_sw_max + 1e-9
            if isinstance(sent, Reply):
                assert isinstance(decode(sent.data), (Snapshot, Refused))
        assert core.machine.mode is not Mode.ENGAGED or not learner_state
        assert core.wake > core.t
        assert math.isfinite(core.wake)


def test_time_never_goes_back() -> None:
    core = Core(config())
    core.handle(Tick(10.0))
    core.handle(Tick(9.0))
    assert core.t == 10.0
    assert core.wake == pytest.approx(10.01)


def test_a_look_that_comes_late_counts_for_a_second() -> None:
    core = Core(config())
    for late, worst in ((0.0009, 0.0), (0.0011, 0.0011), (0.03, 0.03), (0.02, 0.03)):
        core.handle(Tick(core.wake + late))
        assert core.facts(core.t).lateness == pytest.approx(worst)
    late = core.t - 0.03  # the look before the last one was 30 ms late
    assert [round(core.facts(late + age).lateness, 4) for age in (0.9999, 1.0001, 1.0301)] == [0.03, 0.02, 0.0]


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("again", [False, True])
def test_the_gate_starts_from_the_wheel_as_it_is_and_a_pause_earns_nothing(side: float, again: bool) -> None:
    world = World().bring_to(Mode.ENGAGED if again else Mode.READY)
    if again:
        world.order(Order.DISENGAGE, then=0.5)
    assert world.mode is Mode.READY
    world.tampered = lambda basis, delta_sw: (basis, world.core.senses.values["delta_sw"] + 0.3 * side)
    world.until(world.t + 0.06)
    sent, measured, gate = len(world.sent), world.core.senses.values["delta_sw"], world.config.gate
    world.order(Order.ENGAGE, then=0.03)
    assert world.mode is Mode.ENGAGED
    step = (world.sent[sent].delta_sw - measured) * side
    assert -gate.quantum < step <= gate.rate_max * gate.dt_min + gate.quantum


@pytest.mark.parametrize("target", ["pose", "report"])
def test_the_gate_reckons_with_the_faster_of_two_speeds(target: str) -> None:
    """Curvature may change by 5/v^2 a second [1/(m s)]; one of the speeds says 5.9 m/s, the other 5 m/s."""
    world = World(v=(5.0, 5.0), s=20.0).bring_to(Mode.ENGAGED)
    world.fault("speed", target, amount=0.9, then=0.05)
    gate = world.config.gate
    world.tampered = lambda basis, delta_sw: (basis, 8.0)
    sent, began = len(world.sent), world.t
    world.until(began + 0.15)
    assert world.mode is Mode.ENGAGED
    kappa = [math.tan(s.delta_sw / gate.steer_ratio) / gate.wheelbase for s in world.sent[sent - 1 :]]
    took = world.sent[-1].t - world.sent[sent - 1].t
    fastest = gate.jerk_max / 5.9**2 * took
    assert 0.7 * fastest < kappa[-1] - kappa[0] <= 1.01 * fastest


def frames(world: World, since: float = 0.0) -> list[bytes]:
    """Those sent from then on."""
    return [out.data for event, outs in world.events for out in outs if isinstance(out, Send) and event.t >= since]


def alerts(world: World, since: float) -> list[bool]:
    """The ALERT bit of each, as the kit's DBC has it: bit 22."""
    return [bool(data[2] >> 6 & 1) for data in frames(world, since)]


@pytest.mark.parametrize("how", ["space bar", "override", "quality", "end"])
def test_at_every_takeover_the_kit_is_asked_to_alert_the_human(how: str) -> None:
    """In all five frames that let go, the wheel where it is; never while it steers, nor when its faults are cleared."""
    world = World().bring_to(Mode.ENGAGED)
    assert not any(alerts(world, 0.0))
    if how == "space bar":
        world.order(Order.DISENGAGE)
    elif how == "end":
        world.handle(End(world.t, "the car server was stopped"))
    else:
        world.fault(how, "pose" if how == "quality" else "report", length=0.2)
    began = world.t
    world.until(began + 0.7)
    ended = next(t for t, mode, _ in world.modes if t >= began and mode is not Mode.ENGAGED)
    assert alerts(world, ended) == [True] * 5
    *_, held = (s.delta_sw for s in world.sent if s.enable)
    tail = [s for s in world.sent if s.t >= ended]
    assert [s.t - tail[0].t for s in tail] == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08], abs=1e-6)
    assert tail[0].t <= ended + world.config.gate.dt_min + 1e-6
    assert {s.delta_sw for s in tail} == {held}
    if world.mode in (Mode.OVERRIDE, Mode.FAULT):
        world.order(Order.ACKNOWLEDGE, then=0.2)
        assert alerts(world, ended) == [True] * 5 + [False]


def test_the_kit_is_told_to_clear_its_faults_once() -> None:
    world = World()
    world.car.timeout = True
    world.order(Order.ARM, then=0.3)
    assert (world.mode, world.sent) == (Mode.STANDBY, [])
    world.order(Order.ACKNOWLEDGE, then=0.3)
    world.order(Order.ENGAGE, then=0.4)
    assert world.mode is Mode.ENGAGED
    clears = [world.config.writer.read(data)[2] for data in frames(world)]
    assert len(clears) > 10
    assert clears == [True] + [False] * (len(clears) - 1)


def linked(**changes: Any) -> Core:
    core = Core(replace(config(), **changes))
    core.handle(Link(5.0, 1, True))
    core.handle(Packet(5.0, 1, encode(Hello(True))))
    return core


def refusals(core: Core, t: float, link: int, message: Any) -> list[str]:
    answers = [decode(out.data) for out in core.handle(Packet(t, link, encode(message))) if isinstance(out, Reply)]
    return [answer.why for answer in answers if isinstance(answer, Refused)]


@pytest.mark.parametrize("basis", [math.nan, math.inf, 5.2, 5.1011])
def test_a_request_is_based_on_the_past(basis: float) -> None:
    core = linked()
    assert "future" in refusals(core, 5.1, 1, Request(basis, 0.0, 0))[0]
    assert core.facts(5.1).request_age == math.inf
    assert refusals(core, 5.1, 1, Request(5.1009, 0.0, 0)) == []


def test_missed_deadlines_count_from_the_first_request_and_each() -> None:
    core = linked()
    core.handle(Packet(5.1, 1, encode(Request(5.1, 0.0, 70))))
    assert core.facts(5.1).misses == 0
    core.handle(Packet(5.25, 1, encode(Request(5.25, 0.0, 72))))
    core.handle(Packet(5.5, 1, encode(Request(5.5, 0.0, 75))))
    assert [core.facts(t).misses for t in (5.5, 6.24, 6.25, 6.49, 6.5)] == [5, 5, 3, 3, 0]


def test_the_request_goes_with_its_controller_and_there_is_one() -> None:
    core = linked()
    core.handle(Packet(5.1, 1, encode(Request(5.1, 0.25, 0))))
    core.handle(Link(5.1, 2, True))
    assert "a controller already" in refusals(core, 5.1, 2, Hello(True))[0]
    assert "say hello first" in refusals(core, 5.1, 2, Request(5.1, 1.0, 0))[0]
    assert refusals(core, 5.1, 2, Hello(False)) == []
    assert "only the controller" in refusals(core, 5.1, 2, Request(5.1, 1.0, 0))[0]
    assert core.facts(5.1).request == 0.25
    core.handle(Link(5.1, 2, False))
    assert core.facts(5.1).request == 0.25
    core.handle(Link(5.1, 1, False))
    facts = core.facts(5.1)
    assert (facts.connected, facts.request_age) == (False, math.inf)
    core.handle(Link(5.2, 3, True))
    assert "another course" in refusals(core, 5.2, 3, Hello(True, course="elsewhere"))[0]
    assert refusals(core, 5.2, 3, Hello(True)) == []


def test_an_order_that_can_do_nothing_is_refused() -> None:
    possible = {Mode.OFF: {Order.ARM}, Mode.READY: {Order.ENGAGE}, Mode.ENGAGED: set[Order]()}
    for mode in Mode:
        core = linked()
        core.machine = Machine(mode, "put there", 5.0)
        refused = {order for order in Order if core._against(order)}
        assert refused == {Order.ENGAGE, Order.ARM, Order.ACKNOWLEDGE} - possible.get(mode, {Order.ACKNOWLEDGE})


@pytest.mark.parametrize("listen_only", [False, True])
def test_a_server_that_only_listens_has_nothing_to_clear(listen_only: bool) -> None:
    core = linked(listen_only=listen_only)
    core.machine = Machine(Mode.FAULT, "put there", 5.0)
    out = core.handle(Packet(5.1, 1, encode(Command(Order.ACKNOWLEDGE))))
    assert core.machine.mode is Mode.STANDBY
    assert core.quiet
    assert any(isinstance(one, Send) for one in out) is not listen_only


@pytest.mark.parametrize(("since", "seen"), [(5.0, 5.5), (5.5, 5.0)])
def test_ages_count_from_the_last_change_of_state_at_the_earliest(since: float, seen: float) -> None:
    core = linked()
    core.senses.echo_ok = core.senses.follow_ok = core.senses.moving = core.senses.enabled_since = seen
    core.senses.enabled_at, core._let_go = 6.0, since
    for mode, ages in ((Mode.ENGAGED, (0.5, 0.5, 0.5, 0.0)), (Mode.READY, (0.0, 0.0, 0.0, 0.5))):
        core.machine = Machine(mode, "put there", since)
        facts = core.facts(6.0)
        assert (facts.echo_age, facts.follow_age, facts.still_for, facts.foreign_enable) == pytest.approx(ages)


@pytest.mark.parametrize("name", ["override", "enabled", "timeout", "brake", "accelerator", *config().fault_flags])
def test_a_flag_is_up_only_when_a_frame_says_so(name: str) -> None:
    core, seen = linked(), []
    for values in ({}, {name: 0.0}, {name: 1.0}):
        core.senses.values |= values
        facts = core.facts(5.1)
        seen.append(f"fault:{''.join(facts.kit_faults)}" == name or getattr(facts, name, False))
    assert seen == [False, False, True]


def test_errors_count_for_a_second() -> None:
    core = linked()
    core.senses.error(6.0, "one")
    core.senses.error(6.5, "two")
    assert [core.facts(t).integrity_errors for t in (6.5, 6.99, 7.0, 7.49, 7.5)] == [2, 2, 1, 1, 0]


def test_arming_takes_the_next_time_stamp_for_an_undelayed_one() -> None:
    core = linked()
    core.senses.age = lambda t, frames: 0.02
    for order, delay in ((Order.ARM, 0.0), (Order.OFF, 0.05)):
        core.senses.delay = 0.05
        assert core.facts(5.1).pose_age == pytest.approx(0.07), "a delayed pose is older than its frame"
        core.handle(Packet(5.1, 1, encode(Command(order))))
        assert core.senses.delay == delay


@pytest.mark.parametrize(("v", "r"), [(5.0, 0.3), (8.0, -0.2), (0.5, 0.1), (-2.0, 0.1)])
def test_without_a_sensor_beta_is_that_of_a_car_that_rolls(v: float, r: float) -> None:
    """Without slip the rear axle moves along the car, so the centre of gravity has v_y = r*l_r; v at least 1 m/s."""
    core = linked()
    core.senses.values |= {"v": v, "r": r}
    rear = max(v, 1.0) * math.tan(core.snapshot(5.0).beta) - r * config().vehicle.l_r
    assert rear == pytest.approx(0.0, abs=1e-9)
    assert core.snapshot(5.0).a_y == v * r
    core.senses.values |= {"beta": 0.01, "a_y": 0.3}
    assert (core.snapshot(5.0).beta, core.snapshot(5.0).a_y) == (0.01, 0.3)


def test_only_an_operator_s_heartbeat_counts_and_it_goes_with_the_operator() -> None:
    core = linked()
    core.handle(Packet(5.1, 1, encode(Beat())))  # the controller's panel may hang while the controller steers on
    assert core.facts(5.1).heartbeat_age == math.inf
    core.handle(Link(5.1, 2, True))
    core.handle(Packet(5.1, 2, encode(Hello(False))))
    core.handle(Packet(5.2, 2, encode(Beat())))
    assert core.facts(5.3).heartbeat_age == pytest.approx(0.1)
    core.handle(Link(5.3, 2, False))  # gone: nothing more comes, and the last one ages
    assert core.facts(5.5).heartbeat_age == pytest.approx(0.3)


def panels(world: World, **beats: float) -> None:
    """The operator is `first`, and on lines 3, 4, ... others come; time passes, and each beats until it does not."""
    names = {2 + k: name for k, name in enumerate(beats)}
    for link, name in names.items():
        if link > 2:
            world.handle(Link(world.t, link, True))
        world.handle(Packet(world.t, link, encode(Hello(False, name=name))))
    world.beats_until = -math.inf
    for _ in range(7):
        for link, name in names.items():
            if world.t < beats[name]:
                world.handle(Packet(world.t, link, encode(Beat())))
        world.until(world.t + 0.1)


def test_one_heartbeat_counts_that_of_the_panel_that_engaged_and_it_is_named() -> None:
    world = World().bring_to(Mode.ENGAGED)
    panels(world, first=math.inf, second=math.inf)
    assert (world.mode, world.query().holder) == (Mode.ENGAGED, "first")
    stops = world.t + 0.05
    panels(world, first=stops, second=math.inf)
    assert world.mode is Mode.FAULT
    when, _, cause = world.modes[-1]
    assert when <= stops + world.config.states.heartbeat
    assert cause.startswith("operator silent: the panel that engaged (first) has not read its keys since 300 ms")
    world.order(Order.ACKNOWLEDGE)
    panels(world, first=0.0, second=math.inf)
    assert (world.mode, world.query().holder) == (Mode.READY, ""), "any panel's heartbeat is enough for that"
    world.order(Order.ENGAGE)  # by a client that reads no keys, so it is the only panel's that counts
    panels(world, first=0.0, second=math.inf)
    assert (world.mode, world.query().holder) == (Mode.ENGAGED, "second")


def test_who_reads_no_keys_cannot_engage_beside_two_panels_whose_names_are_shown_as_far_as_they_can_be() -> None:
    world = World().bring_to(Mode.READY)
    panels(world, **{"first\x1b[2J\n\u202e": math.inf, "x" * 99: math.inf})
    why = refusals(world.core, world.t, 1, Command(Order.ENGAGE))
    assert why == [f"not engaged: engage at one of the panels that read their keys: first[2J; {'x' * 80}"]
    assert world.mode is Mode.READY
    assert refusals(world.core, world.t, 3, Command(Order.ENGAGE)) == []
    assert world.query().holder == "x" * 80


@pytest.mark.parametrize("hello", [["Hello", False, 4, ""], ["Hello", True, 8, "", "me", 1.0], ["Hello", False, 1]])
def test_a_client_of_another_version_is_told_so(hello: list[Any]) -> None:
    core = Core(config())
    core.handle(Link(5.0, 1, True))
    (reply,) = core.handle(Packet(5.0, 1, json.dumps(hello).encode()))
    both = f"version 7 of the protocol, not {hello[2]}: start both from the same installation"
    assert decode(reply.data) == Refused(f"the car server speaks {both}")  # type: ignore[union-attr]
    assert refusals(core, 5.1, 1, Command(Order.ARM)) == ["say hello first, with a version that is understood"]
    assert core.machine.mode is Mode.OFF


class Stopped(World):
    """A car server that stands still while it is asleep: the first frames wait for it, as many as there is room for."""

    waiting: list[Frame]

    def handle(self, event: Any) -> None:
        waiting = vars(self).setdefault("waiting", [])
        if event.t < self.asleep_until:
            if isinstance(event, Frame) and len(waiting) < 800:
                waiting.append(event)
            return
        while waiting:
            super().handle(waiting.pop(0)._replace(t=event.t, arrived=event.t))
        super().handle(event)


@pytest.mark.parametrize(
    ("stops", "gap", "clock", "again"),
    [
        (5.0, 0.0, 0.0, False),  # the last frame that waited is 2.6 s older than the next one
        (5.0, 0.0, -30.0, True),
        (0.0, 0.5, 20.0, False),  # the receiver is started anew
        (0.0, 0.0, -0.3, True),
    ],
)
def test_after_a_pause_acknowledging_is_enough_and_the_panel_says_so(
    stops: float, gap: float, clock: float, again: bool
) -> None:
    """The receiver's clock may have been set by so much. What may be a delay needs the order again, in STANDBY."""
    world = Stopped(s=20.0).bring_to(Mode.ENGAGED)
    began, values = world.t, world.car._values

    def told() -> dict[str, float]:
        known = values()
        later = world.car.t >= began + max(stops, gap)
        return known | {"stamp": (known["stamp"] + clock * later) % 65.536}

    world.car._values = told  # type: ignore[method-assign]
    world.asleep_until = began + stops
    world.fault("drop", "pose", length=gap)
    world.until(began + max(stops, gap) + 2.0)
    assert world.mode is Mode.FAULT
    world.order(Order.ACKNOWLEDGE, then=1.5)
    if again:
        assert "by its time stamp: if its clock was set anew, acknowledge (a) while in STANDBY" in world.query().text
        world.order(Order.ACKNOWLEDGE)
        end = world.t + 12.0  # where frames had waited, dead reckoning has to come to the end of them
        while world.mode is Mode.STANDBY and world.t < end:
            world.until(world.t + 0.1)
    assert world.mode is Mode.READY, world.query().text
    world.order(Order.ENGAGE, then=1.0)
    assert world.mode is Mode.ENGAGED


@pytest.mark.parametrize("late", [0.2, 0.5])
def test_a_delay_is_not_acknowledged_away_with_its_fault(late: float) -> None:
    world = World().bring_to(Mode.ENGAGED)
    world.fault("delay", "pose", amount=late, then=1.0)
    world.order(Order.ACKNOWLEDGE, then=3.0)
    assert world.mode is Mode.STANDBY
    assert f"{1e3 * late - 1.0:.0f} ms of it by its time stamp" in world.query().text


@pytest.mark.parametrize(
    ("topic", "message"),
    [
        ("estimates", Estimates(tuple(map(float, range(3 * len(ESTIMATES)))))),
        ("adapted", Adapted(0.21, 1.08)),
        ("safety", Filtered(0.3, 0.2, 0.5, 0.6, 2.0, 0.1, 1.0)),
    ],
)
def test_what_a_controller_notes_is_the_controllers_and_for_the_recording_only(topic: str, message: Any) -> None:
    core = linked()
    noted = Packet(5.1, 1, encode(message))
    (note,) = [out for out in core.handle(noted) if isinstance(out, Note) and out.topic == topic]
    values = message.named() if topic == "estimates" else message._asdict()
    assert note.values == {"t": 5.1, **values}
    core.handle(Link(5.2, 2, True))
    core.handle(Packet(5.2, 2, encode(Hello(False))))
    (reply,) = core.handle(noted._replace(t=5.3, link=2))
    assert isinstance(reply, Reply)
    assert decode(reply.data) == Refused(f"{type(message).__name__} is not for the car server")


def test_the_end_of_the_process_says_why() -> None:
    world = World().bring_to(Mode.ENGAGED)
    world.handle(End(world.t, "the bus is lost"))
    world.until(world.t + 0.3)
    world.order(Order.ARM)
    assert world.modes[-1][1:] == (Mode.OFF, "the bus is lost"), "and it is over"


def test_a_foreign_sender_of_the_command_is_told() -> None:
    core, told = linked(), []
    for t, kind in ((5.1, ""), (7.0, "x"), (8.0, "fd")):  # "x", of 29 bits: another frame
        core.handle(Frame(t, t, config().writer.message.frame_id, bytes(8), kind))
        told.append("somebody else sends STEERING_CMD" in core.facts(t).foreign)
        assert core.facts(t + 1.1).foreign == ""
    assert told == [True, False, True]


def enabled_by_others(world: World, on: float = math.inf, off: float = 0.0) -> None:
    """From now on somebody else enables the kit for so long [s], and again after a break; what we say does not help."""
    advance, began = world.car.advance, world.t

    def kept(t: float) -> list[tuple[float, int, bytes]]:
        world.car.enabled, world.car.heard = (t - began) % (on + off) < on, world.car.t
        return advance(t)

    world.car.advance = kept  # type: ignore[method-assign]
    world.car.faults.clear()
    world.car.overridden = False


@pytest.mark.parametrize("mode", [m for m in Mode if m is not Mode.ENGAGED])
def test_a_kit_that_stays_enabled_is_told_whatever_the_state(mode: Mode) -> None:
    world = World().bring_to(mode)
    assert "not by us" not in world.query().text
    enabled_by_others(world)
    world.until(world.t + 0.5)
    assert "the kit has been enabled for" in world.query().text
    assert world.mode is (Mode.FAULT if mode in (Mode.STANDBY, Mode.READY) else mode)


@pytest.mark.parametrize(
    ("on", "off", "lets_go", "within", "modes"),
    [
        (math.inf, 0.0, False, 0.13, [Mode.STANDBY, Mode.FAULT]),
        (math.inf, 0.0, True, 0.13, [Mode.STANDBY, Mode.FAULT]),  # the kit ignores EN = 0
        (0.06, 0.06, False, 0.2, [Mode.STANDBY, Mode.FAULT]),  # it comes and goes
        (0.06, 9.0, False, 0.0, [Mode.STANDBY, Mode.READY]),
        (0.0, 9.0, True, 0.0, [Mode.STANDBY, Mode.READY]),  # it lets go at once, and is waited for
    ],
)
def test_a_kit_that_others_enable_is_a_fault_and_nobody_engages(
    on: float, off: float, lets_go: bool, within: float, modes: list[Mode]
) -> None:
    world = World().bring_to(Mode.ENGAGED if lets_go else Mode.READY)
    enabled_by_others(world, on, off)
    began, seen = world.t, len(world.modes)
    if lets_go:
        world.order(Order.DISENGAGE)
        world.handle(Tick(world.t))
        assert world.mode is Mode.STANDBY, "the kit has still to say that it is not enabled"
    world.until(began + 0.05)
    world.order(Order.ENGAGE)
    world.until(began + 0.5)
    assert [mode for _, mode, _ in world.modes[seen:]] == modes
    assert not any(s.enable for s in world.sent if s.t > began)
    if modes[-1] is Mode.FAULT:
        assert world.modes[-1][0] <= began + within
        assert "another program steers, or the kit does not let go" in world.modes[-1][2]
        world.order(Order.ACKNOWLEDGE, then=0.3)
        assert world.mode is Mode.FAULT, "in vain: it is still enabled"
