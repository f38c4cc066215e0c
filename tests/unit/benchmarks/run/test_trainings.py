"""What a training came to: minutes are minutes, GOOD is GOOD, and each net is reported as itself."""

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.run import trainings
from benchmarks.run.results import CURVE
from benchmarks.run.trials import TrialDrive
from steerkit.learning.learner_state import Counts, Episode
from steerkit.metrics import Summary
from steerkit.scenario import Scenario

FELT = dict(rms_wheel_rate_deg=30.0, max_a_y=3.0, rms_jerk=1.0, max_jerk=3.0)
FINE = Summary(duration=130.0, rms_e=0.02, max_e=0.1, share_within_5cm=0.9, **FELT)
HELD = TrialDrive(rounds=1.0, held=True, summary=FINE)


def taken(minutes: float, failures: int = 0, transitions: int = 0) -> Any:
    return SimpleNamespace(t=60.0 * minutes, failures=failures, transitions=transitions, policy=None)


def learned(minutes: float = 6.0, rounds: float | None = None, failures: int = 3) -> Any:
    """A run of so many minutes, with its first round done at `rounds` minutes after two failures."""
    episodes = [Episode(began=0.0, progress=0.0, net=0, ended=1.0, failed=k < failures) for k in range(failures)]
    counts = Counts(episodes=episodes)
    if rounds is not None:
        counts.first_round_begun, counts.first_round_done, counts.failures_to_round = 0.0, 60.0 * rounds, 2
    return SimpleNamespace(t=60.0 * minutes, counts=counts, transitions=np.zeros(1234))


def metrics(drives: list[TrialDrive], nets: list[Any] | None = None, *, episodic: bool = False, **run: Any) -> Any:
    nets = [taken(0.5 * k) for k in range(len(drives))] if nets is None else nets
    return trainings._metrics(learned(**run), nets, drives, episodic=episodic)


def test_times_are_in_minutes() -> None:
    nets = [taken(1.0, failures=4), taken(2.5, failures=7), taken(3.0, failures=9)]
    lost = replace(HELD, held=False, rounds=0.3)
    result = metrics([lost, HELD, HELD], nets, minutes=6.0, rounds=4.5)
    assert result["driving_minutes"] == pytest.approx(6.0)
    assert result["round_minutes"] == pytest.approx(4.5)
    assert result["good_minutes"] == pytest.approx(2.5)
    assert result["round_episodes"] == 3.0  # the one after two failures
    assert (result["failures"], result["trainings"], result["transitions"]) == (3.0, 3.0, 1234.0)


def test_what_was_never_reached_is_infinite() -> None:
    for drives in ([], [replace(HELD, held=False)]):
        result = metrics(drives)
        assert result["round_minutes"] == result["good_minutes"] == math.inf
        assert result["round_episodes"] == result["good_episodes"] == math.inf
        assert result["held"] == 0.0


def test_the_last_twenty_nets_are_judged_and_the_last_one_alone() -> None:
    lost = replace(HELD, held=False, summary=replace(FINE, rms_e=0.3))
    result = metrics([lost] * 30 + [HELD] * 10)
    assert result["last_nets_hold"] == pytest.approx(0.5)
    assert (result["held"], result["rms_e"]) == (1.0, 0.02)
    result = metrics([HELD] * 39 + [lost])
    assert result["last_nets_hold"] == pytest.approx(0.95)
    assert (result["held"], result["rms_e"]) == (0.0, 0.3)


def test_quality_after_so_many_episodes_is_that_of_the_net_trained_then() -> None:
    numbered = [replace(HELD, held=k % 2 == 0, summary=replace(FINE, max_e=0.001 * k)) for k in range(1, 131)]
    result = metrics(numbered, episodic=True)
    for number in trainings.EPISODES:
        assert result[f"max_e_after_{number}"] == pytest.approx(0.001 * number)
        assert result[f"held_after_{number}"] == float(number % 2 == 0)
    assert not any("after" in name for name in metrics(numbered))
    assert not any("after" in name for name in metrics(numbered[:69], episodic=True))


def test_a_curve_has_a_row_for_each_net() -> None:
    nets = [taken(0.5, failures=1, transitions=100), taken(1.0, failures=2, transitions=250)]
    drives = [TrialDrive(rounds=0.2, held=False, summary=None), HELD]
    curve = trainings._curve(nets, drives)
    assert set(curve) == set(CURVE)
    told = {"t": [30.0, 60.0], "iterations": [1.0, 2.0], "transitions": [100.0, 250.0], "failures": [1.0, 2.0]}
    for name, values in (told | {"held": [0.0, 1.0], "rounds": [0.2, 1.0], "rms_e": [math.nan, 0.02]}).items():
        np.testing.assert_allclose(curve[name], values)


def test_on_the_car_driven_only_the_recovery_is_told_and_test_drives_are_the_suites_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: dict[str, Any] = {}

    def drive_each(scenario: Any, setting: Any, nets: Any, *, seed: int) -> list[TrialDrive]:
        asked["judged"] = (scenario, seed)
        return []

    def train(experiment: Any) -> Any:
        asked["learned"] = (experiment.scenario, experiment.seed)
        return SimpleNamespace(run=run, nets=[])

    run = learned(minutes=1.0)
    run.policy = None
    monkeypatch.setattr(trainings, "train", train)
    monkeypatch.setattr(trainings, "drive_each", drive_each)
    same_car, car = (
        trainings.TRAININGS["same-car-1"],
        Scenario(name="slow", steering={"delay": 0.2}, knowledge={"delay": 0.0, "lag": 0.0}),
    )
    trainings.learn(same_car, "default", seed=3, driven=car)
    believed = car.design_model(), car.with_(knowledge={"delay": None, "lag": None}).design_model()
    assert [b.delay for b in believed] == [0.0, 0.2]
    assert asked["judged"] == (car.with_(knowledge={"delay": None, "lag": None}), 3)
    assert asked["learned"] == (asked["judged"][0], 1003)
    trainings.learn(trainings.TRAININGS["clean"], "default", seed=3)
    assert (asked["learned"][1], asked["judged"]) == (3, (Scenario(), 1003))
    with pytest.raises(ValueError, match="training 'same-car-1': it is one for each scenario"):
        trainings.learn(same_car, "default", seed=3)


def test_an_agent_drives_for_its_minutes_and_is_good_by_the_whole_criterion(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, Any] = {}
    curve = {name: np.full(4, 0.02) for name in CURVE}
    curve |= {
        "t": 60.0 * np.arange(1.0, 5.0),
        "transitions": np.arange(4.0),
        "held": np.array([1.0, 0.0, 1.0, 1.0]),
        "rounds": np.ones(4),
        "max_jerk": np.array([9.0, 1.0, 2.0, 1.0]),
    }

    def agent(name: str, *, steps: int, seed: int, judge: Any) -> Any:
        asked.update(name=name, steps=steps, seed=seed)
        return SimpleNamespace(), curve

    monkeypatch.setattr(trainings, "stable_baselines", agent)
    name = next(name for name, kind in trainings.SETTINGS.items() if kind != "NFQ")
    result = trainings.learn(replace(trainings.TRAININGS["agent"], minutes=30.0), name, seed=7)
    assert asked["steps"] == 30 * 60 * 20  # samples of 0.05 s
    assert asked["seed"] == 7
    assert result.metrics["driving_minutes"] == 30.0
    assert result.metrics["good_minutes"] == pytest.approx(3.0)  # too much jerk at first, then lost
