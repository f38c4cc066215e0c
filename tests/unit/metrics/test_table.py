"""All metrics of a drive, and their table, which names each once and stands in the document."""

import math
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit import metrics
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import radians_of
from tests.support.places import ROOT
from tests.support.sines import T, sine


def test_the_table_names_each_metric_once_and_the_document_holds_it() -> None:
    names = [m.name for m in metrics.TABLE]
    assert len(set(names)) == len(names)
    page = (ROOT / "docs" / "metrics.md").read_text(encoding="utf-8")
    head = "| name | unit | better | what | source | limit |\n|---|---|---|---|---|---|\n"
    lines = page.partition(head)[2].partition("\n\n")[0].splitlines()
    for m, line in zip(metrics.TABLE, lines, strict=True):
        cells = [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]
        limit = "" if m.limit is None else f"{m.limit:g}"
        assert cells == [f"`{m.name}`", m.unit, m.better, m.what, m.source, limit]
    assert {m.name for m in metrics.TABLE if not m.lower_is_better} == {
        *("share_within_5cm", "share_within_25cm", "round_share", "good_share")
    }


def test_the_few_metrics_of_a_drive_load_no_scipy() -> None:
    code = "import sys; from steerkit.metrics import GOOD, of_log, rms; print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


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
    rms = 1.0 / math.sqrt(2.0)
    expected = dict(rms_e=0.3 * rms, max_e=0.3, p95_e=0.3 * math.sin(math.pi / 2.0 * 0.95), time_over_50cm=0.0)
    expected |= dict(share_within_25cm=2.0 / math.pi * math.asin(0.25 / 0.3), max_a_y=1.5)
    expected |= dict(rms_psi_e_deg=2.0 * rms, max_psi_e_deg=2.0, large_reversals=24.0, small_reversals=24.0)
    expected |= dict(rms_wheel_rate_deg=10.0 * w * rms, rms_wheel_acceleration_deg=10.0 * w**2 * rms)
    expected |= dict(max_wheel_acceleration_deg=10.0 * w**2, weighted_a_y=1.5 * rms * 0.853)
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


WD_TABLE = """
0.1 62.4  0.125 97.3  0.16 158  0.2 243  0.25 365  0.315 530  0.4 713  0.5 853
0.63 944  0.8 992  1.0 1011  1.25 1008  1.6 968  2.0 890  2.5 776  3.15 642
4.0 512  5.0 409  6.3 323  8.0 253  12.5 161  16.0 125  20.0 100  25.0 80.0
31.5 63.2  40.0 49.4  50.0 38.8  63.0 29.5  80.0 21.1
"""
WD = dict(np.reshape(np.array(WD_TABLE.split(), dtype=float), (-1, 2)).tolist())
"""ISO 2631-1:1997, table 3, W_d x 1000. Its 212 at 10 Hz is not what its own annex A gives there, which is 202."""


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
    assert metrics.r79_acceleration(T, 2.5 * (np.arange(2001) == 0))[0] == pytest.approx(2.5)  # as it was before
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
