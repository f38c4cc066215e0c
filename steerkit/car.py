"""A real car, or a simulated one on a bus, put together: its course, its loop, its processes, its drive."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath
from typing import Any, TextIO

from steerkit import realtime
from steerkit.assembly import steering_loop
from steerkit.block import Block
from steerkit.clock import Clock
from steerkit.controllers.foresight import Foresight
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.recovery import Guarded
from steerkit.controllers.stanley import Stanley
from steerkit.courses import course
from steerkit.doe import Corrected, Dynamic, Integrator
from steerkit.loop import Loop
from steerkit.path import Path
from steerkit.plants.human_driver import ConstantSpeed
from steerkit.plants.real_car.client import CarLink, CarLost, DriverLink, RealCar, ReplayLink
from steerkit.plants.real_car.config import CarConfig
from steerkit.plants.real_car.protocol import Request, Snapshot, decode
from steerkit.plants.real_car.recording import Recorded
from steerkit.plants.real_car.simulated import Fault, SimulatedCar
from steerkit.plants.real_car.slcan_port import SlcanPort
from steerkit.plants.real_car.states import Mode, Order

CONTROLLERS = ("stanley", "a learning run's directory, or a policy's .npz file")


def course_of(config: CarConfig) -> Path:
    """The path that a configuration names."""
    if "name" in config.course:
        return course(config.course["name"])
    return config.course["path"]


def default_socket() -> str:
    """Where clients look for the driver process unless told otherwise."""
    folder = os.environ.get("XDG_RUNTIME_DIR") or tempfile.gettempdir()
    return str(FilePath(folder) / f"steerkit-car-{os.getuid()}")


# ---- loops ------------------------------------------------------------------------------------------------------


def controller_named(name: str, config: CarConfig) -> Block:
    """A controller by name, or a learned policy by its place; raises ValueError with the valid ones."""
    if name == "stanley":
        return Stanley.of(config.vehicle)
    place = FilePath(name)
    if place.is_dir():
        found = sorted([*place.glob("nets/net-*.npz"), *place.glob("net-*.npz")])
        if found:
            return NfqPolicy.load(found[-1])
    elif place.is_file():
        return NfqPolicy.load(place)
    raise ValueError(f"controller {name!r} is not known, nor a place with a policy; valid: {', '.join(CONTROLLERS)}")


def car_loop(config: CarConfig, path: Path, link: CarLink, controller: Block, *, doe: Dynamic | None = None) -> Loop:
    """The loop of the simulated runs with a `RealCar` in the plant's place: 20 Hz, e at the front axle.

    controller: a block that steers, or a policy, which gets `doe` (default: an Integrator) and Stanley as recovery.
    """
    learned = any(port.name == "action" for port in controller.outputs)
    return steering_loop(
        car=RealCar(link=link),
        path=path,
        driver=ConstantSpeed(speed=0.0),  # the human in the car keeps the speed; nobody reads this
        controller=Guarded(block=controller) if learned else controller,
        doe=Corrected(element=doe or Integrator()) if learned else None,
        recovery=Stanley.of(config.vehicle) if learned else None,
        foresight=foresight(config) if learned else None,
        reference=config.vehicle.l_f,
    )


def foresight(config: CarConfig) -> Foresight:
    """How far the car will get behind the gate of `config`."""
    limits = config.gate
    same = ("a_y_max", "jerk_max", "rate_max", "delta_sw_max", "v_floor", "steer_ratio", "wheelbase")
    return Foresight(**{name: getattr(limits, name) for name in same})


@dataclass(kw_only=True)
class Follow:
    """Watches a drive: looks for the place on the path again, and lets a learned policy steer while engaged only.

    Depends on nothing but the snapshots, so that a recorded drive can be replayed.
    """

    link: CarLink
    resting: Loop
    """The loop while not engaged: a learned policy's recovery follows, the output element with it."""
    driving: Loop
    places: float = -1.0
    then: Callable[[realtime.Run], bool | None] | None = None

    @classmethod
    def of(cls, loop: Loop, link: CarLink, then: Callable[[realtime.Run], bool | None] | None = None) -> Follow:
        """For a loop of `car_loop`."""
        block = loop.blocks["controller"]
        resting = loop
        if isinstance(block, Guarded) and isinstance(block.block, NfqPolicy):
            resting = loop.with_block("controller", Guarded(block=replace(block.block, ready_from=float("inf"))))
        return cls(link=link, resting=resting, driving=loop, then=then)

    def __call__(self, run: realtime.Run) -> bool | None:
        s = self.link.last
        assert s is not None
        engaged = s.mode is Mode.ENGAGED
        if s.places != self.places:
            if not engaged and self.places >= 0.0:
                run.restart(self.resting.init())
            self.places = s.places
        run.loop = self.driving if engaged else self.resting
        return self.then(run) if self.then else None


def drive(
    config: CarConfig, path: Path, link: DriverLink, controller: Block, *, duration: float = float("inf"),
    clock: Clock | None = None, watch: Callable[[realtime.Run], bool | None] | None = None,
) -> realtime.Run:  # fmt: skip
    """Run a controller at 20 Hz on the car behind `link`, engaged or not, for `duration` [s].

    Missed deadlines go to the driver process with the next request; it disengages when they repeat. Raises CarLost
    when the driver process ends.
    """
    link.wait(timeout=10.0)
    loop = car_loop(config, path, link, controller)
    follow = Follow.of(loop, link, watch)
    return realtime.run(
        follow.resting, duration, timer=clock or Clock(), watch=follow, on_miss=lambda run: count_misses(run, link)
    )


def count_misses(run: realtime.Run, link: DriverLink) -> None:
    """Tell the driver process about missed deadlines, with the next request."""
    link.misses = run.timing.misses


def replayed_requests(recorded: Recorded, config: CarConfig, path: Path, controller: Block) -> tuple[int, int]:
    """(requests recorded, how many of them the controller gives bit for bit) when it sees the recorded snapshots.

    For drives with one controller throughout; in a learning run the nets change in between.
    """
    asked, snapshots, hello = [], [], 0
    for topic, values in recorded.messages:
        if topic == "/car":
            values = {k: v for k, v in values.items() if k in Snapshot._fields}
            snapshots.append(Snapshot(**{**values, "mode": Mode(values["mode"])}))
        elif topic == "/client" and "data" in values:
            message = decode(bytes.fromhex(values["data"]))
            if isinstance(message, Request):
                hello = hello or len(snapshots)
                asked.append((message.basis, message.delta_sw))
    link = ReplayLink(snapshots[max(0, hello - 2) :])  # the last before the first request's began the loop
    loop = car_loop(config, path, link, controller)
    follow = Follow.of(loop, link)
    run = realtime.Run(follow.resting, follow.resting.init(), realtime.Timing(period=loop.dt))
    try:
        while True:
            run.loop.advance(run.k, run.x, run.y)
            run.k += 1
            follow(run)
    except CarLost:
        pass
    return len(asked), sum(a == b for a, b in zip(asked, link.requests))


# ---- processes --------------------------------------------------------------------------------------------------


def start(*words: str, **popen: Any) -> subprocess.Popen[str]:
    """Start `steerkit car WORDS` as a process of its own, out of the terminal's reach (Ctrl-C is not for it)."""
    command = [sys.executable, "-m", "steerkit.car_cli", *words]
    return subprocess.Popen(command, text=True, start_new_session=True, **popen)


def start_driver(
    config: str, socket_path: str, *, recording: str = "", channel: str = "", time_scale: float = 1.0,
    log: TextIO | None = None, wait: float = 15.0,
) -> subprocess.Popen[str]:  # fmt: skip
    """Start the process that owns the bus, and wait until it answers; raises CarLost when it does not."""
    options = ["--config", config, "--socket", socket_path, "--time-scale", str(time_scale)]
    options += ["--recording", recording] if recording else []
    options += ["--channel", channel] if channel else []
    process = start("driver", *options, stdout=log, stderr=log)
    end = time.monotonic() + wait
    while time.monotonic() < end and process.poll() is None:
        try:
            DriverLink(socket_path, controller=False).close()
            return process
        except CarLost:
            time.sleep(0.05)
    process.terminate()
    raise CarLost(f"the driver process did not come up within {wait:g} s; its messages tell why")


def start_simulated(
    config: str, *, time_scale: float = 1.0, log: str = "", listen: str = "", options: Sequence[str] = (),
    wait: float = 15.0,
) -> tuple[subprocess.Popen[str], str]:  # fmt: skip
    """Start a simulated car; returns its process, which takes faults on its standard input, and its channel."""
    words = ["simulate", "--config", config, "--time-scale", str(time_scale), *options]
    words += ["--log", log] if log else []
    words += ["--listen", listen] if listen else []
    process = start(*words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line.startswith("channel "):
        process.terminate()
        raise CarLost(f"the simulated car did not come up: {line!r}")
    return process, line.split()[1]


def simulated_car(config: CarConfig, path: Path, **options: Any) -> SimulatedCar:
    """The simulated car of a configuration, with Stanley as the human at its wheel."""
    return SimulatedCar(config, path, Stanley.of(config.vehicle), **options)


def serve_simulated(
    car: SimulatedCar, port: SlcanPort, clock: Clock, *, log: TextIO | None = None, faults: TextIO | None = None,
    duration: float = float("inf"),
) -> None:  # fmt: skip
    """Run a simulated car in real time on a port; it writes every command it hears to `log`, as JSON lines.

    faults: lines such as `drop pose 0.5` (kind, target, length [s], amount), each acting from when it is read.
    """
    if faults:
        os.set_blocking(faults.fileno(), False)
    end = clock.now() + duration
    reported = 0.0
    while clock.now() < end:
        for frame_id, data in port.wait(clock.wall(car.next - clock.now())):
            t = clock.now()
            car.receive(t, frame_id, data)
            if log and frame_id == car.config.writer.frame_id:
                angle, enable, _ = car.config.writer.read(data)
                log.write(f'{{"t": {t!r}, "data": "{data.hex()}", "enable": {int(enable)}, "angle": {angle!r}}}\n')
        now = clock.now()
        if now - car.t > 1.0:  # the machine stood still; so did the car
            car.t = now - 0.01
        for _, frame_id, data in car.advance(now):
            port.send(frame_id, data)
        if now - reported > 0.25:
            reported = now
            for line in faults.readlines() if faults else ():
                try:
                    car.faults.append(fault_of(line, now))
                except ValueError as error:
                    print(error, flush=True)
            if log:
                state = {"t": now, "s": car.on_path.s, "progress": car.on_path.progress, "e": car.on_path.e,
                         "v": car.now.v, "enabled": car.enabled, "timeout": car.timeout}  # fmt: skip
                log.write(json.dumps(state) + "\n")
                log.flush()


def fault_of(line: str, start: float) -> Fault:
    """The fault in a line such as `drop pose 0.5` or `delay pose 2 0.2`: kind, target, length [s], amount."""
    kind, target, *numbers = line.split()
    length, amount = (*map(float, numbers), *(float("inf"), 0.0)[len(numbers) :])
    return Fault(kind=kind, target=target, start=start, length=length, amount=amount)


def engage(socket_path: str, *, timeout: float = 20.0) -> None:
    """Arm, acknowledge and engage as an operator would, waiting for READY; for tests and simulated cars."""
    with DriverLink(socket_path, controller=False) as operator:
        end = time.monotonic() + timeout
        while True:
            snapshot = operator.query()
            match snapshot.mode:
                case Mode.ENGAGED:
                    return
                case Mode.OFF:
                    operator.order(Order.ARM)
                case Mode.FAULT | Mode.OVERRIDE:
                    operator.order(Order.ACKNOWLEDGE)
                case Mode.READY:
                    operator.order(Order.ENGAGE)
                case Mode.STANDBY if "kit " in snapshot.text:  # it has a fault latched
                    operator.order(Order.ACKNOWLEDGE)
            if time.monotonic() > end:
                raise CarLost(f"not engaged within {timeout:g} s: {snapshot.mode}: {snapshot.text}")
            time.sleep(0.05)
