"""Costs, targets and updates of NFQ: by hand first, then invariants."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.controllers.policy import StateDescription
from steerkit.learning.costs import BandCost, Cost, TanhCost
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import (
    STANDARD,
    FitSetting,
    Learned,
    Problem,
    action_values,
    fresh_nets,
    goal_patterns,
    iterate,
    mirror_patterns,
    patterns,
    targets,
)
from steerkit.learning.nfq.model import CarModel
from steerkit.learning.nfq.rprop import Fit, Net, fit, flat, forward
from tests.support.modelled_car import CAR, driven
from tests.support.records import ACTIONS, chain, level, recorded

PAPERS, BAND = FitSetting(), BandCost()
TORQUE = replace(CAR, slew=4.0)


def problem(cost: Cost = BAND, **fit: Any) -> Problem:
    return Problem(actions=ACTIONS, cost=cost, fit=FitSetting(**fit))


@pytest.fixture
def fitted(monkeypatch: pytest.MonkeyPatch) -> list[tuple[np.ndarray, np.ndarray]]:
    """The patterns and targets of every fit."""
    seen: list[tuple[np.ndarray, np.ndarray]] = []

    def watched(net: Net, x: np.ndarray, y: np.ndarray, **how: Any) -> Fit:
        seen.append((x, y))
        return fit(net, x, y, **how)

    monkeypatch.setattr(nfq, "fit", watched)
    return seen


def test_a_turn_of_a_torque_cars_wheel_is_dearer_up_to_three_times(monkeypatch: pytest.MonkeyPatch) -> None:
    record, prices, suited = driven(n=40), list[float](), TanhCost.suited
    v = float(np.median(record.s[:, 2]))

    def watched(cost: TanhCost, *how: Any) -> TanhCost:
        prices.append(suited(cost, *how).action_cost)
        return suited(cost, *how)

    monkeypatch.setattr(TanhCost, "suited", watched)
    for car, fast in ((CAR, 2.0), (TORQUE, 1.0), (TORQUE, 3.0), (TORQUE, 5.0)):
        asked = problem(TanhCost(action_cost=0.02), nets=1, epochs=0, imagined=10)
        iterate(record, replace(asked, description=StateDescription(scaled_from=v / fast)), model=car)
    assert prices == pytest.approx([0.02 * 2.0, 0.02 * 3.0, 0.02 * 3.0 * 16.0 / 9.0, 0.02 * 5.0])


def test_what_another_than_the_learner_did_is_no_action_of_its_own() -> None:
    whole, own = recorded(60), recorded(60)
    whole.extend(whole.s, -whole.a, whole.s_next, whole.episode + 100, False)
    (one,), (other,) = (iterate(record, problem(epochs=20, n_step=3)) for record in (own, whole))
    np.testing.assert_array_equal(one[0], other[0])
    others = Transitions()
    others.extend(own.s, own.a, own.s_next, own.episode, False)
    (net,) = iterate(others, problem(epochs=20, n_step=3, imagined=50), [one])  # they teach how the car answers
    assert np.isfinite(net[0]).all()
    with pytest.raises(ValueError, match="no transitions of the learner's"):
        iterate(others, problem())


def test_without_nets_the_target_is_the_cost() -> None:
    record = chain([0.0, 0.1, 0.2, 0.7], [0, 0, 0])
    assert targets(problem(), record) == pytest.approx([0.01, 0.01, 1.0])


@given(n=st.integers(1, 6), discount=st.floats(0.0, 0.99))
def test_n_step_targets_equal_the_sum_written_out_within_zero_and_one(n: int, discount: float) -> None:
    record, cost = recorded(60, seed=1), BandCost(trip=0.35, step=0.2)
    nets = fresh_nets(PAPERS, seed=1)
    asked = problem(cost, n_step=n, discount=discount)
    y = targets(asked, record, nets)
    c, terminal = cost(record.s, record.a, record.s_next)
    ahead = action_values(asked, nets, record.s_next).min(axis=0)
    for k in range(60):
        total, weight = 0.0, 1.0
        for row in range(k, min(k + n, 60)):
            total, weight = total + weight * c[row], weight * discount
            last = row == min(k + n, 60) - 1 or record.episode[row + 1] != record.episode[row]
            if terminal[row]:
                break
            if last:
                total += weight * ahead[row]
                break
        assert y[k] == pytest.approx(min(total, 1.0), abs=1e-6)


def test_the_value_of_an_action_is_the_mean_of_the_nets() -> None:
    record, nets = recorded(200), fresh_nets(FitSetting(nets=3), seed=4)
    each = [
        np.mean([forward(net, patterns(STANDARD, record.s, np.full(200, a), 0.5)) for net in nets], axis=0)
        for a in ACTIONS
    ]
    np.testing.assert_allclose(action_values(problem(), nets, record.s), each, atol=5e-7)


def test_equal_seeds_give_equal_nets_and_others_do_not() -> None:
    record, asked = recorded(), problem(nets=2, epochs=20)
    one, same, other = (iterate(record, asked, seed=seed) for seed in (1, 1, 2))
    assert [flat(net).tobytes() for net in one] == [flat(net).tobytes() for net in same]
    assert not np.array_equal(flat(one[0]), flat(one[1]))
    assert not np.array_equal(flat(one[0]), flat(other[0]))


def test_mirror_doubles_the_data_with_the_same_targets(fitted: list[tuple[np.ndarray, np.ndarray]]) -> None:
    record, before = recorded(200), fresh_nets(seed=3)
    for mirror in (False, True):
        iterate(record, problem(TanhCost(), epochs=1, mirror=mirror), before)
    (x, y), (twice_x, twice_y) = fitted
    assert (len(x), len(twice_x)) == (300, 600)
    np.testing.assert_array_equal(twice_x, np.concatenate([x, mirror_patterns(STANDARD, x)]))
    np.testing.assert_array_equal(twice_y, np.concatenate([y, y]))
    np.testing.assert_array_equal(y[200:], 0.0)


@pytest.mark.parametrize(("v", "goal"), [(6.0, 0.05), (16.0, 0.1), (30.0, 0.15)])
def test_a_fast_cars_well_is_wider(fitted: list[tuple[np.ndarray, np.ndarray]], v: float, goal: float) -> None:
    record, calm = recorded(40), Transitions()
    s, s_next = record.s * 1e-3, record.s_next * 1e-3  # on the path
    s[:, 2] = s_next[:, 2] = v
    calm.extend(s, record.a, s_next, record.episode, True)
    cost = TanhCost(goal=0.15, goal_least=0.05, action_cost=0.0)
    description = StateDescription(scaled_from=8.0)
    iterate(calm, Problem(actions=ACTIONS, cost=cost, fit=FitSetting(epochs=1, hints=0), description=description))
    assert fitted[0][1] == pytest.approx(TanhCost(goal=goal).steps(s_next[:, 0], np.zeros(40)), rel=1e-5)


def test_updates_say_what_is_wrong() -> None:
    record, narrow = recorded(10), Transitions(("e", "v"))
    narrow.append((0.0, 1.0), 0.0, (0.0, 1.0), 0)
    with pytest.raises(ValueError, match="no transitions"):
        iterate(Transitions(), problem())
    with pytest.raises(ValueError, match="but the description has"):
        iterate(narrow, problem())
    with pytest.raises(ValueError, match="no transitions"):
        nfq.update(Transitions(), problem(imagined=1, dead_time=0.1), Learned())
    with pytest.raises(ValueError, match="expected \\(7, 10, 10, 1\\)"):
        iterate(record, problem(), [level(0.5)])
    with pytest.raises(ValueError, match="actions is empty"):
        Problem(actions=(), cost=BandCost())
    for wrong in ({"hidden": (10, 0)}, {"dead_time": 0.1}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            FitSetting(**wrong)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="mirror=True needs -a"):
        Problem(actions=(0.0, 0.5), cost=BandCost(), fit=FitSetting(mirror=True))


def test_each_update_begins_afresh() -> None:
    record = recorded(40)
    nets = iterate(record, problem(nets=2, epochs=1))
    after = iterate(record, problem(nets=2, epochs=0), nets, seed=1)
    assert len(after) == 2
    assert not np.array_equal(flat(after[0]), flat(nets[0]))


@pytest.mark.parametrize("symmetric", [False, True])
def test_of_all_nets_those_stay_that_drive_the_learned_car_best(
    symmetric: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, size = driven(n=40), 2 if symmetric else 1
    asked = problem(nets=2, epochs=0, iterations=2, imagined=10, symmetric=symmetric)
    seen: list[Any] = []

    def trials(problem: Problem, known: object, members: Any, rng: object) -> tuple[np.ndarray, ...]:
        seen.append(members)
        return np.arange(len(members))[::-1] % 4.0, np.zeros(len(members))  # 1 0 3 2 1 0 for the second's six

    monkeypatch.setattr(nfq, "trials", trials)
    first = iterate(record, asked)
    second = iterate(record, asked, first, seed=1)
    assert [len(members) for members in seen] == [4, 6]
    assert all(len(nets) == size for nets in seen[1])
    assert all(a is b for a, b in zip(first, (net for nets in seen[1][:2] for net in nets), strict=True))
    best = [net for nets in (seen[1][1], seen[1][5]) for net in nets]
    assert all(a is b for a, b in zip(second, best, strict=True))


@pytest.mark.parametrize(
    ("lead", "rows", "cost", "turns", "stay"),
    [
        (0.6, 40, 0.86, 1.0, True),
        (0.6, 40, 0.84, 1.0, False),
        (0.6, 41, 0.86, 2.0, False),  # too few rows yet
        (0.6, 40, 0.80, 1.2, False),
        (0.6, 40, 0.80, 1.3, True),  # restless
        (0.6, 40, 1.20, 0.7, True),
        (0.6, 40, 1.20, 0.5, False),  # the one before is restless beside it
        (0.0, 40, 0.99, 2.0, False),  # a car that does not overshoot: the cost alone
    ],
)
def test_where_steering_overshoots_the_cheaper_net_of_those_that_are_calm_steers(
    lead: float, rows: int, cost: float, turns: float, stay: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From some rows on clearly cheaper than the one before."""
    monkeypatch.setattr(nfq, "SETTLED", rows)
    record, asked = driven(n=40), problem(nets=1, epochs=0, imagined=10)
    before = iterate(record, asked)
    monkeypatch.setattr(nfq, "trials", lambda *_: (np.array([1.0, cost]), np.array([1.0, turns])))
    car = replace(CarModel.fit(record, asked.description), fast=1.0, lead=lead)
    after = iterate(record, asked, before, seed=1, model=car)
    assert (after[0] is before[0]) is stay


@pytest.mark.parametrize(
    ("cores", "asked", "expected"), [(4, None, 2), (1, None, 1), (4, "1", 1), (4, "8", 2), (4, "0", 1), (4, "many", 2)]
)
def test_members_share_the_cores_that_the_process_has(
    monkeypatch: pytest.MonkeyPatch, cores: int, asked: str | None, expected: int
) -> None:
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(cores)), raising=False)
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if asked is not None:
        monkeypatch.setenv("OMP_NUM_THREADS", asked)
    assert nfq.threads() == expected


def test_mirroring_patterns_is_mirroring_states() -> None:
    record = recorded(50)
    there = patterns(STANDARD, record.s * STANDARD.mirror_signs, -record.a, 0.5)
    np.testing.assert_array_equal(there, mirror_patterns(STANDARD, patterns(STANDARD, record.s, record.a, 0.5)))


def test_hints_lie_in_the_goal_region_and_leave_the_wheel_alone() -> None:
    x = goal_patterns(problem(hints=500), np.random.default_rng(0))
    assert x.shape == (500, 7)
    assert np.all(np.abs(x[:, :-1]) <= STANDARD.goal)
    assert np.all(np.abs(x[:, 2]).max() > 0.9)
    assert np.all(x[:, -1] == 0.0)
    two = Problem(actions=(-6.0, 6.0), cost=BandCost())
    assert set(goal_patterns(two, np.random.default_rng(0))[:, -1]) == {-1.0, 1.0}
