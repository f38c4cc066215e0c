"""The fit gives the car back, its intervals cover the truth; what was identified predicts other drives, and is kept."""

import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from steerkit.controllers.stanley import Stanley
from steerkit.identification import Drive, identify, read_drive, shipped_drives
from steerkit.identification.fit import Identified, Simulator, _Problem, predict, priors
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack
from steerkit.plants.steering_actuator import steering_of
from steerkit.scenario import Scenario
from steerkit.vehicles import vehicle
from tests.support.compilers import optimised
from tests.support.recorded_cars import BASE, DT, TRUTH, by_rate, driven, noisy


@pytest.fixture(scope="module", autouse=True)
def quick_code() -> Iterator[None]:
    """A fit drives for hours."""
    with optimised():
        yield


@pytest.fixture(scope="module")
def clean() -> dict[str, Any]:
    return driven()


@pytest.fixture(scope="module")
def found(clean: dict[str, Any]) -> Identified:
    return identify(Drive.of(noisy(clean, 0), name="lap"), BASE, name="my-car")


def test_a_clean_log_gives_the_car_back(clean: dict[str, Any]) -> None:
    exact = identify(Drive.of(by_rate(clean)), BASE, fixed={"rate_zero": 0.0})
    for name, value in TRUTH.items():
        assert exact[name].value == pytest.approx(value, rel=0.03, abs=0.003), name
    assert exact.fit.rms < 2e-4  # dt is 0.02 there and 0.01 here


def test_intervals_cover_the_truth(clean: dict[str, Any]) -> None:
    """Nominally 95 %; measured 83 to 100 % by parameter over 24 seeds: slow drift is few independent samples."""
    names = ("steer_ratio", "offset", "delay_lag", "understeer_gradient", "c_f", "c_r")
    inside = dict.fromkeys(names, 0)
    widths = {name: [] for name in names}
    for seed in range(4):
        answer = identify(Drive.of(by_rate(noisy(clean, seed))), BASE)
        for name in names:
            e = answer[name]
            inside[name] += e.low <= TRUTH[name] <= e.high
            widths[name].append((e.high - e.low) / abs(TRUTH[name]))
    assert all(count >= 3 for count in inside.values()), inside
    assert sum(inside.values()) >= 0.9 * 4 * len(names), inside
    assert np.median(widths["steer_ratio"]) < 0.25  # an interval that covers everything proves nothing
    assert np.median(widths["understeer_gradient"]) < 0.6
    assert max(np.median(widths["c_f"]), np.median(widths["c_r"])) < 1.3


def test_slow_driving_determines_the_ratio_but_not_the_tyres() -> None:
    slow = driven(seconds=60.0, v_low=3.5, v_high=5.0)
    answer = identify(Drive.of(by_rate(noisy(slow, 1))), BASE)
    assert answer["ratio_wheelbase"].source == "log and prior"  # the gyro's scale is not known
    assert {answer[n].source for n in ("c_f", "c_r")} == {"prior"}
    assert any("c_f" in note and "hardly determined" in note for note in answer.notes)
    for name in ("c_f", "c_r"):
        assert answer[name].low < TRUTH[name] < answer[name].high


def test_the_wheelbase_only_scales_the_ratio(found: Identified) -> None:
    """What the log determines, ratio times wheelbase, hardly depends on the wheelbase that is given."""
    longer = replace(BASE, l_f=1.1 * BASE.l_f, l_r=1.1 * BASE.l_r, i_z=1.21 * BASE.i_z)
    other = identify(found.drive, longer)
    assert other["ratio_wheelbase"].value == pytest.approx(found["ratio_wheelbase"].value, rel=0.01)
    assert other["steer_ratio"].value == pytest.approx(found["steer_ratio"].value / 1.1, rel=0.01)


def test_fixed_and_known(clean: dict[str, Any]) -> None:
    drive = Drive.of(noisy(clean, 0))
    answer = identify(drive, BASE, fixed={"lag": 0.09}, known={"steer_ratio": (14.0, 0.1)})
    assert answer["lag"].source == "given"
    assert answer["lag"].low == answer["lag"].high == 0.09
    assert abs(answer["delay"].value - 0.07) < 0.01
    with pytest.raises(ValueError, match="'ratio' is no parameter; valid: steer_ratio, offset"):
        identify(drive, BASE, fixed={"ratio": 15.0})
    bounds = {"lag": (0, 1), "delay": (-0.5, 1), "offset": (-1, 1), "rate_zero": (-0.1, 0.1), "steer_ratio": (1, 50)}
    for name, (low, high) in (bounds | {"d_f": (0.002, 0.05), "d_r": (0.002, 0.05)}).items():
        wrong, unit = 1.01 * high, re.escape(PRIORS[name].unit)
        with pytest.raises(ValueError, match=rf"{name} = {wrong:g} \[{unit}\], expected {low} to {high}"):
            identify(drive, BASE, fixed={name: wrong})


N = 100
PRIORS = priors(BASE)


FREE = replace(PRIORS["steer_ratio"], mean=10.0, deviation=1e3, low=-1e4, high=1e4)
"""The one parameter of a problem, of which nearly nothing is known."""
ZEROED = replace(PRIORS["rate_zero"], deviation=0.0)


def problem(rates: Any = None, r: Any = 0.0, n: int = N, **table: Any) -> _Problem:
    """Of n samples with these rates and priors."""
    drive = SimpleNamespace(dt=DT, driving=np.ones(n, dtype=bool), v=np.ones(n), r=r * np.ones(n), scale_deviation=0.0)
    return _Problem(SimpleNamespace(drive=drive, base=BASE, yaw_rates=rates), table)  # type: ignore[arg-type]


def linear(x: np.ndarray, r: np.ndarray) -> _Problem:
    """r = x steer_ratio, to be solved for the ratio."""
    return problem(
        lambda sets: np.outer(x, [one["steer_ratio"] for one in sets]), r, len(x), steer_ratio=FREE, rate_zero=ZEROED
    )


def test_a_residual_is_correlated_until_it_has_died_out() -> None:
    turns = (-1.0) ** np.arange(N)
    fours = np.repeat(turns[:25], 4)
    for error, rho in ((np.ones(N), np.ones(50)), (turns, [1.0]), (fours, [1.0, 51.0 / 99.0])):
        assert problem(**PRIORS)._autocorrelation(error) == pytest.approx(rho)


def test_slow_errors_count_in_full_however_short_the_blocks_are() -> None:
    """The mean of n = 400 errors that go together for tau = 20 samples has (1 + 2 a/(1 - a))/n of their variance.

    a = exp(-1/tau); blocks, an eighth of the record at most, cut off two fifths of it.
    """
    n, a, rng, claimed = 400, math.exp(-1.0 / 20.0), np.random.default_rng(1), []
    for _ in range(200):
        error = lfilter([math.sqrt(1.0 - a * a)], [1.0, -a], rng.normal(size=n + 200))[200:]
        one = linear(np.ones(n), 12.0 + error)
        theta, sigma, _ = one.solve()
        claimed.append([c[0, 0] for c in one.covariance(theta, sigma)[0]])
    expected = (1.0 + 2.0 * a / (1.0 - a)) / n
    by_blocks, by_correlation = np.mean(claimed, axis=0) / expected
    assert by_blocks < 0.6 < 0.68 < by_correlation < 1.0  # the mean that is fitted takes some of the error, too


def test_no_variance_is_negative_where_an_autocorrelation_that_is_cut_off_has_a_negative_spectrum() -> None:
    """A constant error has rho = 1 until it is cut off; the slope swings where that window's spectrum is least."""
    lags = np.arange(1, N // 2)
    w = np.linspace(0.0, np.pi, 2001)
    least = float(w[np.argmin(1.0 + 2.0 * np.cos(np.outer(w, lags)).sum(axis=1))])
    x = np.cos(least * np.arange(N))
    one = linear(x, 10.0 * x + 1.0)
    for covariance in one.covariance(np.array([10.0]), 1.0)[0]:
        assert covariance[0, 0] >= 0.0


def test_at_a_bound_the_secant_to_half_a_deviation_inside_counts() -> None:
    """12^2 with a bound at 12 and a deviation of 2: as the straight line from 11^2 to 12^2."""
    x, found = 1.0 + np.arange(N) % 3, []
    for power, slope, high in ((2, 1.0, 12.0), (1, 23.0, 1e4)):

        def rates(sets: Any, n: int = power, k: float = slope) -> Any:
            return np.outer(x, [k * one["steer_ratio"] ** n - 132.0 * (n == 1) for one in sets])

        ratio = replace(PRIORS["steer_ratio"], mean=10.0, deviation=2.0, low=1.0, high=high)
        found.append(problem(rates, 7.0, steer_ratio=ratio, rate_zero=ZEROED))
    one, other = (each.covariance(np.array([12.0]), 3.0) for each in found)
    np.testing.assert_allclose(one[0], other[0], rtol=1e-6)
    assert one[1] == other[1]


def test_intervals_are_those_of_students_distribution_through_the_formulas() -> None:
    values, names = {n: p.mean for n, p in PRIORS.items()}, list(PRIORS)
    steps = {n: 0.1 * p.deviation for n, p in PRIORS.items()}
    small, large = (np.diag([(k * steps[n]) ** 2 for n in names]) for k in (0.5, 1.0))
    found = problem(**PRIORS).estimates(values, (small, large), 11, [])
    assert problem(**PRIORS).estimates(values, (large, small), 11, []) == found
    by_name, factor = {one.name: one for one in found}, 2.228138852
    half = {name: 0.5 * (one.high - one.low) / factor for name, one in by_name.items()}
    both = {"delay_lag": np.hypot(steps["delay"], steps["lag"])}
    both |= {"ratio_wheelbase": 0.5 * BASE.wheelbase, "understeer_gradient": np.hypot(steps["d_f"], steps["d_r"])}
    expected = {name: steps[name] for name in ("steer_ratio", "offset", "delay", "lag", "rate_zero")} | both
    bank = BASE.steer_ratio * BASE.understeer_gradient * 9.81 * 0.02
    expected["offset"] = np.hypot(steps["offset"], 1.96 * bank / factor)
    assert {name: half[name] for name in expected} == pytest.approx(expected)
    for name, key in (("c_f", "d_f"), ("c_r", "d_r")):
        ends = [by_name[name].value * values[key] / (values[key] + sign * factor * steps[key]) for sign in (1.0, -1.0)]
        assert [by_name[name].low, by_name[name].high] == pytest.approx(ends)
    assert {round(one.learned, 9) for one in found if one.name != "offset"} == {0.99}


def test_thirds_that_contradict_each_other_widen_the_interval_and_take_its_flag() -> None:
    """Of three equal parts at -d, 0, d with deviation s: tau^2 = d^2 - s^2, told where 2 d^2/s^2 > 5.99."""
    values, small = {n: p.mean for n, p in PRIORS.items()}, np.diag([(0.1 * p.deviation) ** 2 for p in PRIORS.values()])
    for d, told in ((0.15, False), (0.3, True)):
        parts = [(np.array([sign * d * p.deviation for p in PRIORS.values()]), small) for sign in (-1.0, 0.0, 1.0)]
        found = {e.name: e for e in problem(**PRIORS).estimates(values, (small, small), 11, parts)}
        ratio = found["steer_ratio"]
        assert (ratio.high - ratio.low) / 2.0 / 2.228138852 == pytest.approx(5.0 * np.sqrt(0.01 + d * d - 0.01))
        assert (ratio.source == "unsteady") is told


@pytest.mark.parametrize("scale", [0.92, 1.08])
def test_a_gyros_scale_is_found_by_the_heading_else_the_ratios_interval_holds_it(clean: Any, scale: float) -> None:
    columns = noisy(clean, 0)
    columns["r"] = scale * columns["r"]
    columns["psi"] = columns["psi"] + 0.01 * np.random.default_rng(1).normal(size=len(columns["psi"]))
    seen, unseen = (identify(Drive.of(one), BASE)["steer_ratio"] for one in (columns, by_rate(columns)))
    assert seen.low < TRUTH["steer_ratio"] < seen.high
    assert unseen.low < TRUTH["steer_ratio"] < unseen.high
    assert seen.high - seen.low < 0.6 * (unseen.high - unseen.low)


def test_the_covariance_allows_for_errors_that_are_larger_where_they_matter() -> None:
    """White 1982: r = x theta with error sizes s x has the variance s^2 sum x^4/(sum x^2)^2, found by repetition."""
    n, rng = 4000, np.random.default_rng(0)
    x = np.where(np.arange(n) % 10 == 0, 3.0, 0.3)  # a tenth of the samples holds nearly everything
    claimed, estimates = [], []
    for _ in range(60):
        one = linear(x, 12.0 * x + 0.5 * x * rng.normal(size=n))
        theta, sigma, _ = one.solve()
        estimates.append(theta[0])
        claimed.append(np.sqrt(one.covariance(theta, sigma)[0][0][0, 0]))
    expected = 0.5 * np.sqrt(np.sum(x**4)) / np.sum(x**2)
    assert np.std(estimates) == pytest.approx(expected, rel=0.25)  # three standard errors of 60 repetitions
    assert np.mean(estimates) == pytest.approx(12.0, abs=4.0 * expected / np.sqrt(60))
    assert np.median(claimed) == pytest.approx(expected, rel=0.2)


def test_held_out_drive(found: Identified) -> None:
    other = Drive.of(driven(seconds=40.0, v_low=6.0, v_high=15.0))
    seen = found.predict(other)
    assert seen.rms < 0.002
    shifted = found.predict(replace(other, delta_sw=other.delta_sw + 0.05))
    assert shifted.rms > 3.0 * seen.rms
    assert shifted.zero_shift == pytest.approx(-0.05, abs=0.02)
    assert shifted.rms_rezeroed < 1.5 * seen.rms + 1e-3


def test_the_zero_of_a_gyroscope_is_predicted_too_unless_it_is_calibrated(found: Identified) -> None:
    theta = found.theta | {"rate_zero": 0.01}
    calibrated, raw = (
        predict(Simulator(replace(found.drive, calibrated=zeroed), found.base), theta).r for zeroed in (True, False)
    )
    assert raw - calibrated == pytest.approx(0.01)


def test_the_vehicle_file_comes_back_and_drives(found: Identified, tmp_path: Path) -> None:
    file = tmp_path / "my-car.toml"
    found.save(file, command="steerkit identify lap", held_out=found.fit)
    assert vehicle(str(file)) == found.vehicle
    motor = steering_of(file)
    assert motor.delay + motor.lag == pytest.approx(found.theta["delay"] + found.theta["lag"] - 0.01, abs=1e-12)
    assert motor.offset == found.theta["offset"]
    for block in (LinearSingleTrack(vehicle=vehicle(str(file))), NonlinearSingleTrack(vehicle=vehicle(str(file)))):
        assert block.vehicle.c_f == found.vehicle.c_f
    assert Stanley.of(vehicle(str(file)))
    assert Scenario(vehicle=str(file)).nominal == found.vehicle
    text = file.read_text()
    for words in ("[provenance]", 'log = "lap"', "held_out_rms", 'source = "log"', 'command = "steerkit identify lap"'):
        assert words in text


def test_the_shipped_drives_have_the_figures_of_the_docs() -> None:
    """Fitted on one real lap, the other predicted; see docs/identification.md."""
    fit, other = (read_drive(name) for name in shipped_drives())
    assert fit.notes[1].startswith("yaw rate: -0.00520 rad/s")
    answer = identify(fit, BASE)
    seen = answer.predict(other)
    assert answer.fit.rms == pytest.approx(0.0034, abs=2e-4)
    assert seen.rms == pytest.approx(0.0053, abs=4e-4)
    assert seen.rms_rezeroed < 0.005
    assert answer["ratio_wheelbase"].value == pytest.approx(43.2, abs=1.0)


def test_a_fit_at_its_bound_and_thirds_that_contradict_are_told() -> None:
    values, small = {n: p.mean for n, p in PRIORS.items()}, np.diag([(0.1 * p.deviation) ** 2 for p in PRIORS.values()])
    one = problem(**PRIORS)
    estimates = one.estimates(values, (small, small), 11, [])
    fine = " ".join(one.notes(values, small, estimates))
    assert "at a bound" not in fine
    assert "contradict" not in fine
    told = " ".join(one.notes(values | {"d_r": PRIORS["d_r"].high}, small, estimates))
    assert " d_r at a bound: the model does not fit; check columns, clocks, --wheelbase" in f" {told}"
    unsteady = tuple(replace(e, steady=e.name != "offset") for e in estimates)
    assert "offset: thirds of the log contradict each other" in " ".join(one.notes(values, small, unsteady))


def test_two_drives_of_one_car_agree_and_of_another_ratio_do_not(clean: Any, found: Identified) -> None:
    assert found.against(identify(Drive.of(noisy(clean, 1)), BASE)).startswith("The two drives agree")
    columns = noisy(clean, 2)
    columns["delta_sw"] = 1.3 * columns["delta_sw"]
    said = found.against(identify(Drive.of(columns), BASE))
    assert said.startswith("The two drives contradict each other: ratio_wheelbase is ")
