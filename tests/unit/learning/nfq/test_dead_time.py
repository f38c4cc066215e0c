"""Dead time out of recorded transitions: the one that a car really has, and what goes with it."""

import json
from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest

from steerkit.controllers.delay_compensator import FELT, LENGTH, UNLIMITED, DelayCompensator
from steerkit.controllers.policy import COLUMNS, DOE, E_DOT, PSI_E, V
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq import dead_time
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.dead_time import (
    ROWS,
    TRUST_COURSE,
    aligned,
    dead_time_of,
    most_steered,
    process_of,
    refined,
    since_change,
    since_other_gain,
)
from steerkit.learning.nfq.iterate import FitSetting, Learned, Problem, update
from steerkit.learning.nfq.model import CarModel, Felt, with_heading_of_yaw_rate
from steerkit.learning.nfq.rprop import Fit
from steerkit.learning.settings import DEFAULT
from tests.support.modelled_car import ACTIONS
from tests.support.places import ROOT

CAR = CarModel(held=1.0, pushed=1.0, now=0.006, before=0.005, earlier=0.0, back=0.2, slip=4e-4, yaw=0.38, limit=9.0)
FAST = replace(CAR, slip=0.0, loss=1.2e-3, yaw=1.0 / LENGTH, nose=0.9, tail=2.25e-3, fast=1.0)
"""A car at speed, with soft tyres: at 20 m/s nothing is left of its front axle's course to its own axis."""
NUMBERS = ("held", "pushed", "now", "before", "earlier", "back", "yaw", "limit", "slip", "loss", "nose", "tail", "fast")
NUMBERS += ("straight",)
"""Of a model, in the order of the golden file."""
DESCRIPTION = DEFAULT.description()


def late(
    samples: int,
    *,
    straight: float = 0.0,
    n: int = 600,
    noise: float = 0.0,
    seed: int = 0,
    car: CarModel = CAR,
    speeds: tuple[float, float] = (4.0, 7.0),
    action: float = 1.0,
) -> Transitions:
    """What is recorded of a car where its motion is `samples` late, in bends, in episodes of 60 samples."""
    rng, record, drawn = np.random.default_rng(seed), Transitions((*COLUMNS, "kappa")), []
    for _ in range(n // 60):
        angles, actions = [0.0] * (samples + 2), []
        for _ in range(62 + samples):
            actions.append(action * float(rng.choice(ACTIONS)) - 0.1 * angles[-1])
            angles.append(angles[-1] + actions[-1])
        begins = [0.0, rng.normal(0.0, 0.1), rng.uniform(*speeds), rng.normal(0.0, 0.05), 0.0, 0.0]
        seen = rng.normal(0.0, 0.01, 61) if car.fast else np.zeros(61)
        drawn.append((angles, actions, begins, seen, rng.standard_normal((61, 2))))
    wheel, taken, s, heading, noises = map(np.array, zip(*drawn))  # all episodes at once: (episode, ...)
    bend = 0.15 * np.arange(62 + samples) + np.arange(len(drawn))[:, None]
    kappa = (0.004 if car.fast else 0.03) * np.sin(bend)
    if car.fast:  # the yaw rate is its w
        s[:, 4] = car.yaw * (s[:, E_DOT] - s[:, V] * s[:, PSI_E]) - s[:, V] * kappa[:, 0]
    rows, felt = [], Felt(*[np.full(len(s), -straight)] * 3)
    for k in range(61):
        old = wheel[:, k + 1 : k + 3].T  # the angle that acted before, and the one that acts in this sample
        s[:, DOE] = old[1] - straight
        rows.append(np.column_stack((s, kappa[:, k])))
        following = car.step(s, wheel[:, k + 3] - old[1], old[0] - straight, felt)
        felt = car.after(s, following[:, DOE], felt)
        following[:, 4] -= s[:, V] * (kappa[:, k + 1] - kappa[:, k])
        s = following
    for episode, motion in enumerate(np.stack(rows, axis=1)):
        if car.fast:  # as it is seen, without that w
            motion[:, PSI_E] = heading[episode]
        motion[:, [1, 4]] += noise * noises[episode]
        motion[:, DOE] = wheel[episode, samples + 2 : samples + 63]
        record.extend(motion[:-1], taken[episode, 1:61], motion[1:], episode)
    return record


def without_curvature(record: Transitions) -> Transitions:
    part, n = Transitions(COLUMNS), len(COLUMNS)
    part.extend(record.s[:, :n], record.a, record.s_next[:, :n], record.episode)
    return part


@pytest.mark.parametrize(("samples", "straight"), [(0, 0.06), (3, 0.0), (7, 0.06), (12, 0.0)])
def test_the_dead_time_is_found_and_the_car_behind_it(samples: int, straight: float) -> None:
    process = process_of(late(samples, straight=straight), DESCRIPTION, 0.6)
    assert process.forecast.samples == samples
    for name in ("now", "before", "back", "slip", "yaw"):
        assert getattr(process.model, name) == pytest.approx(getattr(CAR, name), rel=0.15, abs=1e-4), name
    assert process.model.straight == pytest.approx(straight, abs=0.02)
    assert process.forecast.straight == process.model.straight
    assert process.forecast.back == process.model.back
    assert process.record.names == COLUMNS


def test_the_angle_before_is_one_of_three_that_explain() -> None:
    assert dead_time_of(late(3, car=replace(CAR, now=0.001, before=0.01, earlier=0.001)), 12) == 3


@pytest.mark.parametrize(("car", "speeds"), [(CAR, (4.0, 7.0)), (FAST, (12.0, 24.0))])
def test_noise_and_little_data_move_the_dead_time_by_a_sample_at_most(
    car: CarModel, speeds: tuple[float, float]
) -> None:
    for samples in (0, 4, 8):
        record = late(samples, car=car, speeds=speeds, n=240, noise=0.01, straight=0.05)
        record = with_heading_of_yaw_rate(record) if car.fast else record
        assert dead_time_of(record, 12) == pytest.approx(samples, abs=1)


def calmly_steered(samples: int, *, wanders: float = 0.0, n: int = 1500) -> Transitions:
    """Of a fast car whose wheel turns slowly, seen to 1e-4 rad; wanders: by how much its course does [rad]."""
    rng, k, v = np.random.default_rng(5), np.arange(n + 1), 15.0
    doe = 0.05 * np.sin(0.15 * k) + 0.03 * np.sin(0.31 * k + 1.0) + 0.02 * np.sin(0.05 * k)
    acts = 0.006 * (np.roll(doe, samples) + np.roll(doe, samples + 1)) / (1.0 + FAST.loss * v * v)
    w, course = np.zeros(n + 1), np.zeros(n + 1)
    for i in range(n):
        p = acts[i + 1] - FAST.back * w[i]
        w[i + 1] = w[i] + p
        course[i + 1] = course[i] + (FAST.nose - FAST.tail * v * v) * p + 0.05 * v * (w[i] + w[i + 1]) / 2.0 / LENGTH
    course += np.cumsum(rng.normal(0.0, wanders, n + 1)) if wanders else 0.0
    course, w = 1e-4 * np.round(course / 1e-4), w + rng.normal(0.0, 3e-5, n + 1)
    s = np.column_stack((0.0 * k, v * course, 0.0 * k + v, course - w, v * w / LENGTH, doe, 0.0 * k))
    record = Transitions((*COLUMNS, "kappa"))
    record.extend(s[:-1], np.diff(doe), s[1:], 0)
    return record


@pytest.mark.parametrize("samples", [2, 5, 8])
def test_the_dead_time_of_a_fast_car_shows_in_calm_steering_too(samples: int) -> None:
    """A slowly turned wheel is foreseen from its past by gains of both signs: a dead time of any length explains it."""
    record = calmly_steered(samples)
    assert dead_time_of(record, 12) > samples + 1, "it shows without that: nothing is tried here"
    assert dead_time_of(record, 12, DESCRIPTION.scaled_from) == pytest.approx(samples, abs=1)
    process = process_of(record, DESCRIPTION, 0.6)
    assert process.forecast.samples == pytest.approx(samples, abs=1)
    assert min(process.model.now, process.model.before, process.model.earlier) >= 0.0
    assert process.model.ratio(np.array([15.0])) == pytest.approx(0.012 / (1.0 + FAST.loss * 225.0) / 0.2, rel=0.02)


def test_a_course_is_filtered_where_its_noise_is_that_of_the_sensor() -> None:
    def trust(record: Transitions) -> float:
        return process_of(record, DESCRIPTION, 0.6).forecast.trust_course

    assert trust(calmly_steered(3)) == TRUST_COURSE
    assert trust(calmly_steered(3, wanders=2e-4)) == 1.0, "what the car does is not noise"
    assert trust(late(3, car=FAST, speeds=(12.0, 24.0), n=60).part(slice(0, 30))) == 1.0, "too few rows to say"
    assert trust(late(3, noise=0.01)) == 1.0, "a slow car's is as it was"


def test_a_record_too_short_for_a_dead_time_is_taken_to_have_none_or_one_that_it_can_show() -> None:
    def begun(rows: int) -> int:
        part, record = Transitions((*COLUMNS, "kappa")), late(6)
        part.extend(record.s[:rows], record.a[:rows], record.s_next[:rows], 0)
        return dead_time_of(part, 12)

    assert [begun(rows) for rows in (5, 8, 14, 15)] == [0, 0, 0, 0]
    assert begun(17) <= 2  # the angles of longer ones are not in it
    assert begun(60) == 6


def after(*parts: Transitions) -> Transitions:
    """Records one after the other, each in episodes of its own."""
    record = Transitions(parts[0].names)
    for part in parts:
        begun = int(record.episode[-1]) + 1 if len(record) else 0
        record.extend(part.s, part.a, part.s_next, part.episode + begun, part.own)
    return record


@pytest.mark.parametrize(("before", "now", "noise"), [(2, 8, 0.0), (2, 8, 0.005), (8, 2, 0.005), (0, 5, 0.005)])
def test_of_a_car_whose_dead_time_has_changed_the_older_record_is_left_out(before: int, now: int, noise: float) -> None:
    old, new = late(before, n=1800, noise=noise), late(now, n=600, noise=noise, seed=1)
    record = after(old, new)
    assert dead_time_of(since_change(record, 12), 12) == now != dead_time_of(record, 12)
    assert 400 <= len(since_change(record, 12)) <= 800
    calm = changed(late(now, n=1200, seed=2), **dict.fromkeys(("e_dot", "psi_e", "r_e", "doe", "kappa"), 1e-3))
    assert dead_time_of(since_change(after(record, calm), 12), 12) == now  # they do not bring the old rows back


def test_calm_driving_shows_a_change_too_and_a_car_that_is_as_it_was_before_begins_anew() -> None:
    """Of steering so weak that 200 rows do not prove it: another dead time leaves half as much more, 0.3 mrad."""
    parts = [late(samples, n=1800, noise=0.003, seed=seed, action=0.2) for seed, samples in enumerate((3, 9, 3))]
    changed_once, twice = after(*parts[:2]), after(*parts)
    assert len(since_change(changed_once, 12)) == pytest.approx(1800, abs=200)
    assert dead_time_of(since_change(changed_once, 12), 12) == pytest.approx(9, abs=1)
    assert len(since_change(twice, 12)) == pytest.approx(1800, abs=200)
    assert dead_time_of(since_change(twice, 12), 12) == pytest.approx(3, abs=1)


@pytest.mark.parametrize(("car", "speeds"), [(CAR, (4.0, 7.0)), (FAST, (12.0, 24.0))])
def test_of_a_car_that_has_not_changed_the_whole_record_counts(car: CarModel, speeds: tuple[float, float]) -> None:
    for samples, noise in ((0, 0.0), (0, 0.02), (4, 0.0), (9, 0.0), (9, 0.003), (9, 0.02)):
        record = late(samples, car=car, speeds=speeds, n=1500, noise=noise, straight=0.05)
        record = with_heading_of_yaw_rate(record) if car.fast else record
        assert since_change(record, 12) is record
        assert since_other_gain(record, samples) is record


@pytest.mark.parametrize("changes", [{"now": 0.0042, "before": 0.0035}, {"back": 0.3}, {"slip": 4e-3}])
def test_of_a_car_that_answers_otherwise_than_before_the_older_record_is_left_out(changes: dict[str, float]) -> None:
    """Less for its wheel, sooner, or more so the faster it is; and that, and then as it was."""
    one, other = (dict(car=car, n=1200, noise=0.002) for car in (CAR, replace(CAR, **changes)))
    old, new, old_again = late(3, **one), late(3, **other, seed=1), late(3, **one, seed=2)
    for record in (after(old, new), after(old, new, old_again)):
        assert len(since_other_gain(record, 3)) == pytest.approx(1200, abs=150)
        assert since_change(record, 12) is record
    process = process_of(after(old, new), DESCRIPTION, 0.6)
    for name, value in changes.items():
        assert getattr(process.model, name) == pytest.approx(value, rel=0.25), name


@pytest.mark.parametrize("samples", [0, 6])
def test_a_fast_car_is_told_by_its_yaw_rate_and_not_by_its_axis(samples: int) -> None:
    found = process_of(late(samples, car=FAST, speeds=(12.0, 24.0), n=1200), DESCRIPTION, 0.6)
    assert found.forecast.samples == samples
    for name in ("now", "before", "back", "yaw", "loss", "nose", "tail"):
        assert getattr(found.model, name) == pytest.approx(getattr(FAST, name), rel=0.15, abs=1e-4), name
    assert (found.model.slip, found.model.fast) == (0.0, 1.0)
    assert (found.forecast.loss, found.forecast.tail) == (found.model.loss, found.model.tail)
    slow = process_of(late(samples), DESCRIPTION, 0.6).model
    assert (slow.loss, slow.fast, slow.slip) == (0.0, 0.0, pytest.approx(CAR.slip, rel=0.15))


def changed(record: Transitions, **factors: float) -> Transitions:
    """The record with some columns of its states multiplied."""
    part, scale = Transitions(record.names), np.array([factors.get(name, 1.0) for name in record.names])
    part.extend(record.s * scale, record.a, record.s_next * scale, record.episode, record.own)
    return part


def test_steering_that_overshoots_and_is_slow_is_found_and_none_where_there_is_none() -> None:
    speeds, shape = (9.0, 14.0), dict(lead=1.2, fade=0.07, most=6.0, slew=8.0)
    torque = process_of(late(4, car=replace(FAST, **shape), speeds=speeds, action=0.3, n=1200), DESCRIPTION, 0.6)
    found = tuple(getattr(torque.model, name) for name in FELT)
    assert found == (pytest.approx(1.2, abs=0.61), 0.07, 6.0, 8.0), "what it felt before an episode is not known"
    assert tuple(getattr(torque.forecast, name) for name in FELT) == found
    assert torque.model.loss == pytest.approx(FAST.loss, rel=0.1)
    for noise in (0.0, 0.01):
        plain = process_of(late(4, car=FAST, speeds=speeds, action=0.3, n=1200, noise=noise), DESCRIPTION, 0.6).model
        assert (plain.lead, plain.slew, plain.feels) == (0.0, UNLIMITED, False)


def test_an_overshoot_found_before_stays_unless_another_is_better() -> None:
    speeds, none = (9.0, 14.0), (0.0, UNLIMITED, UNLIMITED)
    torque, alike = dict(lead=1.2, most=6.0, slew=8.0), dict(lead=1.2, most=6.0, slew=8.5)
    other = dict(lead=0.3, most=12.0, slew=2.0)

    def found(noise: float, before: dict[str, float] | None, **car: float) -> tuple[float, ...]:
        record = late(4, car=replace(FAST, **car), speeds=speeds, action=0.3, n=1200, noise=noise)
        forecast = None if before is None else DelayCompensator(samples=4, fade=0.07, **before)
        model = process_of(record, DESCRIPTION, 0.6, forecast).model
        return model.lead, model.most, model.slew

    assert found(0.003, alike, fade=0.07, **torque) == tuple(alike.values())
    assert found(0.003, other, fade=0.07, **torque) == found(0.003, None, fade=0.07, **torque) == (0.6, 6.0, 8.0)
    assert found(0.01, None, fade=0.07, **torque) == none
    assert found(0.01, alike, fade=0.07, **torque) == tuple(alike.values()), "as little noise hides it, it is not lost"
    assert found(0.003, alike) == none


def test_a_fast_cars_dead_time_of_before_stays_until_it_is_twice_as_much_worse(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dead_time, "unexplained", lambda *_, **__: [9.0, 5.0, 1.0, 1.03, 1.05, 3.0])
    record = late(2, car=FAST, speeds=(12.0, 24.0), n=60)
    assert [dead_time_of(record, 5, 8.0, before) for before in range(7)] == [2, 2, 2, 3, 2, 2, 2]
    assert dead_time_of(record, 5, before=3) == 2, "a slow car's is found anew"


@pytest.mark.parametrize(
    ("factors", "refuses"),
    [
        ({"doe": -1.0}, True),  # it would turn the car the wrong way
        ({"r_e": -1.0, "kappa": -1.0}, True),
        ({"r_e": 5.0, "kappa": 5.0}, True),
        ({"r_e": 3.0, "kappa": 3.0}, False),
        ({}, False),
    ],
)
def test_a_refined_model_that_no_car_has_is_refused(factors: dict[str, float], refuses: bool) -> None:
    assert (refined(CAR, changed(late(0), **factors)) is CAR) is refuses


def still(n: int, noise: float) -> Transitions:
    """What is recorded of a fast car whose wheel hardly moves, in one episode: noise."""
    rng, s = np.random.default_rng(3), np.zeros((n + 1, len(COLUMNS) + 1))
    s[:, V] = 18.0
    s[:, [E_DOT, 4]] = noise * rng.standard_normal((n + 1, 2))
    s[:, DOE] = 1e-3 * rng.standard_normal(n + 1)
    return Transitions((*COLUMNS, "kappa"), s[:-1], np.diff(s[:, DOE]), s[1:], np.zeros(n, dtype=int), np.ones(n, bool))


def test_the_rows_that_tell_are_the_newest_and_the_pieces_before_that_are_steered_most() -> None:
    record = after(still(1000, 0.0), late(4, car=FAST, speeds=(12.0, 24.0), n=420), still(4000, 0.0))
    telling = most_steered(record)
    assert len(telling) == ROWS // 2 + ROWS // 2 // 200 * 200
    assert np.array_equal(telling.s[-ROWS // 2 :], record.s[-ROWS // 2 :])
    wild = np.abs(record.s[:, DOE]) > 0.01
    assert (np.abs(telling.s[:, DOE]) > 0.01).sum() == wild.sum()
    joined = telling.episode[1:] == telling.episode[:-1]
    assert np.array_equal(telling.s_next[:-1][joined], telling.s[1:][joined])
    assert len(most_steered(record.part(slice(ROWS)))) == ROWS


@pytest.mark.parametrize("rows", [4000, 4070, 4199])
def test_the_first_seconds_tell_at_every_length_of_a_record(rows: int) -> None:
    """Pieces that are counted from the record's end leave some of them out, other ones in each update."""
    record = after(late(4, car=FAST, speeds=(12.0, 24.0), n=420), still(5000, 0.0)).part(slice(rows))
    assert np.array_equal(most_steered(record).s[:420], record.s[:420])


@pytest.mark.parametrize("gain", [0.9, 1.2])
def test_a_fast_car_that_has_changed_is_not_that_of_where_it_was_steered_most(gain: float) -> None:
    car = replace(FAST, now=gain * FAST.now, before=gain * FAST.before)
    first, since = (
        late(4, car=FAST, speeds=(12.0, 24.0), noise=0.002),
        late(4, car=car, speeds=(12.0, 24.0), noise=0.002, n=4200, action=0.2, seed=1),
    )
    model = process_of(after(first, since), DESCRIPTION, 0.6).model
    v = np.array([12.0, 18.0, 24.0])
    assert model.ratio(v) == pytest.approx(car.ratio(v), rel=0.04)


def test_where_steering_is_slow_a_car_stays_that_was_found_while_it_foresees_the_record_as_well() -> None:
    """Of another record of it, with other noise; of a car with 20 % less gain, and of one not slow, it is new."""

    def found(car: CarModel, seed: int, before: DelayCompensator | None = None, rows: int = 1600) -> DelayCompensator:
        record = late(4, car=car, speeds=(12.0, 24.0), n=1600, noise=0.002, seed=seed).part(slice(rows))
        return process_of(record, DESCRIPTION, 0.6, before).forecast

    straight, again = found(FAST, 0), found(FAST, 1)
    first = replace(straight, slew=0.5 * UNLIMITED)  # as good as none
    assert again != straight
    assert replace(found(FAST, 1, first), trust_course=first.trust_course) == first
    other = replace(FAST, now=0.8 * FAST.now, before=0.8 * FAST.before)
    assert replace(found(other, 1, first), slew=UNLIMITED) == found(other, 1)
    assert found(FAST, 1, straight) == again
    few = found(FAST, 1, first, rows=1400)
    assert replace(few, slew=UNLIMITED) == found(FAST, 1, rows=1400), "the first car that is found is a poor one"


@cache
def found_at_first() -> DelayCompensator:
    """Of half a minute of a car whose steering is said to be as good as not slow."""
    forecast = process_of(late(4, car=FAST, speeds=(12.0, 24.0)), DESCRIPTION, 0.6).forecast
    return replace(forecast, slew=0.5 * UNLIMITED)


@pytest.mark.parametrize(("gain", "noise", "stays"), [(0.97, 0.005, True), (0.95, 0.005, False), (0.99, 0.002, False)])
def test_where_steering_is_slow_a_car_stays_while_it_foresees_the_newest_rows_about_as_well(
    gain: float, noise: float, stays: bool
) -> None:
    """After minutes, and where noise hides others: calm driving tells little of a car."""
    first = found_at_first()
    other = replace(FAST, now=gain * FAST.now, before=gain * FAST.before)
    record = late(4, car=other, speeds=(12.0, 24.0), n=ROWS + 400, noise=noise, seed=1)
    found = process_of(record, DESCRIPTION, 0.6, first).forecast
    assert (replace(found, trust_course=first.trust_course) == first) is stays


@pytest.mark.parametrize(
    ("slew", "rows", "left"), [(8.0, 400, 1700), (8.0, ROWS // 2, ROWS // 2), (UNLIMITED, 400, 400)]
)
def test_few_rows_in_which_a_car_that_wanders_seems_another_leave_nothing_out(
    slew: float, rows: int, left: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    record = with_heading_of_yaw_rate(late(4, car=FAST, speeds=(12.0, 24.0), n=1700, noise=0.002))
    before = replace(found_at_first(), slew=slew)
    monkeypatch.setattr(dead_time, "since_other_gain", lambda record, _: record.part(slice(-rows, None)))
    assert len(process_of(record, DESCRIPTION, 0.6, before).record) == pytest.approx(left, rel=0.1)


@pytest.mark.parametrize(("car", "rows"), [(FAST, ROWS - 100), (CAR, 3600)])
def test_a_fast_car_is_told_by_them_and_its_nets_learn_from_all(
    car: CarModel, rows: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = list[int]()
    monkeypatch.setattr(dead_time, "refined", lambda model, part: seen.append(len(part)) or refined(model, part))
    record = late(0, car=car, speeds=(12.0, 24.0) if car.fast else (4.0, 7.0), n=3600, noise=0.002)
    assert len(process_of(record, DESCRIPTION, 0.6).record) == 3600
    assert max(seen) == rows


@pytest.mark.parametrize(("rows", "few"), [(40, True), (41, False)])
def test_a_model_is_refined_from_thirty_samples_with_ten_ahead_on(rows: int, few: bool) -> None:
    record, part = late(0), Transitions((*COLUMNS, "kappa"))
    part.extend(record.s[:rows], record.a[:rows], record.s_next[:rows], 0)
    assert (refined(CAR, part) is CAR) is few


@pytest.mark.parametrize("kind", ["slow", "fast", "slow and short", "fast and short", "without curvature"])
def test_of_noisy_records_the_models_and_what_nets_learn_are_written_down(
    kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Models of least squares and refined; means of all patterns and targets, of nets as they are drawn, whom nobody
    trains: two rounds with all that a fit can have, and without dead time with what is otherwise left out."""
    monkeypatch.setattr(nfq, "fit", lambda net, x, y, **how: seen.append((x, y)) or Fit(net, np.zeros(1)))
    seen: list[tuple[np.ndarray, np.ndarray]] = []
    fast, car, speeds = (True, FAST, (12.0, 24.0)) if kind.startswith("fast") else (False, CAR, (2.0, 7.0))
    record = late(4, car=car, speeds=speeds, noise=0.01, straight=0.2, n=120 if "short" in kind else 600)
    fit = FitSetting(mirror=True, hints=20, nets=2, imagined=150, horizon=3, dead_time=0.6, n_step=2, iterations=2)
    fit = replace(fit, symmetric=True, hidden=(4, 3))
    if kind == "without curvature":
        fit = replace(fit, mirror=False, n_step=1, dead_time=0.0, window=70, discount=0.8)
        record = without_curvature(record)
        models = [CarModel.fit(record, DESCRIPTION)]
    else:
        process = process_of(record, DESCRIPTION, 0.6)
        assert (process.forecast.samples, process.forecast.trust) == (4, 0.25)
        heading = with_heading_of_yaw_rate(record) if fast else record
        models = [CarModel.fit(aligned(heading, 4), DESCRIPTION, fast=fast), process.model]
    asked = Problem(actions=ACTIONS, cost=DEFAULT.cost, fit=fit, description=DESCRIPTION)
    assert {*NUMBERS, *FELT} == {field.name for field in fields(CarModel)}
    found = [
        *np.ravel([[getattr(model, name) for name in NUMBERS] for model in models]),
        *np.ravel([net[0] for net in update(record, asked, Learned()).nets])[::9],
    ]
    for x, y in seen[:: fit.nets]:
        found += [*x.mean(axis=0), *np.abs(x).mean(axis=0), y.mean(), y.std()]
    found = [float(f"{value:.7g}") for value in found]
    expected = json.loads((ROOT / "tests/golden/learning.json").read_text(encoding="utf-8")).get(kind, [])
    assert found == pytest.approx(expected, rel=1e-4, abs=1e-7), f'"{kind}": {json.dumps(found)}'


def test_an_offset_of_the_wheel_is_believed_up_to_half_a_radian() -> None:
    record = late(0, straight=6.0)
    first = CarModel.fit(record, DESCRIPTION)
    assert (first.straight, refined(first, record).straight) == (0.5, 0.5)


def test_an_update_gives_nets_and_forecast_and_needs_the_imagined() -> None:
    fit = FitSetting(mirror=True, symmetric=True, hints=0, nets=2, imagined=200, epochs=5, dead_time=0.6)
    asked = Problem(actions=ACTIONS, cost=DEFAULT.cost, fit=fit, description=DESCRIPTION)
    learned = update(late(3), asked, Learned())
    assert (len(learned.nets), learned.forecast and learned.forecast.samples) == (4, 3)
    later = update(late(3), asked, learned, 1)
    assert not np.array_equal(later.nets[0][0], learned.nets[0][0])
    plain = replace(asked, fit=replace(fit, dead_time=0.0, symmetric=False))
    nothing_found = update(without_curvature(late(0)), plain, Learned())
    assert isinstance(nothing_found, Learned)
    assert nothing_found.forecast is None
    with pytest.raises(ValueError, match="imagined"):
        replace(fit, imagined=0)
