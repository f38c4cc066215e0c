"""The processes of a car: the car server that owns its bus, and a simulated car behind the same DBC.

`steerkit car server` and `steerkit car simulate` are these for people. Programs start them as `python -m
steerkit.car.processes server JSON`, without the command line's packages, and so they are up a third sooner.
"""

import contextlib
import json
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, TextIO

from steerkit._support.clock import Clock
from steerkit._support.errors import in_one_line
from steerkit.car.client import CarClient, CarLost
from steerkit.car.config import bus_of, check_pace, load
from steerkit.car.ports import BusPort, SlcanPort
from steerkit.car.production.port import SocketServer
from steerkit.car.production.simulated import ProductionCar
from steerkit.car.recording import Recording, described
from steerkit.car.server import CarServer
from steerkit.car.simulated import Fault, SimulatedCar
from steerkit.diagram.realtime import preferred


def default_socket() -> str:
    """Where clients look for the car server by default."""
    folder = os.environ.get("XDG_RUNTIME_DIR")
    if not folder:  # a folder of our own: anybody may put a socket into the common one
        own = FilePath(tempfile.gettempdir()) / f"steerkit-{os.getuid()}"
        own.mkdir(mode=0o700, exist_ok=True)
        if own.is_symlink() or own.stat().st_uid != os.getuid() or own.stat().st_mode & 0o077:
            raise OSError(f"{own}: not a folder of this user's alone; remove it, or give --socket")
        folder = str(own)
    return str(FilePath(folder) / f"steerkit-car-{os.getuid()}")


def start(name: str, arguments: Mapping[str, Any], **popen: Any) -> subprocess.Popen[str]:
    """Start one of `steerkit.car.processes` as a process, out of the terminal's reach (Ctrl-C is not for it)."""
    command = [sys.executable, "-m", "steerkit.car.processes", name, json.dumps(arguments)]
    return subprocess.Popen(command, encoding="utf-8", start_new_session=True, **popen)


def start_car_server(
    config: str, socket_path: str, *, log: TextIO | None = None, wait: float = 15.0, **options: Any
) -> subprocess.Popen[str]:
    """Start the process that owns the bus, and wait until it answers; raises CarLost when it does not.

    options: what `server` takes. log: for what it says. wait: for its first answer [s].
    """
    process = start("server", {"config": config, "socket": socket_path, **options}, stdout=log, stderr=log)
    end = time.monotonic() + wait
    while time.monotonic() < end and process.poll() is None:
        if answers(socket_path):
            return process
        time.sleep(0.05)
    process.terminate()
    said = last_line(log.name) if log else ""
    raise CarLost(f"the car server did not come up: {said or f'no answer within {wait:g} s'}")


def answers(socket_path: str) -> bool:
    """Is there a car server?"""
    try:
        CarClient(socket_path, controller=False).close()
    except CarLost:
        return False
    return True


def last_line(log: str) -> str:
    """What a process said last in its log, and where that is; "" without one."""
    if not os.path.isfile(log):
        return ""
    lines = FilePath(log).read_text(encoding="utf-8", errors="replace").split("\n")
    said = next((line for line in reversed(lines) if line), "it said nothing")
    return f"{said} (log: {log})"


def start_simulated(config: str, **options: Any) -> tuple[subprocess.Popen[str], str]:
    """Start a simulated car; returns its process, which takes faults on its standard input, and its channel.

    options: what `simulate` takes. It ends with this program, however that ends.
    """
    options |= {"config": config, "parent": os.getpid()}
    process = start("simulate", options, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line.startswith("channel "):
        process.terminate()
        raise CarLost(f"the simulated car did not come up: {line!r}")
    return process, line.split()[1]


def serve_simulated(
    car: SimulatedCar,
    port: BusPort | SlcanPort,
    clock: Clock,
    *,
    buses: SocketServer | None = None,
    log: TextIO | None = None,
    faults: TextIO | None = None,
    duration: float = float("inf"),
    parent: int = 0,
) -> None:
    """Run a simulated car in real time on a port; it writes every command it hears to `log`, as JSON lines.

    faults: lines such as `drop pose 0.5` (kind, target, length [s], amount), each acting from when it is read.
    parent: number of the process with which it ends; 0: with none. buses: of a production car.
    """
    if faults:
        os.set_blocking(faults.fileno(), False)
    end = clock.now() + duration
    reported, writer = 0.0, car.config.writer
    while clock.now() < end and parent in (0, os.getppid()):
        for frame_id, data in port.wait(clock.wall(car.next - clock.now())):
            t = clock.now()
            if not isinstance(car, ProductionCar):
                car.receive(t, frame_id, data)
            if log and frame_id == writer.message.frame_id:
                angle, enable, _ = writer.read(data)
                log.write(f'{{"t": {t!r}, "data": "{data.hex()}", "enable": {int(enable)}, "angle": {angle!r}}}\n')
        now = clock.now()
        if now - car.t > 1.0:  # the machine stood still; so did the car
            car.t = now - 0.01
        if isinstance(car, ProductionCar) and buses:
            for frame in buses.receive():
                car.hear(now, frame)
        for _, frame_id, data in car.advance(now):
            port.send(frame_id, data)
        if isinstance(car, ProductionCar) and buses:
            buses.send(car.said())
        if now - reported > 0.25:
            reported = now
            for line in faults.readlines() if faults else ():
                try:
                    car.faults.append(fault_of(line, now))
                except ValueError as error:
                    print(error, flush=True)
            if log:
                place, kit = car.on_path, {"enabled": car.enabled, "timeout": car.timeout}
                state = {"t": now, "s": place.s, "progress": place.progress, "e": place.e, "v": car.now.v, **kit}
                log.write(json.dumps(state) + "\n")
                log.flush()


def fault_of(line: str, start: float) -> Fault:
    """The fault in a line such as `drop pose 0.5` or `delay pose 2 0.2`: kind, target, length [s], amount."""
    kind, target, *numbers = line.split()
    length, amount = (*map(float, numbers), *(float("inf"), 0.0)[len(numbers) :])
    return Fault(kind=kind, target=target, start=start, length=length, amount=amount)


def server(
    config: str,
    *,
    socket: str = "",
    recording: str = "",
    channel: str = "",
    time_scale: float = 1.0,
    linger: float = 60.0,
    realtime: bool = False,
) -> int:
    """The process that owns the bus, until nobody has been there for `linger` [s]; exit code 1: recording not whole.

    Raises ValueError for a configuration that wants a recording where none is made, and for what `check_pace` refuses.
    """
    logging.basicConfig(format="%(asctime)s %(name)s %(message)s", level=logging.INFO, stream=sys.stdout)
    car = load(config, channel)
    check_pace(time_scale, car.bus)
    if car.keep_recording and not recording:
        raise ValueError(f"{config}: keep_recording = true, but nothing is recorded; give --recording FILE.mcap")
    recorder = Recording(recording, described(car, time_scale)) if recording else None
    with contextlib.closing(recorder) if recorder else contextlib.nullcontext():
        if realtime:
            logging.info(preferred(threads=True))  # the bus's thread too, but not the recording's
        clock = Clock(scale=time_scale)
        CarServer(car, socket or default_socket(), recording=recorder, clock=clock, linger=linger).run()
    return 1 if recorder and recorder.failed else 0


def simulate(
    config: str,
    *,
    channel: str = "",
    time_scale: float = 1.0,
    ratio: float = 1.0,
    log: str = "",
    parent: int = 0,
    **car: Any,
) -> int:
    """A simulated car on a bus of its own, which takes faults on standard input; its exit code.

    ratio: the true steering ratio over that of the data sheet. car: what else `SimulatedCar` takes. parent: number of
    the process with which it ends; 0: with none. Raises ValueError for a channel of slcan and as `server` does.
    """
    as_told = load(config, "-")
    arguments = bus_of(channel)
    if arguments and arguments["interface"] == "slcan":
        raise ValueError(
            f"--channel {channel!r} of a simulated car: expected INTERFACE:CHANNEL, as socketcan:vcan0; "
            "leave it out for an slcan port of its own"
        )
    check_pace(time_scale, arguments or {"interface": "virtual"})
    clock = Clock(scale=time_scale)
    port = BusPort(arguments) if arguments else SlcanPort()
    true = replace(as_told.vehicle, steer_ratio=ratio * as_told.vehicle.steer_ratio)
    kind = ProductionCar if as_told.port else SimulatedCar
    simulated = kind(as_told, vehicle=true, t0=clock.now(), **car)
    with contextlib.ExitStack() as stack:
        buses = stack.enter_context(SocketServer()) if as_told.port else None
        print(f"channel {port.channel}{f'+{buses.channel}' if buses else ''}", flush=True)
        stream = stack.enter_context(open(log, "w", encoding="utf-8")) if log else None
        stack.enter_context(port)
        with contextlib.suppress(KeyboardInterrupt):
            serve_simulated(simulated, port, clock, buses=buses, log=stream, faults=sys.stdin, parent=parent)
    return 0


def main(words: Sequence[str]) -> int:
    """Run one of the two with arguments in JSON; a mistake in them is one line and exit code 2."""
    name, arguments = words
    runs: dict[str, Callable[..., int]] = {"server": server, "simulate": simulate}
    try:
        return runs[name](**json.loads(arguments))
    except (ValueError, KeyError, OSError) as error:
        print(f"steerkit car: {in_one_line(error)}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
