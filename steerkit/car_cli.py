"""`steerkit car ...`: check a configuration, simulate a car on a bus, drive a car, learn on it."""

from __future__ import annotations

import contextlib
import json
import logging
import sys
import time
from pathlib import Path as FilePath
from typing import Annotated, Any

import typer

from steerkit import car as cars
from steerkit.clock import Clock

app = typer.Typer(
    help="A car on a CAN bus. No car has been driven with this software: see docs/real-car.md.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

Config = Annotated[str, typer.Option("--config", help="TOML file, or a shipped one: dbw-kit.toml.")]
Socket = Annotated[str, typer.Option("--socket", help="Unix socket of the driver process.")]
Scale = Annotated[float, typer.Option(help="How many times faster than real time; simulated cars only.")]
RecordTo = Annotated[str, typer.Option(help="MCAP file to record to; default: under runs/.")]
Channel = Annotated[str, typer.Option(help="slcan channel of a simulated car, instead of the file's bus.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No panel; print transitions only.")]


def _bus(channel: str) -> dict[str, Any] | None:
    if not channel:
        return None
    return {"interface": "slcan", "channel": channel, "bitrate": 500000, "sleep_after_open": 0.0}


def _loaded(config: str, channel: str = "") -> tuple[Any, Any]:
    from steerkit.plants.real_car.config import load

    loaded = load(config, bus=_bus(channel))
    return loaded, cars.course_of(loaded)


@app.command()
def check(
    config: Annotated[str, typer.Argument(help="TOML file, or a shipped one.")] = "dbw-kit.toml",
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead, in SI units.")] = False,
) -> None:
    """Check a configuration and print what would be read and written, and every limit."""
    loaded, path = _loaded(config)
    if as_json:
        print(json.dumps({**loaded.facts(), "course": path.name, "length": path.length, "closed": path.closed}))
        return
    print("\n".join(loaded.summary()))
    print(f"path     {path.name}, {path.length:.0f} m, {'closed' if path.closed else 'open'}")
    print(f"{config}: no mistakes found")


@app.command()
def simulate(
    config: Config = "dbw-kit.toml",
    listen: Annotated[str, typer.Option(help="127.0.0.1:PORT for TCP; default: a pseudo-terminal.")] = "",
    time_scale: Scale = 1.0,
    seed: Annotated[int, typer.Option(help="Seed of the human driver.")] = 0,
    v_min: Annotated[float, typer.Option(help="Slowest speed [m/s].")] = 4.0,
    v_max: Annotated[float, typer.Option(help="Fastest speed [m/s].")] = 6.0,
    log: Annotated[str, typer.Option(help="File for every command heard, as JSON lines.")] = "",
) -> None:
    """A simulated car behind the same DBC on a bus of its own; faults come as lines on standard input.

    A line is `KIND pose|report [LENGTH [AMOUNT]]`, such as `drop pose 0.5`; an unknown one prints the kinds.
    """
    from steerkit.plants.real_car.slcan_port import SlcanPort

    loaded, path = _loaded(config, "-")
    clock, port = Clock(scale=time_scale), SlcanPort(listen)
    car = cars.simulated_car(loaded, path, seed=seed, v_min=v_min, v_max=v_max, t0=clock.now())
    print(f"channel {port.channel}", flush=True)
    with contextlib.ExitStack() as stack:
        stream = stack.enter_context(open(log, "w")) if log else None
        stack.callback(port.close)
        with contextlib.suppress(KeyboardInterrupt):
            cars.serve_simulated(car, port, clock, log=stream, faults=sys.stdin)


@app.command()
def driver(
    config: Config = "dbw-kit.toml",
    socket: Socket = "",
    recording: RecordTo = "",
    channel: Channel = "",
    time_scale: Scale = 1.0,
    linger: Annotated[float, typer.Option(help="End when no client has been there for so long [s].")] = 60.0,
    realtime: Annotated[bool, typer.Option(help="Run under SCHED_FIFO; needs the right to.")] = False,
) -> None:
    """The process that owns the bus. `drive` and `learn` start one where there is none."""
    from steerkit.plants.real_car.driver import Driver
    from steerkit.plants.real_car.recording import Recording

    logging.basicConfig(format="%(asctime)s %(name)s %(message)s", level=logging.INFO, stream=sys.stdout)
    loaded, path = _loaded(config, channel)
    if realtime:
        from steerkit.realtime import prefer

        prefer()
    metadata = {f"file:{name}": text for name, text in loaded.texts.items()} | {"time_scale": str(time_scale)}
    tape = Recording(recording, metadata) if recording else None
    clock = Clock(scale=time_scale)
    Driver(loaded, path, socket or cars.default_socket(), recording=tape, clock=clock, linger=linger).run()


@app.command()
def order(
    word: Annotated[str, typer.Argument(help="ARM, ENGAGE, DISENGAGE, ACKNOWLEDGE or OFF.")], socket: Socket = ""
) -> None:
    """Give the driver process an order from a second terminal, whatever the controller is doing."""
    from steerkit.plants.real_car.client import DriverLink
    from steerkit.plants.real_car.states import Order

    if word.upper() not in list(Order):
        raise ValueError(f"order {word!r} is not known; valid: {', '.join(Order)}")
    with DriverLink(socket or cars.default_socket(), controller=False) as link:
        link.order(Order(word.upper()))
        snapshot = link.query()
        for why in link.refused:
            print(f"refused: {why}")
        print(f"{snapshot.mode}: {snapshot.text}")
        raise typer.Exit(1 if link.refused else 0)


@app.command()
def drive(
    config: Config = "dbw-kit.toml",
    controller: Annotated[str, typer.Option(help="stanley, or the place of a learned policy.")] = "stanley",
    recovery: Annotated[str, typer.Option(help="Who catches a learned controller: stanley.")] = "stanley",
    minutes: Annotated[float, typer.Option(help="How long [min]; 0: until `q`.")] = 0.0,
    simulated: Annotated[bool, typer.Option(help="Drive a simulated car, started for it.")] = False,
    socket: Socket = "",
    recording: RecordTo = "",
    channel: Channel = "",
    time_scale: Scale = 1.0,
    realtime: Annotated[bool, typer.Option(help="Run under SCHED_FIFO; needs the right to.")] = False,
    quiet: Quiet = False,
) -> None:
    """Drive with a controller: arm, look, engage with `e`, and the space bar lets go at once."""
    _only_stanley(recovery)
    from steerkit.realtime import histogram_text

    with _session(config, socket, recording, channel, simulated, time_scale, realtime) as session:
        block = cars.controller_named(controller, session.config)
        with _panel(session, controller, quiet):
            duration = 60.0 * minutes or float("inf")
            run = cars.drive(session.config, session.path, session.link, block, duration=duration,
                             clock=session.clock, watch=session.watch)  # fmt: skip
    print(", ".join(f"{k} {v:.3g}" for k, v in run.timing.summary().items()))
    print(histogram_text(run.timing))
    print(f"recording {session.recording}" if session.recording else "not recorded by this command")


@app.command()
def learn(
    config: Config = "dbw-kit.toml",
    setting: Annotated[str, typer.Option(help="How to learn: default, paper, ...")] = "default",
    out: Annotated[FilePath, typer.Option(help="Directory of the run; an old one is continued.")] = FilePath(
        "runs/car"
    ),
    minutes: Annotated[float, typer.Option(help="How long [min]; 0: until `q`.")] = 0.0,
    seed: Annotated[int, typer.Option(help="Seed of the nets.")] = 0,
    simulated: Annotated[bool, typer.Option(help="Learn on a simulated car, started for it.")] = False,
    socket: Socket = "",
    recording: RecordTo = "",
    channel: Channel = "",
    time_scale: Scale = 1.0,
    realtime: Annotated[bool, typer.Option(help="Run under SCHED_FIFO; needs the right to.")] = False,
    quiet: Quiet = False,
) -> None:
    """Learn to steer on the car: Stanley catches it, training runs in a process of its own meanwhile."""
    from steerkit.learning.on_car import CarLearner
    from steerkit.learning.settings import setting as named

    with _session(config, socket, recording, channel, simulated, time_scale, realtime) as session:
        session.link.wait(timeout=10.0)
        with CarLearner(named(setting), out, session.build, session.link, seed=seed) as learner:
            with _panel(session, f"learning, {setting}", quiet, learner.status):
                duration = 60.0 * minutes or float("inf")
                run = learner.run(duration, clock=session.clock, watch=session.watch)
            print(learner.status())
    print(", ".join(f"{k} {v:.3g}" for k, v in run.timing.summary().items()))


@app.command()
def tape(
    file: Annotated[FilePath, typer.Argument(help="A recording, .mcap.")],
    controller: Annotated[str, typer.Option(help="Replay the requests through this controller too.")] = "",
) -> None:
    """Look into a recording, mend one that a kill cut short, and replay it: are the commands the same, bit for bit?"""
    from steerkit.plants.real_car import recording as tapes
    from steerkit.plants.real_car.core import Core

    recorded = tapes.mend(file)
    print(f"{len(recorded.messages)} messages{'' if recorded.whole else ', cut short; its end is mended'}")
    for v in recorded.of("/state"):
        print(f"  {v['t']:.3f} s  {v['from']} -> {v['to']}: {v['cause']}")
    config = tapes.config_of(recorded)
    path = cars.course_of(config)
    frames, same = tapes.replayed_exactly(recorded, Core(config, path))
    print(f"driver: {same} of {frames} frames the same")
    if controller:
        block = cars.controller_named(controller, config)
        asked, same_asked = cars.replayed_requests(recorded, config, path, block)
        print(f"{controller}: {same_asked} of {asked} requests the same")


def _only_stanley(recovery: str) -> None:
    if recovery != "stanley":
        raise ValueError(f"recovery {recovery!r} is not known; valid: stanley")


class _Session:
    """What `drive` and `learn` share: the processes, the line to the driver, and the wish to end."""

    def __init__(self, config: str, socket: str, recording: str, channel: str, scale: float):
        self.config, self.path = _loaded(config, channel)
        self.socket, self.recording, self.clock = socket or cars.default_socket(), recording, Clock(scale=scale)
        self.ending = False
        self.link: Any = None
        self.timing: Any = None

    def watch(self, run: Any) -> bool:
        """Called after every step."""
        self.timing = run.timing
        return self.ending

    def build(self, policy: Any, doe: Any) -> Any:
        """The loop of a learner."""
        return cars.car_loop(self.config, self.path, self.link, policy, doe=doe)


@contextlib.contextmanager
def _session(config: str, socket: str, recording: str, channel: str, simulated: bool, scale: float, fifo: bool) -> Any:
    from steerkit.plants.real_car.client import CarLost, DriverLink
    from steerkit.plants.real_car.states import Order

    if scale != 1.0 and not (simulated or channel):
        raise ValueError(f"--time-scale {scale:g}: a real car has real time; use --simulated")
    processes = []
    with contextlib.ExitStack() as stack:
        if simulated:
            process, channel = cars.start_simulated(config, time_scale=scale)
            processes.append(process)
        session = _Session(config, socket, recording, channel, scale)
        try:
            try:
                session.link = DriverLink(session.socket)
            except CarLost:
                FilePath("runs").mkdir(exist_ok=True)
                stem = f"runs/car-{time.strftime('%Y%m%d-%H%M%S')}"
                session.recording = recording or f"{stem}.mcap"
                log = stack.enter_context(open(f"{stem}.log", "w"))
                processes.insert(0, cars.start_driver(config, session.socket, recording=session.recording,
                                                      channel=channel, time_scale=scale, log=log))  # fmt: skip
                session.link = DriverLink(session.socket)
            if fifo:
                from steerkit.realtime import prefer

                prefer()
            yield session
            with contextlib.suppress(CarLost):
                session.link.order(Order.DISENGAGE)  # an orderly end is no fault
        finally:
            if session.link:
                session.link.close()
            for process in processes:  # the driver first
                process.terminate()
                process.wait(10.0)


def _panel(session: Any, title: str, quiet: bool, more: Any = None) -> Any:
    from steerkit.car_panel import Panel

    return Panel(session, title, live=not quiet and sys.stdout.isatty(), more=more)


def main() -> None:
    """Run `steerkit car` alone; a mistake of the user's, or a car that is gone, is one line and exit code 2."""
    try:
        app()
    except (ValueError, KeyError, OSError) as error:
        print(f"steerkit car: {error.args[0] if isinstance(error, KeyError) else error}", file=sys.stderr)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
