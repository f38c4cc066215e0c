"""With `steering`, the estimator follows ratio and zeros as they are found, slowly, within bounds."""

import math
from dataclasses import replace
from typing import Any

import pytest

from steerkit.diagram.units import radians_of
from steerkit.estimators import vehicle_state
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.vehicle_state import FOLLOWED, Followed, VehicleState
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.vehicles import VW_PASSAT
from tests.support.stepped import run_fast

PLAIN = VehicleState.of(NonlinearSingleTrack(vehicle=VW_PASSAT))
STEERING = SingleTrackFilter(vehicle=VW_PASSAT, held=False)
HERE = dict(x_in=1.0, y_in=2.0, psi_in=0.1, age_in=0.05, v_in=6.0, r_in=0.1, motion_age_in=0.05, delta_sw_meas=0.4)


ADAPTIVE = replace(PLAIN, steering=STEERING)
END = -len(Followed._fields)


def measured(block: Any, u: Any) -> Any:
    """What of the inputs acts at once."""
    return block.D(*[getattr(u, name) for name in block.D._fields])


def using(x: Any, **numbers: float) -> Any:
    """A state in which these numbers are in use."""
    return (*x[:END], *Followed._make(x[END:])._replace(**numbers))


def test_the_wheel_is_that_of_the_data_sheets_car_and_the_gyro_is_without_its_zero(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(vehicle_state, "FOLLOWED", {name: (*ends, 0.0) for name, (*ends, _) in FOLLOWED.items()})
    block = ADAPTIVE
    u = block.U(**HERE)
    x = using(block.init(), ratio=1.25, understeer=0.006, offset=0.05, rate_zero=0.01, speed=6.0)
    k, length, square = VW_PASSAT.understeer_gradient, VW_PASSAT.wheelbase, 36.0
    wheel = (0.4 + 0.05) / 1.25 * (length + k * square) / (length + 0.006 * square)
    seen = PLAIN.U(**HERE | {"delta_sw_meas": wheel, "r_in": 0.1 - 0.01})
    x = block.settle(0.0, x, measured(block, u))
    state = PLAIN.settle(0.0, PLAIN.init(), measured(PLAIN, seen))
    for _ in range(30):
        y, plain = block.output(0.0, x, u), PLAIN.output(0.0, state, seen)
        assert (y.x, y.r, y.nis) == pytest.approx((plain.x, plain.r, plain.nis), rel=1e-9)
        assert y.gyro_zero == pytest.approx(plain.gyro_zero + 0.01)
        assert y.wheel_offset == pytest.approx(1.25 * plain.wheel_offset + 0.05)
        assert (y.ratio, plain.ratio) == (1.25, 1.0)
        x, state = block.update(0.0, x, u, y), PLAIN.update(0.0, state, seen, plain)
    assert abs(plain.wheel_offset) > 1e-3  # it has found that wheel and gyro do not go together


@pytest.mark.parametrize(
    ("name", "before", "value", "valid", "after"),
    [
        ("ratio", 1.0, 1.3, 1.0, 1.005),
        ("ratio", 1.598, 1.9, 1.0, 1.6),
        ("ratio", 1.0, 0.999, 1.0, 0.999),
        ("ratio", 1.0, 1.3, 0.0, 1.0),
        ("ratio", 1.0, math.nan, 1.0, 1.0),
        ("ratio", 0.602, 0.1, 1.0, 0.6),
        ("offset", 0.1745, 0.3, 1.0, radians_of(10.0)),
        ("offset", -0.1745, -0.3, 1.0, radians_of(-10.0)),
        ("offset", 0.0, -0.3, 1.0, radians_of(-0.05)),
        ("rate_zero", 0.01745, 0.3, 1.0, radians_of(1.0)),
        ("rate_zero", 0.0, -0.3, 1.0, radians_of(-0.005)),
    ],
)
def test_what_is_used_follows_a_valid_estimate_no_faster_than_stated_and_within_bounds(
    monkeypatch: pytest.MonkeyPatch, name: str, before: float, value: float, valid: float, after: float
) -> None:
    found = STEERING.output(0.0, STEERING.init(), ())._replace(**{name: value, f"{name}_valid": valid})
    monkeypatch.setattr(SingleTrackFilter, "output", lambda *_: found)
    u = ADAPTIVE.U(**HERE)
    x = ADAPTIVE.update(0.0, using(ADAPTIVE.init(), **{name: before}), u, None)
    assert getattr(ADAPTIVE._followed(x), name) == pytest.approx(after)


@pytest.mark.parametrize("wrong", [{"v_in": 0.0}, {"v_in": math.nan}, {"r_in": math.nan}, {"delta_sw_meas": math.nan}])
def test_nothing_is_followed_at_a_standstill_nor_what_is_no_number(wrong: dict[str, float]) -> None:
    block = ADAPTIVE
    u = block.U(**HERE | wrong)
    x = block.settle(0.0, block.init(), measured(block, block.U(**HERE)))
    for k in range(300):
        swing = {} if "delta_sw_meas" in wrong else {"delta_sw_meas": math.sin(0.2 * k)}
        gyro = {} if "r_in" in wrong else {"r_in": 0.1 * math.sin(0.2 * k) if u.v_in != 0.0 else 0.0}
        x = block.update(0.0, x, u._replace(**swing, **gyro), None)
    assert x[-4:-1] == (1.0, VW_PASSAT.understeer_gradient, 0.0)


@pytest.mark.parametrize("late", [0.0, 0.05, 0.1])
def test_ratio_and_zeros_are_found_however_old_the_motion_is(late: float) -> None:
    """A car with a ratio 20 % longer: its wheel turns 1.2 times as far; and both sensors are off."""
    block, car = ADAPTIVE, replace(NonlinearSingleTrack(vehicle=VW_PASSAT), v0=7.0)
    z: Any = car.init()
    tape: list[Any] = []
    rows: list[Any] = []
    for k in range(900):
        now = car.output(0.0, z, None)
        tape.append(now)
        old = tape[max(k - round(late / 0.05), 0)]
        age = min(late, 0.05 * k)
        rows.append(block.U(old.x, old.y, old.psi, age, old.v, old.r + 0.004, age, 1.2 * now.delta_sw - 0.03))
        for n in range(5):
            t = 0.05 * k + 0.01 * n
            z = car.update(t, z, car.U(1.2 * math.sin(0.9 * t) + 0.8 * math.sin(0.23 * t + 1.0), 7.0), now)
    ys, x = run_fast(block, rows)
    y = block.Y(*ys[-1])
    assert y.ratio == pytest.approx(1.2, rel=0.01)
    assert y.wheel_offset == pytest.approx(0.03, abs=radians_of(0.2))
    assert y.gyro_zero == pytest.approx(0.004, abs=3e-4)
    assert x[-2] == pytest.approx(0.03, abs=radians_of(0.4))  # by what is used, not by what is found behind it
    assert x[-1] == pytest.approx(0.004, abs=1e-3)
