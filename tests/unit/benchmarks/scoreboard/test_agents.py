"""Agents of others beside NFQ: who is tested when, what is imagined for them, and what the figures say."""

import argparse
import math
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from dataclasses import replace
from importlib.util import find_spec
from multiprocessing import get_context
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.scoreboard import agents
from benchmarks.scoreboard.agents import AGENTS, NFQ, Job, Outcome, Trials
from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.settings import DEFAULT, SETTINGS

JOB = Job("sac", 3, 0, 30.0, 60.0)


def test_a_draw_is_the_same_whenever_it_is_drawn_and_nfq_has_none() -> None:
    assert set(NFQ) <= SETTINGS.keys()
    for agent in AGENTS:
        draws = [agents.drawn(agent, draw) for draw in range(3)]
        assert draws == [agents.drawn(agent, draw) for draw in range(3)]
        assert all(not how for how in draws) if agent in NFQ else draws[0] != draws[1] != draws[2]
        assert all(("share" in how) == agent.endswith("+model") for how in draws)
    assert agents.drawn("sac", 1)["learning_rate"] != agents.drawn("tqc", 1)["learning_rate"]


def test_tests_are_often_at_first_and_the_last_is_at_the_end() -> None:
    *times, never = agents._times(155.0)
    assert times[:3] == [2.0, 4.0, 6.0]
    assert times[9:13] == [20.0, 25.0, 30.0, 35.0]
    assert times[-4:] == [110.0, 120.0, 150.0, 155.0]
    assert never == math.inf


def test_a_run_counts_from_its_first_good_policy_which_is_tested_again(monkeypatch: pytest.MonkeyPatch) -> None:
    seeds: list[int] = []

    def drive_each(place: Any, setting: Any, policies: list[str], *, seed: int) -> list[Any]:
        seeds.append(seed)
        good = policies == ["good"] and seed == 3 + agents.TEST
        summary = SimpleNamespace(rms_e=0.05, max_jerk=2.0)
        return [SimpleNamespace(good=good, rounds=1.0 if good else 0.3, summary=summary if good else None)]

    monkeypatch.setattr(agents, "drive_each", drive_each)
    tests = Trials(JOB)
    assert not tests.look(1.9, lambda: pytest.fail("not due"))
    assert not tests.look(2.0, lambda: None)
    assert not tests.look(4.05, lambda: "bad")
    assert (tests.next, tests.rounds, seeds) == (6.0, 0.3, [1003])
    assert math.isnan(tests.rms_e)
    assert tests.look(6.0, lambda: "good")
    assert seeds == [1003, 1003, 2003]
    outcome = tests.outcome(computing=1.5, driven=6.0, failures=2)
    assert (outcome.good, outcome.confirmed, outcome.rounds, outcome.rms_e) == (6.0, False, 1.0, 0.05)
    assert tests.look(8.0, lambda: pytest.fail("it has ended"))


def test_computing_time_is_that_of_the_calls_and_may_leave_out_the_first() -> None:
    def work(count: int) -> int:
        return sum(range(count))

    both, later = agents._Clock(work), agents._Clock(work, compiles=True)
    for clock in (both, later):
        assert clock(2_000_000) == work(2_000_000)
    assert later.spent == 0.0 < both.spent
    later(2_000_000)
    assert later.spent > 0.0


def row(good: float | None, computing: float = 1.0, **more: Any) -> dict[str, Any]:
    return {"good": good, "computing": computing, "driven": good or 300.0, "failures": 4, "confirmed": True} | more


def test_who_never_came_to_it_counts_as_never_and_the_winner_is_first(capsys: pytest.CaptureFixture[str]) -> None:
    rows = {
        "sac": [row(None), row(None), row(80.0)],
        "tqc": [row(60.0, 2.0), row(None, 2.0), row(100.0, 40.0)],
        "sac+model": [row(16.0), row(14.0), row(18.0)],
        "default": [row(4.0), row(5.0), row(6.0)],
    }
    figures = agents._judged(rows, argparse.Namespace())
    assert figures["good_seconds"] == {"sac": math.inf, "tqc": 100.0, "sac+model": 16.0, "default": 5.0}
    assert figures["good_seconds_interval"]["default"] == [4.0, 6.0]
    assert figures["good_share"]["tqc"] == pytest.approx(2.0 / 3.0)
    assert figures["computing_seconds"]["tqc"] == 40.0
    assert figures["good_within_computing"]["tqc"] == pytest.approx([0.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0])
    assert (figures["agents_x_model_free"], figures["agents_x_same_model"]) == (20.0, pytest.approx(3.2))
    lines = capsys.readouterr().out.splitlines()
    order = [line.split()[1] for line in lines if line.startswith("│")]
    assert order[:4] == ["default", "sac+model", "tqc", "sac"]
    alone = agents._judged({"sac": rows["sac"]}, argparse.Namespace())
    assert alone["agents_x_model_free"] is None


def test_the_best_draw_is_good_soonest_or_else_goes_furthest() -> None:
    rows = [row(None, rounds=0.2, rms_e=math.nan), row(None, rounds=0.9, rms_e=0.2), row(90.0, rounds=1.0, rms_e=0.1)]
    assert sorted(rows, key=agents._merit) == rows[::-1]


def test_a_good_run_counts_for_larger_budgets_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    begun = list[Job]()

    def one_run(job: Job) -> Outcome:
        begun.append(job)
        return Outcome(60.0 if job.seed else None, 1.0, 60.0, 4, True, 1.0, 0.05, 2.0, "")

    monkeypatch.setattr(agents, "one_run", one_run)
    options = argparse.Namespace(keep=tmp_path / "runs.jsonl", quick=True, processes=1, backend="loky", address=None)
    jobs = [Job("sac", seed, 0, 5.0, 30.0) for seed in (0, 1)]
    rows = agents._done(jobs, options)
    assert [rows[job]["good"] for job in jobs] == [None, 60.0]
    assert begun == jobs
    longer = [replace(job, minutes=30.0) for job in jobs]
    assert agents._done(longer, options)[longer[1]] == rows[jobs[1]]
    assert begun[2:] == longer[:1], "what was not GOOD is driven for longer"
    assert agents._done(jobs, options) == rows
    other = [replace(job, computing=20.0) for job in jobs] + [replace(jobs[1], draw=1)]
    agents._done(other, options)
    assert begun[3:] == other, "less computing might not have sufficed"


@pytest.fixture(scope="module")
def course() -> Any:
    """What an agent of others has recorded, here with NFQ at the wheel."""
    pytest.importorskip("gymnasium")
    from steerkit.gym.task import Task

    run = LearningRun(Experiment(setting=DEFAULT, scenario=agents.PLACE, minutes=0.2))
    while not run.done():
        run.drive()
    task = Task(course="paper", actions="continuous", failure=4.0)
    return SimpleNamespace(record=run.transitions, task=task)


class Still:
    """An agent that leaves the wheel alone."""

    def predict(self, seen: Any, deterministic: bool) -> tuple[Any, None]:
        assert len(seen) == agents.STARTS
        return np.zeros((len(seen), 1), dtype=np.float32), None


def test_what_is_imagined_is_what_the_learned_car_does(course: Any) -> None:
    imaginer = agents._Imaginer(course, 0.5, 0)
    imaginer.fresh(Still())
    seen, a, seen_next, done, reward = imaginer._parts[0]
    first = slice(agents.STARTS, None)  # the later samples have nothing but the model in them
    described, car = course.task.description, imaginer._known.model
    s, after = (rows[first] * described.half + described.mid for rows in (seen, seen_next))
    assert (a[first] == 0.0).all()
    assert np.std(a[: agents.STARTS]) > 0.3
    assert np.abs(after[:, 5] - s[:, 5]).max() < 1e-2, "a wheel that is left alone stays"
    faster = np.abs((seen_next - seen)[:, 2])  # the model knows of no change of speed, the record does
    assert faster[first].max() < 1e-6 < 1e-4 < faster[: agents.STARTS].max()
    inside = np.abs(seen[first]).max(axis=1) < 9.0
    # e' follows from the state alone, to what a wheel that moved before adds
    assert np.abs(after - car.step(s, a[first, 0] * 0.0, s[:, 5]))[inside, 0].max() < 0.02
    failed = np.abs(seen_next[:, 0] * described.half[0]) > 0.5
    assert (done[:, 0] == failed).mean() > 0.999
    assert (reward[done[:, 0] > 0.5] == -4.0).all()
    assert (reward[done[:, 0] < 0.5] > -0.1).all()
    assert len(seen) < agents.STARTS * DEFAULT.fit.horizon, "what has failed does not go on"


def test_the_newest_of_what_is_imagined_is_kept_and_the_car_is_learned_anew_when_the_record_has_grown(
    course: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(agents, "IMAGINED", 5000)
    imaginer = agents._Imaginer(course, 0.5, 0)
    imaginer.fresh(Still())
    known = imaginer._known
    for _ in range(3):
        imaginer.fresh(Still())
    assert imaginer._known is known
    assert imaginer.rows is not None
    assert 2500 < len(imaginer.rows[0]) <= 5000
    imaginer._fitted = len(course.record) // 2
    imaginer.fresh(Still())
    assert imaginer._known is not known


def test_a_share_of_the_samples_is_imagined() -> None:
    buffers = pytest.importorskip("stable_baselines3.common.buffers")
    from gymnasium import spaces

    ones = tuple(np.ones((7, columns), dtype=np.float32) for columns in (6, 1, 6, 1, 1))
    dream = SimpleNamespace(share=0.8, rows=None, drawn=lambda count: tuple(rows[[0] * count] for rows in ones))
    box, wheel = spaces.Box(-10.0, 10.0, (6,), np.float32), spaces.Box(-1.0, 1.0, (1,), np.float32)
    buffer = agents._buffer()(100, box, wheel, device="cpu", imaginer=dream)
    assert isinstance(buffer, buffers.ReplayBuffer)
    zero = np.zeros((1, 6), dtype=np.float32)
    for _ in range(20):
        buffer.add(zero, zero, np.zeros((1, 1)), np.zeros(1), np.zeros(1), [{}])
    assert buffer.sample(50).rewards.sum() == 0.0
    dream.rows = ones
    data = buffer.sample(50)
    imagined = data.rewards[:, 0] == 1.0
    assert imagined.sum() == 40
    assert imagined[:10].sum() > 3, "in any order"
    assert bool((data.observations[imagined] == 1.0).all() and (data.observations[~imagined] == 0.0).all())


def test_a_network_at_the_wheel_steers_as_its_policy_block() -> None:
    rng = np.random.default_rng(0)
    layers = tuple((0.2 * rng.normal(size=(n, m)), rng.normal(size=n)) for n, m in ((8, 6), (8, 8), (1, 8)))
    net, described = Network(layers=layers, activation="tanh", head="tanh"), DEFAULT.description()
    block = PolicyBlock(policy=net, largest=0.4, description=described)
    wheel = agents.AtTheWheel(network=net, largest=0.4, description=described)
    for scaled in (0.5, 1.0, 30.0):  # those of the last are cut off
        s = described.mid + scaled * described.half * rng.uniform(-1.0, 1.0, 6)
        seen = wheel.U(*map(float, s))
        asked = block.output(0.0, (), block.U(*map(float, s))).action
        assert wheel.output(0.0, (), seen)._asdict() == {
            "action": pytest.approx(asked, rel=1e-9),
            "q": 0.0,
            "ready": 1.0,
        }
    assert math.isnan(wheel.output(0.0, (), wheel.U(math.nan, *map(float, s[1:]))).action)


@pytest.fixture(scope="module")
def apart() -> Iterator[Executor]:
    """A process for what imports JAX: where JAX is imported, no program of a later test could be a fork."""
    if find_spec("sbx") is None:
        pytest.skip("sbx-rl is of the extra peers")
    with pytest.MonkeyPatch.context() as patch, ProcessPoolExecutor(1, mp_context=get_context("fork")) as process:
        patch.setenv("JAX_DISABLE_MOST_OPTIMIZATIONS", "1")  # they take longer than its few steps
        yield process


def _run(job: Job) -> tuple[str, int]:
    """What came of it, to the time that it took; how much has been compiled."""
    return repr(replace(agents.one_run(job), computing=0.0)), len(agents._COMPILED)


def test_what_was_compiled_for_one_run_changes_nothing_in_the_next(apart: Executor) -> None:
    job = Job("sac+model", 1, 0, 0.07, 60.0)  # it trains from the third second on
    alone, other, again = apart.map(_run, [job, replace(job, seed=2), job])
    assert other[1] == 3
    assert again == alone != other


@pytest.mark.parametrize("agent", ["crossq", "ppo"])
def test_the_net_that_is_test_driven_is_the_agents_own(agent: str, apart: Executor) -> None:
    """With normalisation, `tanh` outside and `relu` inside; without, the limit outside and `tanh` inside."""
    asked, answered = apart.submit(_asked, agent).result()
    assert np.abs(answered - asked).max() < 1e-5
    assert np.ptp(asked) > 0.1


def _asked(agent: str) -> tuple[Any, Any]:
    """What an agent whose nets were changed at random does, and what the network made of it does."""
    import jax

    model, _, _ = agents._made(Job(agent, 0, 0, 1.0, 60.0), agents.drawn(agent, 0))
    rng = np.random.default_rng(0)

    def changed(value: Any) -> Any:
        return value + rng.uniform(-0.3, 0.3, value.shape) if np.ndim(value) else value

    state = model.policy.actor_state
    parts = [name for name in ("params", "batch_stats") if hasattr(state, name)]
    model.policy.actor_state = state.replace(**{name: jax.tree.map(changed, getattr(state, name)) for name in parts})
    seen = rng.uniform(-2.0, 2.0, (50, 6)).astype(np.float32)
    return model.predict(seen, deterministic=True)[0][:, 0], agents.network(model)(seen)


def test_a_car_that_failed_goes_on_where_it_failed() -> None:
    gymnasium = pytest.importorskip("gymnasium")
    import steerkit.gym  # noqa: F401  registers the environments

    env = gymnasium.make("steerkit/TrackSteeringContinuous-v0", duration=1e8, disable_env_checker=True)
    course = agents._course(env, recorded=True)
    _, info = course.reset(seed=0)
    assert (info["s"], info["e"]) == (pytest.approx(0.0, abs=1e-6), pytest.approx(0.0, abs=1e-9))
    terminated = False
    while not terminated:
        *_, terminated, truncated, info = course.step(np.array([1.0], dtype=np.float32))
        assert not truncated
    steps, s = len(course.record), info["s"]
    _, info = course.reset()
    assert course.failures == 1
    assert info["s"] == pytest.approx(s, abs=1e-6)
    course.step(np.array([0.5], dtype=np.float32))
    record = course.record
    assert (record.episode[:steps] == 0).all()
    assert record.episode[steps] == 1
    assert record.a[steps] == pytest.approx(0.5 * course.task.scale)
    np.testing.assert_array_equal(record.s[1:steps], record.s_next[: steps - 1])
    assert record.s_next[0, 5] - record.s[0, 5] == pytest.approx(record.a[0], abs=1e-5)
