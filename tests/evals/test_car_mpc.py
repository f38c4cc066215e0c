"""Model predictive steering on the in-process car: it drives, it replays, and a late solution is not waited for."""

import itertools
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.car import loop as loops
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.loop import Steers
from steerkit.car.protocol import Remark
from steerkit.car.state_machine import Mode
from steerkit.controllers.mpc.block import FALLBACK, LATE, PLAN, SOLVED
from tests.support.car_world import CONFIG, World


def engaged(block: Any, recorder: recordings.Recording | None = None) -> World:
    world = World(s=120.0, v=(5.0, 6.0), controller=block, recorder=recorder)
    world.note(Remark(Steers(name="mpc").text()))
    world.bring_to(Mode.ENGAGED)
    return world


def watched(world: World, seconds: float) -> dict[str, np.ndarray]:
    """e, and where the commands came from, at every sample."""
    rows = []
    end = world.t + seconds
    while world.t < end:
        world.until(world.t + 0.05)
        sample = world.run.sample
        rows.append((world.core.senses.e, sample["controller.status"], sample["controller.fault"]))
    return dict(zip(("e", "status", "fault"), np.array(rows).T))


def block_of(**changes: Any) -> Any:
    return replace(loops.controller_named("mpc", CONFIG).block, **changes)  # type: ignore[type-var]


def test_it_drives_bends_through_the_gate_and_replays_bit_for_bit(tmp_path: Path) -> None:
    recorder = recordings.Recording(tmp_path / "t.mcap", {f"file:{name}": text for name, text in CONFIG.texts.items()})
    world = engaged(block_of(clock=None, budget=None), recorder)
    seen = watched(world, 4.5)
    recorder.close()
    assert world.mode is Mode.ENGAGED
    assert (seen["status"] == SOLVED).all()
    assert abs(seen["e"]).max() < 0.05
    assert max(abs(s.delta_sw) for s in world.sent) > 0.5
    world.check_bus()
    (drive,) = [d for d in replays.drives(recordings.read(tmp_path / "t.mcap")) if d.requests]
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests) > 95


def test_a_late_solution_falls_back_to_the_plan_then_to_stanley_and_comes_back() -> None:
    taken, times = [0.001], itertools.accumulate(iter(lambda: taken[0], None))
    world = engaged(block_of(clock=lambda: next(times)))
    assert (watched(world, 0.5)["status"] == SOLVED).all()
    taken[0] = 2.0 * loops.BUDGET
    late = watched(world, 1.5)
    assert (late["fault"] == LATE).all()
    assert late["status"].tolist()[:5] == [PLAN] * 4 + [FALLBACK]
    assert (late["status"][4:] == FALLBACK).all()
    assert abs(late["e"]).max() < 0.1  # the fallback law drives as well
    taken[0] = 0.001
    assert (watched(world, 0.5)["status"] == SOLVED).all()
    assert world.mode is Mode.ENGAGED


@pytest.mark.parametrize("name", ["stanley-delay", "pure-pursuit", "lqr-adaptive", "nonlinear-mpc"])
def test_a_controller_of_each_kind_drives_a_bend_on_the_car(name: str) -> None:
    block: Any = loops.controller_named(name, CONFIG).block
    if hasattr(type(block), "budget"):
        block = replace(block, clock=None, budget=None)
    world = engaged(block)
    worst = world.worst_e(5.5 - world.t)
    assert world.mode is Mode.ENGAGED
    assert worst < {"pure-pursuit": 0.5}.get(name, 0.05)  # at the front axle, which is not its place
    world.check_bus()
