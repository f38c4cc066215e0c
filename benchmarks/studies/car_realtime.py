"""Drive the simulated car over a bus in real time, and say how punctual it was.

    python -m benchmarks study car_realtime --minutes 5 --json  # --quick: 3 s
    python -m benchmarks study car_realtime --minutes 6 --controller learn  # from nothing; --safe: with the filter
    python -m benchmarks study car_realtime --minutes 0.5 --compare --load 4  # SCHED_FIFO or not

Three processes: the simulated car on an slcan port, the car server that owns the bus, and this one with the
controller at 20 Hz. Counts steps, missed deadlines and lateness; then replays the recording through the server's core
and through the controllers, and compares every frame and every request bit for bit. --load: so many processes that do
nothing but compute run beside it.
"""

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks.tables import show, show_figures
from steerkit.car import loop as loops
from steerkit.car import protocol
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.client import CarClient, CarLost
from steerkit.car.core import Core
from steerkit.car.learner import CarLearner
from steerkit.car.session import Options, Session, session
from steerkit.car.state_machine import Mode, Order
from steerkit.diagram import realtime
from steerkit.learning.settings import DEFAULT
from steerkit.task import DT


@contextlib.contextmanager
def attended(socket_path: str) -> Iterator[None]:
    """Says, as an operator's panel does, that keys are read; for simulated cars only, where nobody has to let go.

    A car server that ends is waited for: another may come.
    """
    over = threading.Event()

    def beat() -> None:
        while not over.wait(0.05):
            with contextlib.suppress(CarLost), CarClient(socket_path, controller=False) as link:
                while not over.wait(0.05):
                    link.note(protocol.Beat())

    thread = threading.Thread(target=beat, name="operator", daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(5.0)


def engage(socket_path: str, *, timeout: float = 20.0) -> None:
    """Arm, acknowledge and engage as an operator would, waiting for READY; for tests and simulated cars."""
    orders = {Mode.OFF: Order.ARM, Mode.READY: Order.ENGAGE, Mode.FAULT: Order.ACKNOWLEDGE}
    orders[Mode.OVERRIDE] = Order.ACKNOWLEDGE
    end = time.monotonic() + timeout
    with CarClient(socket_path, controller=False) as operator:
        while (snapshot := operator.query()).mode is not Mode.ENGAGED:
            if snapshot.mode in orders:
                operator.order(orders[snapshot.mode])
            elif "kit " in snapshot.text:  # it has a fault latched
                operator.order(Order.ACKNOWLEDGE)
            if time.monotonic() > end:
                raise CarLost(f"not engaged within {timeout:g} s: {snapshot.mode}: {snapshot.text}")
            time.sleep(0.05)


def heard_by(log: Path) -> list[dict[str, Any]]:
    """What a simulated car has written down of what goes over the bus; not a last line that is half written."""
    lines = log.read_text(encoding="utf-8").splitlines()
    return [json.loads(line) for line in lines if line.endswith("}")]


def drive(
    controller: str,
    minutes: float,
    folder: Path,
    *,
    fifo: bool = False,
    busy: int = 0,
    safe: bool = False,
    seed: int = 0,
) -> dict[str, Any]:
    """One drive; its figures. safe: a learner's safety filter. seed: of the learner's nets and the human's speed."""
    place, log = folder / "drive.mcap", folder / "car.jsonl"
    options = Options(
        config="dbw-kit.toml",
        simulated=True,
        socket=str(folder / "socket"),
        recording=str(place),
        realtime=fifo,
        simulate={"log": str(log), "seed": seed},
    )
    beside = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
    squares, worst, engaged, lost, granted = 0.0, 0.0, 0, "", "not asked for"
    timing, engagements, more = realtime.Timing(period=DT), list[str](), dict[str, Any]()
    try:
        with session(options) as here, attended(here.socket):
            over = threading.Event()
            threading.Thread(target=operate, args=(here.socket, over, engagements), daemon=True).start()

            def watch(run: realtime.Run) -> None:
                nonlocal squares, worst, engaged, timing
                timing, snapshot = run.timing, here.link.last
                if snapshot and snapshot.mode is Mode.ENGAGED:
                    e = run.sample["path.e"]
                    squares, worst, engaged = squares + e * e, max(worst, abs(e)), engaged + 1

            if fifo:
                granted = realtime.preferred()
            seconds = 60.0 * minutes
            try:
                if controller == "learn":
                    learn(here, folder / "run", seconds, watch, more, safe=safe, seed=seed)
                else:
                    block = loops.controller_named(controller, here.config)
                    loops.drive(here.config, here.link, block, duration=seconds, clock=here.clock, watch=watch)
            except CarLost as error:  # a machine that stands still for a second
                lost = str(error)
            over.set()
    finally:
        if fifo:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        for process in beside:
            process.kill()
            process.wait()
    recorded = recordings.read(place)
    frames, same = recordings.replayed_exactly(recorded, Core(here.config))
    asked = same_asked = 0
    for drive in replays.drives(recorded):
        asked += len(drive.requests)
        same_asked += replays.replayed_requests(drive, here.config)
    heard = heard_by(log)
    times = [h["t"] for h in heard if h.get("enable") == 1]
    return {
        "controller": controller,
        "minutes": minutes,
        "sched_fifo": granted,
        "busy_processes": busy,
        **timing.summary(),
        **more,
        "lost": lost,
        "engagements": len(engagements),
        "faults": engagements[1:],
        "rms_e_m": (squares / max(1, engaged)) ** 0.5,
        "max_e_m": worst,
        "longest_gap_on_bus_ms": 1e3 * max((b - a for a, b in pairwise(times)), default=0.0),
        "frames_sent": frames,
        "frames_replayed_exactly": same,
        "requests": asked,
        "requests_replayed_exactly": same_asked,
        "recording_mb": place.stat().st_size / 1e6,
        "cores": os.cpu_count(),
        "load_average": os.getloadavg()[1],
    }


def operate(socket: str, over: threading.Event, engagements: list[str]) -> None:
    """The operator: engages, and engages again after whatever ended it; keeps the causes."""
    cause = ""
    try:
        while not over.is_set():
            with CarClient(socket, controller=False) as link:
                snapshot = link.query()
            if snapshot.mode in (Mode.FAULT, Mode.OVERRIDE):
                cause = snapshot.text.splitlines()[0]
            if snapshot.mode is not Mode.ENGAGED:
                engage(socket, timeout=60.0)
                engagements.append(cause)
            over.wait(0.2)
    except CarLost as error:
        if not over.is_set():
            engagements.append(str(error))


def learn(
    here: Session, place: Path, seconds: float, watch: Any, more: dict[str, Any], *, safe: bool, seed: int
) -> None:
    """A learning run from nothing; its counts go to `more`, those of the safety filter's of the last minute."""
    here.link.wait(timeout=10.0)
    best = since = 0.0
    failures = 0
    corrected: deque[bool] = deque(maxlen=round(60.0 / DT))
    with CarLearner(replace(DEFAULT, safe=safe), place, here.config, here.link, seed=seed) as learner:
        counts = learner.learner_state.counts

        def count(run: realtime.Run) -> bool:
            nonlocal best, since, failures
            watch(run)
            if safe and run.sample["supervisor.learning"] > 0.5:
                corrected.append(run.sample["safety.share"] > 0.0)
            if counts.failures > failures or here.link.last is None or here.link.last.mode is not Mode.ENGAGED:
                failures, since = counts.failures, counts.driven
            best = max(best, counts.driven - since)
            return False

        try:
            learner.run(seconds, clock=here.clock, watch=count)
        finally:  # also where the car is lost
            more |= {
                "nets": counts.updates,
                "transitions": len(learner.learner_state.transitions),
                "failures": counts.failures,
                "longest_without_failure_m": best,
                "filter_faults": dict(learner.filter_faults),
                "interventions_pct": 100.0 * sum(corrected) / max(1, len(corrected)),
            }


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick drives 3 s."""
    parser.add_argument("--controller", default="stanley", help="stanley, mpc, learn, or a policy's place")
    parser.add_argument("--safe", action="store_true", help="a safety filter before the gate, for `learn`")
    parser.add_argument("--seed", type=int, default=0, help="of the learner's nets, and of the human's speed")
    parser.add_argument("--minutes", type=float, default=None, help="of each drive (default 5)")
    parser.add_argument("--fifo", action="store_true", help="controller and car server under SCHED_FIFO")
    parser.add_argument("--load", type=int, default=0, help="processes that compute beside it")
    parser.add_argument("--compare", action="store_true", help="with and without SCHED_FIFO, idle and with --load")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Drive and print: once, or with and without SCHED_FIFO, idle and busy, side by side, as --compare asks."""
    minutes = (0.05 if options.quick else 5.0) if options.minutes is None else options.minutes
    ways = [(options.load, options.fifo)]
    if options.compare:
        ways = [(busy, fifo) for busy in dict.fromkeys((0, options.load)) for fifo in (False, True)]
    rows, how = [], {"safe": options.safe, "seed": options.seed}
    for busy, fifo in ways:
        with tempfile.TemporaryDirectory() as folder:
            rows.append(drive(options.controller, minutes, Path(folder), fifo=fifo, busy=busy, **how))
    if not options.compare:
        show_figures(rows[0])
        return rows[0]
    names = (
        "sched_fifo",
        "busy_processes",
        "load_average",
        "steps",
        "misses",
        "jitter_p50_ms",
        "jitter_p99_ms",
        "jitter_max_ms",
        "longest_step_ms",
        "longest_gap_on_bus_ms",
        "faults",
        "lost",
    )
    show("with and without SCHED_FIFO", [{name: row[name] for name in names} for row in rows])
    return {"drives": rows}
