"""Measurements find the sample in which they were made."""

from __future__ import annotations

import math

import pytest

from steerkit.estimators.arrivals import SIZE, Arrived, sorted_in, turned_on

DT = 0.05
NAN = math.nan


def put(buffer: tuple[float, ...], x: float, age: float, r: float = NAN, motion_age: float = NAN) -> list[Arrived]:
    return sorted_in(buffer, (x, 2.0, 0.3), age, (5.0, r), motion_age, DT)


def kept(slots: list[Arrived]) -> tuple[float, ...]:
    """The buffer of the next sample."""
    return tuple(value for slot in slots[:-1] for value in slot)


EMPTY = (NAN,) * (2 * SIZE)


@pytest.mark.parametrize(("age", "slot", "lead"), [(0.0, 0, 0.0), (0.02, 0, 0.02), (0.06, 1, 0.01), (0.09, 2, -0.01)])
def test_each_in_its_sample(age: float, slot: int, lead: float) -> None:
    slots = put(EMPTY, 1.0, age)
    assert [math.isfinite(one.x) for one in slots] == [k == slot for k in range(3)]
    assert slots[slot].lead == pytest.approx(lead)
    assert math.isnan(slots[slot].r)


@pytest.mark.parametrize("age", [0.13, 3.0, -0.03, NAN, math.inf])
def test_too_late_from_the_future_or_of_no_age(age: float) -> None:
    assert not any(math.isfinite(one.x) for one in put(EMPTY, 1.0, age))


def test_order_does_not_matter() -> None:
    first = put(kept(put(EMPTY, 1.0, 0.0)), 2.0, 0.0)
    late = put(kept(put(EMPTY, NAN, NAN)), 2.0, 0.0)
    late = put(kept(late), 1.0, 0.1)
    assert put(kept(first), NAN, NAN)[1:] == [first[0], first[1]]
    assert late[2].x == 1.0
    assert late[1].x == 2.0


def test_pose_and_motion_have_their_own_ages() -> None:
    slots = put(EMPTY, 1.0, 0.1, r=0.2, motion_age=0.0)
    assert (slots[2].x, slots[0].r, slots[0].v) == (1.0, 0.2, 5.0)
    assert math.isnan(slots[0].x)
    assert math.isnan(slots[2].r)


def test_what_is_nan_replaces_nothing() -> None:
    buffer = kept(put(EMPTY, 1.0, 0.0, r=0.2, motion_age=0.0))
    again = put(buffer, NAN, 0.05, r=NAN, motion_age=0.05)
    assert (again[1].x, again[1].r) == (1.0, 0.2)


def test_what_a_wheel_turns_unheard_is_not_left_in_its_zero() -> None:
    heard = turned_on(1.0, 0.0, 0.1, 1.2)
    assert (heard.before, heard.after, heard.zero, heard.held, heard.unsure) == (1.0, 1.2, 0.1, 0.0, 0.0)
    for nonsense in (NAN, math.inf, 1e9):
        lost = turned_on(1.0, 0.0, 0.1, nonsense)
        assert (lost.before, lost.after, lost.zero, lost.held, lost.unsure) == (1.0, 1.0, 0.1, 1.0, 1.0)
    back = turned_on(1.0, 1.0, 0.7, 1.6)  # the filter has found that it turned by 0.6 in the meantime
    assert (back.before, back.after, back.held, back.unsure) == (1.6, 1.6, 0.0, 1.0)
    assert back.zero == pytest.approx(0.1)
