"""Model predictive steering and controllers of other kinds on the in-process car: they drive, and it replays."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from steerkit.car import loop as loops
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.loop import Steers
from steerkit.car.protocol import Remark
from steerkit.car.state_machine import Mode
from steerkit.controllers.mpc.block import SOLVED
from tests.support.car_world import CONFIG, World


def engaged(name: str, recorder: recordings.Recording | None = None) -> World:
    """On its way to a bend; solutions take as long as they take."""
    block: Any = loops.controller_named(name, CONFIG).block
    if hasattr(type(block), "budget"):
        block = replace(block, clock=None, budget=None)
    world = World(s=120.0, v=(5.0, 6.0), controller=block, recorder=recorder)
    world.note(Remark(Steers(name="mpc").text()))
    return world.bring_to(Mode.ENGAGED)


def test_it_drives_bends_through_the_gate_and_replays_bit_for_bit(tmp_path: Path) -> None:
    recorder = recordings.Recording(tmp_path / "t.mcap", {f"file:{name}": text for name, text in CONFIG.texts.items()})
    world = engaged("mpc", recorder)
    statuses, worst = set(), 0.0
    while world.t < 5.0 and world.mode is Mode.ENGAGED:
        worst = max(worst, world.worst_e(0.05))
        statuses.add(world.run.sample["controller.status"])
    recorder.close()
    assert world.mode is Mode.ENGAGED
    assert statuses == {SOLVED}
    assert worst < 0.05
    assert max(abs(s.delta_sw) for s in world.sent) > 0.5
    world.check_bus()
    (drive,) = [d for d in replays.drives(recordings.read(tmp_path / "t.mcap")) if d.requests]
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests) > 95


@pytest.mark.parametrize("name", ["stanley-delay", "pure-pursuit", "lqr-adaptive", "nonlinear-mpc"])
def test_a_controller_of_each_kind_drives_a_bend_on_the_car(name: str) -> None:
    world = engaged(name)
    worst = world.worst_e(5.5 - world.t)
    assert world.mode is Mode.ENGAGED
    assert worst < {"pure-pursuit": 0.5}.get(name, 0.05)  # at the front axle, which is not its place
    world.check_bus()
