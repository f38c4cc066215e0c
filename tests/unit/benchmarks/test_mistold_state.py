"""Cars of which nothing that estimator and controllers are told is true, and what is measured of a drive."""

from __future__ import annotations

import math

import pytest

from benchmarks.calibration_loop import mistold
from benchmarks.mistold_state import driven, unlike


def test_cars_are_wrong_by_what_is_said_and_behind_an_estimator_nothing_is_late() -> None:
    zeros = set()
    for number in (3004, 3008):
        raw, behind = unlike(number, "none"), unlike(number, "adaptive-state")
        wrong, true = mistold(number)
        assert (raw.believed_delay, behind.estimator) == (wrong.believed_delay, "adaptive-state")
        assert behind.believed_dead_time == pytest.approx(max(raw.believed_dead_time - raw.latency, 0.0))
        assert (raw.ratio, raw.offset_deg) == (true.ratio, true.offset_deg)
        assert 0.8 <= raw.tyres <= 1.25
        assert abs(raw.gyro_zero_deg) <= 0.3
        assert raw.sensing == "no sideslip"
        zeros.add(raw.wheel_zero_deg)
    assert zeros == {3.0, -3.0}


def test_errors_are_those_of_what_is_seen_and_an_estimator_sees_better() -> None:
    raw, behind = (driven("stanley-adaptive", 4001, kind, 10.0) for kind in ("none", "adaptive-state"))
    assert math.isnan(raw.nis_mean)
    assert 0.5 < behind.nis_mean < 2.0
    assert 0.7 < behind.nis_share <= 1.0
    assert behind.rms_heading < 0.7 * raw.rms_heading < 0.03  # 50 ms of latency are 0.4 degrees and more
    assert 0.001 < raw.rms_side < 0.05
    assert raw.max_e > raw.rms_e > 0.0
