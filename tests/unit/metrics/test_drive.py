"""Metrics of signals whose metrics are known, and the criterion at its bounds."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit import metrics
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import radians_of
from steerkit.metrics import GOOD, Summary
from tests.support.sines import T, sine

SINE = np.sin(2.0 * np.pi * 0.2 * T)  # 20 whole periods


def test_rms_and_largest_of_a_sine() -> None:
    assert metrics.rms(0.3 * SINE[:-1]) == pytest.approx(0.3 / math.sqrt(2.0))
    assert metrics.largest(-0.3 * SINE) == pytest.approx(0.3)
    assert metrics.rms([3.0, -4.0]) == pytest.approx(math.sqrt(12.5))


def test_share_within_counts_samples_inside_and_not_on_the_bound() -> None:
    assert metrics.share_within([0.0, 0.049, -0.049, 0.05, -0.2, math.nan, 1.0, 0.01], 0.05) == 0.5
    # a sine is within half its amplitude for a third of the time
    assert metrics.share_within(0.1 * SINE[:-1], 0.05) == pytest.approx(1.0 / 3.0, abs=0.01)


def test_rates_of_a_ramp() -> None:
    np.testing.assert_allclose(metrics.rates(T, 3.0 * T - 1.0), 3.0)


def test_jerk_of_a_ramp_is_its_slope_and_of_a_step_is_spread_over_the_window() -> None:
    np.testing.assert_allclose(metrics.lateral_jerk(T, 2.5 * T), 2.5)
    step = np.where(T < 50.0, 0.0, 2.0)
    jerk = metrics.lateral_jerk(T, step)
    assert jerk.max() == pytest.approx(4.0)  # 2 m/s^2 in 0.5 s
    assert np.count_nonzero(jerk) == 10
    assert jerk.sum() * 0.05 == pytest.approx(2.0)


@pytest.mark.parametrize("dt", [0.05, 0.01, 0.1])
def test_jerk_is_the_moving_average_of_the_derivative(dt: float) -> None:
    t = np.arange(round(20.0 / dt)) * dt
    a_y = np.sin(1.3 * t) + 0.3 * np.cos(4.0 * t)
    n = round(0.5 / dt)
    expected = np.convolve(np.diff(a_y) / dt, np.full(n, 1.0 / n), mode="valid")
    np.testing.assert_allclose(metrics.lateral_jerk(t, a_y), expected, atol=1e-12)


def test_the_jerk_of_a_sine_is_damped_by_the_window() -> None:
    """The average over 0.5 s of w cos(w t) has the amplitude w |sinc(w 0.25 s)|."""
    w = 2.0 * np.pi * 0.2
    assert metrics.largest(metrics.lateral_jerk(T, SINE)) == pytest.approx(w * math.sin(w / 4.0) / (w / 4.0), rel=1e-3)


def drive(**changes: Any) -> dict[str, Any]:
    """20 s with e = 0.2 m for the first half, 0.01 m after; the wheel at 10 deg/s; a_y up to -3 m/s^2, as a ramp."""
    t = np.arange(401) * 0.05
    signals = {"t": t, "e": np.where(t < 10.0, -0.2, 0.01), "delta_sw": radians_of(10.0) * t, "a_y": -0.15 * t}
    return signals | changes


def test_the_summary_of_a_drive() -> None:
    s = metrics.summary(**drive())
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
    signals = {"path.e": d["e"], "car.delta_sw": d["delta_sw"], "car.a_y": d["a_y"], "front.e": 2.0 * d["e"]}
    log = Log(d["t"], signals, dict.fromkeys(signals, "m"))
    assert metrics.of_log(log) == metrics.summary(**d)
    assert metrics.of_log(log, e="front.e").max_e == 0.4
    with pytest.raises(KeyError, match=r"no signal 'seen.e' in the log"):
        metrics.of_log(log, e="seen.e")


def test_a_nan_is_not_averaged_away() -> None:
    e = np.append(np.zeros(400), math.nan)
    s = metrics.summary(**drive(e=e))
    assert math.isnan(s.rms_e)
    assert math.isnan(s.max_e)
    assert not GOOD.met(s, rounds=1.0)


PERFECT = Summary(
    duration=130.0,
    rms_e=0.02,
    max_e=0.1,
    share_within_5cm=0.9,
    rms_wheel_rate_deg=30.0,
    max_a_y=3.0,
    rms_jerk=1.0,
    max_jerk=3.0,
)


def test_good_is_a_whole_round_within_the_bounds() -> None:
    assert GOOD.met(PERFECT, rounds=1.0)
    assert GOOD.failures(PERFECT, rounds=1.7) == ()
    almost = replace(PERFECT, max_e=0.2499, rms_e=0.0999, max_jerk=4.999)
    assert GOOD.met(almost, rounds=1.0)
    assert GOOD.failures(PERFECT, rounds=0.995) == ("0.99 rounds, expected 1",)


@pytest.mark.parametrize(
    ("name", "bound", "words"),
    [
        ("max_e", 0.25, "max_e 0.25 m, expected < 0.25 m"),
        ("rms_e", 0.10, "rms_e 0.1 m, expected < 0.1 m"),
        ("max_jerk", 5.0, "max_jerk 5 m/s^3, expected < 5 m/s^3"),
        ("max_jerk", math.nan, "max_jerk nan m/s^3, expected < 5 m/s^3"),
    ],
)
def test_each_bound_alone_fails_a_drive(name: str, bound: float, words: str) -> None:
    drive = replace(PERFECT, **{name: bound})
    assert GOOD.failures(drive, rounds=1.0) == (words,)
    assert not GOOD.met(drive, rounds=1.0)


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


def drive_of_sines(**changes: Any) -> dict[str, Any]:
    signals = {
        "t": T,
        "e": sine(0.2, amplitude=0.3),
        "psi_e": radians_of(sine(0.2, amplitude=2.0)),
        "delta_sw": radians_of(sine(0.2, amplitude=10.0)),
        "a_y": sine(0.5, amplitude=1.5),
    }
    return signals | changes


def test_a_drive_of_sines_has_the_metrics_of_sines() -> None:
    found = metrics.measures(**drive_of_sines())
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
    found = metrics.measures(**drive_of_sines())
    groups = ("tracking", "steering", "comfort")
    assert list(found) == [m.name for m in metrics.TABLE if m.group in groups]
    few = metrics.summary(**{name: s for name, s in drive_of_sines().items() if name != "psi_e"})
    assert {name: found[name] for name in vars(few) if name in found} == {
        name: value for name, value in vars(few).items() if name != "duration"
    }
    d = drive_of_sines()
    names = {"path.e": "e", "path.psi_e": "psi_e", "car.delta_sw": "delta_sw", "car.a_y": "a_y"}
    log = Log(d["t"], {long: d[short] for long, short in names.items()}, dict.fromkeys(names, "1"))
    assert metrics.measures_of_log(log) == found


@pytest.mark.parametrize("name", ["e", "psi_e", "delta_sw", "a_y"])
def test_a_nan_in_a_signal_is_in_all_its_metrics(name: str) -> None:
    found = metrics.measures(**drive_of_sines(**{name: np.where(T > 90.0, math.nan, drive_of_sines()[name])}))
    of = {
        "e": ("rms_e", "p95_e", "max_e"),
        "psi_e": ("rms_psi_e_deg", "max_psi_e_deg"),
        "delta_sw": [m.name for m in metrics.TABLE if m.group == "steering"],
        "a_y": [m.name for m in metrics.TABLE if m.group == "comfort"],
    }
    assert {key for key, value in found.items() if math.isnan(value)} == set(of[name])


@settings(max_examples=25)
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
