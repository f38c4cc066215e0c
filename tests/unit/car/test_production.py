"""Production cars: their port, their frames, what their limits are; judged by opendbc's safety code in C."""

import json
import math
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("opendbc")

from benchmarks.judges.opendbc_safety import SafetyJudge
from benchmarks.run.production import PortedCar, ProductionWorld, config_of
from benchmarks.studies import production_cars as study
from steerkit._support import native
from steerkit.car import processes
from steerkit.car.client import CarClient
from steerkit.car.config import CarConfig, ConfigError
from steerkit.car.gate import gate
from steerkit.car.production import platforms, table
from steerkit.car.production.car_frames import CarFrames, Said
from steerkit.car.production.limits import limits_of
from steerkit.car.production.line import SocketLine, SocketServer, line_of
from steerkit.car.production.platforms import LateralMap, platform
from steerkit.car.production.port import REJECTED_BUS, RELEASED, SILENCE, Frame, Port
from steerkit.car.production.simulated import ProductionCar
from steerkit.car.simulated import Fault
from steerkit.car.state_machine import Mode, Order
from steerkit.estimators.torque_map import TorqueMap
from steerkit.paths.courses import course
from steerkit.vehicles import vehicle

judged = pytest.mark.skipif(native.compiler() is None, reason="opendbc's safety code is C, and there is no compiler")
EACH = (
    *("TESLA_MODEL_3", "FORD_MUSTANG_MACH_E_MK1", "FORD_FOCUS_MK4", "NISSAN_LEAF", "NISSAN_ALTIMA", "TOYOTA_COROLLA"),
    *("TOYOTA_RAV4_TSS2_2023", "HONDA_CIVIC_BOSCH", "HONDA_CIVIC", "HYUNDAI_ELANTRA_2021", "HYUNDAI_IONIQ_5"),
    *("VOLKSWAGEN_GOLF_MK7", "VOLKSWAGEN_PASSAT_NMS", "SUBARU_OUTBACK", "SUBARU_IMPREZA", "MAZDA_CX5_2022"),
    *("CHRYSLER_PACIFICA_2020", "RAM_1500_5TH_GEN", "CHEVROLET_BOLT_EUV", "RIVIAN_R1"),
)
"""A platform of each maker and each kind of its frames."""


@cache
def config(name: str) -> CarConfig:
    return config_of(name)


def ported(name: str, **more: Any) -> PortedCar:
    """On the highway, by hand: its wheel is never quite straight."""
    return PortedCar(config(name), course("highway"), judge=SafetyJudge(platform(name)), s=10.0, **more)


def steered(car: PortedCar, seconds: float, delta_sw: float = 0.0, *, enable: bool = True) -> None:
    """For so long, with a command each 20 ms."""
    writer = car.config.writer
    for _ in range(round(seconds / 0.02)):
        t = car.due + 0.01
        car.receive(t, writer.frame_id, writer.write(delta_sw, enable=enable))
        car.advance(t)


# ---- frames -----------------------------------------------------------------------------------------------------


@judged
@pytest.mark.parametrize("name", EACH)
def test_a_port_reads_the_simulated_car_and_the_safety_code_lets_it_steer(name: str) -> None:
    car = ported(name)
    car.advance(1.2)
    quantum = car.config.writer.quantum
    steered(car, 0.6, round(car.car.car.turned / quantum) * quantum)
    port, counts, judge = car.port, car.car.counts, car.judge
    assert judge is not None
    assert port.steering, port.why
    assert judge.allowed
    assert not judge.invalid
    assert not judge.relay_malfunction
    assert counts.not_in_order == counts.rejected == 0
    assert counts.sent > 20
    assert abs(port.state.vEgoRaw - car.now.v) < 0.1
    assert port.state.steeringAngleDeg == pytest.approx(
        math.degrees(car.car.car.turned), abs=1.6 if name == "TOYOTA_COROLLA" else 0.4
    )


@pytest.mark.parametrize("name", EACH[::3])
def test_what_a_car_says_is_what_the_port_tells(name: str) -> None:
    """Each flag in its turn, and none of the others."""
    frames, found = CarFrames(platform(name)), Port(config(name))
    cases: dict[str, Said] = {
        "BELT_OPEN": Said(v=20.0, angle_deg=1.0, belt=False),
        "NOT_IN_DRIVE": Said(v=20.0, angle_deg=1.0, drive=False),
        "DOOR_OPEN": Said(v=20.0, angle_deg=1.0, door=True),
        "CRUISE_OFF": Said(v=20.0, angle_deg=1.0, cruise=False),
        "STEERING_FAULT": Said(v=20.0, angle_deg=1.0, fault=True),
        "": Said(v=20.0, angle_deg=1.0),
    }
    if found.platform.maker == "nissan":
        del cases["STEERING_FAULT"]  # opendbc knows none of this maker's
    t, rng = 0.0, np.random.default_rng(0)
    for k, (flag, said) in enumerate(cases.items()):
        for _ in range(60):
            t, said = t + 0.01, replace(said, v=20.0 + float(rng.normal()) * 0.02 + k)
            for frame in frames.send(said):
                found.receive(t, Frame(*frame))
            found.step(t)
        up = {name for name, value in found.flags.items() if value}
        # a car with a manual gearbox is in D unless it reverses; that is what opendbc takes it for without firmware
        assert up == ({flag} if flag else set()), (flag, up)


def test_the_other_way_of_reading_a_command_is_its_inverse() -> None:
    for name in ("TESLA_MODEL_3", "FORD_MUSTANG_MACH_E_MK1", "VOLKSWAGEN_GOLF_MK7", "HYUNDAI_ELANTRA_2021"):
        car = ported(name)
        heard: list[Frame] = []
        car.listen = heard.append
        car.advance(1.2)
        steered(car, 0.3, -0.1)
        frame, command = next((f, c) for f in heard[::-1] if (c := car.car.frames.command(f.frame_id, f.data, 13.0)))
        by = 0.001 if car.car.platform.steered_by == "curvature" else 0.2
        changed = car.car.frames.altered(frame.frame_id, frame.data, by=by)
        again = car.car.frames.command(frame.frame_id, changed, 13.0)
        assert again is not None
        assert again.value - command.value == pytest.approx(by, abs=0.06 * by + 0.004 * (by > 0.1) + 2e-5)
        off = car.car.frames.command(
            frame.frame_id, car.car.frames.altered(frame.frame_id, frame.data, active=False), 13.0
        )
        assert off is not None
        assert not off.active


# ---- limits -----------------------------------------------------------------------------------------------------


@judged
@settings(max_examples=10, deadline=None)
@given(
    st.sampled_from(
        ["TESLA_MODEL_3", "NISSAN_LEAF", "TOYOTA_RAV4_TSS2_2023", "FORD_MUSTANG_MACH_E_MK1", "TOYOTA_COROLLA"]
    ),
    st.lists(st.floats(-12.0, 12.0) | st.just(math.nan) | st.just(math.inf), min_size=4, max_size=8),
    st.floats(8.0, 28.0),
)
def test_nothing_that_passes_the_gate_is_rejected_by_the_safety_code(name: str, wishes: list[float], v: float) -> None:
    car = ported(name, v_min=v, v_max=v)
    car.advance(1.2)
    last = 0.0
    for wish in wishes:
        for _ in range(4):
            verdict = gate(car.config.gate, wish, last, (v, v), 0.02)
            if verdict.send:
                last = verdict.delta_sw
            steered(car, 0.02, last)
    assert car.car.counts.sent > 10
    assert car.car.counts.rejected == 0


def test_a_gate_with_a_table_of_rates_lets_no_more_through_than_a_line_of_it() -> None:
    limits = config("NISSAN_LEAF").gate
    (v_0, rate_0), (v_1, rate_1), (v_2, rate_2) = limits.rates
    assert limits.rate(0.5 * (v_0 + v_1)) == pytest.approx(0.5 * (rate_0 + rate_1))
    assert limits.rate(0.25 * v_1 + 0.75 * v_2) == pytest.approx(0.25 * rate_1 + 0.75 * rate_2)
    assert limits.rate(40.0) == pytest.approx(rate_2)
    assert np.allclose(limits.rate(np.array([v_1, v_2])), [rate_1, rate_2])
    verdict = gate(replace(limits, a_y_max=5.0, jerk_max=10.0), 1.0, 0.0, (v_2,), 0.02)
    assert rate_2 * 0.02 - limits.quantum < verdict.delta_sw <= rate_2 * 0.02
    with pytest.raises(ValueError, match="fall ever more slowly"):
        replace(limits, rates=((0.0, 1.0), (5.0, 2.0)))


@pytest.mark.parametrize("name", ["TOYOTA_COROLLA_TSS2", "HONDA_CIVIC_BOSCH", "VOLKSWAGEN_GOLF_MK7"])
def test_a_torque_s_limits_are_those_of_its_port(name: str) -> None:
    found = platform(name)
    limits = limits_of(found, vehicle(name.lower().replace("_", "-")))
    per_second = {"TOYOTA_COROLLA_TSS2": 15 * 100 / 1500, "HONDA_CIVIC_BOSCH": 3.0, "VOLKSWAGEN_GOLF_MK7": 4 * 50 / 300}
    assert limits.jerk_max == pytest.approx(min(5.0, per_second[name] * found.lateral.gain))
    assert limits.torque_limit == pytest.approx(found.lateral.gain * (1.0 - found.lateral.friction))


@judged
def test_of_frames_that_break_a_limit_none_passes() -> None:
    for name in ("NISSAN_LEAF", "HYUNDAI_ELANTRA_2021"):
        row = study.altered((name, 300, 3))
        assert row["altered"] >= 300
        assert row["passed"] == 0
        assert row["hostile"] > 10
        assert row["hostile_rejected"] == 0


# ---- port -------------------------------------------------------------------------------------------------------


@judged
def test_after_a_rejection_port_and_safety_code_begin_anew_together() -> None:
    car = ported("TESLA_MODEL_3")
    car.advance(1.2)
    steered(car, 0.5, 0.2)
    before = car.car.counts.rejected
    car.port.receive(car.due, Frame(0x488, b"", REJECTED_BUS))
    steered(car, 0.04, 0.2)
    assert not car.port.steering
    assert car.port.why == "a frame was rejected"
    steered(car, RELEASED + 0.1, 0.2)
    assert car.port.steering
    assert car.car.counts.rejected == before


def test_a_port_asks_for_nothing_without_a_fresh_command_and_sends_nothing_into_silence() -> None:
    car = ported("TOYOTA_COROLLA_TSS2")
    car.advance(1.2)
    steered(car, 0.4, 0.1)
    assert car.port.steering
    car.advance(car.due + 0.2)
    assert not car.port.steering
    assert "command old" in car.port.why
    heard: list[Frame] = []
    car.listen = heard.append
    car.car.faults.append(Fault(kind="drop", target="report", start=0.0))
    car.advance(car.due + SILENCE + 0.05)
    heard.clear()
    steered(car, 0.3, 0.1)
    assert not heard
    assert not car.port.steering


def test_equal_frames_give_equal_frames() -> None:
    frames: list[list[Frame]] = []
    for _ in range(2):
        car = PortedCar(config("HYUNDAI_ELANTRA_2021"), course("highway"), s=10.0)
        heard: list[Frame] = []
        car.listen = heard.append
        car.advance(0.8)
        steered(car, 0.6, 0.05)
        frames.append(heard)
    assert len(frames[0]) > 100
    assert frames[0] == frames[1]


def test_what_a_torque_does_is_found_while_driving() -> None:
    """Gain, friction and offset that are not the data sheet's, from a drive with a wheel that goes to and fro."""
    true, finder = LateralMap(gain=2.3, friction=0.15, offset=0.1), TorqueMap(gain=2.0, friction=0.2)
    x, a_y, before = finder.init(), 0.0, 0.0
    for k in range(6000):
        u = 0.5 * math.sin(0.3 * 0.01 * k) + 0.2 * math.sin(1.1 * 0.01 * k)
        centre, half = true.gain * u + true.offset, true.gain * true.friction
        before, a_y = a_y, max(centre - half, min(centre + half, a_y))
        x = finder.update(x, u=u, a_y=a_y, turning=(a_y - before) / 0.01, dt=0.01)
        if k == 500:
            assert finder.found(x) == (2.0, 0.2, 0.0)  # too little driving
    found = finder.found(x)
    assert found.gain == pytest.approx(true.gain, rel=0.05)
    assert found.friction == pytest.approx(true.friction, rel=0.2)
    assert found.offset == pytest.approx(true.offset, abs=0.03)
    assert finder.update(x, u=math.nan, a_y=0.0, turning=0.0, dt=0.01) is x
    assert replace(finder, gain=1.6, sure=0.1).found(x).gain == pytest.approx(
        1.3 * 1.6
    )  # no further than may be believed
    still = finder.init()
    for _ in range(6000):
        still = finder.update(still, u=0.3, a_y=0.9, turning=0.2, dt=0.01)
    assert finder.found(still) == (2.0, 0.2, 0.0)  # one torque alone does not tell a gain


@judged
def test_a_torque_car_is_driven_with_a_map_that_is_wrong() -> None:
    true = LateralMap(gain=1.2 * platform("TOYOTA_COROLLA_TSS2").lateral.gain, friction=0.12, offset=0.15)
    world = ProductionWorld(config("TOYOTA_COROLLA_TSS2"), seed=2, lateral=true)
    drive = study.drive_of(world, "lqr")
    while len(drive.e) < 300 and not drive.ended:
        drive.step()
    assert not drive.ended
    assert max(map(abs, drive.e)) < 0.3


def test_the_limits_of_the_car_s_own_watchdog() -> None:
    """Its steering lets go when the port no longer sends."""
    made = ProductionCar(config("TESLA_MODEL_3"), course("highway"), s=10.0)
    made.receive(0.0, Frame(0x488, CAPTURED, 0))
    made.advance(0.05)
    assert made.enabled
    made.advance(0.05 + SILENCE + 0.05)
    assert not made.enabled


def _captured() -> bytes:
    car = ported("TESLA_MODEL_3")
    heard: list[Frame] = []
    car.listen = heard.append
    car.advance(1.2)
    steered(car, 0.3)
    return next(f.data for f in heard[::-1] if f.frame_id == 0x488)


CAPTURED = _captured() if native.compiler() else b""


# ---- whole drives -----------------------------------------------------------------------------------------------


@judged
@pytest.mark.parametrize(
    ("name", "controller"), [("NISSAN_LEAF", "lqr"), ("SUBARU_OUTBACK", "mpc"), ("RIVIAN_R1", "auto")]
)
def test_a_drive_through_gate_port_and_safety_code(name: str, controller: str) -> None:
    row = study.driven((name, controller, 12.0, 4))
    assert row["held"], row
    assert row["max_e"] < 0.2
    assert row["rejected"] == row["not_in_order"] == 0
    assert row["frames"] > 5000


@judged
@pytest.mark.parametrize("what", [*study.FAULTS, *study.KILLED])
def test_whatever_goes_wrong_nothing_asks_for_steering_soon(what: str) -> None:
    row = study.faulty(("FORD_MUSTANG_MACH_E_MK1", what, 2))
    assert row["drove"]
    assert row["silent_s"] <= 0.25, row
    assert row["rejected"] <= 2 * (what in ("wrong check sums", "frames frozen"))  # which it notices a sample sooner
    told = {
        "driver's torque": "override",
        "brake": "brake",
        "door": "DOOR_OPEN",
        "cruise control off": "CRUISE_OFF",
        "steering fault": "STEERING_FAULT",
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
    world = ProductionWorld(config("TESLA_MODEL_3"), judged=False)
    world.car.faults.append(Fault(kind="disabled", target="report", start=0.0))
    drive = study.drive_of(world, "lqr")
    for _ in range(40):
        drive.step()
    assert world.mode is Mode.STANDBY
    assert any("CRUISE_OFF" in text for text in world.core.obstacles())


def test_a_killed_car_server_leaves_a_production_car_to_its_human(tmp_path: Path) -> None:
    """In three processes, in real time; the car's steering lets go by itself."""
    log = tmp_path / "car.log"
    simulated, channel = processes.start_simulated("production-car.toml", log=str(log))
    server = processes.start_car_server("production-car.toml", str(tmp_path / "socket"), channel=channel)
    try:
        with (
            CarClient(str(tmp_path / "socket")) as line,
            CarClient(str(tmp_path / "socket"), controller=False) as panel,
        ):
            end = time.monotonic() + 20.0
            while time.monotonic() < end:
                snapshot = line.query()
                panel.beat()
                if math.isfinite(snapshot.delta_sw):
                    line.request(snapshot.delta_sw)
                order = {Mode.OFF: Order.ARM, Mode.READY: Order.ENGAGE}.get(snapshot.mode)
                if order is not None:
                    panel.order(order)
                if snapshot.mode is Mode.ENGAGED and '"enabled": true' in log.read_text(encoding="utf-8")[-200:]:
                    break
                time.sleep(0.02)
            assert snapshot.mode is Mode.ENGAGED, snapshot.text
            server.kill()
            server.wait()
            killed = time.monotonic()
        time.sleep(0.8)
        states = [json.loads(text) for text in log.read_text(encoding="utf-8").splitlines() if '"enabled"' in text]
        assert [state["enabled"] for state in states if state["t"] > killed + 0.3]
        assert not any(state["enabled"] for state in states if state["t"] > killed + 0.3)
    finally:
        server.kill()
        simulated.kill()


# ---- files, lines, lists ----------------------------------------------------------------------------------------


def test_a_platform_that_is_unknown_or_never_steered_is_refused_by_name() -> None:
    with pytest.raises(ConfigError, match="did you mean TESLA_MODEL_3"):
        config_of("TESLA_MODEL_33")
    with pytest.raises(ConfigError, match=r"PSA_PEUGEOT_208.*dashcam"):
        config_of("PSA_PEUGEOT_208")
    with pytest.raises(ConfigError, match="SecOC"):
        config_of("TOYOTA_RAV4_PRIME")
    with pytest.raises(ConfigError, match="cruise control"):
        config_of("AUDI_Q5_MK1")


def test_without_opendbc_a_port_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    real = platforms.importlib.util.find_spec
    monkeypatch.setattr(platforms.importlib.util, "find_spec", lambda name: None if name == "opendbc" else real(name))
    platforms._interfaces.cache_clear()
    try:
        with pytest.raises(ConfigError, match=r"pip install 'steerkit-control\[production\]'"):
            config_of("TESLA_MODEL_3")
    finally:
        platforms._interfaces.cache_clear()


def test_what_the_port_gives_may_not_be_given_by_the_file_too() -> None:
    from steerkit._support.files import toml_of
    from steerkit.car.config import Reading, shipped

    text = shipped("production-car.toml").read_text(encoding="utf-8")
    data = toml_of(text, "car")
    data["read"]["delta_sw"] = {"frame": "POSE_MOTION", "signal": "PSI"}
    with pytest.raises(ConfigError, match=r"\[read\] delta_sw: the port of TESLA_MODEL_3 gives it"):
        Reading("car", data, {}, shipped("production-car.toml").parent).config(None)


def test_the_gate_of_a_port_is_no_wider_than_the_file_says() -> None:
    car = config_of("TESLA_MODEL_3", a_y_max=1.0, rate_max_deg=20.0)
    assert car.gate.a_y_max == 1.0
    assert math.degrees(car.gate.rate_max) == pytest.approx(20.0)
    assert car.gate.jerk_max == pytest.approx(0.95 * (3.0 + 0.06 * 9.81), rel=1e-3)


def test_the_table_lists_each_platform_once_and_writes_a_file_that_is_sound(tmp_path: Any) -> None:
    rows = table.rows()
    assert len({row["name"] for row in rows}) == len(rows) == 243
    assert {row["by"] for row in rows} == {"angle", "curvature", "torque"}
    assert sum(not row["obstacle"] for row in rows) == 208
    text = "\n".join(table.lines(rows))
    assert "TESLA_MODEL_3" in text
    assert "208 of 243" in text
    table.write("NISSAN_ROGUE", tmp_path / "car.toml")
    assert 'opendbc = "NISSAN_ROGUE"' in (tmp_path / "car.toml").read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="exists already"):
        table.write("NISSAN_ROGUE", tmp_path / "car.toml")


def test_frames_cross_a_socket_whole() -> None:
    server = SocketServer()
    line = SocketLine(server.channel)
    frames = [Frame(0x488, b"\x01\x02\x03\x04", 0), Frame(0x18DAB0F1, bytes(32), 2)]
    server.receive()
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
    server.close()
    time.sleep(0.05)
    with pytest.raises(OSError, match="gone"):
        line.receive()
    line.close()


def test_a_line_that_is_none_or_not_there_is_refused() -> None:
    with pytest.raises(ValueError, match=r"expected 127\.0\.0\.1:PORT"):
        line_of({"line": "socket", "channel": "10.0.0.1:99"}, platform("TESLA_MODEL_3"))
    with pytest.raises(ValueError, match="panda"):
        line_of({"line": "pandas"}, platform("TESLA_MODEL_3"))
    with pytest.raises(OSError, match="panda"):
        line_of({}, platform("TESLA_MODEL_3"))
    with pytest.raises(OSError, match="cannot be opened"):
        line_of({"line": "python-can", "interface": "socketcan", "channels": ["nothere0"]}, platform("TESLA_MODEL_3"))


def test_the_highway_is_wide() -> None:
    path = course("highway")
    assert path.closed
    assert float(np.abs(path.samples.kappa).max()) == pytest.approx(0.0025, rel=0.02)
