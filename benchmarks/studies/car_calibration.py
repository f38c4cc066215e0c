"""Calibrate simulated cars behind their bus, from the data sheet, and say how near the truth the vehicle file is.

    python -m benchmarks study car_calibration [--cars 8] [--first 0] [--minutes 2] [--quick] [--json]

Each car is drawn by its seed: ratio 20 % less to 25 % more than the data sheet has, 0 to 0.2 s of dead time, 0.05 to
0.2 s of lag, an offset within 3 degrees, a gyro whose zero is off by up to 0.005 rad/s. Car, kit and the car server's
core (gate, checks, state machine, all of them) are those of a drive, on a clock of their own: no machine is too slow.
The operator engages again after whatever ends a drive. Dead time is that from the sample which a command is computed
from: what the gate and the 20 ms of the bus add to it is measured on the bus and part of the truth.
"""

import argparse
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.signal import lfilter

from benchmarks.tables import as_line, say, show
from steerkit.car import protocol
from steerkit.car.calibration import Guided
from steerkit.car.config import load
from steerkit.car.core import Core, Frame, Link, Packet, Reply, Send, Tick
from steerkit.car.estimates import Watched
from steerkit.car.simulated import SimulatedCar
from steerkit.car.state_machine import Mode, Order
from steerkit.diagram import realtime
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.paths.courses import course

Timed = Sequence[tuple[float, float]]
"""Times [s] and angles [rad]."""
COMPUTING = 0.003
"""From a sample to its request [s]."""
OPERATOR = 2
SHOWN = {
    "delay_lag": ("dead time and lag", 1e3, "ms"),
    "delay": ("dead time", 1e3, "ms"),
    "lag": ("lag", 1e3, "ms"),
    "steer_ratio": ("steering ratio", 100.0, "%"),
    "offset": ("offset", degrees_of(1.0), "deg"),
    "rate_zero": ("gyro's zero", degrees_of(1.0), "deg/s"),
}


class Yard:
    """A car, its car server's core and a guided drive, stepped by 10 ms; a line to the core for the drive."""

    def __init__(self, seed: int, minutes: float):
        rng = np.random.default_rng(seed)
        low, high = (0.8, 0.0, 0.05, radians_of(-3.0), -0.005), (1.25, 0.2, 0.2, radians_of(3.0), 0.005)
        ratio, delay, lag, offset, zero = map(float, rng.uniform(low, high))
        self.config = replace(load("dbw-kit.toml"), course=course("calibration"))
        true = replace(self.config.vehicle, steer_ratio=ratio * self.config.vehicle.steer_ratio)
        untold: dict[str, Any] = dict(vehicle=true, delay=delay, lag=lag, offset=offset, rate_zero=zero)
        self.car = SimulatedCar(self.config, seed=seed, v_min=4.0, v_max=5.0, **untold)
        self.truth = dict(steer_ratio=true.steer_ratio, delay=delay, lag=lag, offset=offset, rate_zero=zero)
        self.core, self.t = Core(self.config), 0.0
        self.last: protocol.Snapshot | None = None
        self.sent: list[tuple[float, float]] = []
        self.asked: list[tuple[float, float]] = []
        self.faults, self.worst, self.driven = list[str](), 0.0, 0
        for link, controls in ((1, True), (OPERATOR, False)):
            self._happens(Link(0.0, link, True))
            self.note(protocol.Hello(controls), link)
        while self.t < 8.0:
            self._step()
        line: Any = self
        self.watched = Watched(self.config, self.note)
        self.guided = Guided(config=self.config, link=line, minutes=minutes)
        resting = self.guided.follow.resting
        self.run = realtime.Run(resting, resting.init(), realtime.Timing(period=resting.dt))

    def calibrated(self, longest: float) -> dict[str, Any]:
        """Drive until all is driven, or for so long [s]; what is found."""
        self.note(protocol.Command(Order.ARM), OPERATOR)
        tick, over, end = 0, False, self.t + longest
        while not over and self.t < end:
            self._step()
            tick += 1
            if tick % 5 == 0:
                self.run.loop.advance(self.run.k, self.run.x, self.run.y)
                self.run.k += 1
                over = self.guided.step(self.run)
                self.watched.sample(self.last)
                self._note()
            if tick % 10 == 0:
                self._operate()
        late = self._late()
        self.truth["delay"] += late
        self.truth["delay_lag"] = self.truth["delay"] + self.truth["lag"]
        return self.watched.estimators.found()

    def query(self) -> protocol.Snapshot:
        """As a line to the car server has it; so are the next two."""
        self.note(protocol.Query())
        assert self.last is not None
        return self.last

    def request(self, delta_sw: float) -> None:
        """Sent once it is computed."""
        assert self.last is not None
        self.t += COMPUTING
        self.note(protocol.Request(self.last.t, delta_sw, 0))
        self.t -= COMPUTING

    def note(self, message: Any, link: int = 1) -> None:
        """Whatever else it is told."""
        self._happens(Packet(self.t, link, protocol.encode(message)))

    def _step(self) -> None:
        self.t = round(self.t + 0.01, 6)
        for when, frame_id, data in self.car.advance(self.t):
            self._happens(Frame(self.t, when, frame_id, data))
        self._happens(Tick(self.t))

    def _happens(self, event: Any) -> None:
        for out in self.core.handle(event):
            if isinstance(out, Send):
                self.car.receive(self.t, out.frame_id, out.data)
                self.sent.append((self.t, self.config.writer.read(out.data)[0]))
            elif isinstance(out, Reply):
                answer = protocol.decode(out.data)
                self.last = answer if isinstance(answer, protocol.Snapshot) else self.last

    def _operate(self) -> None:
        self.note(protocol.Beat(), OPERATOR)
        machine = self.core.machine
        if machine.mode in (Mode.FAULT, Mode.OVERRIDE):
            self.faults.append(machine.cause)
            self.note(protocol.Command(Order.ACKNOWLEDGE), OPERATOR)
        elif machine.mode is Mode.READY:
            self.note(protocol.Command(Order.ENGAGE), OPERATOR)

    def _note(self) -> None:
        assert self.last is not None
        self.asked.append((self.last.t, self.last.command))
        if self.last.mode is Mode.ENGAGED:
            self.worst, self.driven = max(self.worst, abs(self.last.e)), self.driven + 1

    def _late(self) -> float:
        """By how much commands come to the bus later than the samples that they are of [s]."""
        asked = [(t, angle) for t, angle in self.asked if np.isfinite(angle)]
        begin = max(asked[0][0], self.sent[0][0]) + 1.0
        return lateness(asked, self.sent, begin, asked[-1][0] - 0.1, self.truth["lag"])


def lateness(asked: Timed, sent: Timed, begin: float, end: float, lag: float) -> float:
    """By how much angles (t, angle) are sent later than the samples of which they were asked [s], as a motor of that
    lag feels it between `begin` and `end`: to 1 ms, 60 ms at most."""
    t = np.arange(begin, end, 0.001)
    keep = np.exp(-0.001 / lag)

    def felt(x: Any) -> Any:
        return lfilter([1.0 - keep], [1.0, -keep], x - x[0])

    (times, angles), (acting, moved) = np.array(asked).T, np.array(sent).T
    held = felt(angles[np.searchsorted(times, t, side="right")])
    acted = felt(moved[np.searchsorted(acting, t, side="right") - 1])
    start = 2000
    return 0.001 * min(range(60), key=lambda ms: float(np.mean((acted[start:] - held[start - ms : len(t) - ms]) ** 2)))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick drives one car for 12 s."""
    parser.add_argument("--cars", type=int, default=8, help="how many cars (default 8)")
    parser.add_argument("--first", type=int, default=0, help="seed of the first (default 0)")
    parser.add_argument("--minutes", type=float, default=2.0, help="of driving each, engaged (default 2)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Drive and print."""
    cars, minutes = (1, 0.2) if options.quick else (options.cars, options.minutes)
    rows: list[dict[str, Any]] = []
    for seed in range(options.first, options.first + cars):
        yard = Yard(seed, minutes)
        found = yard.calibrated(240.0 * minutes)
        row: dict[str, Any] = {"seed": seed, "faults": yard.faults, "worst_e_m": yard.worst, "driven": yard.driven}
        for name, (_, factor, _) in SHOWN.items():
            true, q = yard.truth[name], found[name]
            factor = factor / true if name == "steer_ratio" else factor
            row[name] = {"truth": true, "value": q.value, "low": q.low, "high": q.high, "valid": q.valid > 0.5}
            row[name] |= {"error": factor * (q.value - true), "holds": bool(q.low <= true <= q.high)}
        rows.append(row)
        say(f"{as_line(row)}; errors: {as_line({name: row[name]['error'] for name in SHOWN})}")
    figures: dict[str, Any] = {"cars": cars, "minutes": minutes, "rows": rows}
    figures["faults"] = sum(len(row["faults"]) for row in rows)
    figures["worst_e_m"] = max(row["worst_e_m"] for row in rows)
    figures["coverage_pct"] = 100.0 * float(np.mean([row[name]["holds"] for row in rows for name in SHOWN]))
    table = []
    for name, (text, _, unit) in SHOWN.items():
        errors = np.abs([row[name]["error"] for row in rows])
        share, holds = (100.0 * float(np.mean([row[name][key] for row in rows])) for key in ("valid", "holds"))
        figures[f"{name}_error"] = {"median": float(np.median(errors)), "worst": float(errors.max()), "unit": unit}
        figures[f"{name}_valid_pct"] = share
        table.append({"error": text, **figures[f"{name}_error"], "valid_pct": share, "covered_pct": holds})
    show(f"{cars} cars", table)
    return figures
