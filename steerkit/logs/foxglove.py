"""Drives to Foxglove and PlotJuggler: as an MCAP file, and live over a WebSocket while they are driven.

Both hold the same topics: `/car`, `/wheel`, `/path` under the names that the layouts show, and `/signals/...`. Clients
of the live server can look, and nothing else: it offers no capability.
"""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import known, optional, require
from steerkit._support.files import atomic_write, write_text
from steerkit.diagram.loop import Sample
from steerkit.diagram.simulation import Log
from steerkit.logs.drive import Drive

_SOURCES = {
    **{f"/car/{name}": [f"car.{name}", name] for name in ("x", "y", "v", "r", "beta", "psi", "a_y")},
    **{f"/path/{name}": [f"path.{name}"] for name in ("e", "e_dot", "psi_e", "kappa", "s")},
    "/wheel/delta_sw": ["car.delta_sw", "actuator.delta_sw", "delta_sw"],
    "/wheel/delta_sw_cmd": [f"{block}.delta_sw" for block in ("supervisor", "doe", "controller", "gate")],
}
"""What the layouts call a signal, and the signals that may be it, best first."""


def shown_as(names: Iterable[str]) -> dict[str, str]:
    """What the layouts call each of the signals of a loop or of a drive: name there to name here.

    `/car/x`, `/wheel/delta_sw`, `/path/e`, ...: the first signal that holds it; all stand under `/signals/` too.
    """
    known = list(names)
    shown = {name: [source for source in sources if source in known] for name, sources in _SOURCES.items()}
    first = {name: sources[0] for name, sources in shown.items() if sources}
    return first | {f"/signals/{name.replace('.', '/')}": name for name in known}


LAYOUTS = {".json": "foxglove", ".xml": "plotjuggler"}
"""Endings of the layouts that ship, and whose they are: where the car is, e, the wheel, the states."""
BEGIN = 1_700_000_000_000_000_000
"""When a log without a date begins, since 1970 [ns]."""


def layout(file: Path) -> str:
    """Write the layout of the program that reads files of such an ending; returns its name."""
    program = LAYOUTS[known(file.suffix, LAYOUTS, f"layout {file}: ending")]
    write_text(file, (files(__package__) / "layouts" / f"{program}{file.suffix}").read_text(encoding="utf-8"))
    return program


HOST = "127.0.0.1"
FLUSH = 0.3
"""For how long clients may take the last messages [s]; the server then ends, whether they have or not."""


def place_of(where: str) -> tuple[str, int]:
    """Host and port of `[HOST:]PORT`; the loopback unless one is named. Raises ValueError for anything else."""
    host, _, port = where.rpartition(":")
    address = host[1:-1] if host[:1] == "[" and host[-1:] == "]" else host
    good = port.isascii() and port.isdigit() and int(port) <= 65535 and (":" not in address or address != host)
    require(good, f"stream at '{where}'", "expected [HOST:]PORT, such as 8765, 0.0.0.0:8765 or [::1]:0 (any free port)")
    return address or HOST, int(port)


class Topics:
    """Signals as topics of Foxglove's SDK, for whatever listens to its context: `begin` with their names, then `show`.

    start: when t = 0 is, since 1970 [ns]; None: the first sample is stamped with the time of day. Raises ValueError
    where foxglove-sdk is missing.
    """

    def __init__(self, *, start: int | None = None):
        foxglove = optional("foxglove", "Foxglove: MCAP or a stream", "logs")
        foxglove.set_log_level(logging.CRITICAL)  # who dials a wrong number is no news on a terminal
        self.sdk, self.context = foxglove, foxglove.Context()
        self._start = start
        self.channels: dict[str, Any] = {}
        self._topics: dict[str, dict[str, int]] = {}

    def begin(self, names: Sequence[str]) -> None:
        """The signals that come, in their order; the layouts' names are made of theirs."""
        place = {name: k for k, name in enumerate(names)}
        for name, source in shown_as(names).items():
            topic, _, field = name.rpartition("/")
            self._topics.setdefault(topic, {})[field] = place[source]
        for topic, fields in self._topics.items():
            self._open(topic, "number", sorted(fields))

    def show(self, t: float, values: Sequence[float]) -> None:
        """One sample, at t [s]. Never waits for who looks; what is no number is null, as JSON has it."""
        when = self._when(t)
        for topic, fields in self._topics.items():
            if self.channels[topic].has_sinks():
                row = {name: values[k] if math.isfinite(values[k]) else None for name, k in fields.items()}
                self.channels[topic].log(row, log_time=when)

    def note(self, topic: str, words: Mapping[str, str], t: float) -> None:
        """Words on a topic of their own, at t [s]."""
        if topic not in self.channels:
            self._open(topic, "string", words)
        self.channels[topic].log(dict(words), log_time=self._when(t))

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

    def _open(self, topic: str, kind: str, fields: Iterable[str]) -> None:
        title, properties = topic.strip("/").replace("/", "."), {name: {"type": kind} for name in fields}
        schema = {"title": title, "type": "object", "properties": properties}
        self.channels[topic] = self.sdk.Channel(topic, schema=schema, context=self.context)


class Server(Topics):
    """Serves signals to Foxglove from this process, over a WebSocket.

    where: `[HOST:]PORT`. Raises ValueError for a port that is taken, and where foxglove-sdk is missing.
    """

    def __init__(self, where: str):
        host, port = place_of(where)
        super().__init__()
        about = {"name": "steerkit", "host": host, "port": port, "capabilities": []}
        try:
            self._server = self.sdk.start_server(**about, context=self.context)
        except (RuntimeError, OverflowError) as error:
            what = str(error).removeprefix("FoxgloveError: ")
            raise ValueError(f"stream at {where}: {what}; choose another port, or 0 for any") from error
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{self._server.port}"

    def end(self) -> None:
        """Stop serving; clients have a moment for the last messages."""
        time.sleep(FLUSH)
        # the library's own end waits for clients that read nothing, for a minute
        stop = threading.Thread(target=self._server.stop, daemon=True)
        stop.start()
        stop.join(FLUSH)


def to_mcap(log: Log | Drive, file: str | Path) -> dict[str, int]:
    """Write a log as MCAP, in JSON; returns messages by topic.

    Numbers come back bit for bit, NaN and infinity as null. Raises ValueError for a batch, and without foxglove-sdk.
    """
    record = log.to_log() if isinstance(log, Drive) else log
    columns = {name: values for name, values in record.columns().items() if name != "t"}
    require(not any("[" in name and name.startswith("car.") for name in columns), "export", "a batch of cars; save one")
    topics = Topics(start=BEGIN)
    with atomic_write(file) as draft, topics.sdk.open_mcap(draft, allow_overwrite=True, context=topics.context):
        topics.begin(list(columns))
        for t, *row in zip(record.t.tolist(), *(values.tolist() for values in columns.values())):
            topics.show(t, row)
    return dict.fromkeys(topics.channels, len(record.t))


def paced(each: Callable[[Sample], None]) -> Callable[[Sample], None]:
    """The same, but no faster than real time; it does not wait for anything but the time."""
    began = time.monotonic()

    def wrapped(sample: Sample) -> None:
        each(sample)
        time.sleep(max(0.0, began + sample.t - time.monotonic()))

    return wrapped
