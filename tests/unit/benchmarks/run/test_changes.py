"""A car that changes while it is driven: what moves goes on moving, and when it is as good as the best again."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks.foreign_cars import HOME
from benchmarks.run.changes import CHANGES, SAFE, Job, best_of, carried, driven, exchange, judged, phases
from steerkit.diagram.simulation import simulate
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.metrics.signals import rms
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario import drive
from steerkit.task import DT


def job(change: str, minutes: float = 0.02) -> Job:
    return Job(car=HOME, change=change, seed=0, minutes=minutes, conditions="hard", told=("lqr",))


@pytest.mark.parametrize("change", CHANGES)
def test_every_change_is_a_scenario_and_the_loop_goes_on_in_it(change: str) -> None:
    before, *later = phases(job(change))
    assert before.believed_dead_time == pytest.approx(before.steering.delay + 0.05)
    run = LearningRun(Experiment(setting=SAFE, scenario=before, minutes=1.0))
    for _ in range(3):
        run.drive()
    for scenario in later:
        where = [run._value(f"car.{name}") for name in ("x", "y", "psi")]
        exchange(run, scenario)
        assert run.loop.blocks["safety"] is not None
        run.drive()
        moved = [run._value(f"car.{name}") for name in ("x", "y", "psi")]
        v = run._value("car.v")
        assert math.dist(where[:2], moved[:2]) == pytest.approx(v * DT, rel=0.2), "it does not jump"
        assert moved[2] == pytest.approx(where[2], abs=0.05)
        after = scenario.blocks(run.path)
        for name in ("car", "actuator", "sensors"):
            assert type(run.loop.blocks[name]) is type(after[name])
    assert run.t == pytest.approx((3 + len(later)) * DT)


def test_commands_on_their_way_take_the_new_delay() -> None:
    """Of commands 0, 1, 2 ... sent before, the wheel shows each in turn, after the gap that the new delay makes."""

    def angles(first: float, then: float) -> list[float]:
        old, new = (SteeringActuator(delay=delay, lag=0.0, rate_limit=200.0) for delay in (first, then))
        x: Any = old.init()
        seen = []
        for k in range(12):
            if k == 6:
                x = carried(old, new, x)
            block = old if k < 6 else new
            x = block.update(0.0, x, block.U(0.1 * (k + 1)), block.output(0.0, x, ()))
            seen.append(round(10.0 * x[0], 6))
        return seen

    assert angles(0.03, 0.03) == [0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9]
    assert angles(0.03, 0.05) == [0, 0, 0, 1, 2, 3, 4, 4, 4, 5, 6, 7]
    assert angles(0.03, 0.0) == [0, 0, 0, 1, 2, 3, 7, 8, 9, 10, 11, 12]
    assert angles(0.0, 0.02) == [1, 2, 3, 4, 5, 6, 6, 6, 7, 8, 9, 10]


def test_a_bias_walks_and_all_else_changes_at_once() -> None:
    before, *later = phases(job("gnss"))
    run, starts, failures = driven(before, later, job("gnss"))
    sensors: Any = run.loop.blocks["sensors"]
    assert starts == pytest.approx([1.2, 2.4])
    assert sensors.x_bias == pytest.approx(2.0 * 0.1 / 20.0), "a step at once, and one after a second"
    assert len(failures) == 1
    before, *later = phases(job("delay"))
    run, starts, failures = driven(before, later, job("delay"))
    actuator: Any = run.loop.blocks["actuator"]
    assert (actuator.delay, len(starts), len(failures)) == (0.1, 3, 2)


def test_the_best_drives_the_same_way_under_the_same_noise() -> None:
    """At each time it is where the learner is, and what the sensors add is the same number."""
    now = job("mass", 0.05)
    before, later = phases(now)
    run, starts, _ = driven(before, [later], now)
    loop = drive.drive_loop(later, drive.controller("lqr", later), seed=now.seed)
    log = simulate(loop, starts[-1])
    mine, its = run.x[run.loop.names.index("sensors")], log.state.x[loop.names.index("sensors")]
    assert its[:15] == mine[:15]  # errors, drifts and the generator
    assert log["path.s"][-1] == pytest.approx(run._value("path.s"), abs=0.1)


def test_the_best_is_the_one_with_the_least_error_after_the_change() -> None:
    now = replace(job("mass", 0.05), told=("pure-pursuit", "lqr"))
    _, later = phases(now)
    name, e = best_of(later, now, 3.0, 6.0)
    truth = later.with_(knowledge={"oracle": True})
    loops = {of: drive.drive_loop(truth, drive.controller(of, truth), seed=now.seed) for of in now.told}
    part = slice(round(3.0 / DT), round(6.0 / DT))
    errors = {of: simulate(loop, 6.0, every=round(DT / loop.dt))["path.e"][part] for of, loop in loops.items()}
    assert rms(errors["lqr"]) < rms(errors["pure-pursuit"])
    assert name == "lqr"
    assert e.tolist() == errors["lqr"].tolist()


def test_when_it_is_as_good_as_the_best() -> None:
    """At first it has three times as much, then a tenth more, in bends as on straights."""
    t = np.arange(0.0, 120.0, DT)
    best = np.where(t % 40.0 < 10.0, 0.04, 0.01)
    e = np.sqrt(best) * np.where(t < 30.0, 3.0, 1.1)
    recovered, x = judged(t, e**2, best)
    assert x == pytest.approx(1.1)
    assert 45.0 < recovered < 50.1, "a window with hardly any of the first 30 s in it"
    never, _ = judged(t, 2.0 * best, best)
    assert never == math.inf
    assert math.isnan(judged(t[t < 50.0], best[t < 50.0], best[t < 50.0])[1]), "too short for what comes after 60 s"
