"""Every metric on a signal whose metric is known: sines, ramps, steps, and the standards' own tables."""

from __future__ import annotations

import math
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit import metrics
from steerkit.metrics.autoware import LEFT_OUT
from steerkit.metrics.table import as_markdown
from steerkit.simulation import Log
from steerkit.units import radians_of
from tests.support.places import ROOT

T = np.arange(2001) * 0.05  # 100 s at 20 Hz
WD = {
    0.1: 62.4,
    0.125: 97.3,
    0.16: 158,
    0.2: 243,
    0.25: 365,
    0.315: 530,
    0.4: 713,
    0.5: 853,
    0.63: 944,
    0.8: 992,
    1.0: 1011,
    1.25: 1008,
    1.6: 968,
    2.0: 890,
    2.5: 776,
    3.15: 642,
    4.0: 512,
    5.0: 409,
    6.3: 323,
    8.0: 253,
    12.5: 161,
    16.0: 125,
    20.0: 100,
    25.0: 80.0,
    31.5: 63.2,
    40.0: 49.4,
    50.0: 38.8,
    63.0: 29.5,
    80.0: 21.1,
}
"""ISO 2631-1:1997, table 3, W_d x 1000. Its 212 at 10 Hz is not what its own annex A gives there, which is 202."""


def sine(frequency: float, t: Any = T, amplitude: float = 1.0) -> Any:
    return amplitude * np.sin(2.0 * np.pi * frequency * t)


def test_the_magnitude_of_95_percent() -> None:
    assert metrics.magnitude_at(np.arange(-100, 1), 0.95) == pytest.approx(95.0)
    assert metrics.magnitude_at([1.0, -3.0], 0.5) == pytest.approx(2.0)
    # a sine is below sin(90 deg * 0.95) for 95 % of the time
    assert metrics.magnitude_at(sine(0.2)[:-1]) == pytest.approx(math.sin(math.pi / 2.0 * 0.95), abs=2e-3)
    assert math.isnan(metrics.magnitude_at([0.0, math.nan]))
    with pytest.raises(ValueError, match=r"share 95 \[1\], expected 0 to 1"):
        metrics.magnitude_at([1.0], 95)


def test_the_time_over_a_bound_counts_a_nan_as_over() -> None:
    t = np.arange(5) * 0.1
    assert metrics.time_over(t, [0.5, -0.51, 0.6, math.nan, 0.0], 0.5) == pytest.approx(0.3)
    # a sine is above half its amplitude, either way, for two thirds of the time
    assert metrics.time_over(T[:-1], sine(0.2)[:-1], 0.5) == pytest.approx(100.0 * 2.0 / 3.0, abs=1.0)


def test_the_acceleration_of_a_parabola() -> None:
    np.testing.assert_allclose(metrics.accelerations(T, 1.5 * T**2 - 4.0 * T), 3.0, rtol=1e-6)
    with pytest.raises(ValueError, match="2 samples, expected at least 3"):
        metrics.accelerations([0.0, 0.1], [1.0, 2.0])


@pytest.mark.parametrize("frequency", [0.1, 0.2, 0.3])
def test_a_sine_reverses_twice_a_period(frequency: float) -> None:
    """12 a minute at 0.1 Hz; the low-pass at 0.6 Hz, passed twice, leaves 1/(1 + (f/0.6)^4) of the amplitude."""
    for amplitude, counted in ((1.49, False), (1.51, True)):
        gain = 1.0 / (1.0 + (math.tan(math.pi * frequency * 0.05) / math.tan(math.pi * 0.6 * 0.05)) ** 4)
        angle = radians_of(sine(frequency, amplitude=amplitude / gain))
        rate = metrics.reversal_rate(T, angle)
        assert rate == pytest.approx(120.0 * frequency if counted else 0.0, abs=1.3)


def test_reversals_are_counted_at_the_gap_and_not_below() -> None:
    """A slow wave of 4 deg, 3 a minute, with a wiggle of 0.8 deg, 24 a minute: which of them counts is the gap's."""
    angle = 2.0 * np.cos(2.0 * np.pi * 0.05 * T) + 0.4 * np.sin(2.0 * np.pi * 0.4 * T)
    assert metrics.reversal_rate(T, radians_of(angle)) == pytest.approx(60.0 * 10.0 / 100.0, abs=0.7)
    assert metrics.reversal_rate(T, radians_of(angle), gap_deg=0.1, cutoff=2.0) == pytest.approx(48.0, abs=1.0)


def test_what_the_filter_removes_is_no_reversal_and_a_nan_is_no_number() -> None:
    assert metrics.reversal_rate(T, radians_of(sine(5.0, amplitude=20.0))) == 0.0
    assert metrics.reversal_rate(T, 0.2 * T) == 0.0
    assert metrics.reversal_rate(T, np.full(2001, 0.3)) == 0.0
    assert math.isnan(metrics.reversal_rate(T, np.where(T > 99.0, math.nan, 0.0)))


@pytest.mark.parametrize(
    ("t", "options"), [(T[:10], {}), (T, {"cutoff": 10.0}), (T, {"cutoff": 0.0}), (T, {"gap_deg": 0.0})]
)
def test_reversals_refuse_what_they_cannot_count(t: Any, options: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"reversal_rate: .* expected more than 10 samples, 0 < cutoff < 0.5/dt"):
        metrics.reversal_rate(t, np.zeros(len(t)), **options)


@pytest.mark.parametrize("dt", [0.05, 0.01])
@pytest.mark.parametrize("frequency", [0.1, 0.5, 1.0])
def test_the_r79_filter_is_a_fourth_order_butterworth(dt: float, frequency: float) -> None:
    """|H| = 1/sqrt(1 + (f/0.5 Hz)^8): 0.7071 at the cut-off, f bent by the bilinear transform elsewhere."""
    t = np.arange(round(200.0 / dt)) * dt
    filtered = metrics.r79_acceleration(t, sine(frequency, t))[len(t) // 2 :]
    bent = math.tan(math.pi * frequency * dt) / math.tan(math.pi * 0.5 * dt)
    assert metrics.rms(filtered) * math.sqrt(2.0) == pytest.approx(1.0 / math.sqrt(1.0 + bent**8), rel=2e-3)


def test_the_r79_jerk_of_a_sine_and_of_a_steady_bend() -> None:
    """At 0.5 Hz: the filter's 1/sqrt 2, times w, times sinc of the 0.5 s average."""
    t = np.arange(20001) * 0.01
    w = 2.0 * math.pi * 0.5
    expected = w / math.sqrt(2.0) * math.sin(w / 4.0) / (w / 4.0)
    assert metrics.largest(metrics.r79_jerk(t, sine(0.5, t))[10000:]) == pytest.approx(expected, rel=1e-3)
    np.testing.assert_allclose(metrics.r79_acceleration(T, np.full(2001, 2.5)), 2.5)
    np.testing.assert_allclose(metrics.r79_jerk(T, np.full(2001, 2.5)), 0.0, atol=1e-9)
    with pytest.raises(ValueError, match=r"dt = 0.5 s, expected <= 0.25 s"):
        metrics.r79_acceleration(np.arange(100) * 0.5, np.zeros(100))


def test_the_weighting_filter_has_the_factors_of_the_standard() -> None:
    """Within 1 % at every one-third octave of table 3; the printed factors have three digits."""
    from scipy.signal import sosfreqz

    frequencies = np.array(list(WD))
    for rate, highest in ((1000.0, 50.0), (4000.0, 80.0)):
        seen = frequencies <= highest
        _, gain = sosfreqz(metrics.wd_filter(rate), frequencies[seen], fs=rate)
        np.testing.assert_allclose(1000.0 * np.abs(gain), np.array(list(WD.values()))[seen], rtol=0.01)
    _, at_10_hz = sosfreqz(metrics.wd_filter(4000.0), [10.0], fs=4000.0)
    assert abs(at_10_hz[0]) == pytest.approx(0.2017, abs=2e-4)
    with pytest.raises(ValueError, match="rate 20 Hz, expected >= 1000 Hz"):
        metrics.wd_filter(20.0)


@pytest.mark.parametrize(("rate", "highest"), [(20.0, 6.3), (100.0, 40.0), (1000.0, 50.0)])
def test_the_weighted_acceleration_of_sines_is_their_rms_times_the_factor(rate: float, highest: float) -> None:
    t = np.arange(round(60.0 * rate)) / rate
    for frequency in (f for f in WD if 0.4 <= f <= highest):
        a_w = metrics.weighted_acceleration(t, sine(frequency, t, 2.0))
        assert a_w == pytest.approx(2.0 / math.sqrt(2.0) * WD[frequency] / 1000.0, rel=0.015), frequency


def test_a_steady_bend_weighs_nothing_and_the_weight_is_that_of_the_amplitude() -> None:
    assert metrics.weighted_acceleration(T, np.full(2001, 3.0)) == pytest.approx(0.0, abs=1e-9)
    a_y = sine(1.0) + 3.0
    once = metrics.weighted_acceleration(T, a_y)
    assert once == pytest.approx(1.011 / math.sqrt(2.0), rel=0.01)
    assert metrics.weighted_acceleration(T, -2.0 * a_y) == pytest.approx(2.0 * once)
    assert math.isnan(metrics.weighted_acceleration(T, np.where(T > 50.0, math.nan, 0.0)))


def test_autowares_figures_of_a_known_drive() -> None:
    t = np.arange(201) * 0.05
    found = metrics.control_evaluator(
        t, e=0.1 - 0.02 * t, psi_e=np.full(201, -0.03), delta=0.05 * t**2, a_y=-0.2 * t, v=4.0 + 0.3 * t
    )
    assert found["lateral_deviation"].max == pytest.approx(0.1)
    assert found["lateral_deviation"].min == pytest.approx(-0.1)
    assert found["lateral_deviation_abs"].mean == pytest.approx(0.05, abs=1e-3)
    assert found["lateral_deviation"].count == 101  # 10 s, every 100 ms
    assert found["yaw_deviation"].mean == pytest.approx(-0.03)
    assert found["yaw_deviation_abs"].mean == pytest.approx(0.03)
    assert found["steering_rate"].max == pytest.approx(0.1 * 9.95)  # mean rate of the last 100 ms
    assert found["steering_acceleration"].mean == pytest.approx(0.1)
    assert found["lateral_acceleration"].max == pytest.approx(2.0)
    assert found["acceleration"].mean == pytest.approx(0.3)
    assert found["jerk"].max == pytest.approx(0.0, abs=1e-9)
    assert found["velocity"].max == pytest.approx(7.0)
    assert not set(found) & set(LEFT_OUT)


def test_the_goal_is_missed_ahead_to_the_left_and_turned() -> None:
    """Goal at (10, 5) heading north; the car 2 m further north and 1 m east of it: ahead, to the right."""
    found = metrics.goal_deviation((11.0, 7.0, math.pi / 2.0 + 0.1 - 4.0 * math.pi), (10.0, 5.0, math.pi / 2.0))
    assert found["goal_longitudinal_deviation"] == pytest.approx(2.0)
    assert found["goal_lateral_deviation"] == pytest.approx(-1.0)
    assert found["goal_lateral_deviation_abs"] == pytest.approx(1.0)
    assert found["goal_yaw_deviation"] == pytest.approx(0.1)


def test_step_times_are_quantiles_and_no_missing_measurement() -> None:
    assert metrics.step_times(np.arange(101) * 1e-6) == {
        "step_p50_us": pytest.approx(50.0),
        "step_p99_us": pytest.approx(99.0),
    }
    for bad in ([], [1e-6, math.nan], [-1e-6]):
        with pytest.raises(ValueError, match="of finite seconds >= 0"):
            metrics.step_times(bad)


def drive(**changes: Any) -> dict[str, Any]:
    signals = {
        "t": T,
        "e": sine(0.2, amplitude=0.3),
        "psi_e": radians_of(sine(0.2, amplitude=2.0)),
        "delta_sw": radians_of(sine(0.2, amplitude=10.0)),
        "a_y": sine(0.5, amplitude=1.5),
    }
    return signals | changes


def test_a_drive_of_sines_has_the_metrics_of_sines() -> None:
    found = metrics.measures(**drive())
    w = 2.0 * math.pi * 0.2
    expected = {
        "rms_e": 0.3 / math.sqrt(2.0),
        "max_e": 0.3,
        "p95_e": 0.3 * math.sin(math.pi / 2.0 * 0.95),
        "share_within_25cm": 2.0 / math.pi * math.asin(0.25 / 0.3),
        "time_over_50cm": 0.0,
        "rms_psi_e_deg": 2.0 / math.sqrt(2.0),
        "max_psi_e_deg": 2.0,
        "rms_wheel_rate_deg": 10.0 * w / math.sqrt(2.0),
        "rms_wheel_acceleration_deg": 10.0 * w**2 / math.sqrt(2.0),
        "max_wheel_acceleration_deg": 10.0 * w**2,
        "large_reversals": 24.0,
        "small_reversals": 24.0,
        "max_a_y": 1.5,
        "weighted_a_y": 1.5 / math.sqrt(2.0) * 0.853,
    }
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, rel=0.015, abs=1e-9), name


def test_a_drive_has_every_metric_of_the_table_and_the_few_are_the_same() -> None:
    found = metrics.measures(**drive())
    groups = ("tracking", "steering", "comfort")
    assert list(found) == [m.name for m in metrics.TABLE if m.group in groups]
    few = metrics.summary(**{name: s for name, s in drive().items() if name != "psi_e"})
    assert {name: found[name] for name in vars(few) if name in found} == {
        name: value for name, value in vars(few).items() if name != "duration"
    }
    d = drive()
    names = {"path.e": "e", "path.psi_e": "psi_e", "car.delta_sw": "delta_sw", "car.a_y": "a_y"}
    log = Log(d["t"], {long: d[short] for long, short in names.items()}, dict.fromkeys(names, "1"))
    assert metrics.measures_of_log(log) == found


@pytest.mark.parametrize("name", ["e", "psi_e", "delta_sw", "a_y"])
def test_a_nan_in_a_signal_is_in_all_its_metrics(name: str) -> None:
    found = metrics.measures(**drive(**{name: np.where(T > 90.0, math.nan, drive()[name])}))
    of = {
        "e": ("rms_e", "p95_e", "max_e"),
        "psi_e": ("rms_psi_e_deg", "max_psi_e_deg"),
        "delta_sw": [m.name for m in metrics.TABLE if m.group == "steering"],
        "a_y": [m.name for m in metrics.TABLE if m.group == "comfort"],
    }
    assert {key for key, value in found.items() if math.isnan(value)} == set(of[name])


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.01, 10.0))
def test_mirrored_drives_are_as_good_and_wider_ones_worse(seed: int, factor: float) -> None:
    rng = np.random.default_rng(seed)
    signals = {name: np.cumsum(rng.normal(size=(400))) * 0.01 for name in ("e", "psi_e", "delta_sw", "a_y")}
    t = T[:400]
    here = metrics.measures(t=t, **signals)
    mirrored = metrics.measures(t=t, **{name: -s for name, s in signals.items()})
    wider = metrics.measures(t=t, **{name: factor * s for name, s in signals.items()})
    for name, value in here.items():
        assert mirrored[name] == pytest.approx(value, rel=1e-9, abs=1e-9)
        if not name.startswith(("share", "time", "large", "small")):
            assert wider[name] == pytest.approx(factor * value, rel=1e-6, abs=1e-9)


def test_the_table_names_each_metric_once_and_the_document_holds_it() -> None:
    names = [m.name for m in metrics.TABLE]
    assert len(set(names)) == len(names)
    page = ROOT / "docs" / "metrics.md"
    assert as_markdown() in page.read_text(encoding="utf-8"), "python -c 'from steerkit.metrics.table import ...'"
    with pytest.raises(KeyError, match="metric 'rms' is not known; valid: rms_e, "):
        metrics.metric("rms")


def test_importing_the_metrics_does_not_load_scipy() -> None:
    code = "import sys, steerkit.metrics; print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
