"""Drive the simulated car over a bus in real time, and say how punctual it was.

    python benchmarks/car_realtime.py --minutes 5 --json
    python benchmarks/car_realtime.py --minutes 6 --controller learn     # from nothing, training in the background

Three processes: the simulated car on an slcan port, the driver process that owns the bus, and this one with the
controller at 20 Hz. Counts steps, missed deadlines and lateness; then replays the recording through the driver's core
and through the controller, and compares every frame and every request bit for bit.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import threading
from itertools import pairwise
from pathlib import Path
from typing import Any

from steerkit import car as cars
from steerkit import car_replay as replays
from steerkit import realtime
from steerkit.clock import Clock
from steerkit.plants.real_car import recording as tapes
from steerkit.plants.real_car.client import CarLost, DriverLink
from steerkit.plants.real_car.config import load
from steerkit.plants.real_car.core import Core
from steerkit.plants.real_car.states import Mode


def measure(controller: str, minutes: float, scale: float, folder: Path, listen: str = "") -> dict[str, Any]:
    """One drive; returns its figures."""
    config = load("dbw-kit.toml")
    path = cars.course_of(config)
    socket, tape, log = str(folder / "socket"), folder / "drive.mcap", folder / "car.jsonl"
    simulated, channel = cars.start_simulated("dbw-kit.toml", time_scale=scale, log=str(log), listen=listen)
    with (folder / "driver.log").open("w") as text:
        driver = cars.start_driver(
            "dbw-kit.toml", socket, recording=str(tape), channel=channel, time_scale=scale, log=text
        )
    try:
        with DriverLink(socket) as link:
            over = threading.Event()
            engagements: list[str] = []
            threading.Thread(target=operate, args=(socket, over, engagements), daemon=True).start()
            squares, worst, engaged = 0.0, 0.0, 0

            def watch(run: realtime.Run) -> None:
                nonlocal squares, worst, engaged
                snapshot = link.last
                if snapshot and snapshot.mode is Mode.ENGAGED:
                    e = run.sample["path.e"]
                    squares, worst, engaged = squares + e * e, max(worst, abs(e)), engaged + 1

            clock = Clock(scale=scale)
            more: dict[str, Any] = {}
            if controller == "learn":
                run = learn(config, path, link, folder / "run", 60.0 * minutes, clock, watch, more)
            else:
                block = cars.controller_named(controller, config)
                run = cars.drive(config, path, link, block, duration=60.0 * minutes, clock=clock, watch=watch)
            over.set()
            last = link.last
            assert last is not None
    finally:
        driver.terminate()
        driver.wait(10.0)
        simulated.terminate()
    recorded = tapes.read(tape)
    frames, same = tapes.replayed_exactly(recorded, Core(config, path))
    asked = same_asked = 0
    for drive in replays.drives(recorded):
        asked += len(drive.requests)
        same_asked += replays.replayed_requests(drive, config, path)
    heard = [json.loads(line) for line in log.read_text().splitlines()]
    times = [h["t"] for h in heard if h.get("enable") == 1]
    print(realtime.histogram_text(run.timing))
    return {
        "controller": controller, "minutes": minutes, "time_scale": scale, "bus": channel.split(":")[0],
        **run.timing.summary(), **more, "engagements": len(engagements), "faults": engagements[1:],
        "mode_at_end": str(last.mode), "cause": last.text.splitlines()[0],
        "engaged_steps": engaged, "rms_e_m": (squares / max(1, engaged)) ** 0.5, "max_e_m": worst,
        "distance_m": max(h["progress"] for h in heard if "progress" in h),
        "longest_gap_on_bus_ms": 1e3 * max((b - a for a, b in pairwise(times)), default=0.0),
        "frame_errors": last.errors, "frames_sent": frames, "frames_replayed_exactly": same,
        "requests": asked, "requests_replayed_exactly": same_asked,
        "recording_mb": tape.stat().st_size / 1e6, "cores": os.cpu_count(), "load_average": os.getloadavg()[1],
    }  # fmt: skip


def operate(socket: str, over: threading.Event, engagements: list[str]) -> None:
    """The operator: engages, and engages again after whatever ended it; keeps the causes."""
    cause = ""
    try:
        while not over.is_set():
            with DriverLink(socket, controller=False) as link:
                snapshot = link.query()
            if snapshot.mode in (Mode.FAULT, Mode.OVERRIDE):
                cause = snapshot.text.splitlines()[0]
            if snapshot.mode is not Mode.ENGAGED:
                cars.engage(socket, timeout=60.0)
                engagements.append(cause)
            over.wait(0.2)
    except CarLost as error:
        if not over.is_set():
            engagements.append(str(error))


def learn(
    config: Any,
    path: Any,
    link: DriverLink,
    place: Path,
    seconds: float,
    clock: Clock,
    watch: Any,
    more: dict[str, Any],
) -> realtime.Run:
    """A learning run from nothing; its counts go to `more`."""
    from steerkit.learning.on_car import CarLearner
    from steerkit.learning.settings import setting

    link.wait(timeout=10.0)
    best = since = 0.0
    failures = 0

    def build(policy: Any, doe: Any) -> Any:
        return cars.car_loop(config, path, link, policy, doe=doe)

    with CarLearner(setting("default"), place, build, link) as learner:

        def count(run: realtime.Run) -> bool:
            nonlocal best, since, failures
            watch(run)
            if learner.failures > failures or link.last is None or link.last.mode is not Mode.ENGAGED:
                failures, since = learner.failures, learner.driven
            best = max(best, learner.driven - since)
            return False

        run = learner.run(seconds, clock=clock, watch=count)
        more |= {
            "nets": learner.updates, "transitions": len(learner.transitions), "failures": learner.failures,
            "by_learner_m": learner.driven, "longest_without_failure_m": best,
            "rounds_without_failure": best / path.length, "trainer_faults": list(learner.trainer.faults),
        }  # fmt: skip
        return run


def main() -> None:
    """Read the options, drive, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--controller", default="stanley", help="stanley, mpc, learn, or a policy's place")
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--time-scale", type=float, default=1.0, help="1 is real time")
    parser.add_argument("--listen", default="", help="127.0.0.1:0 for TCP instead of a pseudo-terminal")
    parser.add_argument("--json", action="store_true", help="print one JSON object as the last line")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        row = measure(options.controller, options.minutes, options.time_scale, Path(folder), options.listen)
    for name, value in row.items():
        print(f"{name:26s} {value:.4g}" if isinstance(value, float) else f"{name:26s} {value}")
    if options.json:
        print(json.dumps(row))


if __name__ == "__main__":
    main()
