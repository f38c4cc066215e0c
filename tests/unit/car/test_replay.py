"""Recorded drives: taken apart by controller, and replayed."""

import math
from typing import Any

from steerkit.car import protocol
from steerkit.car import replay as replays
from steerkit.car.loop import Steers
from steerkit.car.recording import Message, Recorded
from tests.support.car_world import setup

CONFIG, COURSE = setup()


def client(link: int, message: protocol.Message) -> Message:
    return Message("/client", {"t": 0.0, "link": link, "data": protocol.encode(message).hex()})


def car(t: float) -> Message:
    return Message("/car", {**protocol.Snapshot(t)._asdict(), "mode": "READY"})


def test_a_drive_is_what_one_controller_saw_and_asked_for() -> None:
    stanley, mpc = Steers(name="stanley"), Steers(name="mpc")
    messages = [
        client(1, protocol.Hello(True)),
        client(2, protocol.Hello(False)),
        client(1, protocol.Remark(stanley.text())),
        car(0.1),
        car(0.15),
        client(1, protocol.Request(0.15, 0.5, 0)),
        client(2, protocol.Request(0.15, 9.0, 0)),  # refused: it is no controller
        car(0.2),
        client(1, protocol.Request(0.2, 0.6, 0)),
        Message("/client", {"t": 0.0, "link": 1, "data": "ff00"}),
        client(3, protocol.Hello(True)),
        client(3, protocol.Remark(mpc.text())),
        car(0.3),
        client(3, protocol.Request(0.3, 0.7, 0)),
    ]
    first, second = replays.drives(Recorded({}, messages, [], 0, False))
    assert first.requests == [(0.15, 0.5), (0.2, 0.6)]
    assert [s.t for s in first.snapshots] == [0.1, 0.15, 0.2]
    assert (first.first, first.remarks, first.who) == (2, [(0, stanley)], "stanley")
    assert (second.requests, second.first, second.who) == ([(0.3, 0.7)], 1, "mpc")


def test_a_request_that_is_no_number_is_the_same_when_it_is_none_again() -> None:
    """So it is where the wheel's report is stale: NaN is asked for, and the gate lets nothing through."""
    there: dict[str, Any] = {"x": 10.0, "y": 0.0, "psi": 0.0, "v": 5.0, "beta": 0.0, "r": 0.0, "a_y": 0.0}
    wheel = (0.1, 0.1, math.nan, math.nan, 0.1, 0.1)
    seen = [protocol.Snapshot(0.05 * k, **there, delta_sw=angle) for k, angle in enumerate(wheel)]
    drive = replays.Drive(snapshots=seen, requests=[(s.t, math.nan) for s in seen[1:]], first=2)
    none_again = 3  # two without a report, and one more whose controller remembers none
    assert replays.replayed_requests(drive, CONFIG, COURSE, controller="stanley") == none_again
