"""Friction is found from the loop that it leaves, and is not taken for delay."""

from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.estimators.estimate import Estimated, estimated
from steerkit.estimators.steering_hysteresis import PER_LAG, SteeringFriction
from tests.support.steered_car import Signals, answered, driven_fast, steered

FRICTION = SteeringFriction()


def worn(seconds: float = 60.0, *, friction_deg: float = 0.0) -> Signals:
    signals = answered(steered(seconds), delay=0.15, lag=0.2, friction=radians_of(friction_deg))
    return signals | {"angle": signals["delta_sw_cmd"]}


def said(block: SteeringFriction, x: Any) -> Estimated:
    return estimated(block.output(0.0, x, ()), "friction")


@pytest.mark.parametrize("degrees", [0.0, 0.4, 1.5])
def test_friction_is_found_within_a_tenth(degrees: float) -> None:
    found = said(FRICTION, driven_fast(FRICTION, worn(80.0, friction_deg=degrees)))
    assert found.valid == 1.0
    assert found.low <= radians_of(degrees) <= found.high
    assert found.value == pytest.approx(radians_of(degrees), rel=0.025, abs=radians_of(0.005))


@pytest.mark.parametrize("late", [-0.03, 0.03])
def test_a_delay_that_is_given_wrong_is_not_taken_for_friction(late: float) -> None:
    signals = worn(friction_deg=0.5)
    found = said(FRICTION, driven_fast(FRICTION, signals | {"delay": signals["delay"] + late}))
    assert found.value == pytest.approx(radians_of(0.5), abs=radians_of(0.1))
    assert found.low <= radians_of(0.5) <= found.high


def test_on_a_straight_the_prior_stays() -> None:
    signals = answered(np.zeros(1200), delay=0.15, lag=0.2)
    found = said(FRICTION, driven_fast(FRICTION, signals | {"angle": signals["delta_sw_meas"]}))
    assert found.valid == 0.0
    assert found.value == pytest.approx(FRICTION.prior, abs=radians_of(0.05))
    assert found.deviation == pytest.approx(FRICTION.prior_deviation, rel=0.05)


def test_a_lag_that_is_hardly_known_is_in_the_interval_until_another_is_found() -> None:
    signals = worn(30.0, friction_deg=0.5)

    def given(deviation: float, samples: int) -> Estimated:
        given = signals | {"lag_deviation": np.full(len(signals["v"]), deviation)}
        return said(FRICTION, driven_fast(FRICTION, {name: values[:samples] for name, values in given.items()}))

    sure, unsure = given(0.0, 200), given(0.04, 200)
    assert unsure.value == sure.value
    assert unsure.deviation == pytest.approx(np.hypot(sure.deviation, 0.04 * PER_LAG))
    assert unsure.valid == 0.0
    assert given(0.04, 600).valid == 1.0


@pytest.mark.parametrize("longer", [-0.03, 0.05])
def test_a_lag_that_is_given_wrong_is_not_taken_for_friction(longer: float) -> None:
    signals = worn(80.0, friction_deg=0.7)
    given = {"delay": signals["delay"] - longer, "lag": signals["lag"] + longer, "lag_deviation": 0.05 + signals["lag"]}
    found = said(FRICTION, driven_fast(FRICTION, signals | given))
    assert found.low <= radians_of(0.7) <= found.high
    assert found.value == pytest.approx(radians_of(0.7), rel=0.1)


def test_a_width_that_is_known_by_a_fifth_only_is_not_valid() -> None:
    """Of a twist of 0.2 degrees that friction holds the interval is narrow, but not within a tenth of it."""
    found = said(FRICTION, driven_fast(FRICTION, worn(friction_deg=0.25)))
    assert 0.1 * found.value < found.high - found.value < 0.25 * found.value
    assert found.high > radians_of(0.25)
    assert found.valid == 0.0


def test_an_angle_that_turns_between_samples_is_followed_to_where_it_turned() -> None:
    """Behind a dead time of 2.4 samples the wheel turns where no sample is."""
    t = 0.05 * np.arange(1200)
    command = radians_of(60.0) * (np.abs(t % 1.0 - 0.5) - 0.25) + radians_of(5.0) * np.sin(t)
    signals = answered(command, delay=0.12, lag=0.1, friction=radians_of(0.6))
    found = said(FRICTION, driven_fast(FRICTION, signals | {"angle": command}))
    assert found.value == pytest.approx(radians_of(0.6), rel=0.02)
    assert found.low <= radians_of(0.6) <= found.high
