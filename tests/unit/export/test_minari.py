"""Data sets for Minari hold the transitions of a run."""

from dataclasses import asdict
from pathlib import Path
from typing import Any

import gymnasium
import minari
import numpy as np
import pytest

from steerkit.export.minari import to_minari
from steerkit.gym import Task
from steerkit.learning import rundir
from steerkit.learning.data.transitions import Transitions
from tests.support.short_run import published_on_a_circle


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return published_on_a_circle(tmp_path_factory.mktemp("run"))


@pytest.fixture(autouse=True)
def sets(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "sets"))
    return tmp_path / "sets"


def test_the_data_set_holds_the_transitions_and_recovers_its_environment(run: Path) -> None:
    experiment = rundir.experiment_of(run)
    scenario, setting = experiment.scenario, experiment.setting
    options: dict[str, Any] = {"scenario": asdict(scenario), "actions": setting.actions, "doe": setting.doe}
    task = Task(**options, cost=rundir.plain(setting.cost))
    transitions = rundir.load(run).transitions
    to_minari(transitions, "steerkit/again-v0", task)
    data = minari.load_dataset("steerkit/again-v0")
    episodes = list(data.iterate_episodes())
    seen = np.concatenate([episode.observations[:-1] for episode in episodes])
    after = np.concatenate([episode.observations[1:] for episode in episodes])
    actions = np.concatenate([episode.actions for episode in episodes])
    rewards = np.concatenate([episode.rewards for episode in episodes])
    np.testing.assert_array_equal(seen, task.observation(transitions.s))
    np.testing.assert_array_equal(after, task.observation(transitions.s_next))
    np.testing.assert_array_equal(np.array(setting.actions)[actions], transitions.a)
    cost, over = setting.cost(transitions.s, transitions.a, transitions.s_next)
    np.testing.assert_allclose(rewards, -cost)
    assert sum(episode.terminations.sum() for episode in episodes) == over.sum() >= 1
    assert all(e.terminations[-1] or e.truncations[-1] for e in episodes)
    env = data.recover_environment()
    assert env.observation_space == task.observation_space
    assert isinstance(env.action_space, gymnasium.spaces.Discrete)
    assert env.unwrapped.task.price == setting.cost  # type: ignore[attr-defined]
    env.reset(seed=0)
    env.step(0)
    with pytest.raises(ValueError, match="exists; give another name"):
        to_minari(transitions, "steerkit/again-v0", task)


def test_a_gap_in_time_or_an_unknown_action_does_not_go_unseen() -> None:
    record = Transitions()
    s = np.random.default_rng(0).uniform(-0.01, 0.01, (6, 6))
    record.extend(s[:-1], np.zeros(5), s[1:], 0)
    record.extend(s[:2] + 0.1, np.zeros(2), s[1:3] + 0.1, 0)  # the same episode number, but a jump
    data = to_minari(record, "steerkit/gap-v0", Task())
    assert [len(e.rewards) for e in data.iterate_episodes()] == [5, 2]
    record.append(s[0], 0.123, s[1], 1)
    with pytest.raises(ValueError, match=r"action .0.123. rad is none of the task's"):
        to_minari(record, "steerkit/other-v0", Task())


def test_an_episode_ends_for_one_reason() -> None:
    """Failed: terminated and not truncated; handed over or cut: truncated and not terminated."""
    record, task = Transitions(), Task()
    s = np.zeros((6, 6))
    s[:, 0], s[:, 2] = [0.0, 0.1, 0.2, 0.3, 0.4, 0.7], 5.0
    record.extend(s[:-1], np.zeros(5), s[1:], 0)  # the last one beyond 0.5 m
    record.extend(s[:3], np.zeros(3), s[1:4], 1)
    record.extend(s[:3], np.full(3, 0.123), s[1:4], 1, False)  # recovery's, which are none of the learner's
    data = to_minari(record, "steerkit/ends-v0", task)
    ends = [(e.terminations.tolist(), e.truncations.tolist(), e.rewards) for e in data.iterate_episodes()]
    assert [e[:2] for e in ends] == [([False] * 4 + [True], [False] * 5), ([False] * 3, [False, False, True])]
    assert ends[0][2][-1] == -task.failure
    assert all((rewards <= 0.0).all() for *_, rewards in ends)
