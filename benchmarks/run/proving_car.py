"""Manoeuvres of vehicle testing on simulated cars behind the bus: a kit, and production cars through opendbc's ports.

`measure` drives every manoeuvre that ships, at a speed and a size that fit each car, provokes whatever aborts a run,
and kills a process with kill -9 in the middle of each manoeuvre. Drives and aborts are in one process, with the car
server's core, gate and port (judged by opendbc's safety code in C); the kills are among real processes in real time.
"""

import contextlib
import math
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.run.production import ProductionWorld
from benchmarks.studies.car_realtime import attended, heard_by
from benchmarks.tables import as_line, say
from steerkit._support.clock import Clock
from steerkit.car import loop as loops
from steerkit.car import processes
from steerkit.car import recording as recordings
from steerkit.car.client import CarClient, CarLost
from steerkit.car.config import CarConfig, load, shipped
from steerkit.car.core import Event, Send
from steerkit.car.protocol import Snapshot
from steerkit.car.prove import Proving, most, on_course, runs_in
from steerkit.car.simulated import Fault
from steerkit.car.state_machine import Mode, Order
from steerkit.diagram import realtime
from steerkit.paths.courses import bends
from steerkit.paths.path import Path as Course
from steerkit.proving.manoeuvre import Manoeuvre, manoeuvre, names
from steerkit.task import DT

KIT = "dbw-kit.toml"
CARS = {KIT: (8.0, "stanley", 40.0), "TESLA_MODEL_3": (15.0, "mpc", 200.0), "TOYOTA_RAV4": (15.0, "mpc", 200.0)}
"""A kit, a production car by angle and one by torque: how fast each drives [m/s], by which controller between the runs
(Stanley swings with a slow torque), on which bends [m]."""
SILENT = 0.15
"""So soon after a kill no command may steer any more [s]."""
REPORTS = 0.6
"""After a kill the simulated car is watched for so long [s]."""
QUICK = ("step-steer",)


@cache
def oval(straight: float = 400.0, radius: float = 40.0) -> Course:
    """A closed course with two long straights [m]."""
    ramp = 0.4 * radius
    return bends([(straight, 90.0, radius, ramp), (10.0, 90.0, radius, ramp)] * 2, name="oval")


def config_on(course: Course, folder: Path, name: str = KIT) -> CarConfig:
    """A car's file on that course, written into a folder so that a recording holds all of it."""
    course.to_csv(folder / "course.csv")
    text = shipped(name if name == KIT else "production-car.toml").read_text(encoding="utf-8")
    for known in ("paper", "highway"):
        text = text.replace(f'[course]\nname = "{known}"', '[course]\nfile = "course.csv"\nclosed = true')
    (folder / "car.toml").write_text(text.replace("TESLA_MODEL_3", name), encoding="utf-8")
    return load(str(folder / "car.toml"))


def fitting(name: str, config: CarConfig, v: float) -> Manoeuvre:
    """A manoeuvre that ships, at that speed [m/s] and at most as large as it fits the car's limits, to each side once.

    On a course: as it is.
    """
    made = replace(manoeuvre(name).at(v), repeats=1)
    if on_course(made):
        return made
    asked = made.required.a_y or 1.0
    return made.at(a_y=math.floor(100.0 * min(asked, 0.95 * min(most(made, config, v).values()))) / 100.0)


class ProvingWorld(ProductionWorld):
    """Car, car server's core and the runs of a manoeuvre in one process.

    beyond: commands outside the gate's limits, or sent while nobody drives.
    """

    def __init__(self, wanted: Manoeuvre, config: CarConfig, *, file: Path | None = None, **more: Any):
        self.recorder = recordings.Recording(file, recordings.described(config)) if file else None
        self.beyond, self.before = 0, (-math.inf, 0.0)
        how = {key: more.pop(key) for key in ("base", "minutes", "yes") if key in more}
        v = wanted.conditions.v
        given = {"s": 20.0, "v_min": v - 0.1, "v_max": v + 0.1}
        super().__init__(config, **given | more)
        self.lasting, self.over = True, False
        self.seen: list[Snapshot] = []
        link: Any = self
        self.proving = Proving(config=config, link=link, manoeuvre=wanted, **how)
        resting = self.proving.follow.resting
        self.run = realtime.Run(resting, resting.init(), realtime.Timing(period=DT))
        self.order(Order.ARM)

    @property
    def runs(self) -> list[dict[str, Any]]:
        """As `Proving.runs`."""
        return self.proving.runs

    def step(self) -> None:
        """A sample."""
        self.run.loop.advance(self.run.k, self.run.x, self.run.y)
        self.run.k += 1
        assert self.last is not None
        self.seen.append(self.last)
        self.over = self.over or self.proving.step(self.run)

    def drive(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Step by step for so long, or until that is true; is it?"""
        end = self.t + seconds
        while self.t < end - 1e-9 and not until():
            self.step()
        return until()

    def begin(self, seconds: float = 300.0) -> dict[str, Any]:
        """Engage, consent, and wait for the next run."""
        self.proving.yes, before = True, len(self.runs)
        assert self.drive(seconds, lambda: len(self.runs) > before), (self.proving.status(), self.core.obstacles())
        self.proving.yes = False
        return self.runs[-1]

    def fault(self, kind: str, target: str = "report", length: float = 0.3, **more: Any) -> None:
        """From now on."""
        self.car.faults.append(Fault(kind=kind, target=target, start=self.t, length=length, **more))

    def told(self, event: Event, outputs: list[Any]) -> None:
        """Record an event, and judge what is sent."""
        if self.recorder:
            self.recorder.event(event, outputs)
        gate, v = self.config.gate, self.core.senses.values
        for out in outputs:
            if not isinstance(out, Send):
                continue
            angle, enable, _ = self.config.writer.read(out.data)
            (t, last), now = self.before, self.t
            fast, dt = max(abs(v["v"]), abs(v["v_kit"]), gate.v_floor), min(now - t, gate.dt_max)
            kappa = [math.tan(one / gate.steer_ratio) / gate.length(fast) for one in (last, angle)]
            step = 1.01 * gate.quantum / gate.steer_ratio / gate.length(fast)
            wrong = [enable and self.mode is not Mode.ENGAGED, abs(angle) > gate.delta_sw_max + 1e-9]
            if enable and math.isfinite(t):
                grows = abs(kappa[1]) > abs(kappa[0])
                wrong += [
                    now - t < gate.dt_min - 1e-6,
                    abs(angle - last) > gate.rate(fast) * dt + 1.01 * gate.quantum,
                    abs(kappa[1] - kappa[0]) > gate.jerk_max / fast**2 * dt + step,
                    grows and abs(kappa[1]) > gate.a_y_max / fast**2 + step,
                ]
            self.beyond += any(wrong)
            self.before = (now, angle) if enable else (-math.inf, 0.0)

    @property
    def beyond_gate(self) -> int:
        """Those and, of a production car, what its safety code rejected."""
        return self.beyond + (self.car.car.counts.rejected if self.config.port else 0)

    def close(self) -> None:
        """Write the recording's end."""
        if self.recorder:
            self.recorder.close()


def _slower(world: ProvingWorld) -> None:
    car = world.car.car if world.config.port else world.car
    v = world.proving.manoeuvre.conditions.v
    car.pedals = replace(car.pedals, driver=replace(car.pedals.driver, v_min=v - 0.95, v_max=v - 0.9))


def _no_bus(world: ProvingWorld) -> None:
    world.fault("drop", "pose")
    world.fault("drop")


def _gone(world: ProvingWorld) -> None:
    """The controller: no request any more."""
    world.until(world.t + 0.5)


HAPPENS: dict[str, tuple[Callable[[ProvingWorld], Any], str]] = {
    "driver's torque": (lambda world: world.fault("torque", amount=5.0), "OVERRIDE"),
    "override": (lambda world: world.fault("override"), "OVERRIDE"),
    "brake": (lambda world: world.fault("brake"), "OVERRIDE: brake"),
    "pose lost": (lambda world: world.fault("drop", "pose"), "FAULT"),
    "bus lost": (_no_bus, "FAULT"),
    "kit's fault": (lambda world: world.fault("kit_fault"), "FAULT"),
    "operator's key": (lambda world: world.order(Order.DISENGAGE), "STANDBY: operator"),
    "panel silent": (lambda world: setattr(world, "beats", False), "FAULT: operator silent"),
    "controller silent": (_gone, "FAULT: controller silent"),
    "speed": (_slower, "v - "),
}
"""What ends a run from outside, and how its cause begins."""
WATCHED = {"a_y": 0.5, "e": 0.9, "r": 0.5}
"""What `Abort` watches, and a bound as a share of what the run reaches: a tighter one than it was checked with."""


def _course(car: str, name: str) -> Course:
    """With straights that are long enough for that manoeuvre."""
    v, _, radius = CARS[car]
    made = manoeuvre(name)
    return oval(300.0 if on_course(made) else max(45.0 * v, v * (made.seconds + 8.0)), radius)


def driven(car: str, name: str, folder: Path, sides: int = 2) -> dict[str, Any]:
    """All runs of a manoeuvre on a car, to so many sides."""
    v, base, _ = CARS[car]
    config = config_on(_course(car, name), folder, car)
    wanted = fitting(name, config, v)
    wanted = replace(wanted, sides=wanted.sides[:sides])
    start = 300.0 - 10.0 * v if on_course(wanted) else 20.0  # a bend is what there is to drive there
    world = ProvingWorld(wanted, config, yes=True, base=base, minutes=0.3, s=start)
    world.drive(1500.0, lambda: world.over)
    runs = world.runs
    return {
        "car": car,
        "manoeuvre": name,
        "a_y": runs[-1]["a_y"] if runs else math.nan,
        "runs": len(runs),
        "valid": sum(run["cause"] == "" for run in runs),
        "causes": [run["cause"] for run in runs if run["cause"]],
        "max_e": max([abs(s.e) for s in world.seen if s.mode is Mode.ENGAGED], default=math.nan),
        "max_a_y": max([abs(s.a_y) for s in world.seen if s.mode is Mode.ENGAGED], default=math.nan),
        "beyond_gate": world.beyond_gate,
    }


def aborted(car: str, what: str, folder: Path) -> dict[str, Any]:
    """A run that something ends; kept: did the base controller, or the human, have the car at once?"""
    v, base, _ = CARS[car]
    config = config_on(_course(car, "sine"), folder, car)
    name, v = ("openpilot-sine-20", min(v, 10.0)) if what == "r" else ("sine", v)  # where r gets above its least bound
    wanted = replace(fitting(name, config, v), sides=("left",))
    world = ProvingWorld(wanted, config, base=base)
    run = world.begin()
    world.drive(0.3)
    if what in WATCHED:  # the bounds that a run was checked with are those of the linear car
        reached = {"a_y": wanted.required.a_y, "r": wanted.required.a_y / v, "e": abs(world.seen[-1].e) + 0.1}
        bound = replace(wanted.abort, **{what: WATCHED[what] * reached[what]}) if what != "r" else None
        bound = bound or replace(wanted.abort, r=max(0.05, WATCHED[what] * reached[what]))
        world.proving.manoeuvre = replace(wanted, abort=bound)
        cause = f"{what}: "
    else:
        happens, cause = HAPPENS[what]
        happens(world)
    world.drive(wanted.seconds, lambda: run["end"] is not None)
    told = run["cause"] or ""
    ended = world.t
    world.drive(1.0)
    engaged = world.mode is Mode.ENGAGED
    block: Any = world.run.loop.blocks["controller"]
    steers = block.amplitude == 0.0
    return {
        "car": car,
        "what": what,
        "cause": told,
        "ok": told.startswith(cause) and steers and engaged is (what in (*WATCHED, "speed")),
        "after_s": ended - run["begin"],
        "beyond_gate": world.beyond_gate,
    }


class Killed:
    """A simulated car of its own process, and rounds in which a car server or a controller that proves is killed."""

    def __init__(self, car: str, folder: Path):
        self.car, self.folder, self.log, self.number = car, folder, folder / "car.jsonl", 0
        config_on(_course(car, "random-steer"), folder, car)
        self.file, v = str(folder / "car.toml"), CARS[car][0]
        given: dict[str, Any] = {"log": str(self.log), "v_min": v - 0.1, "v_max": v + 0.1}
        self.simulated, self.channel = processes.start_simulated(self.file, **given)
        self.text = (folder / "text.log").open("w", encoding="utf-8")

    def kill(self, name: str, victim: str, longest: float = 150.0) -> dict[str, Any]:
        """Kill one in the middle of a run; returns what happened."""
        self.number += 1
        socket, file = str(self.folder / f"s{self.number}"), self.folder / f"{self.number}.mcap"
        how: dict[str, Any] = {"recording": str(file), "channel": self.channel, "log": self.text}
        server = processes.start_car_server(self.file, socket, **how)
        command = [sys.executable, "-m", __name__, self.file, socket, name, self.car]
        child = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=self.text, encoding="utf-8")
        row: dict[str, Any] = {"car": self.car, "manoeuvre": name, "victim": victim, "killed": False}
        try:
            with attended(socket):
                assert child.stdout is not None
                timer = _ended_after(child, longest)
                row["killed"] = child.stdout.readline().startswith("running")
                timer.cancel()
                at = time.monotonic()
                os.kill(child.pid if victim == "controller" else server.pid, signal.SIGKILL)
                time.sleep(REPORTS)
                after = [line for line in heard_by(self.log) if line["t"] > at]
                heard = [line["t"] - at for line in after if line.get("enable") == 1]
                on = [line["t"] - at for line in after if line.get("enabled") is True]
                row["silent_s"] = max([0.0, *heard])
                row["silent"] = row["silent_s"] <= SILENT and len(after) > 0 and not any(t > 0.4 for t in on)
        finally:
            for process in (child, server):
                process.terminate()
                process.wait(20.0)
        try:
            runs = runs_in(file)
            row |= {"readable": bool(runs) and bool(runs[-1]["cause"]), "cause": runs[-1]["cause"] if runs else ""}
        except ValueError as error:
            row |= {"readable": False, "cause": str(error)}
        return row

    def down(self) -> None:
        """End the simulated car."""
        self.simulated.terminate()
        self.simulated.wait(20.0)
        self.text.close()


def _ended_after(child: subprocess.Popen[str], seconds: float) -> Any:
    from threading import Timer

    timer = Timer(seconds, child.terminate)
    timer.daemon = True
    timer.start()
    return timer


def prove(file: str, socket: str, name: str, car: str) -> None:
    """The process that is the controller: it proves, and says when a run has lasted for a while."""
    config, (v, base, _) = load(file), CARS[car]
    with CarClient(socket) as link:
        link.wait(timeout=20.0)
        wanted = replace(fitting(name, config, v), repeats=20)
        proving = Proving(config=config, link=link, manoeuvre=wanted, base=base, yes=True, minutes=1.0)
        link.order(Order.ARM)
        seconds = 1.0 if on_course(wanted) else 0.4 * min(wanted.seconds, 6.0)

        def watch(live: Any) -> bool:
            over, run = proving.step(live), proving.driving
            if run and link.last is not None and link.last.t - run["begin"] > seconds:
                print("running", flush=True)
            return over

        with contextlib.suppress(CarLost, BrokenPipeError):
            resting = proving.follow.resting
            realtime.run(resting, timer=Clock(), watch=watch, on_miss=lambda live: loops.count_misses(live, link))


def measure(quick: bool) -> dict[str, Any]:
    """Everything, or with `quick` one manoeuvre of the kit to one side, an abort and a kill; rows are under `rows`."""
    rows: dict[str, list[dict[str, Any]]] = {"driven": [], "aborted": [], "killed": []}

    def done(part: str, row: dict[str, Any]) -> None:
        rows[part].append(row)
        say(f"{part}: {as_line(row)}")

    wanted = QUICK if quick else names()
    for car in [KIT] if quick else CARS:
        with tempfile.TemporaryDirectory() as folder:
            for name in wanted:
                done("driven", driven(car, name, Path(folder), 1 if quick else 2))
            for what in (*HAPPENS, *WATCHED)[-1:] if quick else (*HAPPENS, *WATCHED):
                if what == "brake" and car == KIT:
                    continue  # the shipped kit does not tell
                done("aborted", aborted(car, what, Path(folder)))
        with tempfile.TemporaryDirectory() as folder:
            bench = Killed(car, Path(folder))
            try:
                for k, name in enumerate(wanted[:1] if quick else wanted):
                    done("killed", bench.kill(name, ("controller", "server")[k % 2]))
            finally:
                bench.down()
    drives, aborts, kills = rows.values()
    return {
        "runs": sum(row["runs"] for row in drives),
        "valid": sum(row["valid"] for row in drives),
        "aborts": sum(row["ok"] for row in aborts),
        "aborts_of": len(aborts),
        "beyond_gate": sum(row["beyond_gate"] for row in (*drives, *aborts)),
        "killed": sum(row["killed"] for row in kills),
        "silent_after_kill": sum(row["killed"] and row["silent"] for row in kills),
        "partial_readable": sum(row["killed"] and row["readable"] for row in kills),
        "rows": rows,
    }


if __name__ == "__main__":  # as `Killed` starts it
    prove(sys.argv[1], sys.argv[2], sys.argv[3], sys.argv[4])
