"""Whole drives through gate, port and safety code, and what may go wrong in them."""

import json
import math
import time
from pathlib import Path

import pytest

pytest.importorskip("opendbc")

from benchmarks.run.production import ProductionWorld, config_of
from benchmarks.studies import production_cars as study
from steerkit.car import processes, recording
from steerkit.car.client import CarClient
from steerkit.car.protocol import Beat
from steerkit.car.simulated import Fault
from steerkit.car.state_machine import Mode, Order
from tests.support.production import judged


@judged
@pytest.mark.parametrize(("name", "controller"), [("NISSAN_LEAF", "lqr"), ("RIVIAN_R1", "auto")])
def test_a_drive_through_gate_port_and_safety_code(name: str, controller: str) -> None:
    row = study.driven((name, controller, 1.5, 4, {}))
    assert row["held"], row
    assert row["max_e"] < 0.2
    assert row["rejected"] == row["not_in_order"] == 0
    assert row["frames"] > 800


@judged
def test_an_understeering_car_is_given_the_wheel_that_it_needs_at_25_metres_a_second() -> None:
    """With bounds on a_y of a car without understeer its gate would keep a Corolla from the path's curvature."""
    world = ProductionWorld(config_of("TOYOTA_COROLLA"), seed=1, v_min=25.0, v_max=26.0, s=5620.0)  # the tightest bend
    drive = study.drive_of(world, "lqr")
    while len(drive.e) < 120 and not drive.ended:
        drive.step()
    assert not drive.ended
    assert world.car.now.v > 20.0
    assert max(map(abs, drive.e)) < 0.1
    assert world.car.car.counts.rejected == 0


def test_slow_steering_is_not_engaged_in_a_bend_and_the_human_steers_until_it_is() -> None:
    """A Pacifica's frames have their request set from 2 s on, engaged or not: what steers is a torque."""
    world = ProductionWorld(config_of("CHRYSLER_PACIFICA_2020"), judged=False, seed=0, v_min=22.0, v_max=28.0)
    drive = study.drive_of(world, "lqr")
    while world.t < 4.0:
        drive.step()
    assert world.mode is Mode.STANDBY
    assert "a_y: a_y = 0.99 m/s^2, limit 0.59 m/s^2" in world.core.obstacles()[0]
    assert abs(world.car.on_path.e) < 0.05
    assert world.car.now.a_y == pytest.approx(world.car.on_path.kappa * world.car.now.v**2, abs=0.1)


FLAGS = ("door", "steering fault")
"""Told by a flag of the car's, as cruise control is: test_car_frames.py sees each."""


@judged
@pytest.mark.parametrize("what", [what for what in (*study.FAULTS, *study.KILLED) if what not in FLAGS])
def test_whatever_goes_wrong_nothing_asks_for_steering_soon(what: str) -> None:
    row = study.faulty(
        ("FORD_MUSTANG_MACH_E_MK1", what, 2), before=0.4, after=1.6 if what == "ignition off, bus lost" else 0.6
    )
    assert row["drove"]
    assert row["silent_s"] <= 0.25, row
    assert row["rejected"] <= 2 * (what in ("wrong check sums", "frames frozen"))  # which it notices a sample sooner
    told = {
        "driver's torque": "override",
        "brake": "brake",
        "cruise control off": "CRUISE_OFF",
        "ignition off, bus lost": "CAN_INVALID",
        "frames frozen": "CAN_INVALID",
        "frames 0.3 s late": "CAN_INVALID",
        "wrong check sums": "",  # of frames without one, whatever is in them
        "pose lost": "pose",
        "controller killed": "controller",
        "car server killed": "operator: engage",
    }
    assert told[what] in row["cause"], row["cause"]
    modes = {"driver's torque": "OVERRIDE", "brake": "OVERRIDE", "car server killed": "ENGAGED"}
    if what == "wrong check sums" and row["mode"] == "OVERRIDE":  # whatever is in those frames that have none
        modes[what] = "OVERRIDE"
    assert row["mode"] == modes.get(what, "FAULT")
    if what in ("brake", "cruise control off", "ignition off, bus lost", "frames frozen", "wrong check sums"):
        assert not row["allowed"]


def test_a_car_that_was_not_allowed_is_not_engaged() -> None:
    world = ProductionWorld(config_of("TESLA_MODEL_3"), judged=False)
    world.car.faults.append(Fault(kind="disabled", target="report", start=0.0))
    drive = study.drive_of(world, "lqr")
    for _ in range(20):
        drive.step()
    assert world.mode is Mode.STANDBY
    assert any("CRUISE_OFF" in text for text in world.core.obstacles())


def test_a_killed_car_server_leaves_a_production_car_to_its_human(tmp_path: Path) -> None:
    """In three processes, in real time; the car's steering lets go by itself."""
    log = tmp_path / "car.log"
    simulated, channel = processes.start_simulated("production-car.toml", log=str(log))
    kept = str(tmp_path / "drive.mcap")
    server = processes.start_car_server(
        "production-car.toml", str(tmp_path / "socket"), channel=channel, recording=kept
    )
    try:
        with (
            CarClient(str(tmp_path / "socket")) as line,
            CarClient(str(tmp_path / "socket"), controller=False) as panel,
        ):
            end = time.monotonic() + 20.0
            while time.monotonic() < end:
                snapshot = line.query()
                panel.note(Beat())
                if math.isfinite(snapshot.delta_sw):
                    line.request(snapshot.delta_sw)
                # a machine that pauses for 0.3 s looks like a pose that jumps
                orders = {Mode.OFF: Order.ARM, Mode.READY: Order.ENGAGE, Mode.FAULT: Order.ACKNOWLEDGE}
                order = orders.get(snapshot.mode)
                if order is not None:
                    panel.order(order)
                driven = snapshot.mode is Mode.ENGAGED and '"enabled": true' in log.read_text(encoding="utf-8")[-200:]
                if driven and sum(one.topic == "/port" for one in recording.read(kept).messages) > 10:
                    break  # a disk that is busy writes late
                time.sleep(0.02)
            assert snapshot.mode is Mode.ENGAGED, snapshot.text
            server.kill()
            server.wait()
            killed = time.monotonic()
        time.sleep(0.8)
        states = [json.loads(text) for text in log.read_text(encoding="utf-8").splitlines() if '"enabled"' in text]
        assert [state["enabled"] for state in states if state["t"] > killed + 0.3]
        assert not any(state["enabled"] for state in states if state["t"] > killed + 0.3)
        steps = [one.values for one in recording.read(kept).messages if one.topic == "/port"]
        assert len(steps) > 10  # the car's own frames are kept too
        assert sum(len(step["received"]) for step in steps) > 50
        assert {frame.split()[1] for step in steps for frame in step["sent"]} >= {"488"}  # DAS_steeringControl
    finally:
        server.kill()
        simulated.kill()


@judged
def test_after_braking_it_engages_again_once_cruise_control_does() -> None:
    """The safety code allows steering at an edge of cruise control, which braking ends and the human engages again."""
    world = ProductionWorld(config_of("TOYOTA_COROLLA"))
    for k in range(60):
        if k == 12:
            world.car.faults.append(Fault(kind="brake", target="report", start=world.t, length=0.5))
        snapshot = world.query()
        if math.isfinite(snapshot.delta_sw):
            world.request(snapshot.delta_sw)
        orders = {Mode.OFF: Order.ARM, Mode.READY: Order.ENGAGE, Mode.OVERRIDE: Order.ACKNOWLEDGE}
        if k % 5 == 0 and not 12 <= k < 30 and world.mode in orders:
            world.order(orders[world.mode])
    assert [to for _, to, _ in world.modes[-4:]] == ["OVERRIDE", "STANDBY", "READY", "ENGAGED"]
    assert world.car.car.counts.rejected == 0
