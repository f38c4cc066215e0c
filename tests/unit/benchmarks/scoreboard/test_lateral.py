"""The part `lateral` of the scoreboard: what is fitted, tuned and cut, and the peer's file."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.peers.lateral_pid import Controller
from benchmarks.scoreboard import lateral
from steerkit.controllers.lateral import ChallengeController, LateralMpc
from steerkit.scenario.lateral import LateralTarget


def test_a_response_is_fitted_as_it_was_made() -> None:
    rng, taps = np.random.default_rng(0), np.concatenate((np.zeros(5), [1.2, 0.5, -0.1], np.zeros(lateral.TAPS - 8)))
    u, roll = rng.normal(size=300), rng.normal(size=300)
    a = np.convolve(np.concatenate(([0.0], u)), taps)[:300]
    log: Any = {"target.a_y": a + roll, "target.a_roll": roll, "controller.a_y_cmd": u}
    response, gain = lateral.fitted([log])
    assert gain == pytest.approx(1.6)
    assert np.array(response) * gain == pytest.approx(np.cumsum(taps), abs=1e-9)


def test_laps_are_cut_into_what_the_car_can_do() -> None:
    pieces = lateral.lap_pieces(60.0)
    assert len(pieces) == 5
    rows = np.concatenate([piece.table.rows for piece in pieces])
    assert np.abs(rows[:, 0]).max() == 1.8
    assert rows[:, 2].min() == 8.0
    assert all(piece.table.rows[0, 0] == 0.0 for piece in pieces)


def test_the_best_of_the_drawn_gains_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    def cost(block: Any, target: Any, seed: int) -> float:
        return abs(float(block.make().ff) - 0.5)

    monkeypatch.setattr(lateral, "cost", cost)
    gaps = [abs(lateral.tuned_pid([(None, 0)], draws).make().ff - 0.5) for draws in (1, 5, 50)]  # type: ignore
    assert gaps == sorted(gaps, reverse=True)
    assert gaps[-1] < 0.03 < gaps[0]


def test_the_pid_feeds_forward_and_holds_its_sum_at_the_limit() -> None:
    pid, state = Controller(0.5, 0.1, 1.0, 0.0, 2), SimpleNamespace(roll_lataccel=0.2)
    assert pid.update(0.0, 0.0, state, SimpleNamespace(lataccel=[0.4, 1.2])) == pytest.approx(0.5)
    assert pid.update(1.0, 0.0, state, SimpleNamespace(lataccel=[])) == pytest.approx(0.4 + 0.1)
    assert pid.update(9.0, 0.0, state, SimpleNamespace(lataccel=[9.0, 9.0])) == 2.0
    assert pid.sum == pytest.approx(0.1)
    assert ChallengeController.load("benchmarks.peers.lateral_pid:Controller").make().ff == 0.55


def test_the_learned_response_costs_less_than_the_told_one() -> None:
    target = LateralTarget.drawn(5, seconds=30.0)
    told: Any = lateral.lateral_controller("lqr", lateral.CAR)
    response, gain = lateral.fitted([lateral.lateral_drive(lateral.CAR, target, told, seed=5)])
    learned = lateral.replace(told, response=response, gain=gain)
    other = LateralTarget.drawn(6, seconds=30.0)
    assert lateral.cost(learned, other, 5) < lateral.cost(told, other, 5)


@pytest.mark.parametrize(("times", "q_step"), [(0.5, 1000.0), (1.5, 1000.0), (0.75, 100.0), (1.25, 100.0)])
def test_a_wrong_dead_time_does_not_swing_within_what_the_step_cost_is_said_to_hold(
    times: float, q_step: float
) -> None:
    """Hardly steering costs 1,360 on such targets; that of the right dead time is 150."""
    told = lateral.CAR.design_model()
    block = LateralMpc(response=LateralMpc.told(times * told.delay, told.lag), q_step=q_step)
    assert lateral.cost(block, LateralTarget.drawn(7001), 7001) < 600.0


def test_a_trained_policy_is_asked_with_what_it_has_commanded_before() -> None:
    seen, answers = list[Any](), iter([0.3, -0.1, 1.0])

    def predict(row: Any, *, deterministic: bool) -> tuple[Any, None]:
        assert deterministic
        seen.append(np.asarray(row))
        return np.array([next(answers)]), None

    greedy = lateral._Greedy(SimpleNamespace(predict=predict))
    state = SimpleNamespace(roll_lataccel=0.1, v_ego=12.0)
    plan = SimpleNamespace(lataccel=[0.5] * 50, roll_lataccel=[0.1] * 50)
    assert [greedy.update(0.5, 0.2, state, plan) for _ in range(3)] == pytest.approx([0.6, -0.2, 2.0])
    assert greedy.past[-3:] == pytest.approx((0.6, -0.2, 2.0))
    assert len({row.tobytes() for row in seen}) == 3, "each time with the commands before it"


def test_an_agent_of_others_learns_and_drives() -> None:
    pytest.importorskip("stable_baselines3")
    block = lateral.trained(0, 0.17)  # trainings begin after 100 samples
    target = LateralTarget.drawn(lateral.HELD_OUT, seconds=2.0)
    log = lateral.lateral_drive(lateral.CAR, target, block, seed=0)
    assert 0.0 < np.abs(log["controller.a_y_cmd"]).max() <= 2.0
