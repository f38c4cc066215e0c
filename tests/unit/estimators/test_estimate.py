"""Quantities are read by name, with their interval; what holds for every estimator of a car, out of range too."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.special import ndtr

from steerkit.diagram.block import Block
from steerkit.diagram.units import radians_of
from steerkit.estimators.estimate import Estimated, estimated
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import WheelDelay, YawDelay
from steerkit.estimators.steering_hysteresis import SteeringFriction
from tests.support.steered_car import PASSAT, answered, driven_fast, gaps, quantities, steered


def test_the_interval_holds_95_percent() -> None:
    got = Estimated(np.array([1.0, 2.0]), np.array([0.1, 0.2]), np.ones(2))
    share = ndtr((got.high - got.value) / got.deviation) - ndtr((got.low - got.value) / got.deviation)
    np.testing.assert_allclose(share, 0.95, atol=1e-4)


@pytest.mark.parametrize(
    "block", [WheelDelay(longest=0.3), SingleTrackFilter(vehicle=PASSAT), SteeringFriction(longest=0.2)]
)
def test_at_a_standstill_nothing_is_learned_or_forgotten(block: Block) -> None:
    """A deviation of `YawDelay` depends on the speed."""
    signals = answered(steered(20.0), delay=0.1, lag=0.2)
    x = driven_fast(block, signals | {"angle": signals["delta_sw_cmd"]})
    stands = {port.name: np.zeros(2000) for port in block.inputs} | {"active": np.ones(2000)}
    stands |= {"delay": np.full(2000, 0.1), "lag": np.full(2000, 0.2), "psi": np.full(2000, math.nan)}
    stands["r"] = np.full(2000, math.nan if isinstance(block, SingleTrackFilter) else 0.0)  # a gyro at rest is its zero
    before = block.output(0.0, x, ())
    after = block.output(0.0, driven_fast(block, stands, x), ())
    for quantity in quantities(block):
        assert estimated(after, quantity) == estimated(before, quantity)


@pytest.mark.parametrize("what", ["override", "nan"])
@pytest.mark.parametrize(
    ("block", "quantity", "truth", "near"),
    [
        (WheelDelay(), "delay_lag", 0.4, 0.006),
        (SteeringFriction(), "friction", radians_of(0.5), radians_of(0.05)),
        (SingleTrackFilter(vehicle=PASSAT), "ratio", 1.2, 0.025),
    ],
)
def test_what_others_do_to_the_wheel_and_lost_samples_are_not_used(
    block: Block, quantity: str, truth: float, near: float, what: str
) -> None:
    """Whoever overrides turns the wheel as he likes, here exactly against the command."""
    friction, ratio = (truth if quantity == name else other for name, other in (("friction", 0.0), ("ratio", 1.0)))
    car = replace(PASSAT, steer_ratio=ratio * PASSAT.steer_ratio)
    signals = answered(steered(80.0), delay=0.2, lag=0.2, friction=friction, car=car)
    signals["angle"] = signals["delta_sw_cmd"]
    mask = gaps(len(signals["v"]))
    lost, instead = ("v", "r"), np.full(len(mask), np.nan)
    if what == "override":
        signals["active"], lost, instead = np.where(mask, 0.0, 1.0), (), -signals["delta_sw_cmd"]
    for name in ("delta_sw", "delta_sw_meas", *lost):
        signals[name] = np.where(mask, instead, signals[name])
    found = estimated(block.output(0.0, driven_fast(block, signals), ()), quantity)
    assert found.valid == 1.0
    assert found.value == pytest.approx(truth, abs=near)


@pytest.mark.parametrize(
    ("kind", "wrong", "message"),
    [
        (WheelDelay, dict(longest=0.52), r"WheelDelay: longest = 0.52 \[s\], expected a multiple of dt"),
        (WheelDelay, dict(longest=5.05), r"longest = 5.05 \[s\], expected 2 to 100 samples of 0.05 s"),
        (WheelDelay, dict(longest=0.05, prior_delay=0.0), "expected 2 to 100 samples"),
        (WheelDelay, dict(prior_delay=0.9), r"prior_delay = 0.9 \[s\], expected 0 to 0.75"),
        (YawDelay, dict(vehicle="vw-passat"), "YawDelay: .*expected a Vehicle"),
        (SteeringFriction, dict(dt=0.2), r"dt = 0.2 \[s\], expected 0.001 to 0.15"),
        (SingleTrackFilter, dict(vehicle="vw-passat"), "expected a Vehicle"),
        (SingleTrackFilter, dict(vehicle=PASSAT, dt=0.5), r"dt = 0.5 \[s\], expected 0.001 to 0.15"),
        (SingleTrackFilter, dict(vehicle=PASSAT, longest=0.52), r"longest = 0.52 \[s\], expected a multiple of dt"),
        (SingleTrackFilter, dict(vehicle=PASSAT, longest=5.05), "expected 1 to 100 samples"),
    ],
)
def test_parameters_out_of_range(kind: type[Block], wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(**wrong)
    assert [WheelDelay(longest=n, prior_delay=0.1).longest for n in (0.1, 5.0)] == [0.1, 5.0]
    assert [SingleTrackFilter(vehicle=PASSAT, longest=n).longest for n in (0.05, 5.0)] == [0.05, 5.0]
