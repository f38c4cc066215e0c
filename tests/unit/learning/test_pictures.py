"""The diagnostics show what the run and the policy really are; the film of a run says who drove, how far off, how often
it failed."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.learn import learn
from steerkit.learning.pictures import (
    course_angle,
    draw_all,
    failed_at,
    film_of,
    moments_of,
    policy_map,
    q_values,
    replay,
    states,
    with_heading,
)
from steerkit.scenario import Scenario
from tests.support.short_run import FAST

pytestmark = pytest.mark.usefixtures("without_layout")  # many pictures are drawn


def course_of(figure: Any) -> Any:
    """The map in a figure."""
    return next(axis for axis in figure.axes if axis.get_xlabel() == "x [m]")


def test_failures_are_where_the_log_has_them(run: LearningRun, log: Log, kept: Path) -> None:
    failed = failed_at(run.counts.episodes, log)
    assert len(failed) == run.counts.failures > 2
    e = np.abs(log["path.e"])
    assert (e[failed] > 0.5).all()  # the sample in which the wheel was taken
    assert (e[failed - 1] <= 0.5).all()
    with pytest.raises(ValueError, match="is no run directory"):
        draw_all(kept.parent)


def test_a_replay_shows_its_episode(run: LearningRun, log: Log) -> None:
    episodes = run.counts.episodes
    number = next(k for k, e in enumerate(episodes, start=1) if e.failed and e.began > 5.0)
    episode = episodes[number - 1]
    assert episode.ended is not None
    figure = replay(episodes, log, number, name="run")
    assert f"episode {number}, failed after {episode.ended - episode.began:.1f} s" in figure.get_suptitle()
    dots = max(len(c.get_offsets()) for c in course_of(figure).collections)
    assert dots == episode.samples + 1  # and the one it failed in
    assert abs(figure.axes[0].get_lines()[0].get_ydata()[-1]) > 0.5
    replay(episodes, log, len(episodes), name="run")


@pytest.mark.usefixtures("undrawn")
def test_all_pictures_of_a_run_are_drawn(kept: Path, tmp_path: Path) -> None:
    learn(Experiment(setting=FAST, minutes=0.005), tmp_path / "new")
    assert draw_all(tmp_path / "new")[0].stem == "policy-map"  # it has just begun
    files = draw_all(kept, tmp_path / "out")
    names = [file.stem for file in files]
    assert names[0] == "policy-map"
    assert all(name.startswith("episode-") for name in names[1:])
    assert 2 <= len(names) <= 3
    assert all(file.read_bytes()[:4] == b"\x89PNG" for file in files)


def test_an_episode_that_ended_otherwise_is_no_failure(run: LearningRun, log: Log) -> None:
    """At the end of an open course, say: the car was carried back."""
    first, *others = run.counts.episodes
    assert first.failed
    carried = failed_at([replace(first, failed=False), *others], log)
    np.testing.assert_array_equal(carried, failed_at(run.counts.episodes, log)[1:])


# ---- the film


def test_the_beginning_is_real_time_until_the_learner_has_the_wheel_again(run: LearningRun, log: Log) -> None:
    t, episodes = log.t, run.counts.episodes
    first = float(t[failed_at(episodes, log)[0]])
    again = float(t[(log["supervisor.learning"] > 0.5) & (t > first)][0])
    until = float(t[-1])
    found = moments_of(episodes, log, until, lasts=4.0 * (again + 4.0), fps=10.0)
    slow = found < again + 4.0
    assert found[slow][-1] == pytest.approx(again + 4.0, abs=0.11)
    np.testing.assert_allclose(np.diff(found[slow]), 0.1)
    if until > again + 4.0:
        steps = np.diff(found[~slow])
        np.testing.assert_allclose(steps, steps[0])
    assert found[-1] == until
    squeezed = moments_of(episodes, log, until, lasts=0.5 * again, fps=10.0)  # no more than half of the film
    assert (squeezed < again + 4.0).sum() == pytest.approx(0.5 * len(squeezed), abs=2)


@pytest.mark.parametrize(
    ("option", "says"),
    [({"lasts": 1.0}, "lasts = 1.0 s, expected 2 to 120"), ({"fps": 90.0}, "fps = 90.0, expected 1 to")],
)
def test_mistakes_teach(option: dict[str, float], says: str, kept: Path, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=says):
        film_of(kept, tmp_path / "run.gif", **option)


def test_the_car_points_where_it_drives(run: LearningRun, log: Log) -> None:
    log = with_heading(run.path, log)
    fast = np.flatnonzero(log["car.v"] > 3.0)[5:-5:40]
    course = np.arctan2(log["car.y"][fast + 1] - log["car.y"][fast], log["car.x"][fast + 1] - log["car.x"][fast])
    off = np.angle(np.exp(1j * (log["car.psi"][fast] - course)))
    assert np.abs(off).max() < 0.25  # sideslip


# ---- a policy


def test_values_lead_to_the_actions_that_the_policy_takes(run: LearningRun, kept: Path) -> None:
    policy = replace(rundir.final_policy(kept), continuous=False)
    s = run.transitions.s[:200]
    q = q_values(policy, s).mean(axis=0)
    y = policy.output(0.0, (), policy.D(*s.T))
    np.testing.assert_allclose(q.min(axis=0), y.q, atol=1e-6)
    clear = np.partition(q, 1, axis=0)[1] - q.min(axis=0) > 1e-5
    assert clear.sum() > 100
    np.testing.assert_array_equal(np.sort(policy.actions)[q.argmin(axis=0)][clear], y.action[clear])


@pytest.mark.parametrize("reference", ["front", "cg"])
def test_states_on_a_steady_bend_are_where_a_car_really_is(reference: str) -> None:
    """A slow car in a steady bend: r = v tan(delta)/L, every point turns about the same centre."""
    scenario = Scenario(reference=reference)
    car, delta, v = scenario.nominal, 0.1, 2.0
    b = car.l_r + scenario.ahead
    r = v * math.tan(delta) / car.wheelbase
    course = course_angle(scenario, delta * car.steer_ratio)
    assert course == pytest.approx(math.atan2(b * r, v))
    if reference == "front":
        assert course == pytest.approx(delta)
    names = NfqPolicy().description.names
    steady = dict(zip(names, states(scenario, names, 1, v=v, doe=delta * car.steer_ratio)[0]))
    assert steady["psi_e"] == pytest.approx(-course)
    assert (steady["e"], steady["e_dot"], steady["r_e"], steady["v"]) == (0.0, 0.0, 0.0, v)
    psi_e = 0.05 - course  # turned out of it: the point's speed across the path, component by component
    across = v * math.sin(psi_e) + b * r * math.cos(psi_e)
    turned = dict(zip(names, states(scenario, names, 1, v=v, doe=delta * car.steer_ratio, psi=0.05)[0]))
    assert turned["e_dot"] == pytest.approx(across)


def test_a_policy_without_nets_has_nothing_to_show() -> None:
    with pytest.raises(ValueError, match="the policy has no nets"):
        policy_map(NfqPolicy(), Scenario())
