"""Which measurements are used, which are rejected, and what is remembered of them."""

from __future__ import annotations

import math
from typing import Any

import pytest

from steerkit.estimators.arrivals import Arrived
from steerkit.estimators.correction import D_X, GYRO, HEADING, NEVER, PSI, Correction, Memory, R, V, X
from steerkit.estimators.gauss import Covariance
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.vehicles import VW_PASSAT

RHS = NonlinearSingleTrack(vehicle=VW_PASSAT).rhs
NAN = math.nan
CORRECTION = Correction(
    position_noise=0.01, psi_noise=0.001, v_noise=0.05, r_noise=0.003, gate=4.0, patience=0.2, doubt_time=0.5, dt=0.05
)
MEAN = tuple(5.0 if i == V else 0.0 for i in range(13))
NOTHING = Arrived(NAN, NAN, NAN, NAN, NAN, NAN)


def known(deviation: float = 0.01) -> Covariance:
    return [[deviation**2, *[0.0] * (12 - i)] for i in range(13)]


def after(
    due: Arrived, memory: Memory | None = None, p: Covariance | None = None
) -> tuple[tuple[float, ...], Covariance, Memory]:
    mean, wider, kept = CORRECTION.measured(RHS, MEAN, p or known(), due, memory or Memory(*[0.0] * 14), 0.0)
    return tuple(mean), wider, kept


def test_nothing_measured_changes_nothing_but_the_time() -> None:
    mean, p, memory = after(NOTHING)
    assert mean == MEAN
    assert p == known()
    assert memory.unseen == pytest.approx(0.05)
    assert (memory.nis, memory.nis_count, memory.rejected) == (0.0, 0.0, 0.0)


def test_a_position_is_shared_between_car_and_sensor_by_what_is_known_of_them() -> None:
    p = known()
    p[D_X][0] = 0.02**2
    mean, _, memory = after(NOTHING._replace(x=0.03, y=0.0, lead=0.0), p=p)
    assert mean[D_X] == pytest.approx(4.0 * mean[X])
    assert mean[X] == pytest.approx(0.03 * 1e-4 / (1e-4 + 4e-4 + 1e-4), rel=1e-3)
    assert (memory.unseen, memory.nis_count) == (0.0, 2.0)
    assert memory.nis == pytest.approx(0.03**2 / 6e-4, rel=1e-3)


def test_an_older_pose_is_moved_along_the_course() -> None:
    mean, _, memory = after(NOTHING._replace(x=-0.02, y=0.0, lead=0.004))
    assert mean[X] == pytest.approx(0.0, abs=1e-9)
    assert memory.rejected == 0.0


def test_each_measurement_is_judged_by_what_is_known_after_those_before() -> None:
    """The speed settles what the yaw rate is taken against, if they go together."""
    p = known(0.1)
    p[R][0], p[GYRO][0] = 0.1**2, 0.0
    p[R][V - R] = 0.999 * 0.1**2
    mean, _, memory = after(NOTHING._replace(v=5.1, r=0.1), p=p)
    assert memory.nis < 4.0
    assert mean[R] == pytest.approx(0.1, abs=0.01)


@pytest.mark.parametrize(
    ("channel", "states"), [("x", (X, D_X)), ("psi", (PSI, HEADING)), ("r", (R, GYRO)), ("v", (V,))]
)
def test_a_jump_is_rejected_until_it_has_lasted(channel: str, states: tuple[int, ...]) -> None:
    before = dict(zip(["x", "y", "psi", "v", "r"], (0.0, 0.0, 0.0, 5.0, 0.0)))
    far: Any = Arrived(**(before | {channel: before[channel] + 1.0}), lead=0.0)
    memory = Memory(*[0.0] * 14)
    for _ in range(4):
        mean, p, memory = after(far, memory)
        assert memory.rejected == 1.0
        assert sum(mean[i] - MEAN[i] for i in states) == pytest.approx(0.0, abs=1e-9)
    mean, p, memory = after(far, memory)
    assert memory.rejected == 0.0
    assert sum(mean[i] - MEAN[i] for i in states) == pytest.approx(1.0, abs=0.05)
    assert p[states[0]][0] > (0.4 if len(states) == 2 else 0.001)


def test_one_that_comes_back_in_time_is_forgotten() -> None:
    far, near = (NOTHING._replace(x=x, y=0.0, lead=0.0) for x in (1.0, 0.0))
    memory = Memory(*[0.0] * 14)
    for due in (far, far, far, near, far, far, far):
        _, _, memory = after(due, memory)
    assert memory.position == pytest.approx(0.15)
    assert memory.rejected == 1.0


def test_the_first_position_is_believed_wherever_it_is() -> None:
    never = Memory(*[0.0] * 14)._replace(unseen=NEVER)
    mean, _, memory = after(NOTHING._replace(x=5e4, y=-3e3, lead=0.0), never)
    assert mean[X] == pytest.approx(5e4, rel=1e-6)
    assert abs(mean[D_X]) < 0.1
    assert (memory.unseen, memory.rejected) == (0.0, 0.0)


@pytest.mark.parametrize("value", [NAN, math.inf, -math.inf])
def test_nonsense_is_nothing(value: float) -> None:
    mean, p, memory = after(Arrived(value, value, value, 0.0, value, value))
    assert mean == MEAN
    assert p == known()
    assert memory.rejected == 0.0


def test_innovations_of_one_sign_add_up() -> None:
    memory = Memory(*[0.0] * 14)
    due = NOTHING._replace(x=0.0, y=0.03, psi=0.0, lead=0.0, v=5.0, r=-0.005)
    for _ in range(40):
        _, _, memory = after(due, memory)
    assert memory.aside == pytest.approx(0.03 / math.sqrt(3e-4), rel=0.05)
    assert memory.turning < -0.1
    assert memory.turned == pytest.approx(0.0, abs=0.1)
