"""Metrics of signals whose metrics are known, and the criterion at its bounds."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit import metrics
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import radians_of
from steerkit.metrics import GOOD
from tests.support.sines import T


def drive(**changes: Any) -> dict[str, Any]:
    """20 s with e = 0.2 m for the first half, 0.01 m after; the wheel at 10 deg/s; a_y up to -3 m/s^2, as a ramp."""
    t = np.arange(401) * 0.05
    signals = {"t": t, "e": np.where(t < 10.0, -0.2, 0.01), "delta_sw": radians_of(10.0) * t, "a_y": -0.15 * t}
    return signals | changes


def test_the_summary_of_a_drive() -> None:
    s = metrics.summary(**drive(t=3.0 + np.arange(401) * 0.05))
    assert s.duration == pytest.approx(20.0)
    assert s.max_e == 0.2
    assert s.rms_e == pytest.approx(math.sqrt((200 * 0.04 + 201 * 1e-4) / 401))
    assert s.share_within_5cm == pytest.approx(201 / 401)
    assert s.rms_wheel_rate_deg == pytest.approx(10.0)
    assert s.max_a_y == pytest.approx(3.0)
    assert s.rms_jerk == pytest.approx(0.15)
    assert s.max_jerk == pytest.approx(0.15)


def test_a_log_is_summed_up_by_its_names() -> None:
    d = drive()
    signals = {"path.e": d["e"], "car.delta_sw": d["delta_sw"], "car.a_y": d["a_y"]}
    assert metrics.of_log(Log(d["t"], signals, dict.fromkeys(signals, "m"))) == metrics.summary(**d)


@pytest.mark.parametrize(("name", "bound"), [("max_e", 0.25), ("rms_e", 0.10), ("max_jerk", 5.0)])
def test_good_is_a_drive_within_each_of_the_bounds(name: str, bound: float) -> None:
    zero = metrics.summary(**drive(e=np.zeros(401)))
    assert GOOD.met(replace(zero, **{name: 0.999 * bound}))
    for value in (bound, math.nan):
        assert not GOOD.met(replace(zero, **{name: value}))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"e": np.zeros(400)}, r"summary: shapes .* differ, expected \(T,\) each"),
        ({"t": T[:401] ** 2}, "t is not evenly spaced"),
        ({"t": -T[:401]}, "t is not evenly spaced and rising"),
        ({name: np.zeros((401, 3)) for name in ("t", "e", "delta_sw", "a_y")}, r"signal of shape \(401, 3\), expected"),
        ({name: np.arange(10) * 0.05 for name in ("t", "e", "delta_sw", "a_y")}, "10 samples at dt = 0.05 s, expected"),
        ({name: np.arange(100) * 0.5 for name in ("t", "e", "delta_sw", "a_y")}, "expected dt <= 0.25 s"),
        ({name: np.zeros(0) for name in ("t", "e", "delta_sw", "a_y")}, r"shape \(0,\), expected \(T,\) with T >= 1"),
    ],
)
def test_what_is_no_drive_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        metrics.summary(**drive(**changes))
