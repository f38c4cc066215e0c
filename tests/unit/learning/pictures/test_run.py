"""The diagnostics show what the run and the policy really are: pictures are read back and compared."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning import rundir
from steerkit.learning.experiment import Experiment
from steerkit.learning.learn import learn
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.pictures.policy import course_angle, policy_map, q_slices, q_values, states
from steerkit.learning.pictures.run import Record, compare, draw_all, failure_map, learning_curve, replay
from steerkit.learning.settings import DEFAULT
from steerkit.scenario.world import World
from steerkit.units import degrees_of, radians_of

FAST = replace(DEFAULT, fit=FitSetting(epochs=20, mirror=True, n_step=3, nets=2))


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    where = tmp_path_factory.mktemp("runs") / "short"
    learn(Experiment(setting=FAST, minutes=0.8, seed=3), where)
    return where


@pytest.fixture(scope="module")
def record(place: Path) -> Record:
    return Record.read(place)


def course_of(figure: Any) -> Any:
    """The map in a figure."""
    return next(axis for axis in figure.axes if axis.get_xlabel() == "x [m]")


def test_a_record_is_what_the_run_was(record: Record, place: Path) -> None:
    run = rundir.load(place)
    assert record.name == "short: default on paper"
    assert list(record.episodes) == run.counts.episodes
    assert len(record.transitions) == len(run.transitions)
    assert len(record.failed_at) == run.counts.failures > 3
    e = np.abs(record.log["path.e"])
    assert (e[record.failed_at] > 0.5).all()  # the sample in which the wheel was taken
    assert (e[record.failed_at - 1] <= 0.5).all()
    with pytest.raises(ValueError, match="is no run directory"):
        Record.read(place.parent)


def test_rms_is_of_the_learner_over_the_window(record: Record) -> None:
    rms, e, learns = record.rms(1.0), record.log["path.e"], record.learning
    for k in np.flatnonzero(learns)[::37]:
        window = slice(max(0, k - 19), k + 1)
        assert rms[k] == pytest.approx(math.sqrt(np.mean(e[window][learns[window]] ** 2)))
    assert np.isnan(rms[~learns]).all()


# ---- what the net says ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("combine", ["mean", "max", "disagreement"])
def test_values_lead_to_the_actions_that_the_policy_takes(record: Record, combine: Any) -> None:
    policy = replace(record.policy, combine=combine)
    s = record.transitions.s[:200]
    members = q_values(policy, s)
    q = {
        "mean": members.mean(axis=0),
        "max": members.max(axis=0),
        "disagreement": members.mean(axis=0) + members.std(axis=0),
    }[combine]
    y = policy.output(0.0, (), policy.D(*s.T))
    np.testing.assert_allclose(q.min(axis=0), y.q, atol=1e-6)
    clear = np.partition(q, 1, axis=0)[1] - q.min(axis=0) > 1e-5
    assert clear.sum() > 100
    np.testing.assert_array_equal(np.sort(policy.actions)[q.argmin(axis=0)][clear], y.action[clear])


@pytest.mark.parametrize("reference", ["front", "cg"])
def test_states_on_a_steady_bend_are_where_a_car_really_is(reference: str) -> None:
    """A slow car in a steady bend: r = v tan(delta)/L, every point turns about the same centre."""
    world = World(reference=reference)
    car, delta, v = world.vehicle, 0.1, 2.0
    b = car.l_r + world.ahead
    r = v * math.tan(delta) / car.wheelbase
    course = course_angle(world, delta * car.steer_ratio)
    assert course == pytest.approx(math.atan2(b * r, v))
    if reference == "front":
        assert course == pytest.approx(delta)
    names = NfqPolicy().description.names
    steady = dict(zip(names, states(world, names, 1, v=v, doe=delta * car.steer_ratio)[0]))
    assert steady["psi_e"] == pytest.approx(-course)
    assert (steady["e"], steady["e_dot"], steady["r_e"], steady["v"]) == (0.0, 0.0, 0.0, v)
    psi_e = 0.05 - course  # turned out of it: the point's speed across the path, component by component
    across = v * math.sin(psi_e) + b * r * math.cos(psi_e)
    turned = dict(zip(names, states(world, names, 1, v=v, doe=delta * car.steer_ratio, psi=0.05)[0]))
    assert turned["e_dot"] == pytest.approx(across)


def test_recorded_states_keep_to_the_rule_that_the_pictures_use(record: Record) -> None:
    """e_dot = v/cos(course) sin(psi_e + course), with the angle really steered: in the log, wheel moving slowly."""
    log, world = record.log, record.experiment.world
    course = course_angle(world, log["car.delta_sw"])
    e_dot = np.gradient(log["path.e"], log.t)
    rule = log["car.v"] / np.cos(course) * np.sin(log["path.psi_e"] + course)
    slow = np.abs(np.gradient(log["car.delta_sw"], log.t)) < radians_of(40.0)
    assert slow.sum() > 50
    assert np.sqrt(np.mean((e_dot - rule)[slow] ** 2)) < 0.3 * np.sqrt(np.mean(e_dot[slow] ** 2))


def test_slices_hold_the_policys_values(record: Record) -> None:
    policy, world = record.policy, record.experiment.world
    figure = q_slices(policy, world, v=5.0)
    assert [axis.get_xlabel().split(" [")[0] for axis in figure.axes] == [
        "e",
        "e_dot",
        "v",
        "psi_e",
        "r_e",
        "steering wheel",
    ]
    line = next(line for line in figure.axes[0].get_lines() if line.get_label() == "greedy")
    for e, q in zip(line.get_xdata()[::40], line.get_ydata()[::40]):
        u = policy.D(e=float(e), e_dot=0.0, v=5.0, psi_e=0.0, r_e=0.0, doe=0.0)
        assert policy.output(0.0, (), u).q == pytest.approx(q, abs=1e-6)
    assert len(figure.axes[0].get_lines()) == len(policy.actions) + 1


def test_the_map_shows_the_action_that_the_policy_takes(record: Record) -> None:
    policy, world = record.policy, record.experiment.world
    figure = policy_map(policy, world, visited=record.transitions, v=5.0, doe_deg=(0.0, 120.0))
    above = [axis for axis in figure.axes if axis.get_title(loc="left")]
    assert len(above) == 2
    legend = {handle.get_label(): handle.get_color() for handle in above[0].get_lines() if handle.get_label()[0] != "_"}
    shade_of = {tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)): name for name, c in legend.items()}
    assert len(shade_of) == len(policy.actions)
    checked = 0
    for axis, doe in zip(above, (0.0, radians_of(120.0))):
        pixels = np.asarray(axis.get_images()[0].get_array())
        for i, j in np.random.default_rng(0).integers(0, 161, (40, 2)):
            e, psi = np.linspace(-0.5, 0.5, 161)[j], np.linspace(-1.0, 1.0, 161)[i] * radians_of(10.0)
            s = states(world, policy.description.names, 1, v=5.0, doe=doe, e=e, psi=psi)
            q = np.sort(q_values(policy, s).mean(axis=0)[:, 0])
            if q[1] - q[0] > 1e-5:
                action = float(policy.output(0.0, (), policy.D(*s.T)).action[0])
                shown = shade_of[tuple(pixels[i, j].tolist())]
                assert shown == (f"{degrees_of(action):+.0f}°" if action else "hold, 0°")
                checked += 1
    assert checked > 40


def test_a_policy_without_nets_has_nothing_to_show() -> None:
    with pytest.raises(ValueError, match="the policy has no nets"):
        q_slices(NfqPolicy(), World())


# ---- how it came about ------------------------------------------------------------------------------------------


def test_the_learning_curve_counts_every_episode_and_failure(record: Record) -> None:
    held, error, count = learning_curve(record).axes
    crosses = [line for line in held.get_lines() if line.get_marker() == "x" and len(line.get_xdata())]
    assert [line.get_xdata()[0] for line in crosses] == [e.ended for e in record.episodes if e.failed]
    assert [line.get_ydata()[0] for line in crosses] == [e.ended - e.began for e in record.episodes if e.failed]  # type: ignore[operator]
    np.testing.assert_array_equal(error.get_lines()[0].get_ydata(), record.rms())
    assert max(count.get_lines()[0].get_ydata()) == len(record.failed_at)
    assert count.get_ylim()[1] > len(record.failed_at)


def test_failures_stand_where_they_happened(record: Record) -> None:
    figure = failure_map(record)
    assert f"{len(record.failed_at)} failures" in figure.get_suptitle()
    dots = next(c for c in course_of(figure).collections if len(c.get_offsets()) == len(record.failed_at))
    xy = np.stack([record.log["car.x"], record.log["car.y"]], axis=1)[record.failed_at]
    np.testing.assert_array_equal(dots.get_offsets(), xy)
    np.testing.assert_array_equal(dots.get_array(), [e.ended for e in record.episodes if e.failed])


def test_a_replay_shows_its_episode_and_a_little_around(record: Record) -> None:
    number = next(k for k, e in enumerate(record.episodes, start=1) if e.failed and e.began > 5.0)
    episode = record.episodes[number - 1]
    assert episode.ended is not None
    figure = replay(record, number, margin=1.0)
    assert f"episode {number}, failed after {episode.ended - episode.began:.1f} s" in figure.get_suptitle()
    e = figure.axes[0]
    dots = max(len(c.get_offsets()) for c in course_of(figure).collections)
    assert dots == episode.samples + 1  # and the one it failed in
    line = e.get_lines()[0]
    assert line.get_xdata()[0] == pytest.approx(-1.0, abs=0.051)
    at_failure = np.argmin(np.abs(line.get_xdata() - (episode.ended - episode.began)))
    assert abs(line.get_ydata()[at_failure]) > 0.5
    last = len(record.episodes)
    for bad in (0, last + 1):
        with pytest.raises(ValueError, match=f"episode {bad} of short.*, expected 1 to {last}"):
            replay(record, bad)
    replay(record, last)


def test_runs_are_compared_to_the_longest(record: Record) -> None:
    half = replace(record, name="half", episodes=record.episodes[:2])
    figure = compare([half, record])
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "half, seed 3",
        "short: default on paper, seed 3",
    ]
    assert figure.axes[2].get_ylim()[1] > len(record.failed_at)
    with pytest.raises(ValueError, match="no runs"):
        compare([])


def test_all_pictures_of_a_run_are_drawn(place: Path, tmp_path: Path) -> None:
    files = draw_all(place, tmp_path / "out", against=[place])
    names = [file.stem for file in files]
    assert names[:4] == ["q-slices", "policy-map", "learning-curve", "failures"]
    assert names[-1] == "comparison"
    assert any(name.startswith("episode-") for name in names)
    assert all(file.read_bytes()[:4] == b"\x89PNG" for file in files)


def test_a_run_that_has_just_begun_can_be_drawn_too(tmp_path: Path) -> None:
    learn(Experiment(setting=FAST, minutes=0.005), tmp_path / "new")
    assert [file.stem for file in draw_all(tmp_path / "new")][:4] == [
        "q-slices",
        "policy-map",
        "learning-curve",
        "failures",
    ]
