"""Drives to Foxglove and PlotJuggler: as an MCAP file, and live over a WebSocket while they are driven.

Both hold the same topics: `/car`, `/wheel`, `/path` under the names that the layouts show, `/signals/...`, and
the scene of Foxglove's 3D panel. Clients of the live server can look, and nothing else: it offers no capability.
"""

from __future__ import annotations

import json
import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import known, require
from steerkit._support.files import atomic_write, write_text
from steerkit.diagram.loop import Sample
from steerkit.diagram.simulation import Log
from steerkit.logs.drive import Drive

_STATES = ("v", "r", "beta", "psi", "a_y")
_LOOP = ("e", "e_dot", "psi_e", "kappa", "s")
POSE, DRIVEN = "/scene/pose", "/scene/driven"
"""Topics of Foxglove's 3D panel: where the car is, and the way that it came."""
MOST = 2000
"""Points of the way driven, at most."""


def shown_as(names: Iterable[str]) -> dict[str, str]:
    """What the layouts call each of the signals of a loop or of a drive: name there to name here.

    `/car/x`, `/wheel/delta_sw`, `/path/e`, ...: the first signal that holds it; all stand under `/signals/` too.
    """
    known = list(names)
    shown: dict[str, str] = {}

    def first(name: str, *sources: str) -> None:
        shown.update([(name, source) for source in sources if source in known][:1])

    for name in ("x", "y", *_STATES):
        first(f"/car/{name}", f"car.{name}", name)
    for name in _LOOP:
        first(f"/path/{name}", f"path.{name}")
    first("/wheel/delta_sw", "car.delta_sw", "actuator.delta_sw", "delta_sw")
    first("/wheel/delta_sw_cmd", "supervisor.delta_sw", "doe.delta_sw", "controller.delta_sw", "gate.delta_sw")
    return shown | {f"/signals/{name.replace('.', '/')}": name for name in known}


def by_topic(shown: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """What belongs to the names `/topic/field`, by topic and field."""
    topics: dict[str, dict[str, Any]] = {}
    for name, what in shown.items():
        topic, _, field = name.rpartition("/")
        topics.setdefault(topic, {})[field] = what
    return topics


def number(value: Any) -> float | None:
    """As JSON has it: null for what is none."""
    value = float(value)
    return value if math.isfinite(value) else None


def packed(values: Mapping[str, Any]) -> bytes:
    """A message."""
    return json.dumps(values, allow_nan=False, separators=(",", ":")).encode()


def schema(topic: str, fields: Iterable[str]) -> tuple[str, dict[str, Any]]:
    """Name and JSON schema of a topic's"""
    if topic == POSE:
        return "foxglove.PoseInFrame", _POSE
    if topic == DRIVEN:
        return "foxglove.PosesInFrame", _POSES
    properties = {name: {"type": "number"} for name in sorted(fields)}
    return topic.strip("/").replace("/", "."), {"type": "object", "properties": properties}


_XYZ = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyz"}}
_XYZW = {"type": "object", "properties": {axis: {"type": "number"} for axis in "xyzw"}}
_PLACED = {"type": "object", "properties": {"position": _XYZ, "orientation": _XYZW}}
_WHEN = {"type": "object", "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}}}
_POSE = {"type": "object", "properties": {"timestamp": _WHEN, "frame_id": {"type": "string"}, "pose": _PLACED}}
_POSES = {
    "type": "object",
    "properties": {"timestamp": _WHEN, "frame_id": {"type": "string"}, "poses": {"type": "array", "items": _PLACED}},
}


def pose(x: Any, y: Any, psi: Any, when: int) -> dict[str, Any]:
    """Where the car is: x, y [m], psi [rad] (None: not known), at `when` since 1970 [ns]."""
    return {**_stamped(when), "pose": _placed(number(x), number(y), None if psi is None else number(psi))}


def way(points: Sequence[Sequence[float]], when: int) -> dict[str, Any]:
    """The way driven, (n, 2) [m], no more than MOST of its points or so."""
    return {**_stamped(when), "poses": [_placed(x, y, None) for x, y in points[:: max(1, len(points) // MOST)]]}


def _stamped(when: int) -> dict[str, Any]:
    return {"timestamp": {"sec": when // 10**9, "nsec": when % 10**9}, "frame_id": "map"}


def _placed(x: float | None, y: float | None, psi: float | None) -> dict[str, Any]:
    turn = psi or 0.0
    return {
        "position": {"x": x or 0.0, "y": y or 0.0, "z": 0.0},
        "orientation": {"x": 0.0, "y": 0.0, "z": math.sin(turn / 2.0), "w": math.cos(turn / 2.0)},
    }


LAYOUTS = {"foxglove": "foxglove.json", "plotjuggler": "plotjuggler.xml"}
"""The layouts that ship: where the car is, e, the wheel, the states."""
BEGIN = 1_700_000_000_000_000_000
"""When a log without a date begins, since 1970 [ns]."""


def layout(program: str, file: str | Path) -> Path:
    """Write the layout for a program, `foxglove` or `plotjuggler`, to a file; returns it."""
    text = (files(__package__) / "layouts" / LAYOUTS[known(program, LAYOUTS, "layout")]).read_text(encoding="utf-8")
    write_text(file, text)
    return Path(file)


HOST = "127.0.0.1"
FLUSH = 0.3
"""For how long clients may take the last messages [s]; the server then ends, whether they have or not."""
EVERY = 1.0
"""The way driven is shown no more often than this [s]."""


def place_of(where: str) -> tuple[str, int]:
    """Host and port of `[HOST:]PORT`; the loopback unless one is named. Raises ValueError for anything else."""
    host, _, port = where.rpartition(":")
    address = host[1:-1] if host[:1] == "[" and host[-1:] == "]" else host
    good = port.isascii() and port.isdigit() and int(port) <= 65535 and (":" not in address or address != host)
    require(good, f"stream at '{where}'", "expected [HOST:]PORT, such as 8765, 0.0.0.0:8765 or [::1]:0 (any free port)")
    return address or HOST, int(port)


class Topics:
    """Signals as topics of Foxglove's SDK, for whatever listens to its context: `begin` with their names, then `show`.

    start: when t = 0 is, since 1970 [ns]; None: the first sample is stamped with the time of day. every: how often the
    way driven is shown [s of computing]. Raises ValueError where foxglove-sdk is missing.
    """

    def __init__(self, *, start: int | None = None, every: float = EVERY):
        installed = find_spec("foxglove") is not None
        require(installed, "Foxglove", "needs the package foxglove-sdk: pip install 'steerkit-control[logs]'")
        import foxglove

        foxglove.set_log_level(logging.CRITICAL)  # who dials a wrong number is no news on a terminal
        self._context = foxglove.Context()
        self._start, self._every, self._shown_way = start, every, 0.0
        self._channels: dict[str, Any] = {}
        self._topics: dict[str, dict[str, int]] = {}
        self._points: list[tuple[float, float]] = []

    def begin(self, names: Sequence[str]) -> None:
        """The signals that come, in their order; the layouts' names are made of theirs."""
        place = {name: k for k, name in enumerate(names)}
        shown = shown_as(names)
        self._topics = by_topic({name: place[source] for name, source in shown.items()})
        for topic, fields in self._topics.items():
            self._open(topic, *schema(topic, fields))
        if {"x", "y"} <= self._topics.get("/car", {}).keys():
            for topic in (POSE, DRIVEN):
                self._open(topic, *schema(topic, ()))

    def show(self, t: float, values: Sequence[float]) -> None:
        """One sample, at t [s]. Never waits for who looks."""
        when = self._when(t)
        for topic, fields in self._topics.items():
            if self._channels[topic].has_sinks():
                self._log(topic, {name: number(values[k]) for name, k in fields.items()}, when)
        if POSE in self._channels:
            self._show_scene(values, when)

    def note(self, topic: str, words: Mapping[str, str], t: float) -> None:
        """Words on a topic of their own, at t [s]."""
        if topic not in self._channels:
            properties = {name: {"type": "string"} for name in words}
            self._open(topic, topic.strip("/"), {"type": "object", "properties": properties})
        self._log(topic, words, self._when(t))

    def _when(self, t: float) -> int:
        if self._start is None:
            self._start = time.time_ns() - round(t * 1e9)
        return self._start + round(t * 1e9)

    def sample(self, sample: Sample, signals: Sequence[str] | None = None) -> None:
        """One sample of a loop, of these signals (default: all); vectors number by number, `name[0]`, `name[1]`, ..."""
        values, names = list[float](), list[str]()
        for name in signals or sample:
            value = sample[name]
            numbers = np.ravel(np.asarray(value, dtype=float)).tolist()
            values += numbers
            if not self._topics:
                names += [name] if np.ndim(value) == 0 else [f"{name}[{k}]" for k in range(len(numbers))]
        if names:
            self.begin(names)
        self.show(sample.t, values)

    def _show_scene(self, values: Sequence[float], when: int) -> None:
        car = self._topics["/car"]
        x, y = values[car["x"]], values[car["y"]]
        if not (math.isfinite(x) and math.isfinite(y)):
            return
        self._log(POSE, pose(x, y, values[car["psi"]] if "psi" in car else None, when), when)
        self._points.append((x, y))
        if len(self._points) > 2 * MOST:
            self._points = self._points[::2]
        if time.monotonic() - self._shown_way >= self._every and self._channels[DRIVEN].has_sinks():
            self._shown_way = time.monotonic()
            self.show_way(when)

    def show_way(self, when: int) -> None:
        """The way that was driven so far, stamped `when` since 1970 [ns]."""
        self._log(DRIVEN, way(self._points, when), when)

    def _open(self, topic: str, name: str, schema: dict[str, Any]) -> None:
        from foxglove import Channel, Schema

        text = Schema(name=name, encoding="jsonschema", data=json.dumps(schema).encode())
        self._channels[topic] = Channel(topic, schema=text, message_encoding="json", context=self._context).base

    def _log(self, topic: str, values: Mapping[str, Any], when: int) -> None:
        channel = self._channels[topic]
        if channel.has_sinks():
            channel.log(packed(values), log_time=when)


class Server(Topics):
    """Serves signals to Foxglove from this process, over a WebSocket.

    where: `[HOST:]PORT`. Raises ValueError for a port that is taken, and where foxglove-sdk is missing.
    """

    def __init__(self, where: str):
        host, port = place_of(where)
        super().__init__()
        from foxglove import start_server

        try:
            self._server = start_server(name="steerkit", host=host, port=port, capabilities=[], context=self._context)
        except (RuntimeError, OverflowError) as error:
            raise ValueError(
                f"stream at {where}: {str(error).removeprefix('FoxgloveError: ')}; choose another port, or 0 for any"
            ) from error
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"

    def end(self) -> None:
        """Stop serving; clients have a moment for the last messages."""
        time.sleep(FLUSH)
        # the library's own end waits for clients that read nothing, for a minute
        stop = threading.Thread(target=self._server.stop, daemon=True)
        stop.start()
        stop.join(FLUSH)


def to_mcap(log: Log | Drive, file: str | Path) -> dict[str, int]:
    """Write a log as MCAP with a topic a group (`/car`, `/path`, `/wheel`, `/signals/...`) in JSON, and `/scene/pose`,
    `/scene/driven` for Foxglove's 3D panel; returns messages by topic.

    Numbers come back bit for bit; one that is none is null. Raises ValueError for a batch of cars, and where
    foxglove-sdk is missing.
    """
    record = log.to_log() if isinstance(log, Drive) else log
    columns = {name: values for name, values in record.columns().items() if name != "t"}
    require(not any("[" in name and name.startswith("car.") for name in columns), "export", "a batch of cars; save one")
    topics = Topics(start=BEGIN, every=math.inf)
    from foxglove import open_mcap

    with atomic_write(file) as draft, open_mcap(draft, allow_overwrite=True, context=topics._context):
        topics.begin(list(columns))
        for t, *row in zip(record.t.tolist(), *(values.tolist() for values in columns.values())):
            topics.show(t, row)
        if topics._points:
            topics.show_way(BEGIN)
    return dict.fromkeys([topic for topic in topics._channels if topic != DRIVEN], len(record.t))


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
