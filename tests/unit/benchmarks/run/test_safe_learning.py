"""What counts as a departure."""

import math
from typing import Any

import pytest

from benchmarks.run.safe_learning import summarise

FOUND = dict(max_e=0.2, good=5.0, failures=1, interventions_pct=0.5, final_rms_e=0.011)
GOOD: dict[str, Any] = dict(car="single track", seed=0, minutes=3.0, safe=True, code="a", **FOUND)


def test_what_is_counted() -> None:
    left = GOOD | dict(seed=1, max_e=0.51, good=None, interventions_pct=2.5)
    unknown = GOOD | dict(seed=2, max_e=math.nan, final_rms_e=0.5)
    free = GOOD | dict(safe=False, max_e=3.0, good=None, final_rms_e=0.010)
    report = summarise([GOOD, left, unknown, free])
    assert (report["runs"], report["runs_without"]) == (3, 1)
    assert (report["departures"], report["departures_without"]) == (2, 1)
    assert (report["good_median_s"], report["good_worst_s"]) == (5.0, math.inf)
    assert (report["interventions_pct"], report["interventions_above_2_pct"]) == (2.5, 1)
    assert report["interventions_mean_pct"] == pytest.approx(3.5 / 3)
    assert report["final_rms_x"] == pytest.approx(1.1)
    assert report["codes"] == 1
    assert math.isnan(summarise([])["final_rms_x"])
