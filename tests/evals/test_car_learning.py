"""Learning on the in-process car: caught in time behind the gate, and replayed bit for bit, nets and all."""

import os
import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit._support import files
from steerkit.car import learner as on_car
from steerkit.car import loop as loops
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.state_machine import Mode, Order
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram import realtime
from steerkit.learning import rundir
from steerkit.learning.learner_state import Before, Recovery
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import Setting, changed, setting
from steerkit.learning.trainer import Job, Result, SimulatedTrainer
from tests.support.car_world import CONFIG, World

TINY = replace(
    setting("model-free"), name="tiny", fit=FitSetting(nets=1, epochs=20, mirror=True, hints=0), retrain_every_m=5.0
)
"""Learns nothing worth having, but fast: nets come and go while it drives."""


def untrained(how: Setting, speed: float) -> World:
    nets = nfq.fresh_nets(how.fit, how.description(), seed=0)
    policy = NfqPolicy(nets=nets, actions=how.actions, description=how.description())
    return World(s=20.0, v=(speed, speed), controller=policy, doe=how.element()).bring_to(Mode.ENGAGED)


@pytest.mark.parametrize(("name", "speed"), [("default", 2.0), ("default", 7.0), ("bang-bang", 7.0)])
def test_whatever_an_untrained_net_does_it_is_caught_well_before_the_hard_limit(name: str, speed: float) -> None:
    world = untrained(setting(name), speed)
    worst = world.worst_e(3.0)
    assert not world.follow.trusted  # it did fail
    assert world.mode is Mode.ENGAGED
    assert worst < 1.6  # the hard limit is 2 m
    world.check_bus()


def test_the_loop_is_told_what_the_gate_let_through() -> None:
    world = untrained(setting("bang-bang"), 6.0)
    for _ in range(6):
        world.go_on_for(0.05)
        sample = world.run.sample
        assert sample["car.engaged"] == 1.0
        assert sample["doe.state"] == sample["car.applied"] == world.last.command  # type: ignore[union-attr]
        assert abs(sample["doe.delta_sw"]) > 9.0  # the wish: full lock
        assert abs(sample["car.applied"]) < 4.0  # what became of it so far
    world.order(Order.DISENGAGE, then=0.1)
    assert world.run.sample["car.applied"] == world.run.sample["car.delta_sw"]
    assert world.config.gate.delta_sw_max > 9.0


class Beside(SimulatedTrainer):
    """A trainer whose time is the world's."""

    def __init__(self, world: World, learned: Any):
        super().__init__(seconds=0.4, learned=learned)
        self.world, self.faults = world, ()

    def submit(self, job: Job, t: float) -> None:
        super().submit(job, self.world.t)

    def poll(self, t: float) -> Result | None:
        return super().poll(self.world.t)

    def idle(self, t: float) -> bool:
        return super().idle(self.world.t)

    def close(self) -> None: ...


def learner_of(world: World, place: Path, how: Setting = TINY, **options: Any) -> on_car.CarLearner:
    link: Any = world
    return on_car.CarLearner(how, place, world.config, link, **options)


def learned(
    folder: Path, monkeypatch: pytest.MonkeyPatch, seconds: float, how: Setting = TINY, **options: Any
) -> on_car.CarLearner:
    """A learning run, recorded in `folder`/drive.mcap."""
    metadata = {f"file:{name}": text for name, text in CONFIG.texts.items()}
    recorder = recordings.Recording(folder / "drive.mcap", metadata)
    world = World(s=20.0, recorder=recorder)
    monkeypatch.setattr(on_car, "Trainer", lambda learned: Beside(world, learned))
    with learner_of(world, folder / "run", how, **options) as learner:
        learner.remark()  # as `run` does
        world.run = realtime.Run(learner._idle, learner._idle.init(), realtime.Timing(period=0.05))
        monkeypatch.setattr(world, "stepped", learner.step)
        world.bring_to(Mode.ENGAGED)
        world.until(world.t + seconds)
        world.order(Order.DISENGAGE, then=0.3)
        world.order(Order.ENGAGE, then=1.0)
    recorder.close()
    return learner


def test_a_learning_run_replays_bit_for_bit_with_the_nets_taken_over_on_the_way(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    learner = learned(tmp_path, monkeypatch, 5.0)
    nets = sorted(f.name for f in (tmp_path / "run" / "nets").iterdir())
    assert learner.learner_state.counts.failures >= 1
    assert len(nets) >= 3  # the untrained one, and those taken over
    recorded = recordings.read(tmp_path / "drive.mcap")
    drives = [d for d in replays.drives(recorded) if d.remarks]
    drive = drives[-1]
    assert {Path(s.name).name for _, s in drive.remarks} == set(nets)
    assert {s.trusted for _, s in drive.remarks} == {True, False}
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests) > 120
    first = drive.remarks[0][1]  # with the first net all along it comes out differently: the replay depends on the nets
    same = [(n, replace(s, name=first.name, sha256=first.sha256)) for n, s in drive.remarks]
    assert replays.replayed_requests(replace(drive, remarks=same), CONFIG) < len(drive.requests)
    # the directory has moved
    (tmp_path / "run").rename(tmp_path / "moved")
    with pytest.raises(ValueError, match=r"net-0000.npz: the net that drove is gone; .* --run"):
        replays.replayed_requests(drive, CONFIG)
    moved = str(tmp_path / "moved")
    assert replays.replayed_requests(drive, CONFIG, run=moved) == len(drive.requests)
    # and somebody has changed a net
    (tmp_path / "moved" / "nets" / nets[1]).write_bytes((tmp_path / "moved" / "nets" / nets[0]).read_bytes())
    with pytest.raises(ValueError, match="is not the net that drove: its SHA-256 differs"):
        replays.replayed_requests(drive, CONFIG, run=moved)


def test_a_run_is_continued_with_its_own_setting_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = learned(tmp_path, monkeypatch, 3.0)
    (tmp_path / "drive.mcap").unlink()
    again = learned(tmp_path, monkeypatch, 0.5)
    assert again.learner_state.counts.updates >= first.learner_state.counts.updates > 0
    assert len(again.learner_state.transitions) > len(first.learner_state.transitions)
    assert on_car.setting_of(tmp_path / "run") == TINY
    assert loops.element_of(tmp_path / "run") == "integrator"
    world = World()
    with pytest.raises(ValueError, match=r"learned with the setting 'tiny', which differs from 'default'; continue it"):
        learner_of(world, tmp_path / "run", setting("default"))
    with pytest.raises(ValueError, match="holds no run of a car"):
        learner_of(world, tmp_path)
    assert not (tmp_path / ".lock").exists()  # nothing is left in a folder of something else
    named = loops.controller_named(str(tmp_path / "run"), CONFIG)
    assert named.steers.doe == "integrator"
    assert Path(named.steers.name).name == again.net_file.name


def test_a_run_that_is_continued_trains_its_newest_nets_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(s=20.0)
    monkeypatch.setattr(on_car, "Trainer", lambda learned: Beside(world, learned))
    with learner_of(world, tmp_path / "run") as first:
        assert first.trainer.learned.nets == (), "an untrained net is none to go on from"  # type: ignore[attr-defined]
    newest = replace(first.learner_state.policy, nets=nfq.fresh_nets(TINY.fit, TINY.description(), seed=1))
    newest.save(rundir.net_file(tmp_path / "run", 1))
    with learner_of(world, tmp_path / "run") as again:
        np.testing.assert_equal(again.trainer.learned.nets, newest.nets)  # type: ignore[attr-defined]


def test_one_process_at_a_time_learns_on_a_car_in_a_directory(tmp_path: Path) -> None:
    world = World(s=20.0)
    with learner_of(world, tmp_path / "run") as learner:
        before = {file: file.read_bytes() for file in (tmp_path / "run").rglob("*") if file.is_file()}
        with pytest.raises(ValueError, match=rf"run is being learned by process {os.getpid()} \(.*\) since .*; wait"):
            learner_of(world, tmp_path / "run")
        assert {file: file.read_bytes() for file in before} == before
        learner.store.append([0.0] * len(learner.learner_state.names), 0.0, [0.0] * len(learner.learner_state.names), 1)
    with pytest.raises(ValueError, match="differs from 'default'"):
        learner_of(world, tmp_path / "run", setting("default"))
    with learner_of(world, tmp_path / "run") as again:  # a refused one holds nothing
        assert len(again.learner_state.transitions) == 1


def test_the_output_element_ends_at_the_stops_of_the_cars_wheel(tmp_path: Path) -> None:
    world = World(s=20.0)
    world.config = replace(world.config, vehicle=replace(world.config.vehicle, delta_sw_max=5.0))
    with learner_of(world, tmp_path / "run") as learner:
        assert learner.learner_state.element.limit == learner._idle.blocks["doe"].element.limit == 5.0  # type: ignore[attr-defined]


def test_what_is_for_simulations_stays_there(tmp_path: Path) -> None:
    world = World()
    with pytest.raises(ValueError, match=r"on a car: .*expected"):
        learner_of(world, tmp_path / "run", changed(TINY, ["after_failure=reset"]))
    assert not (tmp_path / "run").exists()


# ---- who may steer ------------------------------------------------------------------------------------------------


def test_a_net_that_failed_does_not_steer_until_a_newer_one_has_taken_over_and_no_sample_waits_for_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[tuple[bool, bool, int, float]] = []
    step = on_car.CarLearner.step

    def watched(learner: on_car.CarLearner, live: Any) -> None:
        learning = live.sample["supervisor.learning"] > 0.5
        step(learner, live)
        learner_state = learner.learner_state
        assert (live.loop is learner.follow.driving) is (learner_state.trusted and learner.follow.engaged)
        assert (learner_state.counts.recovery is not None) is (learner.follow.engaged and not learning)
        steps.append((learning, learner_state.trusted, learner_state.net, learner_state.counts.driven))

    here = threading.current_thread()  # the recording has a thread of its own, which may wait

    def fsync(handle: int) -> None:
        assert not steps or threading.current_thread() is not here, "a control sample waits for the disk"
        starting(handle)

    monkeypatch.setattr(on_car.CarLearner, "step", watched)
    starting = files.os.fsync
    monkeypatch.setattr(files.os, "fsync", fsync)
    learner = learned(tmp_path, monkeypatch, 5.0)
    learner_state = learner.learner_state
    assert learner_state.counts.failures == sum(episode.failed for episode in learner_state.counts.episodes) >= 1
    for before, now, after in zip(steps, steps[1:], steps[2:]):
        if not now[1]:
            assert not after[0]  # not trusted: it has not the wheel in the next sample
        if before[1] is False and now[1] is True:
            assert now[2] > before[2]  # trusted again: by a newer net
    assert {trusted for _, trusted, _, _ in steps} == {True, False}
    assert steps[-1][2] >= 2
    # transitions: each of an episode's samples but its first one completes one, and they follow each other
    record = learner_state.transitions
    assert len(record) == len(learner.store.transitions())
    same = record.episode[1:] == record.episode[:-1]
    np.testing.assert_array_equal(record.s[1:][same], record.s_next[:-1][same])
    assert sum(learning for learning, *_ in steps) - len(record) <= len(learner_state.counts.episodes)


def test_the_human_s_taking_the_wheel_is_no_failure_and_ends_a_recovery(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    by_hand: list[Recovery | None] = []
    step = on_car.CarLearner.step

    def watched(learner: on_car.CarLearner, live: Any) -> None:
        counts = learner.learner_state.counts
        counts.recovery = counts.recovery or Recovery(began=0.0)
        step(learner, live)
        if not learner.follow.engaged:
            by_hand.append(counts.recovery)

    monkeypatch.setattr(on_car.CarLearner, "step", watched)
    learner = learned(tmp_path, monkeypatch, 0.15)  # too short for it to fail
    assert by_hand == [None] * len(by_hand) != []
    first = learner.learner_state.counts.episodes[0]
    assert first.ended is not None
    assert not first.failed
    record = learner.learner_state.transitions
    assert len(set(record.episode)) == len(learner.learner_state.counts.episodes) >= 1


def test_a_late_step_is_no_transition(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def late(loop: Any, duration: float, *, timer: Any, watch: Any, on_miss: Any) -> None:
        on_miss(realtime.Run(loop, loop.init(), realtime.Timing(period=0.05, misses=3)))

    monkeypatch.setattr(on_car, "run", late)
    world = World()
    with learner_of(world, tmp_path / "run") as learner:
        learner.learner_state.before = Before(0, (0.0,) * 6, 0.0, 1, True)
        learner.run(1.0)
        assert learner.learner_state.before is None
    assert world.misses == 3


def test_a_policy_that_breaks_has_failed_and_a_newer_one_takes_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once it has learned something, the net at the wheel raises an error, for ever."""
    seen: list[tuple[int, bool, bool, bool]] = []
    broken: list[Any] = []
    output, step = NfqPolicy.output, on_car.CarLearner.step

    def breaks(policy: NfqPolicy, t: Any, x: Any, u: Any) -> Any:
        if not broken and len(seen) > 10 and seen[-1][1]:
            broken.append(policy.nets[0][0])  # type: ignore[index]
        if broken and policy.nets and policy.nets[0][0] is broken[0]:
            raise ZeroDivisionError("no net")
        return output(policy, t, x, u)

    def watched(learner: on_car.CarLearner, live: Any) -> None:
        learning, fault = (live.sample[f"supervisor.{name}"] > 0.5 for name in ("learning", "fault"))
        step(learner, live)
        seen.append((learner.learner_state.net, learning, fault, learner.learner_state.trusted))

    monkeypatch.setattr(NfqPolicy, "output", breaks)
    monkeypatch.setattr(on_car.CarLearner, "step", watched)
    learner = learned(tmp_path, monkeypatch, 4.0)
    at = next(i for i, (_, _, fault, _) in enumerate(seen) if fault)
    net = seen[at][0]
    assert seen[at - 1][1], "it had the wheel"
    assert (seen[at][1], seen[at][3]) == (False, False), "lost it in that very sample, and is not trusted any more"
    assert any(episode.failed and episode.net == net for episode in learner.learner_state.counts.episodes)
    assert any(newer > net and learning and not fault for newer, learning, fault, _ in seen[at:])
