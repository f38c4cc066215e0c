"""A drive, driven again: where nothing is to be changed nothing is, and where something is, it is found."""

import math
from dataclasses import replace

import numpy as np
import pytest

from steerkit import vehicle
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.logs import Drive
from steerkit.logs.resimulate import resimulate, way
from steerkit.plants.steering_actuator import SteeringActuator

CAR = vehicle("vw-passat")
QUICK = SteeringActuator(lag=0.05)


def drive(*, seconds: float = 40.0, dt: float = 0.05, wrong: float = 0.0) -> Drive:
    """A steady S at 8 m/s, steered as the linear car needs it; `wrong` [rad] more of wheel from 20 to 22 s."""
    t = np.arange(0.0, seconds, dt)
    v = np.full_like(t, 8.0)
    r = 0.15 * np.sin(2.0 * np.pi * t / 20.0)
    kappa = r / v
    wheel = CAR.steer_ratio * kappa * (CAR.wheelbase + CAR.understeer_gradient * v**2)
    wheel = wheel + wrong * ((t > 20.0) & (t < 22.0))
    return Drive.of(dict(t=t, delta_sw=wheel, v=v, r=r), name="s", dt=dt, trusted=True)


def test_the_way_is_the_integral_of_speed_and_yaw_rate() -> None:
    t = np.arange(0.0, 60.0, 0.02)
    v, r = np.full_like(t, 6.0), np.full_like(t, 0.1)
    wheel = np.full_like(t, 0.5)
    circle = Drive.of(dict(t=t, delta_sw=wheel, v=v, r=r), name="c", trusted=True)
    path = way(circle, ahead=0.0)
    assert path.length == pytest.approx(10.0 + 6.0 * t[-1] + 50.0, abs=0.1)
    xy = path.point(np.linspace(12.0, 300.0, 50))
    assert np.abs(np.hypot(xy[:, 0], xy[:, 1] - 60.0) - 60.0).max() < 0.01
    front = way(circle, ahead=2.0).point(np.linspace(12.0, 300.0, 50))
    assert np.abs(np.hypot(front[:, 0], front[:, 1] - 60.0) - math.hypot(60.0, 2.0)).max() < 0.01


@pytest.mark.parametrize("name", ["stanley", "mpc"])
def test_a_drive_as_the_controller_would_is_left_as_it_is(name: str) -> None:
    again = resimulate(drive(seconds=30.0), name, vehicle=CAR, steering=QUICK)
    assert np.abs(again.log["path.e"][again.compared]).max() < 0.06
    assert degrees_of(float(np.nanmax(np.abs(again.differs)))) < 6.0
    figures = again.figures()
    assert figures["again"]["max_a_y"] == pytest.approx(figures["driven"]["max_a_y"], rel=0.05)
    assert figures["again"]["seconds_beyond_a_y"] == 0.0
    assert again.log.t[again.compared][0] == pytest.approx(2.0), "it begins on a straight that was not driven"


def test_what_was_steered_otherwise_is_found() -> None:
    again = resimulate(drive(wrong=radians_of(30.0)), "stanley", vehicle=CAR, steering=QUICK)
    worst = again.places(1)[0]
    assert 20.0 <= worst["t"] <= 22.05
    assert worst["differs_deg"] == pytest.approx(-30.0, abs=6.0)
    apart = [place["t"] for place in again.places()]
    assert min(abs(a - b) for a in apart for b in apart if a != b) >= 10.0
    assert again.figures()["driven"]["rms_wheel_speed_deg_s"] > again.figures()["again"]["rms_wheel_speed_deg_s"]


def test_an_offset_of_the_record_is_no_difference() -> None:
    plain = drive(seconds=25.0)
    shifted = replace(plain, delta_sw=plain.delta_sw - 0.1)
    one = resimulate(plain, "stanley", vehicle=CAR, steering=QUICK)
    other = resimulate(shifted, "stanley", vehicle=CAR, steering=replace(QUICK, offset=0.1))
    assert np.allclose(one.driven, other.driven, atol=1e-12)


def test_limits_are_counted() -> None:
    fast = drive(seconds=40.0)
    fast = replace(fast, v=3.0 * fast.v, delta_sw=fast.delta_sw)
    figures = resimulate(fast, "stanley", vehicle=CAR, steering=QUICK).figures()
    exact = float(np.mean(np.abs(24.0 * 0.15 * np.sin(np.linspace(0.0, 4.0 * np.pi, 4000))) > 3.0))
    assert figures["driven"]["max_a_y"] == pytest.approx(3.6, abs=0.01)
    assert figures["driven"]["seconds_beyond_a_y"] == pytest.approx(exact * 40.0, rel=0.1)


def test_a_drive_without_a_way_and_unknown_controllers_are_refused() -> None:
    short = drive(seconds=22.0)
    short = replace(short, v=0.0 * short.v)
    with pytest.raises(ValueError, match=r"goes 0.0 m, expected 20 m or more"):
        resimulate(short, "stanley", vehicle=CAR)
    with pytest.raises(ValueError, match=r"controller 'stanlay' is not known \(did you mean 'stanley'"):
        resimulate(drive(seconds=22.0), "stanlay", vehicle=CAR)
