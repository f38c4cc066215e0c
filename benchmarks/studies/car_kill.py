"""Frames on the bus after a kill: of the controller, the training process or the car server, at random moments.

    python -m benchmarks study car_kill [--kills N] [--victims NAME,...] [--seed N] [--quick] [--json]

A simulated car on an slcan port hears what goes over the bus and writes it down, with times of the one monotonic clock
that all processes share. Each round: a learning run drives, one of its processes is killed (kill -9), and the time
is measured for which the kit still received commands with enable = 1. After a kill of the controller or the car server
both are started again, the recording is opened and replayed, the transition store is compared with what had been
committed before the kill, and the run goes on from it.
"""

import argparse
import contextlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from itertools import pairwise
from pathlib import Path
from typing import Any

from benchmarks.studies.car_realtime import attended, engage, heard_by
from benchmarks.tables import as_line, say
from steerkit._support.clock import Clock
from steerkit._support.files import write_text
from steerkit.car import processes
from steerkit.car import recording as recordings
from steerkit.car.client import CarClient, CarLost
from steerkit.car.config import load
from steerkit.car.core import Core
from steerkit.car.learner import CarLearner
from steerkit.learning.data.store import TransitionStore
from steerkit.learning.settings import setting

LIMIT = 0.1
"""The bus has to be silent or neutral so soon after a kill [s]."""
CONFIG = "dbw-kit.toml"


def controller(folder: Path) -> None:
    """The process that is the controller: it learns, and says now and then what is safely on disk."""
    config = load(CONFIG)
    with CarClient(str(folder / "socket")) as link:
        link.wait(timeout=10.0)
        with CarLearner(setting("default"), folder / "run", config, link) as learner:
            began = len(learner.learner_state.transitions)

            def watch(run: Any) -> bool:
                if run.timing.steps % 5 == 1:
                    assert learner.store.writer is not None
                    state = {
                        "began": began,
                        "committed": began + learner.store.writer.committed,
                        "net": learner.learner_state.net,  # not one that is still in training: a kill takes that along
                        "trainer": learner.trainer.pid,
                        "mode": str(link.last.mode) if link.last else "",
                        "faults": len(learner.trainer.faults),
                        "misses": run.timing.misses,
                    }
                    write_text(folder / "state.json", json.dumps(state), durable=False)
                return False

            learner.run(float("inf"), clock=Clock(), watch=watch)


class Bench:
    """A simulated car, a car server and a controller that learns, and rounds in which one of them is killed."""

    def __init__(self, folder: Path, seed: int, longest: float):
        self.folder, self.dice, self.longest = folder, random.Random(seed), longest
        self.socket = str(folder / "socket")
        self.log = folder / "car.jsonl"
        self.simulated, self.channel = processes.start_simulated(CONFIG, log=str(self.log))
        self.recordings = 0
        self.server: subprocess.Popen[str] | None = None
        self.controller: subprocess.Popen[str] | None = None
        self.text = (folder / "text.log").open("w", encoding="utf-8")
        self.attended = contextlib.ExitStack()
        self.attended.enter_context(attended(self.socket))

    def up(self) -> dict[str, Any]:
        """Start what is not running, and engage; returns the controller's state."""
        if self.server is None or self.server.poll() is not None:
            self.recordings += 1
            self.server = processes.start_car_server(
                CONFIG, self.socket, recording=str(self.recording), channel=self.channel, log=self.text
            )
        if self.controller is None or self.controller.poll() is not None:
            (self.folder / "state.json").unlink(missing_ok=True)
            command = [sys.executable, "-m", __name__, str(self.folder)]
            self.controller = subprocess.Popen(command, stdout=self.text, stderr=self.text, encoding="utf-8")
        end = time.monotonic() + 90.0
        while time.monotonic() < end:
            state = self.state()
            if state:
                self.engage()
                return state
            time.sleep(0.1)
        raise CarLost(f"the controller did not come up; see {self.folder}")

    def engage(self) -> None:
        """As an operator would, again and again until it is done."""
        engage(self.socket, timeout=60.0)

    @property
    def recording(self) -> Path:
        return self.folder / f"drive-{self.recordings:03d}.mcap"

    def state(self) -> dict[str, Any]:
        """What the controller last wrote."""
        try:
            return json.loads((self.folder / "state.json").read_text(encoding="utf-8"))
        except (FileNotFoundError, json.JSONDecodeError):
            return {}

    def kill(self, victim: str) -> dict[str, Any]:
        """One round; returns what happened."""
        before = self.up()
        time.sleep(self.dice.uniform(0.3, self.longest))
        with CarClient(self.socket, controller=False) as operator:
            if operator.query().mode != "ENGAGED":  # the learner went too far off; that is not what is tested here
                self.engage()
                time.sleep(0.3)
            mode = str(operator.query().mode)
        state = self.state()
        pids = {"controller": self.controller, "server": self.server}
        pid = state["trainer"] if victim == "trainer" else pids[victim].pid  # type: ignore[union-attr]
        killed = time.monotonic()
        os.kill(pid, signal.SIGKILL)
        time.sleep(0.6)
        row: dict[str, Any] = {"victim": victim, "mode": mode}
        if victim == "trainer":
            return row | self._after_trainer(killed, pid)
        heard = heard_by(self.log)
        after = [h["t"] - killed for h in heard if h.get("enable") == 1 and h["t"] > killed]
        row["silent_after_ms"] = 1e3 * max(after, default=0.0)
        row["heard_before_ms"] = 1e3 * min(
            (killed - h["t"] for h in heard if h.get("enable") == 1 and h["t"] <= killed), default=9.0
        )
        for process in (self.controller, self.server) if victim == "server" else (self.controller,):
            assert process is not None
            process.wait(20.0)
        row["ok_bus"] = row["silent_after_ms"] <= 1e3 * LIMIT and row["heard_before_ms"] < 50.0  # it did steer
        row |= self._recording(cut=victim == "server")
        store = TransitionStore(self.folder / "run" / "transitions.db").transitions()
        row |= {"committed": state["committed"], "rows": len(store), "ok_store": len(store) >= state["committed"]}
        after_all = self.up()
        row["ok_resumed"] = after_all["began"] >= state["committed"] and after_all["net"] >= before["net"]
        return row

    def _recording(self, *, cut: bool) -> dict[str, Any]:
        copy = self.folder / "copy.mcap"
        shutil.copy(self.recording, copy)
        try:
            recorded = recordings.read(copy)
            frames, same = recordings.replayed_exactly(recorded, Core(recordings.config_of(recorded)))
        except ValueError as error:
            return {"ok_recording": False, "why": str(error)}
        last_heard = max(h["t"] for h in heard_by(self.log) if "enable" in h)
        lost = last_heard - max(v["t"] for v in recorded.of("/can/tx")) if cut else 0.0
        ok = same >= frames - 1 and lost <= 1.0
        return {"ok_recording": ok, "recorded_frames": frames, "replayed": same, "recording_lost_s": max(0.0, lost)}

    def _after_trainer(self, killed: float, pid: int) -> dict[str, Any]:
        """The car must not notice, and a new training process must come up."""
        end = time.monotonic() + 30.0
        while time.monotonic() < end and self.state().get("trainer") in (None, pid):
            time.sleep(0.2)
        times = [h["t"] for h in heard_by(self.log) if h.get("enable") == 1 and killed - 0.5 <= h["t"] <= killed + 0.5]
        gap = max((b - a for a, b in pairwise(times)), default=9.0)
        back = self.state().get("trainer") not in (None, pid)
        return {"longest_gap_ms": 1e3 * gap, "ok_bus": gap <= LIMIT, "ok_resumed": back}

    def down(self) -> None:
        """End all of it."""
        for process in (self.controller, self.server, self.simulated):
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(20.0)
        self.text.close()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick kills each victim once."""
    parser.add_argument("--kills", type=int, default=None, help="how many (default 50)")
    parser.add_argument("--victims", default="controller,server,trainer")
    parser.add_argument("--seed", type=int, default=0)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Kill, look, print."""
    victims = options.victims.split(",")
    kills = (len(victims) if options.quick else 50) if options.kills is None else options.kills
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), options.seed, 0.5 if options.quick else 2.0)
        try:
            for n in range(kills):
                rows.append(bench.kill(victims[n % len(victims)]))
                say(f"{n + 1} of {kills}: {as_line(rows[-1])}")
        except Exception:
            print((Path(folder) / "text.log").read_text(encoding="utf-8")[-3000:])
            raise
        finally:
            bench.down()
    total: dict[str, Any] = {"kills": len(rows)}
    for victim in victims:
        mine = [r for r in rows if r["victim"] == victim]
        key = "longest_gap_ms" if victim == "trainer" else "silent_after_ms"
        names = ("ok_bus", "ok_recording", "ok_store", "ok_resumed")
        checks = {k: sum(r[k] for r in mine) for k in names if any(k in r for r in mine)}
        total[victim] = {"kills": len(mine), f"worst_{key}": max((r[key] for r in mine), default=0.0), **checks}
    for name, value in total.items():
        print(name, value)
    return total


if __name__ == "__main__":  # as `Bench` starts it
    controller(Path(sys.argv[1]))
