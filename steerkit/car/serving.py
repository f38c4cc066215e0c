"""What runs in the processes of a car: the car server that owns its bus, and a simulated car behind the same DBC.

`steerkit car server` and `steerkit car simulate` are these for people. Programs start them as `python -m
steerkit.car.serving server JSON`, without a command line's packages, and so they are up a third sooner.
"""

from __future__ import annotations

import contextlib
import json
import logging
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

from steerkit._support.clock import Clock
from steerkit._support.errors import in_one_line
from steerkit.car import configured, processes


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
    """The process that owns the bus, until nobody has been there for `linger` [s]; its exit code: 1 if the recording
    is not whole.

    Raises ValueError for a configuration that wants a recording where none is made.
    """
    from steerkit.car.recording import Recording, described
    from steerkit.car.server import CarServer

    logging.basicConfig(format="%(asctime)s %(name)s %(message)s", level=logging.INFO, stream=sys.stdout)
    loaded, path = configured.loaded(config, channel)
    if loaded.keep_recording and not recording:
        raise ValueError(f"{config}: keep_recording = true, but nothing is recorded; give --recording FILE.mcap")
    tape = Recording(recording, described(loaded, path, time_scale)) if recording else None
    with contextlib.closing(tape) if tape else contextlib.nullcontext():
        if realtime:
            from steerkit.diagram.realtime import preferred

            logging.info(preferred(threads=True))  # the bus's thread too, but not the recording's
        clock = Clock(scale=time_scale)
        CarServer(loaded, path, socket or processes.default_socket(), recording=tape, clock=clock, linger=linger).run()
    return 1 if tape and tape.failed else 0


def simulate(
    config: str,
    *,
    listen: str = "",
    channel: str = "",
    time_scale: float = 1.0,
    ratio: float = 1.0,
    log: str = "",
    parent: int = 0,
    **car: Any,
) -> int:
    """A simulated car on a bus of its own, which takes faults on standard input; its exit code.

    ratio: the true steering ratio over that of the data sheet. car: what else `SimulatedCar` takes. parent: number of
    the process with which it ends; 0: with none. Raises ValueError for a channel of slcan.
    """
    from steerkit.car.frames.bus import BusPort
    from steerkit.car.frames.slcan_port import SlcanPort

    loaded, path = configured.loaded(config, "-")
    arguments = configured.bus_of(channel)
    if arguments and arguments["interface"] == "slcan":
        raise ValueError(
            f"--channel {channel!r} of a simulated car: expected INTERFACE:CHANNEL, as socketcan:vcan0; "
            "leave it out for an slcan port of its own"
        )
    clock = Clock(scale=time_scale)
    port = BusPort(arguments) if arguments else SlcanPort(listen)
    true = replace(loaded.vehicle, steer_ratio=ratio * loaded.vehicle.steer_ratio)
    simulated = processes.simulated_car(loaded, path, vehicle=true, t0=clock.now(), **car)
    print(f"channel {port.channel}", flush=True)
    with contextlib.ExitStack() as stack:
        stream = stack.enter_context(open(log, "w", encoding="utf-8")) if log else None
        stack.callback(port.close)
        with contextlib.suppress(KeyboardInterrupt):
            processes.serve_simulated(simulated, port, clock, log=stream, faults=sys.stdin, parent=parent)
    return 0


def main(words: Sequence[str]) -> int:
    """Run one of the two with what it is told in JSON; a mistake in that is one line and exit code 2."""
    name, told = words
    runs: dict[str, Callable[..., int]] = {"server": server, "simulate": simulate}
    try:
        return runs[name](**json.loads(told))
    except (ValueError, KeyError, OSError) as error:
        print(f"steerkit car: {in_one_line(error)}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
