"""The car's block says that it is one car; a car server that speaks otherwise, or refuses, is told."""

import json
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from steerkit.car import client as clients
from steerkit.car.client import CarClient, CarLost, RealCar, ReplayLink
from steerkit.car.protocol import Hello, Query, Refused, Snapshot, encode
from steerkit.car.state_machine import Mode


def test_a_car_that_is_traced_or_batched_says_so() -> None:
    import casadi

    car = RealCar(link=ReplayLink([]))
    with pytest.raises(TypeError, match="one car"):
        car.init((3,))
    with pytest.raises(TypeError, match="cannot be traced"):
        car.output(casadi.SX.sym("t"), (), ())
    assert not car.pure
    with pytest.raises(ValueError, match=r"dt = 2.0 \[s\]"):
        RealCar(link=ReplayLink([]), dt=2.0)


NUMBERS = {"x": 1.0, "y": 2.0, "psi": 3.0, "v": 4.0, "beta": 5.0, "r": 6.0, "a_y": 7.0, "delta_sw": 8.0}


@pytest.mark.parametrize("mode", Mode)
def test_each_port_holds_what_its_name_says_and_only_engaged_is_engaged(mode: Mode) -> None:
    car = RealCar(link=ReplayLink([Snapshot(0.5, **NUMBERS, command=9.0, mode=mode)]))
    y = car.output(0.0, car.init(), ())
    assert {name: getattr(y, name) for name in NUMBERS} == NUMBERS
    assert y.engaged == (1.0 if mode is Mode.ENGAGED else 0.0)
    assert y.applied == (9.0 if mode is Mode.ENGAGED else 8.0), "what turns the wheel: the gate, or a hand"


def test_a_request_goes_out_with_the_time_of_what_it_was_computed_from() -> None:
    link = ReplayLink([Snapshot(0.5), Snapshot(0.55)])
    car = RealCar(link=link)
    for angle in (0.1, 0.2):
        y = car.output(0.0, (), ())
        car.update(0.0, (), car.U(delta_sw_cmd=angle, v_cmd=5.0), y)
    assert link.requests == [(0.5, 0.1), (0.55, 0.2)]
    assert link.count == 2
    with pytest.raises(CarLost, match="ended"):
        link.query()


OLD = json.dumps(["Snapshot", *[0.0] * 21, "OFF", ""]).encode()
NOT_KNOWN = encode(Refused("packet of 41 bytes is not known: zip() argument 2 is longer than argument 1"))


@pytest.mark.parametrize("controller", [True, False])
@pytest.mark.parametrize(
    ("answers", "says"),
    [
        ([NOT_KNOWN, OLD], "the car server speaks another version of the protocol than 7: end it and start it anew"),
        ([encode(Refused("it speaks version 8, not 7")), encode(Snapshot(0.0))], "socket: it speaks version 8, not 7"),
    ],
)
def test_a_car_server_of_another_version_is_told(
    answers: list[bytes], says: str, controller: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    coming, sent = iter(answers), list[bytes]()
    line = SimpleNamespace(recv=lambda size: next(coming), send=sent.append, settimeout=print, connect=print)
    monkeypatch.setattr(clients.socket, "socket", lambda *kind: nullcontext(line))
    monkeypatch.setattr(clients, "_ours", lambda line: True)
    with pytest.raises(CarLost, match=says):
        CarClient("socket", controller=controller, name="me")
    assert sent == [encode(Hello(controller, 7, "", "me")), encode(Query())]
