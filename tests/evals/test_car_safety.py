"""The safety filter before the gate: nobody leaves the path of the in-process car, and what it did replays."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from steerkit.car import loop as loops
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.client import RealCar
from steerkit.car.state_machine import Mode
from steerkit.controllers import fail_safe
from steerkit.controllers.fail_safe import LATE, RAISED
from steerkit.controllers.safety_filter import SafetyFilter
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block, In, Out, Wrapper
from steerkit.diagram.loop import Loop
from steerkit.learning import learner_state
from steerkit.learning.learner_state import LearnerState
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario.assembly import steering_loop
from steerkit.task import STOP
from tests.evals.test_car_learning import TINY, learned
from tests.support.car_world import CONFIG, World

SAFE = replace(TINY, name="safe", safe=True)


@dataclass(frozen=True, eq=False, kw_only=True)
class Away(Block):
    """Straight on until the car is engaged, then away from the path with full lock."""

    e = In("m")
    psi_e = In("rad")
    delta_sw = Out("rad")

    def output(self, t: Any, x: Any, u: Any) -> Any:
        side = 1.0 if u.e + 1.5 * u.psi_e >= 0.0 else -1.0
        return self.Y(0.0 if t < 0.6 else side * STOP)


class Filtered(World):
    """A world whose controller has the filter behind it."""

    def build(self, controller: Block, doe: Any) -> Loop:
        return steering_loop(
            car=RealCar(link=self),
            path=self.config.course,
            driver=ConstantSpeed(speed=0.0),
            controller=controller,
            safety=loops.safety(self.config).block,
            reference=self.config.vehicle.l_f,
        )


def test_an_adversary_is_kept_on_the_path_behind_the_gate() -> None:
    world = Filtered(s=20.0, v=(6.0, 6.0), controller=Away()).bring_to(Mode.ENGAGED)
    assert 0.35 < world.worst_e(3.0) < 0.5
    assert world.mode is Mode.ENGAGED
    world.check_bus()


@dataclass(frozen=True, eq=False, kw_only=True)
class LeftThenStanley(Wrapper):
    """What a roll-out takes for granted: Stanley, full lock to the left for 0.4 s, Stanley."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(STOP) if self.left(t) else self.inner_output(t, x, u)

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return self.settle(t, x, u) if self.left(t) else super().update(t, x, u, y)

    def left(self, t: float) -> bool:
        return 0.6 <= t + 1e-9 < 1.0


@pytest.mark.parametrize("v", [7.0, 9.0])
def test_what_is_rolled_out_is_no_less_than_what_comes_behind_the_gate(v: float) -> None:
    """Half way through the lock four samples of it are left. One that does not know the gate promises half of it."""
    world = World(s=20.0, v=(v, v), controller=LeftThenStanley(block=Stanley.of(CONFIG.vehicle))).bring_to(Mode.ENGAGED)
    knows: Any = loops.safety(world.config).block
    sure: dict[str, Any] = dict(e_doubt=0.0, psi_doubt=0.0, yaw_doubt=0.0, ratio_doubt=0.0, delay_doubt=0.0)
    blocks, reaches, worst = (replace(knows, **sure), replace(knows, **sure, gate=None)), list[float](), 0.0
    while world.t < 3.5:
        world.go_on_for(0.05)
        run, worst = world.run, max(worst, world.core.senses.e)
        if abs(run.k * 0.05 - 0.85) < 1e-6:
            s, at = run.sample, world.config.course.kappa
            for block in blocks:
                preview = tuple(float(at(s["path.s"] + 0.1 * v * n)) for n in range(block.preview_points))
                seen = {"e": s["path.e"], "psi_e": s["path.psi_e"], "preview": preview, "v": s["car.v"]}
                wheel = {"r": s["car.r"], "delta_sw_meas": s["car.delta_sw"], "applied": s["car.applied"]}
                u = {"command": STOP, **seen, **wheel}
                d = block.D(**{name: u[name] for name in block.D._fields})
                x = block.settle(0.0, block.init(), d)
                reaches.append(block.output(0.0, x, d).reach)
    assert reaches[1] < 0.6 * worst < 0.6 * reaches[0]
    assert reaches[0] < 1.6 * worst


class Clock:
    """Seconds for the filter's budget, asked before and after an answer: now and then one takes too long."""

    asked, seconds = 0, 0.0

    def __call__(self) -> float:
        self.asked += 1
        self.seconds += self.asked % 25 == 0
        return self.seconds


def test_a_filtered_learner_stays_on_the_path_and_replays_bit_for_bit_corrections_and_faults_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    answer = SafetyFilter.output

    def fails_once(self: SafetyFilter, t: Any, x: Any, u: Any) -> Any:
        if abs(t - 0.75) < 1e-6:
            raise FloatingPointError("something unforeseen")
        return answer(self, t, x, u)

    monkeypatch.setattr(SafetyFilter, "output", fails_once)
    with caplog.at_level(logging.ERROR, logger="steerkit"):
        learner = learned(tmp_path, monkeypatch, 3.7, SAFE, clock=Clock())
    assert learner.filter_faults[fail_safe.FAULTS[RAISED]] == 1
    assert learner.filter_faults[fail_safe.FAULTS[LATE]] >= 1
    assert "something unforeseen" in caplog.text
    assert "the filter was late" in caplog.text
    assert learner.filter_faults.keys() <= set(learner.figures()["filter_faults"])
    assert all(what in learner.status() for what in learner.filter_faults)
    recorded = recordings.read(tmp_path / "drive.mcap")
    told = recorded.of("/safety")
    (drive,) = [d for d in replays.drives(recorded) if d.remarks]
    assert len(told) == len(drive.filtered) == len(drive.requests) > 90
    assert {v["reason"] for v in told} >= {0.0, 2.0, LATE, RAISED}
    assert {s.safe for _, s in drive.remarks} == {True}
    assert max(abs(v["e"]) for v in recorded.of("/car") if v["mode"] == "ENGAGED") < 0.5
    faults = [drive.first + n for n, did in enumerate(drive.filtered) if did.reason in fail_safe.FAULTS]
    lost = [n for n, steers in drive.remarks if not steers.trusted]
    assert any(0 <= n - fault <= 2 for n in lost for fault in faults), "one cost the policy the wheel"
    assert learner.learner_state.counts.failures == len(lost) >= 2
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests)
    basis, asked = drive.requests[20]
    drive.requests[20] = basis, asked + 1e-15
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests) - 1


def test_a_dead_time_that_the_filter_finds_goes_into_the_policy_and_the_recording(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrives = LearnerState.arrives

    def found(self: LearnerState, late: float, believed: float) -> bool:
        assert late == 0.0
        return arrives(self, 0.3 if len(self.transitions) > 45 else 0.0, believed)

    monkeypatch.setattr(LearnerState, "arrives", found)
    monkeypatch.setattr(learner_state, "ENOUGH", 40)
    how = replace(SAFE, fit=replace(SAFE.fit, imagined=20, dead_time=0.6), warm_up_seconds=0.0)
    learner = learned(tmp_path, monkeypatch, 3.0, how)
    samples = round((0.3 + loops.design_model_of(CONFIG).delay) / 0.05)
    (file,) = [file for file in (tmp_path / "run" / "nets").iterdir() if "dead" in file.name]
    assert file.stem.endswith(f"-dead{samples}")
    recorded = recordings.read(tmp_path / "drive.mcap")
    (drive,) = [d for d in replays.drives(recorded) if d.remarks]
    assert str(file) in {s.name for _, s in drive.remarks}
    assert learner.learner_state.counts.late == 0.3
    assert replays.replayed_requests(drive, CONFIG) == len(drive.requests)


def test_only_policies_get_it() -> None:
    world = World(s=20.0)
    with pytest.raises(ValueError, match="expected a policy"):
        loops.car_loop(world.config, world, Away(), safe=True)
