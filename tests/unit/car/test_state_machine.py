"""Who steers: every state with every fact and every order, exhaustively."""

import itertools
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.car.state_machine import (
    Facts,
    Machine,
    Mode,
    Order,
    StateLimits,
    age_ms,
    always,
    driving,
    ending,
    engaging,
    foreign_enable,
    human,
    readying,
    step,
    warnings,
)

LIMITS = StateLimits()
GOOD = Facts(
    connected=True,
    report_age=0.01,
    pose_age=0.01,
    request_age=0.02,
    request=0.1,
    delta_sw=0.05,
    v=5.0,
    v_kit=5.1,
    e=0.1,
    psi_e=0.02,
    a_y=0.5,
    quality=4.0,
    enabled=True,
    heartbeat_age=0.1,
)
BAD_IN: dict[str, dict[str, dict[str, Any]]] = {
    "human": {
        "override": {"override": True},
        "torque": {"torque_reports": 3},
        "brake": {"brake": True},
        "accelerator": {"accelerator": True},
    },
    "always": {
        "controller gone": {"connected": False},
        "report stale": {"report_age": LIMITS.report_age},
        "pose stale": {"pose_age": 0.15},
        "integrity": {"integrity_errors": 2},
        "kit fault": {"kit_faults": ("FLTPWR",)},
        "kit timeout": {"timeout": True},
        "pose quality": {"quality": 0.0},
        "speed mismatch": {"v_kit": 7.0},
        "too fast": {"v": 10.1, "v_kit": 10.1},
        "off the path": {"e": -2.01},
        "request invalid": {"request": math.nan},
        "missed deadlines": {"misses": 3},
        "server late": {"lateness": LIMITS.lateness},
        "operator silent": {"heartbeat_age": LIMITS.heartbeat},
        "reversing": {"v": -0.16, "v_kit": -0.16},
        "foreign sender": {"foreign": "somebody"},
        "recording": {"recording": "the disk is full"},
    },
    "driving": {
        "controller silent": {"request_age": LIMITS.request_lost},
        "kit not enabled": {"enabled": False},
        "command echo": {"echo_age": 0.15},
        "wheel does not follow": {"follow_age": 0.3},
        "across the path": {"psi_e": 0.8},
        "leaving the path": {"e_growth": 1.6},
    },
    "engaging": {
        "listen only": {"listen_only": True},
        "request stale": {"request_age": LIMITS.request_age},
        "command differs": {"delta_sw": 0.5},
        "e": {"e": 0.51},
        "psi_e": {"psi_e": -0.27},
        "a_y": {"a_y": -20.1},
        "speed": {"v": 0.4, "v_kit": 0.4},
        "kit enabled": {"foreign_enable": 1e-9},
        "witness": {"astray": 0.19},
    },
    "foreign": {"foreign enable": {"foreign_enable": 0.1}},
    "ending": {"end of the course": {"remaining": 4.9}, "standstill": {"still_for": 1.0}},
}
"""By when it matters, and by the name of its check: what is wrong."""
BAD = {name: facts for group in BAD_IN.values() for name, facts in group.items()}
ALL = (human, always, driving, engaging, foreign_enable, ending)
FAR_OFF = ("controller silent", "across the path")
"""What ends driving from values at which nobody could have engaged."""


def names(facts: Facts, *checks: Any) -> set[str]:
    return {text.split(": ")[0] for check in checks for text in check(LIMITS, facts)}


def expected(mode: Mode, name: str, order: Order | None) -> Mode:
    """The state after one look, with one thing wrong ("": nothing), written out once more as a table."""
    if order is Order.OFF:
        return Mode.OFF
    against = name in BAD_IN["human"] | BAD_IN["always"] | BAD_IN["engaging"] or name in FAR_OFF
    against = against or name == "end of the course"
    if mode is Mode.OFF:
        return Mode.STANDBY if order is Order.ARM else Mode.OFF
    if mode in (Mode.OVERRIDE, Mode.FAULT):
        return Mode.STANDBY if order is Order.ACKNOWLEDGE else mode
    if name in BAD_IN["foreign"] and mode in (Mode.STANDBY, Mode.READY):
        return Mode.FAULT
    if mode is Mode.STANDBY:
        return Mode.STANDBY if against else Mode.READY
    if mode is Mode.READY:
        if against:
            return Mode.STANDBY
        return Mode.ENGAGED if order is Order.ENGAGE else Mode.READY
    if order is Order.DISENGAGE:
        return Mode.STANDBY
    if name in BAD_IN["human"]:
        return Mode.OVERRIDE
    if name in BAD_IN["always"] | BAD_IN["driving"]:
        return Mode.FAULT
    return Mode.STANDBY if name in BAD_IN["ending"] else Mode.ENGAGED


def test_every_check_has_a_case() -> None:
    flags = dict.fromkeys(("override", "brake", "accelerator", "timeout", "listen_only"), True)
    many = dict.fromkeys(("torque_reports", "integrity_errors", "misses", "engaged_for"), 9)
    texts: dict[str, Any] = {"kit_faults": ("FLT",), "foreign": "x", "recording": "x", "connected": False}
    unknown = {name: math.nan for name, value in Facts()._asdict().items() if isinstance(value, float)}
    assert names(Facts(**{**unknown, "request_age": 1.0, **flags, **many, **texts}), *ALL) == set(BAD)


@pytest.mark.parametrize("name", ["", *BAD])
def test_every_fault_in_every_state_under_every_order(name: str) -> None:
    facts = GOOD._replace(**BAD.get(name, {}))
    for mode, order in itertools.product(Mode, (None, *Order)):
        after = step(LIMITS, Machine(mode, "before", 0.0), facts, 1.0, order)
        assert after.mode is expected(mode, name, order), (mode, order)
        if after.mode in (Mode.FAULT, Mode.OVERRIDE) and mode is not after.mode:
            assert after.cause.startswith(f"{name}: ")
            assert after.since == 1.0


def test_what_never_came_is_said_so() -> None:
    assert [age_ms(age) for age in (0.0504, 99.9, math.inf, math.nan)] == ["50 ms", "99900 ms", *["never came"] * 2]
    assert "report stale: report never came" in [*always(LIMITS, Facts())]
    assert "report stale: report 250 ms" in [*always(LIMITS, GOOD._replace(report_age=0.25))]
    assert "end of the course" in names(Facts(), engaging)


def test_the_kit_has_some_time_to_say_that_it_is_enabled() -> None:
    facts = GOOD._replace(enabled=False)
    for since in (1.0, 100.0):
        assert step(LIMITS, Machine(Mode.ENGAGED, "", since), facts, since + 0.29).mode is Mode.ENGAGED
        assert step(LIMITS, Machine(Mode.ENGAGED, "", since), facts, since + 0.31).mode is Mode.FAULT


def test_a_nan_counts_as_broken() -> None:
    for field in {*FLOATS, "lateness", "echo_age", "follow_age"} - {"delta_sw", "psi_e"}:
        facts = GOOD._replace(**{field: math.nan})
        assert step(LIMITS, Machine(Mode.ENGAGED, "", 0.0), facts, 1.0).mode is Mode.FAULT, field
    for field in ("psi_e", "delta_sw", "request", "e", "v"):
        facts = GOOD._replace(**{field: math.nan})
        assert step(LIMITS, Machine(Mode.READY, "", 0.0), facts, 1.0, Order.ENGAGE).mode is Mode.STANDBY, field


FLOATS = ("report_age", "pose_age", "request_age", "request", "delta_sw", "v", "v_kit", "e", "psi_e", "quality")
facts_strategy = st.builds(
    Facts,
    **{name: st.floats() for name in (*FLOATS, "lateness", "echo_age", "follow_age")},
    **{name: st.booleans() for name in ("connected", "listen_only", "override", "enabled")},
    **{name: st.integers(0, 9) for name in ("torque_reports", "integrity_errors", "misses")},
)
orders = st.sampled_from([None, *Order])


@settings(max_examples=60)
@given(story=st.lists(st.tuples(st.just(GOOD) | facts_strategy, orders), min_size=1, max_size=40))
def test_engaged_comes_only_from_ready_by_an_order_and_faults_stay(story: list[tuple[Facts, Order | None]]) -> None:
    state = Machine()
    for k, (facts, order) in enumerate(story):
        before, state = state, step(LIMITS, state, facts, 0.05 * k, order)
        if state.mode is Mode.ENGAGED and before.mode is not Mode.ENGAGED:
            assert before.mode is Mode.READY
            assert order is Order.ENGAGE
            assert not names(facts, readying)
        if before.mode in (Mode.FAULT, Mode.OVERRIDE) and state.mode is not before.mode:
            assert order in (Order.ACKNOWLEDGE, Order.OFF)
        assert step(LIMITS, before, facts, 0.05 * k, order) == state  # pure


def test_limits_are_checked() -> None:
    assert StateLimits(v_engage_max=10.0).v_max == 10.0
    for values in ({"request_lost": 0.075}, {"v_engage_min": 9.0}, {"v_engage_max": 10.01}):
        with pytest.raises(ValueError, match="request_age < request_lost and v_engage_min < v_engage_max <= v_max"):
            StateLimits(**values)


@pytest.mark.parametrize(
    ("check", "name", "facts"),
    [
        (always, "reversing", {"v": -0.2, "v_kit": -0.1}),
        (always, "reversing", {"v": -0.1, "v_kit": -0.2}),
        (always, "speed mismatch", {"v": 6.3}),
        (always, "too fast", {"v": 9.9, "v_kit": 10.1}),
        (always, "too fast", {"v": 10.1, "v_kit": 9.9}),
        (always, "off the path", {"e": 2.01}),
        (always, "request invalid", {"request": -1e3}),
        (always, "request invalid", {"request": LIMITS.delta_sw_max * (1.0 + 3e-9)}),
        (driving, "across the path", {"psi_e": -0.8}),
        (engaging, "e", {"e": -0.51}),
        (engaging, "psi_e", {"psi_e": 0.3}),
        (engaging, "speed", {"v": 9.1, "v_kit": 9.1}),
        (engaging, "command differs", {"request": -0.35}),
        (driving, "command echo", {"echo_age": LIMITS.echo_age}),
        (driving, "kit not enabled", {"enabled": False, "engaged_for": LIMITS.enable_time}),
        (ending, "end of the course", {"remaining": LIMITS.end_margin}),
        (engaging, "end of the course", {"remaining": LIMITS.end_margin + 5.0 * LIMITS.end_warning}),
    ],
)
def test_each_side_of_a_check_and_an_age_that_reaches_its_limit(check: Any, name: str, facts: dict[str, Any]) -> None:
    assert name in names(GOOD._replace(**facts), check)


@pytest.mark.parametrize(
    "facts",
    [
        {"v": -LIMITS.v_reverse, "v_kit": 0.0},
        {"v_kit": -LIMITS.v_reverse, "v": 0.0},
        {"v": LIMITS.v_max, "v_kit": LIMITS.v_max},
        {"v": 5.0, "v_kit": 5.0 - LIMITS.v_mismatch},
        {"e": LIMITS.e_max},
        {"psi_e": LIMITS.psi_e_max},
        {"e_growth": LIMITS.e_growth},
        {"quality": LIMITS.quality},
        {"request": LIMITS.delta_sw_max * (1.0 + 1e-9)},  # as rounding on the bus may have it
        *({name: getattr(LIMITS, name) - 1e-9} for name in ("report_age", "pose_age", "lateness", "echo_age")),
        {"request_age": LIMITS.request_lost - 1e-9},
        {"follow_age": LIMITS.follow_time - 1e-9},
        {"heartbeat_age": LIMITS.heartbeat - 1e-9},
        {"foreign_enable": LIMITS.foreign_enable - 1e-9},
        {"enabled": False, "engaged_for": LIMITS.enable_time - 1e-9},
        *({name: getattr(LIMITS, name) - 1} for name in ("torque_reports", "integrity_errors", "misses")),
    ],
)
def test_exactly_at_its_limit_a_check_holds_while_driving(facts: dict[str, Any]) -> None:
    assert names(GOOD._replace(**facts), human, always, driving, foreign_enable) == set()


def test_of_what_is_not_there_the_value_is_not_judged() -> None:
    assert names(GOOD._replace(request_age=math.inf, request=math.nan), always, driving) == {"controller silent"}


@pytest.mark.parametrize(
    "facts",
    [
        {"e": LIMITS.e_engage},
        {"psi_e": LIMITS.psi_e_engage},
        {"a_y": -LIMITS.a_y_engage},
        {"request": 0.0, "delta_sw": LIMITS.delta_engage},
        {"v": LIMITS.v_engage_min},
        {"v": LIMITS.v_engage_max},
        {"v": 0.5, "remaining": LIMITS.end_margin + 0.5 * LIMITS.end_warning + 1e-9},
        {"request_age": LIMITS.request_age - 1e-9},
        {"foreign_enable": 0.0},
    ],
)
def test_exactly_at_its_limit_a_check_holds_for_engaging(facts: dict[str, Any]) -> None:
    assert names(GOOD._replace(**facts), engaging) == set()


def test_the_operator_is_warned_of_the_end_of_the_course_and_only_then() -> None:
    for v, remaining in ((5.0, 31.0), (5.0, 30.0), (0.5, 7.5), (-1.0, 5.0)):
        assert [*warnings(LIMITS, GOOD._replace(v=v, remaining=remaining))] == []
    assert [*warnings(LIMITS, GOOD._replace(remaining=29.0))] == ["the course ends in 24 m"]
