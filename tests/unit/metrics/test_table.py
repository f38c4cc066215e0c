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
