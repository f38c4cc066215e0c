"""A drive to look at in Foxglove while it is driven: a WebSocket that shows what the MCAP export would hold.

The server is a process of its own (`beside`): whoever drives hands its samples over without ever waiting, and what the
server cannot take is left out. Clients can look, and nothing else: no capability is offered to them.
"""

from __future__ import annotations

import contextlib
import json
import logging
import math
import os
import select
import socket
import subprocess
import sys
import time
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.util import find_spec
from typing import Any, NoReturn

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram.loop import Sample
from steerkit.logs import messages

HOST = "127.0.0.1"
PATIENCE = 15.0
"""For how long the server may take to begin [s]."""
FLUSH = 0.3
"""For how long readers may take the last messages [s]; the server then ends, whether they have or not."""
NICE = 10
"""How far the server steps back behind whoever drives (os.nice)."""
EVERY = 1.0
"""The way driven is shown no more often than this [s]."""
PACKET = 1 << 20
"""The longest packet from whoever drives [bytes]."""


def place_of(where: str) -> tuple[str, int]:
    """Host and port of `[HOST:]PORT`; the loopback unless one is named. Raises ValueError for anything else."""
    host, _, port = where.rpartition(":")
    address = host[1:-1] if host[:1] == "[" and host[-1:] == "]" else host
    good = port.isascii() and port.isdigit() and int(port) <= 65535 and (":" not in address or address != host)
    require(good, f"stream at '{where}'", "expected [HOST:]PORT, such as 8765, 0.0.0.0:8765 or [::1]:0 (any free port)")
    return address or HOST, int(port)


class Server:
    """Serves signals to Foxglove from this process: `begin` with their names, then `show` each sample.

    where: `[HOST:]PORT`. Raises ValueError for a port that is taken, and where foxglove-sdk is missing.
    """

    def __init__(self, where: str):
        host, port = place_of(where)
        _check_installed()
        import foxglove

        foxglove.set_log_level(logging.CRITICAL)  # who dials a wrong number is no news on a terminal
        self._context = foxglove.Context()
        try:
            server = foxglove.start_server(
                name="steerkit", host=host, port=port, capabilities=[], context=self._context
            )
        except (RuntimeError, OverflowError) as error:
            raise ValueError(
                f"stream at {where}: {str(error).removeprefix('FoxgloveError: ')}; choose another port, or 0 for any"
            ) from error
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{server.port}"
        self._server = server
        self._channels: dict[str, Any] = {}
        self._topics: dict[str, dict[str, int]] = {}
        self._begin: int | None = None
        self._points: list[tuple[float, float]] = []
        self._shown_way = -math.inf

    def begin(self, names: Sequence[str]) -> None:
        """The signals that come, in their order; the layouts' names are made of theirs."""
        place = {name: k for k, name in enumerate(names)}
        shown = messages.shown_as(names)
        self._topics = messages.by_topic({name: place[source] for name, source in shown.items()})
        for topic, fields in self._topics.items():
            self._open(topic, *messages.schema(topic, fields))
        if {"x", "y"} <= self._topics.get("/car", {}).keys():
            for topic in (messages.POSE, messages.DRIVEN):
                self._open(topic, *messages.schema(topic, ()))

    def show(self, t: float, values: Sequence[float]) -> None:
        """One sample, at t [s]; the first is stamped with the time of day. Never waits for who looks."""
        if self._begin is None:
            self._begin = time.time_ns() - round(t * 1e9)
        when = self._begin + round(t * 1e9)
        for topic, fields in self._topics.items():
            if self._channels[topic].has_sinks():
                self._log(topic, {name: messages.number(values[k]) for name, k in fields.items()}, when)
        if messages.POSE in self._channels:
            self._show_scene(values, when)

    def tell(self, topic: str, words: Mapping[str, str], t: float) -> None:
        """Words on a topic of their own, at t [s]; after `show`."""
        if topic not in self._channels:
            properties = {name: {"type": "string"} for name in words}
            self._open(topic, topic.strip("/"), {"type": "object", "properties": properties})
        self._log(topic, words, (self._begin or 0) + round(t * 1e9))

    def end(self) -> NoReturn:
        """End this process; readers have a moment for the last messages."""
        time.sleep(FLUSH)
        sys.stdout.flush()
        os._exit(0)  # the library's own end waits for readers that take nothing, for a minute

    def _show_scene(self, values: Sequence[float], when: int) -> None:
        car = self._topics["/car"]
        x, y = values[car["x"]], values[car["y"]]
        if not (math.isfinite(x) and math.isfinite(y)):
            return
        self._log(messages.POSE, messages.pose(x, y, values[car["psi"]] if "psi" in car else None, when), when)
        self._points.append((x, y))
        if len(self._points) > 2 * messages.MOST:
            self._points = self._points[::2]
        if time.monotonic() - self._shown_way >= EVERY and self._channels[messages.DRIVEN].has_sinks():
            self._shown_way = time.monotonic()
            self._log(messages.DRIVEN, messages.way(self._points, when), when)

    def _open(self, topic: str, name: str, schema: dict[str, Any]) -> None:
        from foxglove import Channel, Schema

        text = Schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())
        self._channels[topic] = Channel(topic, schema=text, message_encoding="json", context=self._context).base

    def _log(self, topic: str, values: Mapping[str, Any], when: int) -> None:
        channel = self._channels[topic]
        if channel.has_sinks():
            channel.log(messages.packed(values), log_time=when)


class Sender:
    """Hands samples over to the server's process: call it with each. It takes microseconds, and never waits.

    signals: which (default: all of the sample). Vectors are told number by number, `name[0]`, `name[1]`, ...
    """

    def __init__(self, line: socket.socket, signals: Sequence[str] | None = None):
        line.setblocking(False)
        self._line, self._signals = line, signals
        self._told = False
        self.left_out = 0
        """Samples that the server was too slow for."""
        self.broken = False
        """Has the server ended?"""

    def __call__(self, sample: Sample) -> None:
        if self.broken:
            return
        values, names = array("d", (sample.t,)), list[str]()
        for name in self._signals or sample:
            value = sample[name]
            if isinstance(value, (float, int)):
                values.append(value)
            else:
                numbers = np.ravel(np.asarray(value, dtype=float))
                values.extend(numbers.tolist())
            if not self._told:
                names += [name] if np.ndim(value) == 0 else [f"{name}[{k}]" for k in range(np.size(value))]
        try:
            if not self._told:
                self._line.send(json.dumps(names).encode())
                self._told = True
            self._line.send(values.tobytes())
        except BlockingIOError:
            self.left_out += 1
        except OSError:
            self.broken = True


def paced(each: Callable[[Sample], None], pace: float) -> Callable[[Sample], None]:
    """The same, but no faster than `pace` times real time; it does not wait for anything but the time.

    Raises ValueError for a pace that is no number above 0.
    """
    require(0.0 < pace < math.inf, "pace", f"{pace}, expected a number > 0: times real time")
    began = time.monotonic()

    def wrapped(sample: Sample) -> None:
        each(sample)
        time.sleep(max(0.0, began + sample.t / pace - time.monotonic()))

    return wrapped


@contextlib.contextmanager
def beside(where: str, signals: Sequence[str] | None = None) -> Iterator[tuple[str, Sender]]:
    """A server in a process of its own, as long as the block lasts and this process lives: its address, and who hands
    samples over to it.

    where: `[HOST:]PORT`. signals: as for `Sender`. Raises ValueError for a port that is taken, and where foxglove-sdk
    is missing.
    """
    place_of(where)
    _check_installed()
    try:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    except OSError as error:
        raise ValueError(f"stream: needs sockets that keep packets apart, as Linux has ({error.strerror})") from error
    with ours:
        ours.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4 * PACKET)
        with theirs:
            words = [sys.executable, "-m", "steerkit.logs.stream", where, str(theirs.fileno())]
            process = subprocess.Popen(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                pass_fds=(theirs.fileno(),),
                start_new_session=True,
            )
        try:
            yield _begun(process, where), Sender(ours, signals)
        finally:
            ours.close()
            _ended(process)


def _begun(process: subprocess.Popen[bytes], where: str) -> str:
    """The address that a server's first line tells; raises ValueError with its error."""
    assert process.stdout is not None
    heard = bool(select.select([process.stdout], [], [], PATIENCE)[0])
    word, _, text = process.stdout.readline().decode().strip().partition(" ") if heard else ("", "", "")
    if word != "at":
        raise ValueError(text or f"stream at {where}: its server did not begin within {PATIENCE:g} s")
    return text


def _ended(process: subprocess.Popen[bytes]) -> None:
    assert process.stdout is not None
    process.stdout.close()
    try:
        process.wait(10.0 * FLUSH)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _check_installed() -> None:
    missing = find_spec("foxglove") is None
    require(not missing, "stream", "needs the package foxglove-sdk: pip install 'steerkit-control[logs]'")


def serve(server: Server, line: socket.socket) -> None:
    """Show what comes over the line, until its other end is closed."""
    begun, size = False, 0
    while packet := line.recv(PACKET):
        if not begun:
            names = json.loads(packet)
            server.begin(names)
            begun, size = True, len(names) + 1
            continue
        numbers = array("d", packet)
        if len(numbers) == size:
            server.show(numbers[0], numbers[1:])


def main() -> None:
    """What `beside` starts: says `at ADDRESS`, or `no WHY`, and serves until whoever drives is gone."""
    os.nice(NICE)
    try:
        server = Server(sys.argv[1])
    except ValueError as error:
        print(f"no {error}", flush=True)
        raise SystemExit(2) from None
    print(f"at {server.address}", flush=True)
    with socket.socket(fileno=int(sys.argv[2])) as line, contextlib.suppress(KeyboardInterrupt, ConnectionError):
        serve(server, line)
    server.end()


if __name__ == "__main__":
    main()
