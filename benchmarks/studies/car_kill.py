"""Frames on the bus after a kill: of the controller, the training process or the car server, at random moments.

    python -m benchmarks study car_kill [--kills N] [--victims NAME,...] [--seed N] [--quick] [--json]

A simulated car on an slcan port hears what goes over the bus and writes it down, with times of the one monotonic clock
that all processes share. Each round: a controller drives, one of the processes is killed (kill -9), and the time
is measured for which the kit still received commands with enable = 1, and the car's steering was enabled.

`controller`, `server`, `trainer`: of a learning run. After a kill of the controller or the car server both are started
again, the recording is opened and replayed, the transition store is compared with what had been committed before the
kill, and the run goes on from it. `proving.controller`, `proving.server`: in the middle of a manoeuvre of vehicle
testing. The recording is opened and replayed, and says that the run was cut.
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
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.studies.car_realtime import attended, engage, heard_by
from benchmarks.tables import as_line, say
from steerkit._support.clock import Clock
from steerkit._support.errors import known
from steerkit._support.files import write_text
from steerkit.car import loop as loops
from steerkit.car import processes
from steerkit.car import recording as recordings
from steerkit.car.client import CarClient, CarLost
from steerkit.car.config import CarConfig, load
from steerkit.car.core import Core
from steerkit.car.learner import CarLearner
from steerkit.car.prove import Proving, runs_in
from steerkit.car.state_machine import Order
from steerkit.diagram import realtime
from steerkit.learning.data.store import TransitionStore
from steerkit.learning.settings import setting
from steerkit.proving.manoeuvre import manoeuvre

LIMIT = 0.1
"""The bus has to be silent or neutral so soon after a kill [s]."""
LET_GO = 0.4
"""The car's own steering has to be off so soon [s]."""
CONFIG = "dbw-kit.toml"
V, A_Y = 5.0, 1.0
"""Speed [m/s] and acceleration [m/s^2] of the manoeuvre that is cut: they fit the kit."""
STRAIGHT = 724.0
"""Where the longest straight of its course begins [m]."""


def learn(folder: Path, config: CarConfig, link: CarClient) -> None:
    """Learn, and say now and then what is safely on disk."""
    with CarLearner(setting("default"), folder / "run", config, link) as learner:
        began = len(learner.learner_state.transitions)

        def watch(run: Any) -> bool:
            if run.timing.steps % 5 == 1:
                assert learner.store.writer is not None
                told = {
                    "began": began,
                    "committed": began + learner.store.writer.committed,
                    "net": learner.learner_state.net,  # not one that is still in training: a kill takes that along
                    "trainer": learner.trainer.pid,
                    "mode": str(link.last.mode) if link.last else "",
                    "faults": len(learner.trainer.faults),
                    "misses": run.timing.misses,
                }
                tell(folder, told)
            return False

        learner.run(float("inf"), clock=Clock(), watch=watch)


def prove(folder: Path, config: CarConfig, link: CarClient) -> None:
    """Drive a manoeuvre again and again, and say when a run has lasted for a while."""
    proving = Proving(config=config, link=link, manoeuvre=manoeuvre("sine").at(V, A_Y), yes=True)
    link.order(Order.ARM)

    def watch(run: Any) -> bool:
        over, driven = proving.step(run), proving.driving
        if driven and link.last is not None and link.last.t - driven["begin"] > 0.3:
            tell(folder, {"run": driven["number"]})
        return over

    resting = proving.follow.resting
    realtime.run(resting, timer=Clock(), watch=watch, on_miss=lambda run: loops.count_misses(run, link))


def tell(folder: Path, told: dict[str, Any]) -> None:
    """What the controller's process says to who kills it."""
    write_text(folder / "state.json", json.dumps(told), durable=False)


class Work(NamedTuple):
    """What the controller's process does."""

    child: Callable[[Path, CarConfig, CarClient], None]
    car: dict[str, float]
    """What the simulated car is given."""
    goes_on: bool
    """Does it go on after a kill? Else each kill has a car of its own."""


WORKS = {
    "learning": Work(learn, {}, goes_on=True),
    "proving": Work(prove, {"s": STRAIGHT, "v_min": V - 0.1, "v_max": V + 0.1}, goes_on=False),
}
VICTIMS = {
    "controller": ("learning", "controller"),
    "server": ("learning", "server"),
    "trainer": ("learning", "trainer"),
    "proving.controller": ("proving", "controller"),
    "proving.server": ("proving", "server"),
}
"""What is being done, and which process of it is killed."""


class Bench:
    """A simulated car, a car server and a controller, and rounds in which one of them is killed."""

    def __init__(self, name: str, folder: Path, dice: random.Random, longest: float):
        self.name, self.work = name, WORKS[name]
        self.folder, self.dice, self.longest = folder, dice, longest
        self.socket = str(folder / "socket")
        self.log = folder / "car.jsonl"
        self.simulated, self.channel = processes.start_simulated(CONFIG, log=str(self.log), **self.work.car)
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
            command = [sys.executable, "-m", __name__, self.name, str(self.folder)]
            self.controller = subprocess.Popen(command, stdout=self.text, stderr=self.text, encoding="utf-8")
        end = time.monotonic() + 90.0
        while time.monotonic() < end:
            state = self.state()
            if state:
                engage(self.socket, timeout=60.0)
                return state
            time.sleep(0.1)
        raise CarLost(f"the controller did not come up; see {self.folder}")

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
                engage(self.socket, timeout=60.0)
                time.sleep(0.3)
            mode = str(operator.query().mode)
        state = self.state()
        pids = {"controller": self.controller, "server": self.server}
        pid = state["trainer"] if victim == "trainer" else pids[victim].pid  # type: ignore[union-attr]
        killed = time.monotonic()
        os.kill(pid, signal.SIGKILL)
        time.sleep(2.0 * LET_GO)
        row: dict[str, Any] = {"mode": mode}
        if victim == "trainer":
            return row | self._after_trainer(killed, pid)
        for process in (self.controller, self.server) if victim == "server" else (self.controller,):
            assert process is not None
            process.wait(20.0)
        row |= self._bus(killed)
        row |= self._recording(cut=victim == "server")
        return row | (self._resumed(before, state) if self.work.goes_on else self._cut(state))

    def _bus(self, killed: float) -> dict[str, Any]:
        """For how long it was steered on."""
        heard = heard_by(self.log)
        steered = [h["t"] - killed for h in heard if h.get("enable") == 1]
        enabled = [h["t"] - killed for h in heard if h.get("enabled") is True]
        last = max((t for t in steered if t > 0.0), default=0.0)
        before = min((-t for t in steered if t <= 0.0), default=9.0)
        row: dict[str, Any] = {"silent_after_ms": 1e3 * last, "heard_before_ms": 1e3 * before}
        row["ok_bus"] = last <= LIMIT and before < 0.05  # it did steer
        told = [one["t"] - killed for one in heard if "enabled" in one]
        row["ok_let_go"] = max(told) > LET_GO >= max(enabled, default=0.0)
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

    def _resumed(self, before: dict[str, Any], state: dict[str, Any]) -> dict[str, Any]:
        """What a learning run still has, and whether it goes on from that."""
        store = TransitionStore(self.folder / "run" / "transitions.db").transitions()
        row = {"committed": state["committed"], "rows": len(store), "ok_store": len(store) >= state["committed"]}
        after_all = self.up()
        return row | {"ok_resumed": after_all["began"] >= state["committed"] and after_all["net"] >= before["net"]}

    def _cut(self, state: dict[str, Any]) -> dict[str, Any]:
        """What the recording says of the run of a manoeuvre in which it ended."""
        run = runs_in(self.folder / "copy.mcap")[-1]
        return {"cause": run["cause"], "ok_run": run["number"] == state["run"] and run["cause"] != ""}

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
        self.attended.close()
        for process in (self.controller, self.server, self.simulated):
            if process is not None and process.poll() is None:
                process.terminate()
                process.wait(20.0)
        self.text.close()


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick kills each victim once."""
    parser.add_argument("--kills", type=int, default=None, help="how many (default 50)")
    parser.add_argument("--victims", default=",".join(VICTIMS), help="which, in turn (default: all)")
    parser.add_argument("--seed", type=int, default=0)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Kill, look, print."""
    victims = [known(name, VICTIMS, "victim") for name in options.victims.split(",")]
    kills = (len(victims) if options.quick else 50) if options.kills is None else options.kills
    wanted = [victims[n % len(victims)] for n in range(kills)]
    dice = random.Random(options.seed)
    longest = 0.5 if options.quick else 2.0
    rows: list[dict[str, Any]] = []
    for name, work in WORKS.items():
        turns = [victim for victim in wanted if VICTIMS[victim][0] == name]
        for group in [turns] if work.goes_on and turns else [[victim] for victim in turns]:
            rows += killed(name, group, dice, longest)
    total: dict[str, Any] = {"kills": len(rows)}
    for victim in victims:
        mine = [r for r in rows if r["victim"] == victim]
        key = "longest_gap_ms" if victim == "trainer" else "silent_after_ms"
        names = ("ok_bus", "ok_let_go", "ok_recording", "ok_store", "ok_resumed", "ok_run")
        checks = {k: sum(r[k] for r in mine) for k in names if any(k in r for r in mine)}
        total[victim] = {"kills": len(mine), f"worst_{key}": max((r[key] for r in mine), default=0.0), **checks}
    for name, value in total.items():
        print(name, value)
    return total


def killed(name: str, victims: list[str], dice: random.Random, longest: float) -> list[dict[str, Any]]:
    """Kills on one simulated car."""
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(name, Path(folder), dice, longest)
        try:
            for victim in victims:
                rows.append({"victim": victim} | bench.kill(VICTIMS[victim][1]))
                say(as_line(rows[-1]))
        except Exception:
            print((Path(folder) / "text.log").read_text(encoding="utf-8")[-3000:])
            raise
        finally:
            bench.down()
    return rows


def controller(name: str, folder: Path) -> None:
    """The process that is the controller."""
    with CarClient(str(folder / "socket")) as link:
        link.wait(timeout=10.0)
        WORKS[name].child(folder, load(CONFIG), link)


if __name__ == "__main__":  # as `Bench` starts it
    controller(sys.argv[1], Path(sys.argv[2]))
