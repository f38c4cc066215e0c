"""Closed forms of what is said ahead: the model of its own drive, straights, circles and the way into one."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from steerkit import simulate
from steerkit.diagram.loop import Loop
from steerkit.identification import Drive
from steerkit.identification.ahead import HORIZONS, QUANTITIES, Ahead, look_ahead
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import Playback
from tests.support.recorded_cars import BASE, DT, TRUE, steering

T = np.arange(round(40.0 / DT)) * DT
AT = np.array(HORIZONS)
PER = BASE.m / BASE.wheelbase
THETA = {
    "steer_ratio": TRUE.steer_ratio,
    "d_f": PER * BASE.l_r / TRUE.c_f,
    "d_r": PER * BASE.l_f / TRUE.c_r,
    **dict.fromkeys(("delay", "lag", "offset", "rate_zero"), 0.0),
}


def made(angle: np.ndarray, speed: float) -> Drive:
    """A drive of the model itself, without noise."""
    play = Playback(angles=tuple(angle.tolist()), speeds=(speed,) * len(angle), dt=DT)
    car = LinearSingleTrack(vehicle=TRUE, v0=speed, dt=DT, substeps=2)
    loop = Loop(blocks={"drive": play, "car": car}, wires=[(play.delta_sw, car.delta_sw_cmd), (play.v, car.v_cmd)])
    log = simulate(
        loop, len(angle) * DT, record=["drive.delta_sw", "car.v", *(f"car.{q}" for q in ("r", "psi", "x", "y"))]
    )
    signals = {name.split(".")[1]: log[name] for name in log.signals}
    return Drive(name="made", dt=DT, measured=log.t >= 1.0, calibrated=True, **signals)


def judged(drive: Drive, **theta: float) -> Ahead:
    found: Any = SimpleNamespace(vehicle=TRUE, base=BASE, theta=THETA | theta)
    return look_ahead(found, drive)


def unplaced(drive: Drive) -> Drive:
    return replace(drive, x=None, y=None)


WANDERING = made(steering(T, np.full(len(T), 12.0)), 12.0)
CIRCLE = made(np.full(len(T), 0.3), 18.0)


@pytest.mark.parametrize(("ahead", "turn"), [(0.0, 0.0), (-1.2, 0.02), (0.8, -1.5)])
def test_the_model_is_right_about_its_own_drive(ahead: float, turn: float) -> None:
    """Wherever on the car its place is measured, and whatever the heading's zero."""
    drive = WANDERING
    point = drive.x + 1j * drive.y + ahead * np.exp(1j * drive.psi)
    point *= np.exp(1j * turn)
    answer = judged(replace(drive, x=point.real, y=point.imag))
    assert list(answer.errors) == list(QUANTITIES)
    assert f"measured {ahead:+.2f} m" in answer.note or abs(ahead) < 0.1
    for quantity, by_predictor in answer.errors.items():
        assert max(by_predictor["model"]) < 0.02, quantity
    assert max(answer.errors["lateral"]["model"]) < 0.01 * answer.errors["lateral"]["persistence"][-1]
    assert answer.errors["lateral"]["kinematics"][-1] > 10.0 * answer.errors["lateral"]["model"][-1]


def test_all_are_right_on_a_straight() -> None:
    answer = judged(made(np.zeros(len(T)), 15.0))
    assert answer.starts == len(T) - round(1.0 / DT) - round(2.0 / DT) - round(0.1 / DT)
    for quantity in QUANTITIES:
        assert np.array(list(answer.errors[quantity].values())) == pytest.approx(0.0, abs=1e-9), quantity


def test_on_a_steady_circle_only_kinematics_is_wrong() -> None:
    """By its yaw rate, v tan(delta)/L in place of v delta/(L + K v^2): another arc of the same length."""
    answer = judged(unplaced(replace(CIRCLE, measured=T >= 5.0)))
    v, r = 18.0, CIRCLE.r[-1]
    delta = 0.3 / TRUE.steer_ratio
    assert r == pytest.approx(v * delta / (TRUE.wheelbase + TRUE.understeer_gradient * v * v), rel=1e-6)
    beta = (TRUE.l_r - TRUE.m * TRUE.l_f / (TRUE.c_r * TRUE.wheelbase) * v * v) * r / v
    rolling = v * np.tan(delta) / TRUE.wheelbase
    arc, wrong = (v / rate * (1.0 - np.cos(rate * AT)) for rate in (r, rolling))
    assert abs(beta) > 1e-3  # it slides, so v_y starts from a steady one that is not kinematic
    assert answer.errors["lateral"]["kinematics"] == pytest.approx(wrong - arc, rel=2e-3)
    assert max(answer.errors["lateral"]["persistence"]) < 2e-5
    assert max(answer.errors["lateral"]["model"]) < 1e-3


def test_persistence_is_late_by_half_r_v_t_squared_into_a_circle() -> None:
    """From a start s before it, r v (t - s)^2/2 aside: over N starts an RMS of r v/2 sqrt(t^5/(5 dt N))."""
    v, r = 10.0, 0.01
    rate = np.where(T < 20.0, 0.0, r)
    drive = unplaced(replace(CIRCLE, delta_sw=0.0 * T, v=v + 0.0 * T, r=rate, psi=np.cumsum(rate) * DT))
    answer = judged(drive)
    closed = 0.5 * r * v * np.sqrt(AT**5 / (5.0 * DT * answer.starts))
    assert answer.errors["lateral"]["persistence"][1:] == pytest.approx(closed[1:], rel=0.1)


def test_what_is_not_in_the_log_is_said() -> None:
    bare = judged(unplaced(WANDERING))
    assert "v_y" not in bare.errors
    assert "v_y is not in the log" in bare.note
    assert max(bare.errors["lateral"]["model"]) < 0.05  # it starts from a steady v_y
    blind = judged(replace(unplaced(WANDERING), psi=None))  # the yaw rate is enough for displacement
    assert blind.errors["lateral"]["model"] == pytest.approx(bare.errors["lateral"]["model"], abs=0.01)
    mirrored = judged(replace(WANDERING, y=-WANDERING.y))
    assert "do not fit" in mirrored.note
    assert mirrored.errors == bare.errors
    broken = judged(replace(WANDERING, measured=(T % 1.9) > 0.1))
    assert (broken.starts, broken.errors) == (0, {})
    assert "nothing is judged" in broken.note


def test_the_zero_of_a_yaw_rate_is_taken_off() -> None:
    drive = replace(unplaced(WANDERING), psi=None, calibrated=False)
    shifted = judged(replace(drive, r=drive.r + 0.03), rate_zero=0.03)
    for quantity, by_predictor in judged(drive).errors.items():
        for who, errors in by_predictor.items():
            assert shifted.errors[quantity][who] == pytest.approx(errors, abs=1e-9)


def test_places_that_are_not_known_are_left_out() -> None:
    x = WANDERING.x.copy()
    x[1000:1100] = np.nan
    less, all_of_it = judged(replace(WANDERING, x=x)), judged(WANDERING)
    half = round(0.1 / DT)
    assert all_of_it.starts - less.starts == 100 + 2 * half + round(2.0 / DT)
    assert less.errors["lateral"]["model"] == pytest.approx(all_of_it.errors["lateral"]["model"], abs=2e-3)


def test_a_position_that_jumps_is_left_out_and_one_that_is_held_is_not_taken() -> None:
    """Untold, a jump of 50 m turned the heading by 0.14 rad, and all errors became metres."""
    all_of_it = judged(WANDERING)
    jumped = judged(replace(WANDERING, x=WANDERING.x + 50.0 * (T > 30.0)))
    assert "left out 0.2 s in which it goes otherwise than v" in jumped.note
    assert 0 < all_of_it.starts - jumped.starts <= round(2.4 / DT)
    assert jumped.errors["lateral"]["model"] == pytest.approx(all_of_it.errors["lateral"]["model"], abs=2e-3)
    each_second = np.arange(len(T)) // round(1.0 / DT) * round(1.0 / DT)
    held = judged(replace(WANDERING, x=WANDERING.x[each_second], y=WANDERING.y[each_second]))
    assert held.note.startswith("by v and heading, v_y is not in the log")
    assert held.errors["lateral"]["model"][-1] < 0.1
