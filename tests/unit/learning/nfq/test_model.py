"""The learned model of the car: what it finds, its symmetries, and what is imagined with it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.controllers.policy import DOE, E
from steerkit.doe import Integrator, LowPass, PlainAngle
from steerkit.learning.costs import TanhCost
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import STANDARD, FitSetting, Problem, imagined_targets
from steerkit.learning.nfq.model import CarModel, believed_loss, earlier_doe, explained, follow, imagine
from tests.support.modelled_car import ACTIONS, CAR, driven
from tests.support.records import level

signed = st.floats(-0.4, 0.4)

RATIO = float(CAR.ratio(np.array(6.0)))


def test_the_numbers_behind_the_transitions_are_found() -> None:
    found = CarModel.fit(driven(n=2000), STANDARD)
    for name in ("held", "pushed", "now", "before", "earlier", "back", "yaw"):
        assert getattr(found, name) == pytest.approx(getattr(CAR, name), rel=0.03), name


@pytest.mark.parametrize("element", [Integrator(), LowPass(), PlainAngle()])
def test_the_dynamic_output_element_is_found(element: Integrator | LowPass | PlainAngle) -> None:
    rng, record = np.random.default_rng(1), Transitions()
    for episode in range(100):
        s = rng.normal(0.0, 0.1, (1, 6)) + np.array([[0, 0, 5.0, 0, 0, 0]])
        a = rng.uniform(-2.0, 2.0, 1)
        angle = element.output(0.0, element.init((1,))._replace(delta_sw=s[:, 5]), element.D(action=a)).delta_sw
        s_next = s.copy()
        s_next[:, 5] = angle
        record.extend(s, a, s_next, episode)
    found = CarModel.fit(record, STANDARD)
    s, a = np.array([[0, 0, 5.0, 0, 0, 1.0]]), np.array([0.7])
    expected = element.output(0.0, element.init((1,))._replace(delta_sw=s[:, 5]), element.D(action=a)).delta_sw
    assert found.step(s, a, s[:, 5])[0, 5] == pytest.approx(float(expected[0]), abs=1e-3)


@given(signed, signed, signed, signed, signed, st.floats(-4.0, 4.0))
def test_every_steady_bend_is_the_same(e: float, e_dot: float, psi_e: float, r_e: float, a: float, x: float) -> None:
    s = np.array([[e, e_dot, 5.0, psi_e, r_e, 0.5]])
    bent = s + np.array([[0, 0, 0, -x * RATIO, 0, x]])
    action = np.array([a])
    straight, turned = CAR.step(s, action, s[:, 5]), CAR.step(bent, action, bent[:, 5])
    np.testing.assert_allclose(turned - straight, [[0, 0, 0, -x * RATIO, 0, x]], atol=1e-12)


@given(signed, signed, signed, signed, signed, signed)
def test_the_mirrored_car_is_the_same_car(e: float, e_dot: float, psi_e: float, r_e: float, a: float, d: float) -> None:
    s, signs = np.array([[e, e_dot, 5.0, psi_e, r_e, d]]), np.array(STANDARD.mirror_signs)
    action, earlier = np.array([a]), np.array([0.1])
    np.testing.assert_allclose(CAR.step(s * signs, -action, -earlier), CAR.step(s, action, earlier) * signs, atol=1e-15)


@pytest.mark.parametrize("v", [2.0, 6.0, 20.0])
@pytest.mark.parametrize("changes", [{}, {"slip": 4e-4}, {"loss": 1.2e-3, "nose": 0.9, "tail": 2e-3, "earlier": 0.002}])
def test_a_wheel_held_turns_the_car_by_the_ratio(changes: dict[str, float], v: float) -> None:
    """w = c - psi_e goes to ratio*doe, and stays there."""
    model = replace(CAR, held=1.0, **changes)
    s = np.array([[0.0, 0.0, v, 0.0, 0.0, 0.5]])
    for _ in range(150):
        s = model.step(s, np.zeros(1), s[:, 5])
    assert s[0, 1] / v - s[0, 3] == pytest.approx(0.5 * float(model.ratio(np.array(v))), rel=1e-6)
    assert s[0, 5] == 0.5
    unknown = replace(model, slip=0.0, back=1e-3)
    assert (float(unknown.ratio(np.array(v))), float(replace(unknown, back=1.01e-3).ratio(np.array(v))) > 1.0) == (
        0.0,
        True,
    )


def test_the_model_says_what_it_cannot_learn_from() -> None:
    with pytest.raises(ValueError, match="no transitions"):
        CarModel.fit(Transitions(), STANDARD)
    with pytest.raises(ValueError, match="the model needs"):
        CarModel.fit(Transitions(("e", "v")), STANDARD)


def test_a_learner_is_not_imagined_where_recovery_alone_has_been() -> None:
    record, aside = driven(), np.array([2.0, 0, 0, 0, 0, 0])
    record.extend(record.s + aside, record.a, record.s_next + aside, record.episode, False)
    assert np.abs(imagine(explained(CAR, record), STANDARD, 4000, np.random.default_rng(0)).s[:, 0]).max() < 1.5


def straight_on(n: int = 50, yaw: float = 0.0) -> Transitions:
    """Rows on the path, of a car like `CAR` but for what `yaw` does to its heading in every sample [rad]."""
    s = np.zeros((n, 6))
    s[:, 2] = 5.0
    s_next = CAR.step(s, np.zeros(n), np.zeros(n))
    s_next[:, 3] += yaw
    record = Transitions()
    record.extend(s, np.zeros(n), s_next, 0)
    return record


def test_trials_by_hand() -> None:
    """A net that leaves the wheel alone stays where it is put; one that turns it on and on fails, as on a crooked road;
    between actions of the set a lopsided one is gentler."""
    cost = TanhCost(goal=0.1, action_cost=0.1)
    asked = Problem(actions=ACTIONS, cost=cost)
    turning = np.array([[0, 0, 0, 0, 0, 0, -1.0]], np.float32), np.zeros(1, np.float32)
    members = [(level(0.2),), (turning,)]
    (still, turned), (none, most) = nfq.trials(asked, explained(CAR, straight_on()), members, np.random.default_rng(3))
    rng = np.random.default_rng(3)
    rng.integers(50, size=nfq.TRIALS)
    e = 2.0 * 0.1 * rng.uniform(-1.0, 1.0, nfq.TRIALS // nfq.FAR)
    assert still == pytest.approx(0.04 * (np.tanh(e * np.arctanh(np.sqrt(0.95)) / 0.1) ** 2).sum() / nfq.TRIALS)
    assert 0.3 < turned < 1.0
    assert (none, most) == (0.0, pytest.approx(0.3))
    (crooked, _), _ = nfq.trials(asked, explained(CAR, straight_on(yaw=0.02)), members, np.random.default_rng(3))
    assert 0.3 < crooked < 1.0


def test_trials_are_driven_as_the_policy_would() -> None:
    """Net by net, and where the policy takes actions between those of the set."""
    nets = tuple(tuple(4.0 * p for p in net) for net in nfq.fresh_nets(FitSetting(nets=3), seed=3))
    record = driven(n=100)
    costs = []
    for continuous in (False, True):
        asked = Problem(actions=ACTIONS, cost=TanhCost(action_cost=0.1), continuous=continuous)
        together, _ = nfq.trials(asked, explained(CAR, record), [(net,) for net in nets], np.random.default_rng(0))
        each = [nfq.trials(asked, explained(CAR, record), [(net,)], np.random.default_rng(0))[0][0] for net in nets]
        np.testing.assert_allclose(together, each, rtol=1e-6)
        costs.append(together)
    assert not np.allclose(*costs)


def test_where_steering_overshoots_trials_have_dead_time_and_more_than_was_found() -> None:
    """What a net does by the forecast over `samples` reaches the car LATER than that; until then it stays as it is."""
    car, asked = replace(CAR, lead=1e-9), Problem(actions=ACTIONS, cost=TanhCost(goal=0.1))
    turning = np.array([[0, 0, 0, 0, 0, 0, -1.0]], np.float32), np.zeros(1, np.float32)

    def cost(model: CarModel, samples: int) -> float:
        return float(
            nfq.trials(asked, explained(model, straight_on()), [(turning,)], np.random.default_rng(3), samples)[0][0]
        )

    assert cost(CAR, 5) == cost(CAR, 0) == pytest.approx(cost(car, 0))
    fails = (1.0 - cost(car, 0)) * nfq.TRIAL
    assert 1.0 - cost(car, 5) == pytest.approx((fails + 5 + round(5 * nfq.LATER)) / nfq.TRIAL, abs=0.02)


def test_nets_of_trials_act_on_the_state_that_comes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without noise and action, the state forecast over three samples is that of three samples later."""
    s, record = straight_on().s.copy(), Transitions()
    s[:, DOE] = 0.01 * np.sin(np.arange(len(s)))
    record.extend(s, np.zeros(len(s)), s, 0)
    known = explained(replace(CAR, fast=1.0, lead=0.6, most=1.0, fade=0.1), record)
    known = known._replace(residual=np.zeros_like(known.residual))
    asked, with_each = Problem(actions=ACTIONS, cost=TanhCost(goal=0.1)), nfq._with_each_action
    monkeypatch.setattr(nfq, "LATER", 0.0)

    def states(samples: int) -> np.ndarray:
        seen: list[np.ndarray] = []
        monkeypatch.setattr(nfq, "_with_each_action", lambda asked, s: seen.append(s) or with_each(asked, s))
        nfq.trials(asked, known, [(level(0.2),)], np.random.default_rng(3), samples)
        return np.array(seen)

    now = states(0)
    assert np.abs(now[:, :, E]).max() < asked.cost.trip  # type: ignore[attr-defined]
    np.testing.assert_allclose(states(3)[:-3], now[3:], atol=1e-12)


def test_a_fast_cars_action_costs_what_the_net_chose() -> None:
    fast = replace(STANDARD, scaled_from=2.0)
    cost = TanhCost(action_cost=0.1, action_unit=0.5)
    asked = Problem(actions=ACTIONS, cost=cost, description=fast)
    s = np.zeros((2, 6))
    s[:, 2] = 1.0, 6.0
    c, _ = asked.costs(s, np.array([0.25, 0.25 / 9.0]), s)
    assert c == pytest.approx([0.1 / 2, 0.1 / 2])


def followed(
    asked: Problem, model: CarModel, s: np.ndarray, before: float, residual: np.ndarray, a: float, nets: Any
) -> tuple[float, bool]:
    """One imagined car, followed by the definition: its target, and whether it failed on the way."""
    setting = asked.fit
    angles, total = [before, s[5]], 0.0  # the angle of the sample before comes first
    for step in range(setting.horizon):
        s_next = model.step(s[None], np.array([a]), np.array([angles[step]]))[0]
        s_next = s_next + residual if step == 0 else s_next
        c, failed = asked.cost(s[None], np.array([a]), s_next[None])
        total += setting.discount**step * float(c[0])
        if failed[0]:
            return min(1.0, total), True
        s = s_next
        angles.append(s[5])
        values = nfq.action_values(asked, nets, s[None])[:, 0].tolist()
        a = min(zip(values, map(abs, ACTIONS), ACTIONS))[2]
    return min(1.0, total + setting.discount**setting.horizon * min(values)), False


@pytest.mark.parametrize("horizon", [1, 2, 5])
def test_imagined_cars_drive_greedily_until_they_fail(horizon: int) -> None:
    """The model remembers the angle before; residuals act once; after a failure nothing counts."""
    model = replace(CAR, earlier=0.02)
    setting = FitSetting(horizon=horizon, discount=0.9, nets=2)
    asked = Problem(actions=ACTIONS, cost=TanhCost(trip=0.3), fit=setting)
    nets = tuple(tuple(4.0 * p for p in net) for net in nfq.fresh_nets(setting, seed=3))
    near = imagine(explained(model, driven(model)), STANDARD, 150, np.random.default_rng(5))
    rng = np.random.default_rng(6)
    near.residual[:] = rng.normal(0.0, 0.02, near.residual.shape)
    near.s[:, 0] *= 2.0
    a = rng.choice(ACTIONS, 150)
    y = imagined_targets(asked, model, near, a, nets)
    each = [followed(asked, model, *one, nets) for one in zip(near.s, near.earlier, near.residual, a)]
    np.testing.assert_allclose(y, [target for target, _ in each], atol=2e-6)
    assert 10 < sum(failed for _, failed in each) < 140


@pytest.mark.parametrize(("seed", "model"), [(0, CAR), (1, CAR), (2, replace(CAR, slip=4e-3))])
def test_an_imagined_state_is_the_recorded_one_in_another_bend_at_another_speed(
    seed: int, model: CarModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one recorded row: courses, the wheel's last turn and the residual stay, up to the mirror."""
    monkeypatch.setattr("steerkit.learning.nfq.model.SPREAD", 0.0)
    s = np.array([[0.1, 0.3, 5.0, 0.02, -0.05, 1.0], [0.12, 0.35, 6.0, 0.03, -0.04, 1.5]])
    record = Transitions()
    record.extend(s, [0.5, 0.3], s[[1, 1]] + 0.01, 0)
    late = imagine(explained(model, record), STANDARD, 400, np.random.default_rng(seed))
    signs = np.where(late.s[:, 0] < 0.0, -1.0, 1.0)
    row = np.where(np.isclose(np.abs(late.s[:, 0]), 0.1), 0, 1)
    assert 100 < row.sum() < 300
    assert abs(signs.mean()) < 0.3
    np.testing.assert_allclose(late.s[:, 1] / late.s[:, 2], signs * (s[:, 1] / s[:, 2])[row], atol=1e-12)
    np.testing.assert_allclose(late.s[:, 4], signs * s[row, 4], atol=1e-12)
    now, before = model.ratio(late.s[:, 2]) * late.s[:, 5], (model.ratio(s[:, 2]) * s[:, 5])[row]
    np.testing.assert_allclose(late.s[:, 3], signs * (s[row, 3] + before) - now, atol=1e-12)
    np.testing.assert_allclose(late.s[:, 5] - late.earlier, signs * np.array([0.0, 0.5])[row], atol=1e-12)
    missed = record.s_next - model.step(record.s, record.a, np.array([1.0, 1.0]))
    expected = missed[row] * np.where(np.array(STANDARD.mirror_signs) < 0.0, signs[:, None], 1.0)
    np.testing.assert_allclose(late.residual, expected, atol=1e-12)


def test_a_car_that_feels_another_angle_is_imagined_with_it() -> None:
    """What it feels is what it felt when recorded, turned with the wheel, and it is the same car in the mirror."""
    torque = replace(CAR, lead=1.0, fade=0.2, most=2.0, slew=4.0)
    s = np.array([[0.0, 0.0, 5.0, 0.0, 0.0, angle] for angle in (0.0, 0.3, 0.4, 0.1, 0.1)])
    record = Transitions()
    record.extend(s[:-1], np.diff(s[:, 5]), s[1:], 0)
    felt = torque.felt(record)
    assert felt is not None
    np.testing.assert_allclose(felt.now, [0.0, 0.16, 0.32, 0.16])  # the slew; then 0.08 rad of overshoot and more
    np.testing.assert_allclose(felt.before, [0.0, 0.0, 0.16, 0.32])
    np.testing.assert_allclose(felt.slow, [0.0, 0.06, 0.128, 0.1224])
    a, earlier = np.array([0.1, -0.3, 0.2, 0.1]), np.array([0.0, 0.0, 0.3, 0.4])
    there = torque.step(s[:-1], a, earlier, felt)
    mirrored = torque.step(-s[:-1] * (1, 1, -1, 1, 1, 1), -a, -earlier, felt.part(slice(None), -1.0))
    np.testing.assert_allclose(mirrored, there * (-1, -1, 1, -1, -1, -1), atol=1e-15)
    near = imagine(explained(torque, record), STANDARD, 400, np.random.default_rng(0))
    assert near.felt is not None
    off = np.abs(np.array(near.felt) - near.s[:, 5])
    for row in range(4):
        expected = np.abs(np.array(felt)[:, row] - s[row, 5])
        assert np.isclose(off.T, expected, atol=1e-12).all(axis=1).any()


def test_imagined_states_lie_within_an_eighth_of_the_half_ranges_mostly() -> None:
    """0.13 of the half range by 2 u^2, u even in [0, 1]: a deviation of 0.13*2/sqrt(5)."""
    record = Transitions()
    record.extend(np.array([[0.0, 0.0, 5.0, 0.0, 0.0, 0.0]]), [0.0], np.array([[0.0, 0.0, 5.0, 0.0, 0.0, 0.0]]), 0)
    near = imagine(explained(CAR, record), STANDARD, 20_000, np.random.default_rng(0))
    for column in (0, 4):
        assert near.s[:, column].std() == pytest.approx(0.13 * 2.0 / 5.0**0.5 * STANDARD.half[column], rel=0.03)


def test_a_loss_is_believed_up_to_four_at_the_highest_speed() -> None:
    v = np.array([10.0, 20.0, 15.0])
    assert [believed_loss(x, v) for x in (1.0, 0.005, -1.0)] == [4.0 / 400.0, 0.005, -0.5 / 400.0]


def test_the_angle_before_is_the_row_aboves_and_an_episode_begins_with_its_own() -> None:
    record, s = Transitions(), np.zeros((6, 6))
    s[:, 5] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0]
    record.extend(s, np.zeros(6), s, [1, 1, 1, 2, 2, 3])
    assert follow(record).tolist() == [False, True, True, False, True, False]
    assert earlier_doe(record).tolist() == [1.0, 1.0, 2.0, 8.0, 8.0, 32.0]
