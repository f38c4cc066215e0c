"""Costs, targets and updates of NFQ: by hand first, then invariants."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.learning.costs import COSTS, BandCost, IdoeCost, SmoothCost, TanhCost
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting, cost_to_go, fresh_nets, iterate, targets
from steerkit.learning.nfq.network import Net, flat, forward
from steerkit.learning.nfq.patterns import STANDARD, StateDescription, goal_patterns, mirror_patterns, patterns
from steerkit.learning.nfq.rprop import Fit, fit

ACTIONS = (-0.5, 0.0, 0.5)


def states(e: list[float]) -> np.ndarray:
    s = np.zeros((len(e), 6))
    s[:, 0], s[:, 2] = e, 5.0
    return s


def chain(e: list[float], episode: list[int], a: float = 0.5) -> Transitions:
    """Rows k: from e[k] to e[k + 1]."""
    record = Transitions()
    record.extend(states(e[:-1]), np.full(len(e) - 1, a), states(e[1:]), episode)
    return record


def level(q: float) -> Net:
    """A net whose value is q everywhere."""
    return np.zeros((1, 7), np.float32), np.array([math.log(q / (1.0 - q))], np.float32)


def recorded(n: int = 300, seed: int = 0) -> Transitions:
    rng = np.random.default_rng(seed)
    record = Transitions()
    s = rng.uniform(-1.0, 1.0, (n + 1, 6)) * [0.4, 1.0, 1.0, 0.3, 0.3, 6.0] + [0.0, 0.0, 5.0, 0.0, 0.0, 0.0]
    record.extend(s[:-1], rng.choice(ACTIONS, n), s[1:], np.arange(n) // 50)
    return record


# ---- costs ------------------------------------------------------------------------------------------------------


def test_band_cost_by_hand() -> None:
    e = [0.0, 0.049, -0.051, 0.4, -0.6]
    c, terminal = BandCost()(states(e), np.ones(5), states(e))
    assert c.tolist() == [0.0, 0.0, 0.01, 0.01, 1.0]
    assert terminal.tolist() == [False, False, False, False, True]


def test_idoe_cost_is_free_only_with_the_wheel_left_alone() -> None:
    c, _ = IdoeCost()(states([0.0] * 3), np.array([0.0, -0.0, 0.1]), states([0.01, -0.01, 0.0]))
    assert c.tolist() == [0.0, 0.0, 0.01]


def test_tanh_cost_by_hand() -> None:
    e = [0.0, 0.05, -0.05, 0.4, 0.51]
    c, terminal = TanhCost()(states(e), np.zeros(5), states(e))
    assert c == pytest.approx([0.0, 0.95 * 0.04, 0.95 * 0.04, 0.04, 1.0], abs=1e-12)
    assert terminal.tolist() == [False] * 4 + [True]
    moving, _ = TanhCost()(states(e), np.full(5, 0.1), states(e))
    assert (moving - c) == pytest.approx([0.01] * 4 + [0.0])


def test_smooth_cost_by_hand() -> None:
    """5 m/s: 0.05 rad/s more yaw rate in 0.05 s is a jerk of 5 m/s^3."""
    cost = SmoothCost(cost=TanhCost(action_cost=0.0), jerk_cost=0.01, jerk_unit=10.0, wheel_cost=0.02, wheel_unit=0.4)
    s, s_next = states([0.0] * 4), states([0.0, 0.0, 0.0, 0.6])
    s_next[0, 4] = 0.05
    s_next[1, 5] = -0.2
    s_next[2, 4:] = 10.0
    c, terminal = cost(s, np.zeros(4), s_next)
    assert c == pytest.approx([0.01 / 4, 0.02 / 4, 0.01 + 0.02, 1.0])
    assert terminal.tolist() == [False, False, False, True]
    with pytest.raises(ValueError, match="wheel_unit"):
        SmoothCost(jerk_unit=0.0)


@given(e=st.floats(-2.0, 2.0), a=st.sampled_from(ACTIONS), cost=st.sampled_from(COSTS))
def test_costs_are_symmetric_and_within_one(e: float, a: float, cost: type) -> None:
    c, terminal = cost()(states([0.0, 0.0]), np.array([a, -a]), states([e, -e]))
    assert c[0] == c[1]
    assert 0.0 <= c[0] <= 1.0
    assert terminal[0] == (abs(e) > 0.5)


def test_costs_say_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="expected 0 < goal < trip"):
        BandCost(goal=0.6)
    with pytest.raises(ValueError, match="expected 0 < step <= 1"):
        IdoeCost(step=0.0)
    with pytest.raises(ValueError, match="action_cost"):
        TanhCost(action_cost=1.0)


# ---- patterns ---------------------------------------------------------------------------------------------------


def test_ranges_become_minus_one_and_one() -> None:
    low, high = np.array([STANDARD.low]), np.array([STANDARD.high])
    assert patterns(STANDARD, low, np.array([-0.5]), 0.5).tolist() == [[-1.0] * 7]
    assert patterns(STANDARD, high, np.array([0.5]), 0.5).tolist() == [[1.0] * 7]


def test_mirroring_patterns_is_mirroring_states() -> None:
    record = recorded(50)
    image = record.mirrored(STANDARD)
    there = patterns(STANDARD, image.s, image.a, 0.5)
    np.testing.assert_array_equal(there, mirror_patterns(STANDARD, patterns(STANDARD, record.s, record.a, 0.5)))


def test_hints_lie_in_the_goal_region_and_leave_the_wheel_alone() -> None:
    x = goal_patterns(STANDARD, ACTIONS, 500, np.random.default_rng(0))
    assert x.shape == (500, 7)
    assert np.all(np.abs(x[:, :-1]) <= STANDARD.goal)
    assert np.all(np.abs(x[:, 2]).max() > 0.9)
    assert np.all(x[:, -1] == 0.0)
    assert set(goal_patterns(STANDARD, (-6.0, 6.0), 100, np.random.default_rng(0))[:, -1]) == {-1.0, 1.0}


def test_descriptions_say_what_is_wrong() -> None:
    with pytest.raises(ValueError, match="low has 2 entries, expected 6"):
        StateDescription(low=(0.0, 1.0))
    with pytest.raises(ValueError, match=r"e: low 1\.0 and high 1\.0"):
        StateDescription(low=(1.0, *STANDARD.low[1:]))
    with pytest.raises(ValueError, match="sign -1 and range"):
        StateDescription(low=(-2.0, *STANDARD.low[1:]))
    with pytest.raises(ValueError, match="valid: -1, 1"):
        StateDescription(mirror_signs=(0.0, -1.0, 1.0, -1.0, -1.0, -1.0))


# ---- targets ----------------------------------------------------------------------------------------------------


def test_without_nets_the_target_is_the_cost() -> None:
    record = chain([0.0, 0.1, 0.2, 0.7], [0, 0, 0])
    assert targets(record, ACTIONS, BandCost()) == pytest.approx([0.01, 0.01, 1.0])


def test_one_step_targets_by_hand() -> None:
    record = chain([0.0, 0.1, 0.02, 0.7], [0, 0, 0])
    y = targets(record, ACTIONS, BandCost(), FitSetting(discount=0.9), nets=[level(0.4)])
    assert y == pytest.approx([0.01 + 0.9 * 0.4, 0.9 * 0.4, 1.0], abs=1e-6)


def test_three_step_targets_by_hand() -> None:
    """Two episodes of 4 and 2 rows, the second one failing."""
    record = chain([0.0, 0.1, 0.1, 0.1, 0.1, 0.2, 0.7], [0, 0, 0, 0, 1, 1])
    g, q, c = 0.9, 0.4, 0.01
    y = targets(record, ACTIONS, BandCost(), FitSetting(discount=g, n_step=3), nets=[level(q)])
    three = c + g * c + g**2 * c + g**3 * q
    expected = [three, three, c + g * c + g**2 * q, c + g * q, c + g * 1.0, 1.0]
    assert y == pytest.approx(expected, abs=1e-6)


def test_nothing_is_carried_over_a_terminal_row_even_within_an_episode_number() -> None:
    record = chain([0.0, 0.7, 0.1, 0.1], [0, 0, 0])
    y = targets(record, ACTIONS, BandCost(), FitSetting(n_step=5), nets=[level(0.4)])
    assert y[0] == 1.0


def test_targets_are_clipped() -> None:
    record = chain([0.1, 0.2, 0.3], [0, 0])
    y = targets(record, ACTIONS, BandCost(), FitSetting(clip=(0.0, 0.05)), nets=[level(0.9)])
    assert y == pytest.approx([0.05, 0.05])


@given(n=st.integers(1, 6), discount=st.floats(0.0, 0.99))
def test_n_step_targets_equal_the_sum_written_out(n: int, discount: float) -> None:
    record = recorded(60, seed=1)
    setting = FitSetting(n_step=n, discount=discount, clip=(-10.0, 10.0))
    nets = fresh_nets(setting, seed=1)
    y = targets(record, ACTIONS, BandCost(trip=0.35), setting, nets=nets)
    c, terminal = BandCost(trip=0.35)(record.s, record.a, record.s_next)
    ahead = cost_to_go(nets, record.s_next, ACTIONS, STANDARD)
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
        assert y[k] == pytest.approx(total, abs=1e-6)


def test_cost_to_go_is_the_least_over_the_actions_of_the_combined_value() -> None:
    record = recorded(200)
    for combine, join in (("mean", np.mean), ("max", np.max)):
        setting = FitSetting(nets=3, combine=combine)  # type: ignore[arg-type]
        nets = fresh_nets(setting, seed=4)
        each = [
            join([forward(net, patterns(STANDARD, record.s, np.full(200, a), 0.5)) for net in nets], axis=0)
            for a in ACTIONS
        ]
        found = cost_to_go(nets, record.s, ACTIONS, STANDARD, setting)
        np.testing.assert_allclose(found, np.min(each, axis=0), atol=5e-7)


# ---- updates ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["auto", "torch"])
def test_equal_seeds_give_equal_nets_and_others_do_not(engine: str) -> None:
    record, setting = recorded(), FitSetting(nets=2, epochs=20, engine=engine)  # type: ignore[arg-type]
    one, same, other = (iterate(record, ACTIONS, BandCost(), setting, seed=seed) for seed in (1, 1, 2))
    assert [flat(net).tobytes() for net in one] == [flat(net).tobytes() for net in same]
    assert not np.array_equal(flat(one[0]), flat(one[1]))
    assert not np.array_equal(flat(one[0]), flat(other[0]))


def test_a_first_update_learns_the_cost_and_the_next_one_looks_further() -> None:
    record, told = recorded(400), []
    setting = FitSetting(epochs=300, hints=0, clip=(0.0, 1.0))
    cost = BandCost(trip=0.3, step=0.3)
    first = iterate(record, ACTIONS, cost, setting, progress=lambda k, errors: told.append((k, *errors)))
    y = targets(record, ACTIONS, cost, setting)
    assert told[0][0] == 0
    assert told[0][1] < 0.5 * np.var(y)
    second = iterate(record, ACTIONS, cost, setting, nets_before=first, seed=1)
    x = patterns(STANDARD, record.s, record.a, 0.5)
    assert forward(second[0], x).mean() > forward(first[0], x).mean() + 0.05


def test_several_iterations_are_several_updates_with_their_own_targets() -> None:
    record, seen = recorded(), []
    iterate(record, ACTIONS, BandCost(), FitSetting(iterations=3, epochs=5), progress=lambda k, e: seen.append(k))
    assert seen == [0, 1, 2]


def test_hints_pull_the_goal_region_down() -> None:
    record = recorded(200)
    before = (level(0.8),)
    goal = goal_patterns(STANDARD, ACTIONS, 200, np.random.default_rng(9))
    setting = FitSetting(hidden=(), epochs=100)
    values = [
        forward(
            iterate(record, ACTIONS, BandCost(), FitSetting(hidden=(), epochs=100, hints=h), nets_before=before)[0],
            goal,
        ).mean()
        for h in (0, 400)
    ]
    assert setting.hints == 100
    assert values[1] < values[0] - 0.1


def test_mirror_doubles_the_data_with_the_same_targets(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[tuple[np.ndarray, np.ndarray]] = []

    def watched(net: Net, x: np.ndarray, y: np.ndarray, **how: Any) -> Fit:
        seen.append((x, y))
        return fit(net, x, y, **how)

    monkeypatch.setattr(nfq, "fit", watched)
    record, before = recorded(200), fresh_nets(seed=3)
    iterate(record, ACTIONS, TanhCost(), FitSetting(epochs=1), nets_before=before)
    iterate(record, ACTIONS, TanhCost(), FitSetting(epochs=1, mirror=True), nets_before=before)
    (x, y), (twice_x, twice_y) = seen
    assert (len(x), len(twice_x)) == (300, 600)
    np.testing.assert_array_equal(twice_x, np.concatenate([x, mirror_patterns(STANDARD, x)]))
    np.testing.assert_array_equal(twice_y, np.concatenate([y, y]))
    np.testing.assert_array_equal(y[200:], 0.0)


def test_warm_starts_from_the_nets_before() -> None:
    record = recorded()
    setting = FitSetting(init="warm", epochs=0, nets=2)
    before = fresh_nets(setting, seed=8)
    after = iterate(record, ACTIONS, BandCost(), setting, nets_before=before)
    assert all(np.array_equal(flat(a), flat(b)) for a, b in zip(before, after, strict=True))
    fresh = iterate(record, ACTIONS, BandCost(), FitSetting(epochs=0, nets=2), nets_before=before)
    assert not np.array_equal(flat(fresh[0]), flat(before[0]))


def test_updates_say_what_is_wrong() -> None:
    record = recorded(10)
    with pytest.raises(ValueError, match="no transitions"):
        iterate(Transitions(), ACTIONS, BandCost())
    with pytest.raises(ValueError, match="but the description has"):
        iterate(_narrow(), ACTIONS, BandCost())
    with pytest.raises(ValueError, match="mirror=True needs -a"):
        iterate(record, (0.0, 0.5), BandCost(), FitSetting(mirror=True))
    with pytest.raises(ValueError, match="expected \\(7, 10, 10, 1\\)"):
        iterate(record, ACTIONS, BandCost(), nets_before=[level(0.5)])
    for wrong in ({"discount": 1.0}, {"init": "cold"}, {"combine": "min"}, {"n_step": 0}, {"clip": (1.0, 0.0)}):
        with pytest.raises(ValueError, match=next(iter(wrong))):
            FitSetting(**wrong)  # type: ignore[arg-type]


def _narrow() -> Transitions:
    record = Transitions(("e", "v"))
    record.append((0.0, 1.0), 0.0, (0.0, 1.0), 0)
    return record
