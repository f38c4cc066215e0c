"""Who has the wheel: every state with every fact and every order, exhaustively."""

from __future__ import annotations

import itertools
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.car.state_machine import (
    ALWAYS,
    DRIVING,
    ENDING,
    ENGAGING,
    HUMAN,
    Facts,
    Machine,
    Mode,
    Order,
    StateLimits,
    broken,
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
    quality=4.0,
    enabled=True,
    heartbeat_age=0.1,
)
BAD: dict[str, dict[str, Any]] = {
    "override": {"override": True},
    "torque": {"torque_reports": 3},
    "controller gone": {"connected": False},
    "report stale": {"report_age": 0.1},
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
    "server late": {"lateness": 0.05},
    "controller silent": {"request_age": 0.15},
    "kit not enabled": {"enabled": False},
    "command echo": {"echo_age": 0.15},
    "wheel does not follow": {"follow_age": 0.3},
    "brake": {"brake": True},
    "accelerator": {"accelerator": True},
    "operator silent": {"heartbeat_age": 0.3},
    "reversing": {"v": -0.16, "v_kit": -0.16},
    "foreign sender": {"foreign": "somebody"},
    "recording": {"recording": "the disk is full"},
    "across the path": {"psi_e": 0.8},
    "leaving the path": {"e_growth": 1.6},
    "foreign enable": {"foreign_enable": 0.3},
    "end of the course": {"remaining": 4.9},
    "standstill": {"still_for": 1.0},
    "listen only": {"listen_only": True},
    "request stale": {"request_age": 0.075},
    "command differs": {"delta_sw": 0.5},
    "e": {"e": 0.51},
    "psi_e": {"psi_e": -0.27},
    "speed": {"v": 0.4, "v_kit": 0.4},
}
FAR_OFF = ("controller silent", "across the path")
"""What ends driving from values at which nobody could have engaged."""
NAMES = {
    group: [name for name, _, _ in checks]
    for group, checks in (
        ("human", HUMAN),
        ("always", ALWAYS),
        ("driving", DRIVING),
        ("engaging", ENGAGING),
        ("ending", ENDING),
    )
}


def expected(mode: Mode, name: str, order: Order | None) -> Mode:
    """The state after one look, with one thing wrong ("": nothing), written out once more as a table."""
    if order is Order.OFF:
        return Mode.OFF
    against = name in (*NAMES["human"], *NAMES["always"], *NAMES["engaging"]) or name in FAR_OFF
    if mode is Mode.OFF:
        return Mode.STANDBY if order is Order.ARM else Mode.OFF
    if mode in (Mode.OVERRIDE, Mode.FAULT):
        return Mode.STANDBY if order is Order.ACKNOWLEDGE else mode
    if mode is Mode.STANDBY:
        return Mode.STANDBY if against else Mode.READY
    if mode is Mode.READY:
        if against:
            return Mode.STANDBY
        return Mode.ENGAGED if order is Order.ENGAGE else Mode.READY
    if order is Order.DISENGAGE:
        return Mode.STANDBY
    if name in NAMES["human"]:
        return Mode.OVERRIDE
    if name in (*NAMES["always"], *NAMES["driving"]):
        return Mode.FAULT
    return Mode.STANDBY if name in NAMES["ending"] else Mode.ENGAGED


def test_every_check_has_a_case() -> None:
    assert set(BAD) == {name for names in NAMES.values() for name in names}


@pytest.mark.parametrize("name", ["", *BAD])
def test_every_fault_in_every_state_under_every_order(name: str) -> None:
    facts = GOOD._replace(**BAD.get(name, {}))
    for mode, order in itertools.product(Mode, (None, *Order)):
        after = step(LIMITS, Machine(mode, "before", 0.0), facts, 1.0, order)
        assert after.mode is expected(mode, name, order), (mode, order)
        if after.mode in (Mode.FAULT, Mode.OVERRIDE) and mode is Mode.ENGAGED:
            assert after.cause.startswith(f"{name}: ")
            assert after.since == 1.0


@pytest.mark.parametrize("name", [n for n in BAD if n not in ("kit not enabled",)])
def test_the_good_case_just_holds(name: str) -> None:
    assert not broken(LIMITS, GOOD, HUMAN + ALWAYS + ENGAGING + DRIVING + ENDING)
    assert broken(LIMITS, GOOD._replace(**BAD[name]), HUMAN + ALWAYS + ENGAGING + DRIVING + ENDING)


def test_the_kit_has_some_time_to_say_that_it_is_enabled() -> None:
    facts = GOOD._replace(enabled=False)
    assert step(LIMITS, Machine(Mode.ENGAGED, "", 1.0), facts, 1.0 + 0.29).mode is Mode.ENGAGED
    assert step(LIMITS, Machine(Mode.ENGAGED, "", 1.0), facts, 1.0 + 0.31).mode is Mode.FAULT


@pytest.mark.parametrize(
    "field",
    [
        "report_age",
        "pose_age",
        "request_age",
        "request",
        "v",
        "v_kit",
        "e",
        "quality",
        "lateness",
        "echo_age",
        "follow_age",
    ],
)
def test_a_nan_counts_as_broken_while_engaged(field: str) -> None:
    facts = GOOD._replace(**{field: math.nan})
    assert step(LIMITS, Machine(Mode.ENGAGED, "", 0.0), facts, 1.0).mode is Mode.FAULT


@pytest.mark.parametrize("field", ["psi_e", "delta_sw", "request", "e", "v"])
def test_a_nan_counts_as_broken_for_engaging(field: str) -> None:
    facts = GOOD._replace(**{field: math.nan})
    assert step(LIMITS, Machine(Mode.READY, "", 0.0), facts, 1.0, Order.ENGAGE).mode is Mode.STANDBY


facts_strategy = st.builds(
    Facts,
    connected=st.booleans(),
    listen_only=st.booleans(),
    report_age=st.floats(),
    pose_age=st.floats(),
    request_age=st.floats(),
    request=st.floats(),
    delta_sw=st.floats(),
    v=st.floats(),
    v_kit=st.floats(),
    e=st.floats(),
    psi_e=st.floats(),
    quality=st.floats(),
    torque_reports=st.integers(0, 9),
    override=st.booleans(),
    enabled=st.booleans(),
    integrity_errors=st.integers(0, 5),
    misses=st.integers(0, 9),
    lateness=st.floats(),
    echo_age=st.floats(),
    follow_age=st.floats(),
)
orders = st.sampled_from([None, *Order])


@settings(max_examples=300)
@given(story=st.lists(st.tuples(st.just(GOOD) | facts_strategy, orders), min_size=1, max_size=40))
def test_engaged_comes_only_from_ready_by_an_order_and_faults_stay(story: list[tuple[Facts, Order | None]]) -> None:
    state = Machine()
    for k, (facts, order) in enumerate(story):
        before, state = state, step(LIMITS, state, facts, 0.05 * k, order)
        if state.mode is Mode.ENGAGED and before.mode is not Mode.ENGAGED:
            assert before.mode is Mode.READY
            assert order is Order.ENGAGE
            assert not broken(LIMITS, facts, HUMAN + ALWAYS + ENGAGING)
        if before.mode in (Mode.FAULT, Mode.OVERRIDE) and state.mode is not before.mode:
            assert order in (Order.ACKNOWLEDGE, Order.OFF)
        assert step(LIMITS, before, facts, 0.05 * k, order) == state  # pure


@pytest.mark.parametrize("field", ["report_age", "e_max", "torque_reports", "v_max"])
def test_limits_are_checked(field: str) -> None:
    for value in (0.0, -1.0, math.nan, math.inf):
        with pytest.raises(ValueError, match=field):
            StateLimits(**{field: value})
    with pytest.raises(ValueError, match="request_age < request_lost"):
        StateLimits(request_age=0.2)


@pytest.mark.parametrize(
    ("name", "facts"),
    [
        ("reversing", {"v": -0.2, "v_kit": -0.1}),
        ("reversing", {"v": -0.1, "v_kit": -0.2}),
        ("speed mismatch", {"v": math.nan}),
        ("speed mismatch", {"v_kit": math.nan}),
        ("speed mismatch", {"v": 6.3}),
        ("too fast", {"v": 9.9, "v_kit": 10.1}),
        ("too fast", {"v": 10.1, "v_kit": 9.9}),
        ("off the path", {"e": 2.01}),
        ("off the path", {"e": -2.01}),
        ("request invalid", {"request": -1e3}),
        ("pose quality", {"quality": math.nan}),
        ("across the path", {"psi_e": -0.8}),
        ("across the path", {"psi_e": 0.8}),
    ],
)
def test_each_side_of_a_check_ends_driving(name: str, facts: dict[str, Any]) -> None:
    assert name in {text.split(":")[0] for text in broken(LIMITS, GOOD._replace(**facts), ALWAYS + DRIVING)}


@pytest.mark.parametrize(
    ("name", "facts"),
    [
        ("e", {"e": -0.51}),
        ("e", {"e": 0.51}),
        ("psi_e", {"psi_e": -0.3}),
        ("psi_e", {"psi_e": 0.3}),
        ("speed", {"v": 0.4, "v_kit": 0.4}),
        ("speed", {"v": 9.1, "v_kit": 9.1}),
        ("command differs", {"request": -0.35}),
        ("command differs", {"delta_sw": math.nan}),
        ("end of the course", {"remaining": 29.0}),
        ("foreign enable", {"foreign_enable": 0.3}),
        ("request stale", {"request_age": 0.08}),
    ],
)
def test_each_side_of_a_check_stands_against_engaging(name: str, facts: dict[str, Any]) -> None:
    assert name in {text.split(":")[0] for text in broken(LIMITS, GOOD._replace(**facts), ENGAGING)}


def test_the_operator_is_warned_of_the_end_of_the_course_and_only_then() -> None:
    assert warnings(LIMITS, GOOD._replace(remaining=31.0)) == []
    assert warnings(LIMITS, GOOD._replace(remaining=29.0)) == ["the course ends in 24 m"]


def test_the_kit_s_time_counts_from_the_engagement() -> None:
    late, facts = Machine(Mode.ENGAGED, "", 100.0), GOOD._replace(enabled=False)
    assert step(LIMITS, late, facts, 100.29).mode is Mode.ENGAGED
    assert step(LIMITS, late, facts, 100.31).mode is Mode.FAULT
