"""How studies judge what was driven: by hand, on logs of a few samples."""

import math
from typing import Any

import numpy as np
import pytest

from benchmarks.peers import python_control
from benchmarks.scenarios import of_fleet
from benchmarks.studies import foreign, learning, safety, throughput
from steerkit.learning.experiment import Experiment
from steerkit.learning.settings import setting
from steerkit.task import DT

NAN = math.nan


def test_medians_and_worst_cases_count_who_never_got_there_as_infinite() -> None:
    other: dict[str, Any] = dict.fromkeys(("held", "failures", "last_nets_hold", "longest_training"), 0.0)
    other |= dict.fromkeys(("final_rms_e", "final_max_e", "final_wheel_rate_deg"), 0.0)
    times = [(100.0, 200.0), (900.0, None), (None, None)]
    seeds = learning.of_seeds([{"first_round_done": done, "good": good, **other} for done, good in times])
    assert (seeds["first_round_done_median"], seeds["first_round_done_worst"]) == (900.0, math.inf)
    assert (seeds["round_share"], seeds["good_share"]) == pytest.approx((2 / 3, 1 / 3))
    beside = dict(rms_x_oracle=0.9, wheel_x_oracle=1.0, jerk_x_oracle=1.1, rms_x_data_sheet=0.3)
    fine: dict[str, Any] = dict(good=10.0, failures=1, departure=2.0, stuck=0, held=True, **beside)
    slow = fine | dict(good=30.0, rms_x_oracle=1.2, failures=3, departure=7.0)
    lost = fine | dict(good=None, held=False, rms_x_oracle=math.inf)
    cars = learning.of_cars([fine, slow, lost])
    assert (cars["good_share"], cars["held_share"]) == pytest.approx((2 / 3, 2 / 3))
    assert (cars["good_median_s"], cars["good_worst_s"]) == (30.0, math.inf)
    assert (cars["rms_x_oracle"], cars["worst_rms_x_oracle"], cars["failures_worst"]) == (1.2, math.inf, 3)
    assert (cars["departure_median_m"], cars["departure_worst_m"]) == (2.0, 7.0)


def test_a_car_that_hardly_learned_is_told_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(learning, "ORACLE", ("stanley-delay",))
    monkeypatch.setattr(learning, "TOLD_DATA_SHEET", ("stanley",))
    (*_, car) = of_fleet(4, rounds=0.1)
    made = learning.one_car(Experiment(setting=setting("model-free"), scenario=car, minutes=0.05))
    assert (made["name"], made["best"], made["best_on_data_sheet"]) == ("fleet-3", "stanley-delay", "stanley")
    assert made["departure"] > 0.5  # it has failed, and nobody hides by how much
    assert (made["good"], made["held"]) == (None, False)


@pytest.mark.filterwarnings("ignore:Unused output")
def test_ways_that_compute_something_else_are_not_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Their agreement itself: the study's quick form."""
    run = python_control.run
    monkeypatch.setattr(python_control, "run", lambda made, steps: run(made, steps) + 1e-9)
    with pytest.raises(SystemExit, match=r"the ways disagree by 1\.00e-09 m"):
        throughput.require_equal_runs(throughput.closed_loop())


def swing(amplitude: float, seconds: float = 40.0, *, period: float = 4.0, about: float = 0.0) -> Any:
    t = DT * np.arange(round(seconds / DT))
    return t, about + amplitude * np.sin(2.0 * math.pi * t / period)


def test_a_limit_cycle_is_what_swings_regularly_by_more_than_a_decimetre() -> None:
    amplitude, period = foreign.limit_cycle(*swing(0.3, about=0.5))
    assert (amplitude, period) == (pytest.approx(0.3, rel=0.01), pytest.approx(4.0, rel=0.02))
    assert foreign.limit_cycle(*swing(0.09)) == (0.0, pytest.approx(NAN, nan_ok=True))
    assert foreign.limit_cycle(*swing(0.3, 9.0))[0] == 0.0, "two periods are none yet"
    t, e = swing(0.3)
    assert foreign.limit_cycle(t, np.where(t < 12.0, e, 0.0))[0] == pytest.approx(0.3, rel=0.01)
    wander = np.where(t % 5.0 < 1.0, 0.3, -0.3)
    assert foreign.limit_cycle(t, wander)[0] == 0.0, "not regular"


def test_a_drive_that_ends_early_is_lost() -> None:
    t, e = swing(0.05)
    found = {"max_e": 0.05, "back": True, "stays": True, "swing": 0.0, "period": NAN}
    assert foreign.judged(t, e, 40.0) == pytest.approx(found, rel=0.01, nan_ok=True)
    late = foreign.judged(t, np.where(t > 30.0, 0.6, e), 40.0)
    assert (late["back"], late["stays"]) == (True, False)
    ended = foreign.judged(t[:500], e[:500], 40.0)
    assert (ended["max_e"], ended["back"], ended["stays"]) == (math.inf, False, False)


def test_what_a_learner_on_a_foreign_car_never_did_counts_as_worst() -> None:
    common = dict(v_min=8.0, v_max=12.0, failures=1, departure=2.0, stuck=0, held=True, best_good=False, code="a")
    fields = dict(rms_x=0.7, rms_x_1=0.9, wheel_x=1.0, wheel_spread=1.2)
    runs: list[Any] = [
        {"car": "torque", "good": 20.0, **common, **fields},
        {"car": "torque", "good": 40.0, **common, **fields, "rms_x": 0.9},
        {"car": "torque", "good": None, **common, **fields, "rms_x": math.inf, "wheel_spread": math.nan},
        {"car": "mujoco", "good": 10.0, **common, **fields, "rms_x": 0.8, "best_good": True},
    ]
    f = foreign.learner_figures(runs)
    assert (f["good_share"], f["good_median_s"], f["good_worst_s"]) == (0.75, 30.0, math.inf)
    assert f["best_good_share"] == 0.25
    assert (f["rms_x_best_told"], f["rms_x_best_told_torque"], f["rms_x_best_told_others"]) == (0.9, 0.9, 0.8)
    assert (f["wheel_spread_nets"], f["rms_x_best_told_worst"], f["wheel_spread_nets_worst"]) == (1.2, *2 * [math.inf])


def test_the_worst_change_and_the_widest_spread_count() -> None:
    change = dict(
        car="passat", change="delay", seed=0, best=["lqr", "learned"], best_rms_e=[0.02, 0.01], failures=[1, 0]
    )
    f = foreign.changes_figures([{**change, "recovered": [25.0, 31.0], "x": [1.1, 1.3], "max_e": [0.6, 0.4]}])
    assert (f["changes"], f["changes_recovered_s"], f["changes_x_best"], f["changes_departures"]) == (2, 31.0, 1.3, 1)
    drives = [
        {"car": "torque", "controller": "lqr-adaptive", "speed": 8.0, "seed": seed, "rms_e": rms_e}
        for seed, pair in enumerate([(0.1, 0.11), (0.2, 0.3), (0.1, math.inf)])
        for rms_e in pair
    ]
    assert foreign.adaptive_figures(drives[:4])["adaptive_spread"] == pytest.approx(1.5)
    assert foreign.adaptive_figures(drives)["adaptive_spread"] == math.inf
    assert foreign.adaptive_figures(drives[:1]) == {}, "half a pair"


def test_a_departure_of_a_learner_with_the_filter_is_counted() -> None:
    found = dict(max_e=0.2, good=5.0, failures=1, interventions_pct=0.5, final_rms_e=0.011)
    good_run: dict[str, Any] = dict(car="single track", seed=0, minutes=3.0, safe=True, code="a", **found)
    left = good_run | dict(seed=1, max_e=0.51, good=None, interventions_pct=2.5)
    unknown = good_run | dict(seed=2, max_e=math.nan, final_rms_e=0.5)
    free = good_run | dict(safe=False, max_e=3.0, good=None, final_rms_e=0.010)
    report = safety.summarise([good_run, left, unknown, free])
    assert (report["runs"], report["runs_without"]) == (3, 1)
    assert (report["departures"], report["departures_without"]) == (2, 1)
    assert (report["good_median_s"], report["good_worst_s"]) == (5.0, math.inf)
    assert (report["interventions_pct"], report["interventions_above_2_pct"]) == (2.5, 1)
    assert report["interventions_mean_pct"] == pytest.approx(3.5 / 3)
    assert report["final_rms_x"] == pytest.approx(1.1)
    assert report["codes"] == 1
    assert math.isnan(safety.summarise([])["final_rms_x"])
