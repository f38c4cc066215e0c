"""Dead time and lag are found from commands and answers, within their intervals, and only where there is something."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import radians_of
from steerkit.estimators.estimate import Estimated, estimated
from steerkit.estimators.steering_delay import DelayBank, WheelDelay, YawDelay
from steerkit.task import STOP
from tests.support.steered_car import HELD, PASSAT, answered, driven, quantities, steered

WHEEL, YAW = WheelDelay(), YawDelay(vehicle=PASSAT)


def said(block: DelayBank, x: Any, name: str = "delay_lag") -> Estimated:
    return estimated(block.output(0.0, x, ()), name)


@pytest.mark.parametrize(("delay", "lag"), [(0.0, 0.2), (0.07, 0.1), (0.22, 0.28), (0.5, 0.15)])
def test_the_wheel_shows_delay_and_lag(delay: float, lag: float) -> None:
    x = driven(WHEEL, answered(steered(40.0), delay=delay, lag=lag))
    for name, truth, most in (("delay_lag", delay + lag, 0.012), ("delay", delay, 0.04), ("lag", lag, 0.04)):
        found = said(WHEEL, x, name)
        assert found.valid == 1.0 or (name != "delay_lag" and lag == 0.1)  # half the prior's lag is separated badly
        assert found.low <= truth <= found.high
        assert found.value == pytest.approx(truth, abs=most)


@pytest.mark.parametrize("v", [5.0, 20.0])
def test_the_yaw_rate_shows_them_with_its_own_age(v: float) -> None:
    signals = answered(steered(40.0), delay=0.12, lag=0.25, v=v)
    noise = np.random.default_rng(3).normal(0.0, YAW.noise, len(signals["r"]))
    late = np.concatenate((np.zeros(2), signals["r"][:-2])) + noise + 0.01  # 0.1 s old, and its zero is wrong
    found = said(YAW, driven(YAW, signals | {"r": late}))
    assert found.valid == 1.0
    assert found.value == pytest.approx(0.12 + 0.25 + 0.1 + HELD, abs=0.01)
    assert found.low <= 0.47 + HELD <= found.high


@pytest.mark.parametrize("early", [2, 8])
def test_a_yaw_rate_whose_clock_is_early_is_not_valid(early: int) -> None:
    signals = answered(steered(60.0), delay=0.0, lag=0.1)
    noise = np.random.default_rng(3).normal(0.0, YAW.noise, len(signals["r"]))
    signals["r"] = np.concatenate((signals["r"][early:], np.full(early, signals["r"][-1]))) + noise
    assert said(YAW, driven(YAW, signals)).valid == 0.0


def test_a_wrong_ratio_and_offset_do_no_harm_to_the_yaw_rates_delay() -> None:
    right = answered(steered(40.0), delay=0.12, lag=0.25)
    wrong = right | {"delta_sw_cmd": 1.25 * right["delta_sw_cmd"] + radians_of(4.0)}
    values = [said(YAW, driven(YAW, signals)).value for signals in (right, wrong)]
    assert values[0] == pytest.approx(values[1], abs=0.004)


@pytest.mark.parametrize("block", [WHEEL, YAW], ids=["wheel", "yaw"])
def test_without_excitation_the_prior_stays_and_is_not_valid(block: DelayBank) -> None:
    straight = answered(np.zeros(600), delay=0.3, lag=0.1)
    noisy = {
        name: straight[name] + np.random.default_rng(0).normal(0.0, d, 600)
        for name, d in (("r", YAW.noise), ("delta_sw_meas", WHEEL.noise))
    }
    for signals in (straight, straight | noisy):
        y = block.output(0.0, driven(block, signals), ())
        assert [estimated(y, name).valid for name in quantities(block)] == [0.0, 0.0, 0.0]
        assert y.delay == pytest.approx(block.prior_delay, abs=0.03)
        assert y.lag == pytest.approx(block.prior_lag, abs=0.005)
        assert y.delay_deviation == pytest.approx(block.prior_delay_deviation, rel=0.1)
        assert y.lag_deviation == pytest.approx(block.prior_lag_deviation, rel=0.1)


@pytest.mark.parametrize("bound", ["stop", "rate_limit"])
def test_commands_that_the_motor_cannot_follow_are_left_out(bound: str) -> None:
    """In two of 20 seconds a command beyond the stop, or one that jumps to and fro: the motor stays calm."""
    calm = steered(60.0)
    signals, k = answered(calm, delay=0.1, lag=0.2), np.arange(len(calm))
    wild = np.abs(calm) + STOP if bound == "stop" else calm + radians_of(50.0) * (-1.0) ** k
    signals["delta_sw_cmd"] = np.where(k % 400 < 40, wild, calm)
    found = said(WHEEL, driven(replace(WHEEL, rate_limit=radians_of(300.0)), signals))
    assert found.value == pytest.approx(0.3, abs=0.006)
    if bound == "rate_limit":
        unlimited = said(WHEEL, driven(replace(WHEEL, rate_limit=100.0), signals))
        assert unlimited.deviation > 1.5 * found.deviation


def test_an_answer_that_the_commands_do_not_explain_is_not_valid() -> None:
    signals = answered(steered(40.0), delay=0.1, lag=0.2)
    found = said(WHEEL, driven(WHEEL, signals | {"delta_sw_meas": steered(40.0, seed=7)}))
    assert found.valid == 0.0
