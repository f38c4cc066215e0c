"""Controllers that adapt, on the car: what they are told outlasts whoever takes the wheel, is recorded, and replays."""

from pathlib import Path
from typing import Any

import pytest

from steerkit.car import loop as loops
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.loop import Steers, adapted_in
from steerkit.car.protocol import Adapted, Remark
from steerkit.car.state_machine import Mode, Order
from steerkit.scenario.catalogue import make_controller
from tests.evals.test_car_learning import learned
from tests.support.car_world import CONFIG, World

NAME = "stanley-adaptive"
DELAY = 0.25
"""Of the steering, and nobody is told [s]."""


def recorded_world(folder: Path, **how: Any) -> World:
    controller = make_controller(NAME, loops.design_model_of(CONFIG))
    recorder = recordings.Recording(folder / "drive.mcap", recordings.described(CONFIG))
    world = World(controller=controller, recorder=recorder, **how)
    world.note(Remark(Steers(name=NAME).text()))
    return world


def told(world: World) -> Adapted:
    adapted = adapted_in(world.run)
    assert adapted is not None
    return adapted


def test_what_it_found_outlasts_an_override_and_a_lost_pose_and_the_drive_replays_bit_for_bit(tmp_path: Path) -> None:
    world = recorded_world(tmp_path, delay=DELAY, s=20.0)
    prior = told(world)
    world.bring_to(Mode.READY)
    world.until(1.5)
    assert told(world) == prior, "the human drives"
    world.order(Order.ENGAGE)
    world.until(12.0)
    assert world.mode is Mode.ENGAGED, world.modes[-1]
    found = told(world)
    assert found.delay > prior.delay + 0.05, "it has found the delay"
    world.fault("override", length=0.1, then=0.5)  # the estimate is read every fifth sample
    assert world.mode is Mode.OVERRIDE
    kept = told(world)
    assert kept == pytest.approx(found, rel=0.02)
    world.until(world.t + 1.5)
    assert told(world) == kept, "the human steers, and teaches nothing of what commands do"
    places = world.last.places  # type: ignore[union-attr]
    world.fault("drop", "pose", length=2.0, then=3.0)
    assert world.last.places > places, "the pose was away"  # type: ignore[union-attr]
    assert told(world) == kept
    world.order(Order.ACKNOWLEDGE, then=0.5)
    world.order(Order.ENGAGE, then=3.0)
    assert world.mode is Mode.ENGAGED, world.modes[-1]
    world.check_bus()
    assert world.recorder is not None
    world.recorder.close()
    recording = recordings.read(tmp_path / "drive.mcap")
    (drive,) = replays.drives(recording)
    notes = recording.of("/adapted")
    assert len(notes) > 13, "one a second"
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests) > 300
    basis, angle = drive.requests[-1]
    drive.requests[-1] = basis, angle + 1e-15
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests) - 1


def test_what_the_recovery_controller_of_a_learner_is_told_is_recorded_too_and_replays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learned(tmp_path, monkeypatch, 3.0, recovery="adaptive")
    recorded = recordings.read(tmp_path / "drive.mcap")
    (drive,) = [d for d in replays.drives(recorded) if d.remarks]
    assert {s.recovery for _, s in drive.remarks} == {"adaptive"}
    assert len(recorded.of("/adapted")) >= 3
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests)
