"""The numbers are found where driving shows them, within their intervals; else the priors stay."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.estimators.estimate import Estimated, estimated
from steerkit.estimators.single_track_filter import SingleTrackFilter
from tests.support.steered_car import PASSAT, Signals, answered, driven_fast, quantities, steered

BLOCK = SingleTrackFilter(vehicle=PASSAT, gyro_scale=0.0, bank=0.0)
"""Of a gyro that is right, on level roads."""
OTHER = replace(PASSAT, steer_ratio=1.2 * PASSAT.steer_ratio)


def found(x: Any) -> dict[str, Estimated]:
    y = BLOCK.output(0.0, x, ())
    return {name: estimated(y, name) for name in quantities(BLOCK)}


def sensed(signals: Signals, zero: float = 0.0) -> Signals:
    """With the noise of hard sensors, and a gyro whose zero is wrong [rad/s]."""
    rng, n = np.random.default_rng(0), len(signals["r"])
    r = signals["r"] + zero + rng.normal(0.0, BLOCK.noise, n)
    return signals | {"r": r, "psi": signals["psi"] + rng.normal(0.0, BLOCK.psi_noise, n)}


def wandering(seconds: float, low: float, high: float) -> np.ndarray:
    t = np.arange(round(seconds / 0.05)) * 0.05
    return np.asarray(0.5 * (low + high) + 0.5 * (high - low) * np.sin(0.2 * t))


def drive(seconds: float = 60.0, **car: Any) -> Signals:
    given: dict[str, Any] = dict(delay=0.15, lag=0.2, v=wandering(seconds, 5.0, 9.0), offset=radians_of(3.0), car=OTHER)
    return answered(steered(seconds), **(given | car))


def test_ratio_offset_and_zero_are_found_within_a_minute() -> None:
    got = found(driven_fast(BLOCK, sensed(drive(), zero=0.004)))
    truth = {"ratio": 1.2, "offset": radians_of(3.0), "rate_zero": 0.004, "total_offset": radians_of(3.0)}
    for name, value in truth.items():
        assert got[name].valid == 1.0
        assert got[name].low <= value <= got[name].high
    assert got["ratio"].value == pytest.approx(1.2, rel=0.02)
    assert got["offset"].value == pytest.approx(radians_of(3.0), abs=radians_of(0.3))
    assert got["understeer"].valid == got["disturbance"].valid == 0.0  # too slow, no bank: neither is observable


def test_what_a_gyros_scale_and_a_bank_make_of_ratio_and_offset_is_in_their_intervals() -> None:
    signals = sensed(drive(120.0))
    aside = 9.81 * 0.03 * PASSAT.understeer_gradient * OTHER.steer_ratio  # of the wheel, on a bank of 0.03
    x = driven_fast(BLOCK, signals | {"r": 1.06 * signals["r"], "delta_sw": signals["delta_sw"] - aside})
    wide = SingleTrackFilter(vehicle=PASSAT).output(0.0, x, ())
    for name, truth in (("ratio", 1.2), ("offset", radians_of(3.0))):
        blind, honest = found(x)[name], estimated(wide, name)
        assert not blind.low <= truth <= blind.high
        assert honest.low <= truth <= honest.high
        assert honest.valid == blind.valid == 1.0


def test_the_understeer_gradient_is_found_at_speed() -> None:
    soft = replace(PASSAT, c_r=0.8 * PASSAT.c_r)
    speeds = wandering(90.0, 10.0, 35.0)
    command = steered(90.0) * (10.0 / speeds) ** 2
    got = found(driven_fast(BLOCK, sensed(answered(command, delay=0.15, lag=0.2, v=speeds, car=soft))))
    assert soft.understeer_gradient < PASSAT.understeer_gradient - 5e-4
    assert got["understeer"].valid == 1.0
    assert got["understeer"].low <= soft.understeer_gradient <= got["understeer"].high


def test_on_a_straight_the_ratio_stays_and_the_offset_is_found() -> None:
    straight = radians_of(-3.0) + np.zeros(1200)
    signals = sensed(drive() | answered(straight, delay=0.15, lag=0.2, offset=radians_of(3.0)))
    got = found(driven_fast(BLOCK, signals))
    assert got["ratio"].value == pytest.approx(1.0, abs=0.05)
    assert got["ratio"].valid == 0.0
    assert got["ratio"].deviation > 0.2
    assert got["offset"].low < radians_of(3.0) < got["offset"].high
    assert got["offset"].value == pytest.approx(radians_of(3.0), abs=radians_of(0.7))  # play may hold the wheels aside
    assert got["offset"].deviation > radians_of(0.3)
    tight = found(driven_fast(replace(BLOCK, play=0.0, play_prior=1e-4), signals))  # given that there is none
    assert tight["offset"].value == pytest.approx(radians_of(3.0), abs=radians_of(0.3))
    assert tight["offset"].deviation < radians_of(0.25)


def test_free_play_is_not_taken_for_another_ratio() -> None:
    """Gentle steering, of which friction and play keep a tenth."""
    worn = dict(friction=radians_of(1.0), play=radians_of(2.0))
    signals = sensed(drive() | answered(0.5 * steered(60.0), delay=0.15, lag=0.2, v=wandering(60.0, 5.0, 9.0), **worn))
    knows, blind = (found(driven_fast(block, signals))["ratio"] for block in (BLOCK, replace(BLOCK, play_prior=1e-4)))
    assert knows.low < 1.0 < knows.high
    assert abs(knows.value - 1.0) < 0.5 * abs(blind.value - 1.0)


def test_while_the_car_stands_the_gyro_tells_its_zero_and_all_else_stays() -> None:
    stands = {port.name: np.zeros(2000) for port in BLOCK.inputs} | {"psi": np.full(2000, np.nan)}
    got = found(driven_fast(BLOCK, sensed(stands, zero=-0.003)))
    assert got["rate_zero"].value == pytest.approx(-0.003, abs=5e-4)
    assert got["rate_zero"].valid == 1.0
    before = found(BLOCK.init())
    for name in ("ratio", "understeer", "offset", "disturbance"):
        assert got[name] == before[name]
        assert got[name].valid == 0.0


def test_bends_leave_nothing_in_the_gyros_zero() -> None:
    """Which the heading shows: by the trapezoidal rule, as a car in a bend turns by a degree from sample to sample."""
    t = 0.05 * np.arange(1200)
    r, psi = 0.4 * np.sin(0.11 * t) + 0.004, 0.4 / 0.11 * (1.0 - np.cos(0.11 * t))
    block, nan = replace(BLOCK, psi_noise=1e-4, noise=1e-4), float("nan")
    x = block.init()
    for k in range(len(t)):
        u = block.U(0.0, 6.0, float(r[k]), float(psi[k]), nan, nan, nan, 0.0)
        x = block.update(0.0, x, u, ())
        if k > 110:  # the first window is over
            assert block.output(0.0, x, ()).rate_zero == pytest.approx(0.004, abs=1e-4)


def test_zeros_stay_known_where_a_ratio_is_forgotten() -> None:
    """A minute of driving with nothing to learn from: an offset is mechanical, a ratio goes with load and tyres."""
    block = replace(BLOCK, memory=300.0)
    x = driven_fast(block, sensed(drive(60.0)))
    blind = {name: values[-1:].repeat(1200) for name, values in sensed(drive(60.0)).items()}
    before, after = found(x), found(driven_fast(block, blind | {"r": np.full(1200, np.nan)}, x))
    assert after["ratio"].deviation > 3.0 * before["ratio"].deviation
    walk = math.sqrt(2.0 * 60.0 / block.zero_memory)  # of what the prior is, in a minute
    for name, prior in (("offset", block.offset_prior), ("rate_zero", block.rate_zero_prior)):
        widened = math.sqrt(after[name].deviation ** 2 - before[name].deviation ** 2)
        assert widened == pytest.approx(walk * prior, rel=0.05)
