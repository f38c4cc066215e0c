"""The parts of the vehicle-state estimator: measurements by their age, and a stiff step of the car."""

import math

import numpy as np
import pytest

from steerkit.diagram.maths import rk4
from steerkit.estimators.vehicle_state import (
    SIZE,
    SWAY,
    WHEEL,
    A,
    Measured,
    R,
    V,
    course,
    motion_rows,
    moved,
    reach_of,
    sorted_in,
)
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack, SingleTrack
from steerkit.vehicles import VW_PASSAT

NAN = math.nan


def put(buffer: tuple[float, ...], x: float, age: float, r: float = NAN, motion_age: float = NAN) -> list[Measured]:
    return sorted_in(buffer, (x, 2.0, 0.3), age, (5.0, r), motion_age, 0.05)


def kept(slots: list[Measured]) -> tuple[float, ...]:
    """The buffer of the next sample."""
    return tuple(value for slot in slots[:-1] for value in slot)


EMPTY = (NAN,) * (2 * SIZE)


@pytest.mark.parametrize(("age", "slot", "lead"), [(0.0, 0, 0.0), (0.02, 0, 0.02), (0.06, 1, 0.01), (0.09, 2, -0.01)])
def test_each_in_its_sample(age: float, slot: int, lead: float) -> None:
    slots = put(EMPTY, 1.0, age)
    assert [math.isfinite(one.x) for one in slots] == [k == slot for k in range(3)]
    assert slots[slot].lead == pytest.approx(lead)
    assert math.isnan(slots[slot].r)


def test_what_comes_later_replaces_what_came_first_but_not_by_nan() -> None:
    buffer = kept(put(EMPTY, 1.0, 0.0, r=0.2, motion_age=0.0))
    again = put(buffer, NAN, 0.05, r=NAN, motion_age=0.05)
    assert (again[1].x, again[1].r) == (1.0, 0.2)
    twice = put(buffer, 3.0, 0.06, r=0.4, motion_age=0.05)
    assert (twice[1].x, twice[1].lead, twice[1].r) == (3.0, pytest.approx(0.01), 0.4)
    for age in (0.13, 3.0, -0.03, NAN, math.inf):  # too late, from the future or of no age
        assert not any(math.isfinite(one.x) for one in put(EMPTY, 1.0, age))


def test_pose_and_motion_have_their_own_ages() -> None:
    slots = put(EMPTY, 1.0, 0.1, r=0.2, motion_age=0.0)
    assert (slots[2].x, slots[0].r, slots[0].v) == (1.0, 0.2, 5.0)
    assert math.isnan(slots[0].x)
    assert math.isnan(slots[2].r)


H = 0.05
plants = pytest.mark.parametrize(
    "plant", [NonlinearSingleTrack(vehicle=VW_PASSAT), LinearSingleTrack(vehicle=VW_PASSAT)]
)


def finely(plant: SingleTrack, x: tuple[float, ...], delta: float, v: float, h: float = H) -> tuple[float, ...]:
    for _ in range(500):
        x = rk4(lambda now: plant.rhs(now, delta, v), x, h / 500)
    return x


def step(plant: SingleTrack, x: tuple[float, ...], delta: float, v: float) -> np.ndarray:
    return np.array(moved(plant.rhs, x, delta, v, H, reach_of(plant.rhs, x, delta, v, H)))


@plants
@pytest.mark.parametrize("v", [2.0, 4.0, 7.0, 15.0, 30.0])
def test_a_step_is_that_of_many_small_ones(plant: SingleTrack, v: float) -> None:
    """After a turn of the wheel by a degree of the road wheels, the yaw rate and the pose on the way."""
    delta = min(0.3, 2.0 * (2.7 + 0.003 * v * v) / v**2)  # about 2 m/s^2
    x = finely(plant, (0.0, 0.0, 0.4, 0.0, 0.0), delta, v, 2.0)
    found, exact = step(plant, x, delta + 0.0175, v), np.array(finely(plant, x, delta + 0.0175, v))
    change = abs(exact[3:] - x[3:])
    assert (abs(found - exact)[3:] <= 0.1 * change + 1e-6).all()
    assert abs(found - exact)[:2].max() < 1e-3
    assert abs(found - exact)[2] < 3e-4


@plants
@pytest.mark.parametrize("v", [0.0, 0.3, 1.5])
def test_at_walking_pace_it_settles_and_does_not_blow_up(plant: SingleTrack, v: float) -> None:
    x = np.array((0.0, 0.0, 0.0, 0.3, 1.0))
    for _ in range(40):
        x = step(plant, tuple(x.tolist()), 0.2, v)
    assert x[4] == pytest.approx(finely(plant, (0.0, 0.0, 0.0, 0.0, 0.0), 0.2, v, 2.0)[4], abs=1e-4)
    assert np.isfinite(x).all()


@plants
def test_what_it_depends_on(plant: SingleTrack) -> None:
    x, delta, v, small = (1.0, 2.0, 0.4, *finely(plant, (0.0, 0.0, 0.4, 0.0, 0.0), 0.1, 6.0, 2.0)[3:]), 0.1, 6.0, 1e-3
    after, rows = motion_rows(plant.rhs, x, delta, v, H, 16.0)
    assert after == pytest.approx(step(plant, x, delta, v))
    for i in (*range(6), WHEEL):
        moved = tuple(value + small * (i == j) for j, value in enumerate(x))
        here, there = (
            np.array(finely(plant, *at))
            for at in ((x, delta, v), (moved, delta + small / 16.0 * (i == WHEEL), v + small * (i == V)))
        )
        if i == SWAY:  # to x and y as if it lasted
            there[:2] = here[:2] + H * np.subtract(plant.rhs(moved, delta, v), plant.rhs(x, delta, v))[:2]
        found = np.array([row.get(i, 0.0) for row in rows[:5]])
        near = [0.05, 0.05, 0.01, 0.01, 0.01] if i in (SWAY, R) else [5e-3] * 5  # the pose is by the midpoint
        assert (abs(found - (there - here) / small) < near).all(), i
        assert i != V or found * H == pytest.approx([row[A] for row in rows[:5]])
    assert rows[V] == {V: 1.0, A: H}


@plants
def test_speed_and_sideslip(plant: SingleTrack) -> None:
    x = finely(plant, (0.0, 0.0, 0.0, 0.0, 0.0), 0.15, 5.0, 2.0)
    dx, dy = np.array(finely(plant, x, 0.15, 5.0, 1e-3)[:2]) - x[:2]
    speed, beta = course(plant.rhs, x[3], x[4], 0.15, 5.0)
    assert speed == pytest.approx(np.hypot(dx, dy) / 1e-3, rel=1e-4)
    assert beta == pytest.approx(np.arctan2(dy, dx) - x[2], abs=1e-3)
    assert course(plant.rhs, 0.0, 0.0, 0.1, 0.0) == (0.0, 0.0)
