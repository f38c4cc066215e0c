"""Recorded transitions as a Minari data set, for offline learners of other libraries. Needs minari (extra `export`)."""

import copy
import dataclasses
import warnings
from itertools import pairwise
from typing import Any

import gymnasium
import numpy as np

from steerkit._support.errors import optional, require
from steerkit.gym.task import Task
from steerkit.learning.data.transitions import Transitions


def to_minari(transitions: Transitions, dataset_id: str, task: Task, *, description: str = "") -> Any:
    """Write the learner's own transitions to a new local Minari data set (Arrow files below MINARI_DATASETS_PATH).

    Observations, actions and rewards are those of the environment of `task`, which the data set can recover when the
    task's options are plain data (names, numbers, dictionaries). An episode is a stretch of consecutive samples: it
    terminates where the task's cost says so, else it is truncated (a hand-over, or the end of the record). float32 as
    in the environment: the store and Parquet keep every bit, this does not.

    Raises ValueError for other columns or actions than the task's, or a data set that exists already.
    """
    where, names, minari = "to_minari", transitions.names, optional("minari", "to_minari", "export")
    transitions = transitions.part(transitions.own)
    require(len(transitions) > 0, where, "no transitions of the learner's own, expected at least one")
    fault = f"columns {names}, but the task has {task.description.names}"
    if "kappa" in names:
        fault += "; a run of a setting that looks for dead time takes actions between those of its set, too, and no "
        fault += "environment does: learn with --setting model-free, or --with fit.dead_time=0 --with continuous=false"
    require(names == task.description.names, where, fault)
    require(dataset_id not in minari.list_local_datasets(), where, f"data set '{dataset_id}' exists; give another name")
    s, a, s_next, episode = transitions.s, transitions.a, transitions.s_next, transitions.episode
    cost, over = task.price(s, a, s_next)
    reward = np.where(over, -task.failure, -cost)
    actions = _actions(a, task)
    broken = (episode[1:] != episode[:-1]) | (s[1:] != s_next[:-1]).any(axis=1) | over[:-1]
    cuts = np.flatnonzero(np.concatenate(([True], broken, [True])))
    episodes = []
    for number, (first, end) in enumerate(pairwise(cuts)):
        terminated = over[first:end]
        truncated = np.zeros(end - first, dtype=bool)
        truncated[-1] = not terminated[-1]
        seen = task.observation(np.concatenate((s[first:end], s_next[end - 1 : end])))
        episodes.append(
            minari.data_collector.EpisodeBuffer(
                id=number,
                observations=seen,
                actions=actions[first:end],
                rewards=reward[first:end],
                terminations=terminated,
                truncations=truncated,
            )
        )
    with warnings.catch_warnings():  # it recommends an author, an address and a link, which only its user knows
        warnings.filterwarnings("ignore", category=UserWarning, module="minari")
        return minari.create_dataset_from_buffers(
            dataset_id,
            episodes,
            env=_spec(task),
            action_space=task.action_space,
            observation_space=task.observation_space,
            description=description or f"transitions of a car on {task.place!r}, recorded in simulation or on a car",
            algorithm_name="steerkit",
            data_format="arrow",
        )


def _actions(a: Any, task: Task) -> Any:
    """The environment's actions that mean the angles a (n,) [rad]."""
    if task.angles is None:
        scaled = a / task.scale
        require(np.abs(scaled).max() <= 1.0 + 1e-9, "to_minari", f"an action beyond largest = {task.scale} rad")
        return scaled.astype(np.float32)[:, None]
    distance = np.abs(a[:, None] - np.array(task.angles))
    other = a[distance.min(axis=1) > 1e-9]
    require(not len(other), "to_minari", f"action {other[:1]} rad is none of the task's: {task.angles}")
    return distance.argmin(axis=1)


def _spec(task: Task) -> Any:
    """The environment's specification, if its options are plain data; None if not."""
    spec = copy.deepcopy(gymnasium.spec("steerkit/TrackSteering-v0"))
    given = {f.name: (getattr(task, f.name), f.default) for f in dataclasses.fields(task)}
    spec.kwargs = {name: value for name, (value, default) in given.items() if value != default}
    try:
        spec.to_json()
    except (ValueError, TypeError, AttributeError):
        return None
    return None if "description" in spec.kwargs else spec
