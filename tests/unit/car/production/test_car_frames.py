"""The frames of a simulated production car: what a port and opendbc's safety code make of them."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("opendbc")

from benchmarks.run.production import altered, config_of
from steerkit.car.production.car_frames import CarFrames, Said
from steerkit.car.production.platforms import platform
from steerkit.car.production.port import Frame, Port
from tests.support.production import EACH, judged, ported, steered


@judged
@pytest.mark.parametrize("name", EACH)
def test_a_port_reads_the_simulated_car_and_the_safety_code_lets_it_steer(name: str) -> None:
    car = ported(name)
    car.advance(0.6)
    quantum = car.config.writer.quantum
    steered(car, 0.2, round(car.car.turned / quantum) * quantum)
    port, counts, judge = car.port, car.car.counts, car.judge
    assert judge is not None
    assert port.steering, port.flags
    assert judge.allowed
    assert not judge.invalid
    assert not judge.relay_malfunction
    assert counts.not_in_order == counts.rejected == 0
    assert counts.sent > 7
    assert abs(port.state.vEgoRaw - car.now.v) < 0.1
    assert port.state.steeringAngleDeg == pytest.approx(
        math.degrees(car.car.turned), abs=1.6 if name == "TOYOTA_COROLLA" else 0.4
    )


@pytest.mark.parametrize("name", EACH[::3])
def test_what_a_car_says_is_what_the_port_tells(name: str) -> None:
    """Each flag in its turn, and none of the others."""
    frames, found = CarFrames(platform(name)), Port(config_of(name))
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
        for _ in range(25):
            t, said = t + 0.01, replace(said, v=20.0 + float(rng.normal()) * 0.02 + k)
            for frame in frames.send(said):
                found.receive(t, Frame(*frame))
            found.step(t)
        up = {name for name, value in found.flags.items() if value}
        # a car with a manual gearbox is in D unless it reverses; that is what opendbc takes it for without firmware
        assert up == ({flag} if flag else set()), (flag, up)


@pytest.mark.parametrize(("name", "told"), [("TOYOTA_COROLLA", True), ("CHRYSLER_PACIFICA_2020", False)])
def test_a_human_steers_once_nothing_is_asked_for_at_once_where_the_frames_tell(name: str, told: bool) -> None:
    """A Chrysler's do not: its torque may be 0 for a moment, and is 0 for longer where nobody asks."""
    car = ported(name)
    heard: list[Frame] = []
    car.listen = heard.append
    car.advance(2.2)  # before, opendbc does not steer a Chrysler
    steered(car, 0.3, -0.3)
    frames, t = car.car.frames, car.car.t
    frame = next(f for f in heard[::-1] if f.frame_id in frames.asks)
    now = frames.command(frame.frame_id, frame.data, float(car.car.now.v))
    assert now is not None
    assert now.active
    data = altered(frames, frame.frame_id, frame.data, by=-now.value, active=False)
    car.car.hear(t, frame._replace(data=data))
    assert math.isnan(car.car._asked) == told
    car.car._steer(t)
    assert car.car.enabled != told
    car.car._steer(t + 0.11)
    assert not car.car.enabled
