"""What runs tell: closed forms of the linear single track, signals with a known answer, intervals, limits, reasons."""

import math
import re
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from steerkit import Scenario
from steerkit.metrics.table import r79_acceleration
from steerkit.proving.evaluate import Evaluation, evaluate, of_repeats, plateaus
from steerkit.proving.manoeuvre import Limit, Manoeuvre, manoeuvre, names
from steerkit.proving.runs import Run, simulated
from steerkit.vehicles import VW_PASSAT as PASSAT
from tests.support.linear_car import closed_forms, linear, noisy


@cache
def runs_of(name: str) -> tuple[Run, ...]:
    """Of the linear Passat, without lag."""
    return tuple(simulated(manoeuvre(name), linear("vw-passat"), controller="stanley"))


def evaluated(name: str, **more: Any) -> Evaluation:
    return evaluate(manoeuvre(name), runs_of(name), PASSAT, **more)


def synthetic(one: Manoeuvre, answer: Any, side: str = "left", number: int = 1, dt: float = 0.01) -> Run:
    """A run whose wheel is the input of 0.2 rad, and whose yaw rate and acceleration are answers to it over time."""
    t = np.arange(-200, round(one.seconds / dt)) * dt
    wave = one.required.wave
    sign = 1.0 if side == "left" else -1.0

    def wheel(at: Any) -> Any:
        return 0.2 * sign * np.interp(at, np.arange(len(wave)) * 0.01, wave, left=0.0)

    v = one.conditions.v
    return Run(
        t=t,
        signals={
            "delta_sw": wheel(t),
            "v": np.full(len(t), v),
            "r": 0.5 * answer(wheel, t),
            "a_y": 10.0 * answer(wheel, t),
        },
        side=side,
        number=number,
    )


@pytest.mark.parametrize("name", ["steady-state-circle", "random-steer", "pulse-steer", "step-steer"])
def test_simulated_manoeuvres_of_the_linear_single_track_give_its_closed_forms(name: str) -> None:
    found, truth = evaluated(name), closed_forms(PASSAT, manoeuvre(name).conditions.v)
    truth["rear_compliance"] = PASSAT.m * PASSAT.l_f / (PASSAT.wheelbase * PASSAT.c_r)
    told = {r.quantity: r.value for r in found.results if r.quantity in truth}
    assert len(told) >= (1 if name == "step-steer" else 3)
    for quantity, value in told.items():
        assert value == pytest.approx(truth[quantity], rel=0.005), quantity


@pytest.mark.parametrize(
    ("name", "quantity", "widest"),
    [("steady-state-circle", "understeer_gradient", 0.001), ("random-steer", "natural_frequency", 0.5)],
)
def test_intervals_of_noisy_measurements_hold_the_truth_mostly(name: str, quantity: str, widest: float) -> None:
    """40 must not be far from 95 %."""
    random, one = np.random.default_rng(3), manoeuvre(name)
    truth = closed_forms(PASSAT, one.conditions.v)
    held = []
    for _ in range(40):
        found = evaluate(one, [noisy(run, random) for run in runs_of(one.name)], PASSAT)
        held += [r.low <= truth[r.quantity] <= r.high for r in found.results if r.quantity in truth]
        assert 0.0 < found[quantity].high - found[quantity].low < widest
    assert 0.85 <= np.mean(held) < 1.0


def test_a_delay_and_a_lag_are_read_off_a_step() -> None:
    """A first-order answer of time constant T after d: 50 % after d + T ln 2, 90 % after d + T ln 10, no overshoot."""
    one = replace(manoeuvre("step-steer").at(v=20.0), cutoff=0.0)
    one = replace(one, input=replace(one.required, rise=0.0))
    lag, delay = 0.2, 0.1

    def answer(wheel: Any, t: Any) -> Any:
        return wheel(t - delay) * np.maximum(1.0 - np.exp(-(t - delay) / lag), 0.0)

    runs = [synthetic(one, answer, side) for side in ("left", "right")]
    found = evaluate(one, runs, PASSAT)
    assert found["yaw_gain"].value == pytest.approx(0.5, rel=1e-3)
    assert found["a_y_gain"].value == pytest.approx(10.0, rel=1e-3)
    assert found["yaw_delay"].value == pytest.approx(delay + lag * math.log(2.0), abs=0.006)
    assert found["yaw_response_time"].value == pytest.approx(delay + lag * math.log(10.0), abs=0.006)
    assert found["yaw_overshoot"].value == pytest.approx(0.0, abs=1e-6)
    assert math.isnan(found["yaw_peak_time"].value)
    assert found["yaw_peak_time"].note == "in no run"


def test_an_overshoot_and_its_time() -> None:
    """Of a second-order answer: exp(-pi D/sqrt(1 - D^2)) after pi/(w sqrt(1 - D^2))."""
    one = replace(manoeuvre("step-steer").at(v=20.0), cutoff=0.0)
    one = replace(one, input=replace(one.required, rise=0.0))
    w, damping = 6.0, 0.5
    root = w * math.sqrt(1.0 - damping**2)

    def answer(wheel: Any, t: Any) -> Any:
        x = np.maximum(t, 0.0)
        return wheel(t) * (1 - np.exp(-damping * w * x) * (np.cos(root * x) + damping * w / root * np.sin(root * x)))

    found = evaluate(one, [synthetic(one, answer)], PASSAT)
    assert found["a_y_overshoot"].value == pytest.approx(math.exp(-math.pi * damping * w / root), abs=2e-3)
    assert found["a_y_peak_time"].value == pytest.approx(math.pi / root, abs=0.02)


@pytest.mark.parametrize("late", [0.0, 0.05, 0.13])
def test_lags_of_sines(late: float) -> None:
    shifted = lambda wheel, t: wheel(t - late)  # noqa: E731
    sine = replace(manoeuvre("sine"), cutoff=0.0)
    found = evaluate(sine, [synthetic(sine, shifted)], PASSAT)
    assert found["yaw_lag"].value == pytest.approx(late, abs=1e-3)
    assert found["a_y_peak_gain"].value == pytest.approx(10.0, rel=1e-3)
    weave = replace(manoeuvre("weave"), cutoff=0.0)
    found = evaluate(weave, [synthetic(weave, shifted)], PASSAT)
    assert found["yaw_lag"].value == pytest.approx(late, abs=1e-3)
    # of a sine a late by phi, the loop is A sin(phi) wide to either side
    phi = 2.0 * math.pi * 0.2 * late
    assert found["hysteresis_angle"].value == pytest.approx(0.2 * math.sin(phi), abs=2e-4)
    assert found["hysteresis_a_y"].value == pytest.approx(2.0 * math.sin(phi), abs=2e-3)
    assert found["sensitivity"].value == pytest.approx(10.0 * math.cos(phi), rel=1e-2)


def test_a_dead_band_on_centre_is_found() -> None:
    one = replace(manoeuvre("transition"), cutoff=0.0)

    def answer(wheel: Any, t: Any) -> Any:
        angle = wheel(t)
        return angle - np.clip(angle, -0.01, 0.01)

    found = evaluate(one, [synthetic(one, answer, side, k) for side in ("left", "right") for k in (1, 2)], PASSAT)
    assert found["dead_band"].value == pytest.approx(0.02, rel=1e-3)
    assert found["a_y_gain"].value == pytest.approx(10.0, rel=1e-3)
    assert found["dead_band"].n == 4


@pytest.mark.parametrize(("share", "kept"), [(0.3, True), (0.4, False)])
def test_a_car_that_goes_on_turning_after_a_dwell_fails(share: float, kept: bool) -> None:
    one = replace(manoeuvre("sine-with-dwell"), cutoff=0.0)
    end = 1.0 / 0.7 + 0.5 - math.asin(0.05) / (2.0 * math.pi * 0.7)

    def answer(wheel: Any, t: Any) -> Any:
        return np.where(t < end, wheel(t), -0.2 * share * np.exp(-np.maximum(t - end - 1.0, 0.0)))

    found = evaluate(one, [synthetic(one, answer)], PASSAT)
    assert found["yaw_ratio_1.00"].value == pytest.approx(share, rel=1e-2)
    assert found["yaw_ratio_1.75"].value == pytest.approx(share * math.exp(-0.75), rel=1e-2)
    verdicts = {v.limit.quantity: v.passed for v in found.verdicts}
    assert verdicts["yaw_ratio_1.00"] is kept


def test_displacement_is_that_of_the_integrated_acceleration_or_of_the_position() -> None:
    one = replace(manoeuvre("sine-with-dwell"), cutoff=0.0)
    run = synthetic(one, lambda wheel, t: np.where(t >= 0.0, 0.3, 0.0))
    assert evaluate(one, [run], PASSAT)["lateral_displacement"].value == pytest.approx(0.5 * 3.0 * 1.07**2, rel=0.03)
    y = np.where(run.t >= 0.0, 0.7 * run.t, 0.0)
    placed = replace(run, signals={**run.signals, "x": 20.0 * run.t, "y": y, "psi": 0.0 * run.t})
    assert evaluate(one, [placed], PASSAT)["lateral_displacement"].value == pytest.approx(0.7 * 1.07, rel=1e-3)


def report_of_openpilot(t: Any, requested: Any, actual: Any) -> tuple[float, float]:
    """Delay at 50 % and crossing time, as openpilot's report has them: sample by sample, from the run's beginning.

    The delay is the time of the first sample at which the actual lateral acceleration has reached half of the first
    peak of the requested one, in its direction; the crossing that of the first one that has reached the peak itself.
    Written from the description of tools/lateral_maneuvers, not from its code.
    """
    peak, k = 0.0, 0
    while k < len(t) and abs(requested[k]) >= abs(peak) and requested[k] * peak >= 0.0:
        peak, k = requested[k], k + 1
    times = [math.nan, math.nan]
    for which, share in enumerate((0.5, 1.0)):
        for when, value in zip(t, actual):
            if math.copysign(1.0, peak) * value >= share * abs(peak):
                times[which] = float(when)
                break
    return times[0], times[1]


@pytest.mark.parametrize("name", [name for name in names() if name.startswith("openpilot")])
@pytest.mark.parametrize("delay", [0.0, 0.2])
def test_a_request_is_timed_as_openpilot_s_report_times_it(name: str, delay: float) -> None:
    one = manoeuvre(name)
    scenario = Scenario(vehicle={"plant": "linear"}, steering={"delay": delay, "lag": 0.15})
    for run in simulated(one, scenario):
        use = run.between(0.0, one.seconds)
        sign = 1.0 if run.side == "left" else -1.0
        wave = sign * one.required.a_y * one.required.wave[: int(use.sum())]
        theirs = report_of_openpilot(run.t[use], wave, run["a_y"][use])
        ours = evaluate(one, [run], scenario.nominal)
        assert (ours["delay_50"].value, ours["crossing"].value) == pytest.approx(theirs, abs=run.dt, nan_ok=True)


def test_a_course_is_judged_by_r79_s_filters() -> None:
    run = runs_of("lane-change-2")[0]
    found = evaluated("lane-change-2")
    assert found["max_a_y"].value == pytest.approx(np.abs(r79_acceleration(run.t, run["a_y"])).max())
    assert found["max_e"].value == pytest.approx(np.abs(run["e"]).max())
    assert found.passed is True
    strict = evaluated("lane-change-2", limits=[Limit(quantity="max_a_y", high=1.0)])
    assert strict.passed is False
    unknown = evaluated("lane-change-2", limits=[Limit(quantity="comfort", high=1.0)])
    assert unknown.passed is None
    assert "comfort: not evaluated" in unknown.notes[-1]


@pytest.mark.parametrize("name", [n for n in names() if manoeuvre(n).input])
def test_left_and_right_are_the_same_mirrored(name: str) -> None:
    one = manoeuvre(name)
    left = runs_of(name)[0]
    signed = ("delta_sw", "delta_sw_cmd", "r", "a_y", "beta", "e", "y", "psi")
    right = replace(left, side="right", signals={k: -v if k in signed else v for k, v in left.signals.items()})
    one_side, other = evaluate(one, [left], PASSAT), evaluate(one, [right], PASSAT)
    for a, b in zip(one_side.results, other.results, strict=True):
        assert a.value == pytest.approx(b.value, rel=1e-6, nan_ok=True), a.quantity


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: s | {"v": s["v"] + 1.5}, "speed 1.50 m/s off"),
        (lambda s: s | {"r": s["r"] + 0.05}, "not straight ahead"),
        (lambda s: s | {"r": s["r"] * math.nan}, "not finite"),
        (lambda s: s | {"a_y": s["a_y"] * 9.0}, r"\|a_y\| ="),
        (lambda s: s | {"r": 20.0 * s["r"]}, r"\|r\| ="),
        (lambda s: {name: values[:501] for name, values in s.items()}, "ends after 2.0 of 4.2 s"),
    ],
)
def test_a_run_that_breaks_the_conditions_does_not_count(change: Any, said: str) -> None:
    one, good = manoeuvre("step-steer"), runs_of("step-steer")
    signals = change(dict(good[1].signals))
    bad = replace(good[1], t=good[1].t[: len(signals["v"])], signals=signals)
    found = evaluate(one, [good[0], bad], PASSAT)
    assert len(found.valid) == 1
    assert found["yaw_gain"].n == 1
    assert re.search(said, found.runs[1].invalid)
    none = evaluate(one, [bad], PASSAT)
    assert none.results == ()
    assert none.notes == ("no valid run",)


@pytest.mark.parametrize(
    ("signals", "said"),
    [
        ({"v": [1.0] * 3}, "no signal"),
        ({"delta_sw": [0.0] * 2, "v": [0.0] * 3, "r": [0.0] * 3, "a_y": [0.0] * 3}, "2 samples"),
    ],
)
def test_signals_that_are_no_run_are_refused(signals: Any, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Run(t=np.arange(3.0), signals={k: np.array(v) for k, v in signals.items()})


def test_repeats_have_student_s_interval_and_one_has_none() -> None:
    three = of_repeats("yaw_gain", [1.0, 2.0, 3.0])
    assert (three.value, three.n) == (2.0, 3)
    assert three.high - three.value == pytest.approx(4.302653 / math.sqrt(3.0), rel=1e-5)
    one = of_repeats("yaw_gain", [1.0, math.nan])
    assert one.value == 1.0
    assert math.isnan(one.low)
    assert one.note == "in 1 of 2 runs"


@pytest.mark.parametrize(("drift", "counts"), [(0.0, True), (0.012, True), (0.04, False)])
def test_a_whole_drive_is_steady_where_angle_and_yaw_rate_change_by_less_than_a_hundredth(
    drift: float, counts: bool
) -> None:
    """Between the halves of 2 s: 0.01 |r| + 0.002 rad/s and 0.01 |angle| + 0.004 rad are allowed."""
    t = 0.01 * np.arange(200)
    r = 0.4 * (1.0 + drift * (t >= 1.0))
    for changing in ("r", "delta_sw"):
        signals = {"delta_sw": 0.0 * t + 1.0, "v": 0.0 * t + 15.0, "r": 0.0 * t + 0.4, "a_y": 6.0 + 0.0 * t}
        signals[changing] = r if changing == "r" else r / 0.4
        found = plateaus(Run(t=t, signals=signals, whole=True), manoeuvre("steady-state-circle"))
        assert len(found) == counts
