"""The port of a production car: when it steers and when not, its line to the car, whole drives through gate, port and
safety code, and what may go wrong in them."""

import json
import math
import socket
import time
from pathlib import Path

import pytest

pytest.importorskip("opendbc")

from benchmarks.run.production import PortedCar, ProductionWorld, config_of
from benchmarks.studies import production_cars as study
from steerkit.car import processes, recording
from steerkit.car.client import CarClient
from steerkit.car.production.platforms import platform
from steerkit.car.production.port import (
    OTHER,
    REJECTED_BUS,
    RELEASED,
    SILENCE,
    Frame,
    SocketLine,
    SocketServer,
    line_of,
)
from steerkit.car.production.simulated import ProductionCar
from steerkit.car.protocol import Beat
from steerkit.car.simulated import Fault
from steerkit.car.state_machine import Mode, Order
from tests.support.production import judged, ported, steered


def steering(name: str) -> tuple[PortedCar, list[Frame]]:
    """A car that its port steers, and the frames on its buses."""
    car, heard = ported(name), list[Frame]()
    car.listen = heard.append
    car.advance(1.2)
    steered(car, 0.5, 0.02)
    assert car.port.steering
    return car, heard


@judged
def test_after_a_rejection_port_and_safety_code_begin_anew_together() -> None:
    car, _ = steering("TESLA_MODEL_3")
    before = car.car.counts.rejected
    car.port.receive(car.due, Frame(0x488, b"", REJECTED_BUS))
    steered(car, 0.04, 0.02)
    assert not car.port.steering
    assert not any(car.port.flags.values())
    steered(car, RELEASED + 0.1, 0.02)
    assert car.port.steering
    assert car.car.counts.rejected == before


def test_a_port_asks_for_nothing_without_a_fresh_command_and_sends_nothing_into_silence() -> None:
    car, heard = steering("TOYOTA_COROLLA_TSS2")
    car.advance(car.due + 0.2)
    assert not car.port.steering
    assert not any(car.port.flags.values())
    car.faults.append(Fault(kind="drop", target="report", start=0.0))
    car.advance(car.due + SILENCE + 0.05)
    heard.clear()
    steered(car, 0.3, 0.02)
    assert not heard
    assert not car.port.steering


@pytest.mark.parametrize("name", ["TESLA_MODEL_3", "TOYOTA_COROLLA_TSS2", "FORD_MUSTANG_MACH_E_MK1"])
def test_another_sender_of_frames_that_steer_is_noticed_and_the_port_lets_go(name: str) -> None:
    car, heard = steering(name)
    own = next(f for f in heard if f.frame_id in car.car.frames.asks)
    car.port.receive(car.due, own._replace(bus=own.bus + 2))  # the camera's, behind the relay
    steered(car, 0.04, 0.02)
    assert car.port.steering
    car.port.receive(car.due, own)
    steered(car, 0.04, 0.02)
    assert not car.port.steering
    assert [name for name, up in car.port.flags.items() if up] == ["OTHER_SENDER"]
    steered(car, OTHER + 0.1, 0.02)
    assert car.port.steering


def test_the_car_s_own_watchdog_lets_go_when_the_port_no_longer_sends() -> None:
    _, heard = steering("TESLA_MODEL_3")
    car = ProductionCar(config_of("TESLA_MODEL_3"), s=10.0)
    car.hear(0.0, next(frame for frame in heard[::-1] if frame.frame_id == 0x488))
    car.advance(0.05)
    assert car.enabled
    car.advance(0.05 + SILENCE + 0.05)
    assert not car.enabled


def test_frames_cross_a_socket_whole() -> None:
    server = SocketServer()
    line = SocketLine(server.channel)
    frames = 400 * [Frame(0x488, b"\x01\x02\x03\x04", 0), Frame(0x18DAB0F1, bytes(64), 2)]
    line.send(frames, steering=True, t=0.0)
    for _ in range(100):
        if got := server.receive():
            break
    assert got == frames
    server.send(frames[::-1])
    for _ in range(1000):
        if back := line.receive():
            break
    assert back == frames[::-1]
    other = SocketLine(server.channel)
    other.send(frames[:1], steering=True, t=0.0)
    line.send(frames[:2], steering=True, t=0.0)
    assert server.receive() == frames[:1], "the port that came last has the car to itself"
    other.close()
    server.close()
    line.send(frames[:1], steering=True, t=0.0)
    with pytest.raises(OSError, match="gone"):
        line.receive()
    line.close()


def test_a_line_that_is_none_or_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected 127\.0\.0\.1:PORT"):
        line_of({"line": "socket", "channel": "10.0.0.1:99"}, platform("TESLA_MODEL_3"))
    with pytest.raises(OSError, match="panda"):
        line_of({}, platform("TESLA_MODEL_3"))


def test_a_simulated_car_that_is_not_there_is_told_when_its_line_is_opened() -> None:
    server = SocketServer()
    server.close()
    with pytest.raises(OSError, match="refused"):
        SocketLine(server.channel)


def test_a_frame_that_is_cut_off_is_no_frame() -> None:
    """Whoever sends it: another program on this machine."""
    server = SocketServer()
    host, port = server.channel.split(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.connect((host, int(port)))
        for text in (b"", b"\x01\x02\x03", b"\x01\0\0\0\0\x08\x01\x02"):
            other.send(text)
        assert server.receive() == []
    server.close()


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
