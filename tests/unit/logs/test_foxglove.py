"""Foxglove: the MCAP of a log, the live view, and layouts that name what is in them."""

import json
import re
import socket
import struct
import sys
import time
import xml.etree.ElementTree as xml
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import numpy as np
import pytest

from steerkit import Loop, Stanley, course, simulate
from steerkit.diagram.loop import Sample
from steerkit.diagram.simulation import Log
from steerkit.logs import foxglove
from steerkit.logs.foxglove import BEGIN, layout, shown_as, to_mcap
from tests.support.command_lines import run
from tests.support.straight_road import PASSAT, looped

pytest.importorskip("mcap")
pytest.importorskip("foxglove")
pytest.importorskip("websockets")


PROTOCOL = "foxglove.sdk.v1"


class Client:
    """A client of Foxglove's WebSocket that reads what comes; `with` ends it."""

    def __init__(self, address: str):
        from websockets.sync.client import connect

        self.socket = connect(address, subprotocols=[PROTOCOL], legacy=True, close_timeout=0.5)  # type: ignore[list-item]
        self.info = self.words()
        self.channels: dict[int, dict[str, Any]] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.socket.close()

    def words(self) -> dict[str, Any]:
        """The next message in JSON; those with numbers before it are lost."""
        while isinstance(text := self.socket.recv(timeout=20.0), bytes):
            pass
        return dict(json.loads(text))

    def ask(self, words: dict[str, Any] | bytes) -> None:
        """Send words, or a binary message."""
        self.socket.send(words if isinstance(words, bytes) else json.dumps(words))

    def subscribe(self, count: int) -> None:
        """To all topics, once so many are there."""
        while len(self.channels) < count:
            words = self.words()
            assert words["op"] == "advertise", words
            self.channels |= {channel["id"]: channel for channel in words["channels"]}
        self.ask({"op": "subscribe", "subscriptions": [{"id": k, "channelId": k} for k in self.channels]})

    def next(self, within: float = 20.0) -> tuple[str, int, dict[str, Any]] | None:
        """The next message with numbers: topic, time [ns], values; None if there is none within so long [s]."""
        try:
            while not isinstance(data := self.socket.recv(timeout=within), bytes):
                pass
        except TimeoutError:
            return None
        operation, channel, when = struct.unpack_from("<BIQ", data)
        assert operation == 1
        return self.channels[channel]["topic"], when, json.loads(data[13:])


def messages(file: Path) -> dict[str, list[tuple[int, Any]]]:
    from mcap.reader import make_reader

    found: dict[str, list[tuple[int, Any]]] = {}
    with file.open("rb") as stream:
        for _, channel, message in make_reader(stream, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append((message.log_time, json.loads(message.data)))
    return found


@pytest.fixture(scope="module")
def loop() -> Loop:
    return looped(Stanley.of(PASSAT), course("circle"), 5.0, 0.0, actuator=None, reference=0.0)


@pytest.fixture(scope="module")
def lap(loop: Loop) -> Log:
    return simulate(loop, 3.0)


def test_a_simulated_run_is_read_back_bit_for_bit(lap: Log, tmp_path: Path) -> None:
    counts = to_mcap(lap, tmp_path / "run.mcap")
    found = messages(tmp_path / "run.mcap")
    assert set(counts) == set(found)
    for words in ("/path e path.e", "/car v car.v", "/wheel delta_sw car.delta_sw"):
        topic, field, signal = words.split()
        assert [values[field] for _, values in found[topic]] == lap[signal].tolist()
    assert [when for when, _ in found["/path"]] == [BEGIN + round(t * 1e9) for t in lap.t.tolist()]


def test_the_layouts_show_what_is_there(lap: Log, tmp_path: Path) -> None:
    shown = shown_as(lap.columns())
    assert layout(tmp_path / "l.json") == "foxglove"
    text = (tmp_path / "l.json").read_text()
    paths = set(re.findall(r'"value": "(/[^"]+)"', text))
    assert paths
    assert {path.replace(".", "/") for path in paths} <= shown.keys()
    assert set(re.findall(r'"(?:first|second)": "([^"]+)"', text)) == set(json.loads(text)["configById"])
    assert layout(tmp_path / "l.xml") == "plotjuggler"
    curves = xml.parse(tmp_path / "l.xml").iter("curve")
    names = {curve.get(key) for curve in curves for key in ("name", "curve_x", "curve_y")} - {None, "/car/[x;y]"}
    assert names <= shown.keys()
    with pytest.raises(ValueError, match=r"ending '.rviz' is not known.*valid: .json, .xml"):
        layout(tmp_path / "l.rviz")


def test_the_car_tells_before_the_motor_and_who_was_last_before_the_wheel() -> None:
    names = ["actuator.delta_sw", "controller.delta_sw", "car.delta_sw", "supervisor.delta_sw", "path.e", "x"]
    shown = foxglove.shown_as(names)
    assert shown["/wheel/delta_sw"] == "car.delta_sw"
    assert shown["/wheel/delta_sw_cmd"] == "supervisor.delta_sw"
    assert (shown["/path/e"], shown["/car/x"]) == ("path.e", "x")
    assert shown["/signals/actuator/delta_sw"] == "actuator.delta_sw"


def test_what_is_no_number_is_null_as_json_has_it_and_several_cars_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="a batch of cars"):
        to_mcap(Log(np.arange(3.0), {"car.x": np.zeros((3, 2))}, {"car.x": "m"}), tmp_path / "a.mcap")
    x = np.arange(9.0)
    y = np.where(x == 3.0, np.nan, 0.0)
    to_mcap(Log(0.997 * x, {"x": x, "y": y}, {"x": "m", "y": "m"}), tmp_path / "a.mcap")
    assert [values["y"] for _, values in messages(tmp_path / "a.mcap")["/car"][2:5]] == [0.0, None, 0.0]


def seen_by(each: Callable[[Sample], None]) -> Callable[[Sample], bool]:
    return lambda sample: each(sample) is not None


def first_of(loop: Loop, t: float = 0.0) -> Sample:
    samples: list[Sample] = []
    simulate(loop, 0.05, until=seen_by(lambda sample: samples.append(Sample(loop, t, list(sample.y)))))
    return samples[0]


def test_a_client_sees_the_drive_as_the_export_has_it_and_cannot_publish(loop: Loop, tmp_path: Path) -> None:
    log = simulate(loop, 3.0)
    topics = to_mcap(log, tmp_path / "run.mcap").keys()
    server = foxglove.Server("0")
    assert server.address.startswith("ws://127.0.0.1:")
    server.sample(early := first_of(loop, t=-100.0))
    with Client(server.address) as client:
        client.subscribe(len(topics))
        assert client.info["capabilities"] == []
        assert {c["topic"] for c in client.channels.values()} == topics
        while (known := client.next(within=0.2)) is None:  # until the server knows who asks
            server.sample(early)
        begin = known[1] + 100 * 10**9
        simulate(loop, 3.0, until=seen_by(server.sample))
        rows: dict[str, list[tuple[int, dict[str, Any]]]] = {}
        while min(len(rows.get(topic, [])) for topic in topics) < len(log.t):
            message = client.next()
            assert message is not None
            topic, when, values = message
            if when >= begin:
                rows.setdefault(topic, []).append((when - begin, values))
        for topic, field, name in (("/path", "e", "path.e"), ("/car", "v", "car.v"), ("/car", "x", "car.x")):
            assert [values[field] for _, values in rows[topic]] == log[name].tolist()
            assert [when for when, _ in rows[topic]] == [round(t * 1e9) for t in log.t.tolist()]

        mine = {"id": 9, "topic": "/path", "encoding": "json", "schemaName": ""}
        client.ask({"op": "advertise", "channels": [mine]})
        client.ask(b"\x01\x09\0\0\0" + b'{"e": 0.0}')
        assert "does not support clientPublish" in client.words()["message"]
        began = time.monotonic()
        for _ in range(5_000):  # more than sockets and the server's queue hold
            server.sample(early)
        assert time.monotonic() - began < 30.0
        server.end()  # with a client that reads nothing any more
        assert time.monotonic() - began < 35.0


def test_vectors_are_shown_number_by_number(monkeypatch: pytest.MonkeyPatch) -> None:
    class Row(dict[str, Any]):
        t = 0.5

    server = foxglove.Server("0")
    monkeypatch.setattr(foxglove.time, "time_ns", lambda: 1_800_000_000 * 10**9)
    server.sample(Row({"car.x": 1.0, "car.y": np.nan, "car.two": np.array([[2.0, np.inf]])}))  # type: ignore[arg-type]
    assert {"/signals/car/two[0]", "/signals/car/two[1]"} <= {
        f"{topic}/{field}" for topic, fields in server._topics.items() for field in fields
    }
    assert server._when(0.6) == 1_800_000_000_100_000_000  # the first sample is stamped with the time of day
    server.end()


@pytest.mark.parametrize("where", ["", "x", "70000", ":", "localhost:", "::1:80", "8765 ", "-1", "1.5"])
def test_a_place_that_is_none_teaches(where: str) -> None:
    with pytest.raises(ValueError, match=r"expected \[HOST:\]PORT, such as 8765"):
        foxglove.place_of(where)


def test_places() -> None:
    assert foxglove.place_of("8765") == ("127.0.0.1", 8765)
    assert foxglove.place_of("0.0.0.0:1") == ("0.0.0.0", 1)
    assert foxglove.place_of("[::1]:0") == ("::1", 0)


def test_a_taken_port_and_a_missing_package_teach(monkeypatch: Any, capsys: Any, tmp_path: Path) -> None:
    words = ("drive", "stanley", "--course", "circle", "--rounds", "0.03", "--out", str(tmp_path / "run"), "-q")
    with socket.create_server(("127.0.0.1", 0)) as other:
        port = str(other.getsockname()[1])
        assert run(*words, "--stream", port, monkeypatch=monkeypatch) == 2
    assert f"stream at {port}: Failed to bind port: Address already in use" in capsys.readouterr().err
    assert run("drive", "stanley", "--car", "dbw-kit.toml", "--stream", "0", monkeypatch=monkeypatch) == 2
    assert "`steerkit car stream` in a second terminal" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()
    assert run(*words, "--json", "--stream", "0", monkeypatch=monkeypatch) == 0
    heard = capsys.readouterr()
    assert json.loads(heard.out)["controller"] == "stanley"
    assert "open a connection to ws://127.0.0.1:" in heard.err
    monkeypatch.setitem(sys.modules, "foxglove", None)
    assert run(*words, "--stream", "0", monkeypatch=monkeypatch) == 2
    assert "pip install 'steerkit-control[logs]'" in capsys.readouterr().err
