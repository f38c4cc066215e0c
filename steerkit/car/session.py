"""A session with a car: the processes it needs, its panel, and a drive or a learning run in it."""

import contextlib
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any, TextIO

from steerkit._support.clock import Clock
from steerkit._support.errors import known
from steerkit.car import loop as loops
from steerkit.car import processes
from steerkit.car.client import CarClient, CarLost
from steerkit.car.config import check_pace, load
from steerkit.car.estimates import Watched
from steerkit.car.learner import CarLearner
from steerkit.car.loop import adapted_in, filtered_in
from steerkit.car.panel import Panel
from steerkit.car.protocol import Adapted, Filtered, digest
from steerkit.car.state_machine import Order
from steerkit.diagram.realtime import Run, Timing, preferred, run
from steerkit.learning.settings import Setting
from steerkit.scenario.catalogue import AUTO, RECOVERIES


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options of a session."""

    config: str
    simulated: bool = False
    """Start a simulated car, and a car server for it alone."""
    socket: str = ""
    recording: str = ""
    channel: str = ""
    time_scale: float = 1.0
    realtime: bool = False
    recovery: str = AUTO
    quiet: bool = False
    simulate: Mapping[str, Any] = field(default_factory=dict)
    """What else the simulated car takes: see `steerkit.car.processes.simulate`."""


class Session:
    """What a drive and a learning run on a car share: the line to the car server, the clock, and the wish to end."""

    def __init__(self, options: Options, socket: str, channel: str):
        self.options, self.socket, self.recording = options, socket, options.recording
        self.config = load(options.config, channel)
        self.clock = Clock(scale=options.time_scale)
        self.ending = False
        self.signals: list[str] = []
        """Those that came since the panel looked, and after which it lets go."""
        self.link: Any = None
        self.watched: Any = None
        """Its estimators, `steerkit.car.estimates.Watched`."""
        self.timing: Timing | None = None
        self.asked: float | None = None
        """The angle that the controller asked for last [rad]."""
        self.adapted: Adapted | None = None
        """What a controller that adapts believes of the car."""
        self.filtered: Filtered | None = None
        """What the safety filter did last."""
        self.learner_steers: bool | None = None
        """Has the learner the wheel, or its recovery controller? None: there is no learner."""
        self.broken = ""
        """What the car server ended with, if that was no good end."""

    def watch(self, run: Run) -> bool:
        """Called after every step."""
        self.watched.sample(self.link.last)
        self.timing = run.timing
        self.asked = run.sample[run.loop.inputs_of("car")["delta_sw_cmd"]]
        self.adapted = adapted_in(run)
        if "supervisor" in run.loop.blocks:
            self.learner_steers = run.sample["supervisor.learning"] > 0.5
        if "safety" in run.loop.blocks:
            self.filtered = filtered_in(run)
        return self.ending

    @property
    def live(self) -> bool:
        """Is the panel drawn?"""
        terminal = sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"
        return terminal and not self.options.quiet


@contextlib.contextmanager
def session(options: Options) -> Iterator[Session]:
    """A session: with the car server that is there, or else one of its own; both end in order."""
    if options.time_scale != 1.0 and not options.simulated:
        check_pace(options.time_scale, load(options.config, options.channel).bus)
    if options.simulated and options.channel:
        raise ValueError("--simulated starts a car on a channel of its own; leave --channel out")
    known(options.recovery, RECOVERIES, "--recovery")
    channel, started = options.channel, list[subprocess.Popen[str]]()
    with contextlib.ExitStack() as stack:
        signals = stack.enter_context(_ended_in_order())
        try:
            socket = options.socket or processes.default_socket()
            if options.simulated:  # never through a car server that may have a real car at its other end
                socket = options.socket or stack.enter_context(tempfile.TemporaryDirectory()) + "/car"
                process, channel = processes.start_simulated(
                    options.config, time_scale=options.time_scale, **options.simulate
                )
                started.append(process)
            here = Session(options, socket, channel)
            here.signals = signals
            if options.simulated or not processes.answers(socket):
                place, text = stack.enter_context(_new_recording(options.recording))
                here.recording, log = str(place), text.name
                how: dict[str, Any] = {"recording": here.recording, "channel": channel, "log": text}
                how |= {"time_scale": options.time_scale, "realtime": options.realtime}
                started.insert(0, processes.start_car_server(options.config, socket, **how))
            else:
                here.recording = ""
                unused = f"; --recording {options.recording} is NOT written" if options.recording else ""
                print(
                    f"the car server at {socket} is used as it runs, with its own configuration and recording{unused}"
                )
            here.link = stack.enter_context(CarClient(socket, course=digest(here.config.course)))
            here.watched = Watched(here.config, here.link.note)
            if options.realtime:
                print(preferred())
            try:
                yield here
            finally:
                with contextlib.suppress(CarLost):
                    here.link.order(Order.DISENGAGE)  # an end in order, or Ctrl-C, is no fault
        finally:
            for process in started:  # the server first
                process.terminate()
                process.wait(20.0)  # it may have to write the end of its recording
        if here.recording and started[0].returncode == 1:
            said = processes.last_line(log) or f"{here.recording} and its log are gone"
            here.broken = f"the car server ended badly: {said}"


@contextlib.contextmanager
def _ended_in_order() -> Iterator[list[str]]:
    """SIGTERM ends a drive as Ctrl-C does; and Ctrl-C and SIGHUP do so too where the parent had them ignored.

    That is what a shell does to what it runs in the background; at the keyboard Ctrl-C can still be pressed.
    Without a keyboard what is ignored stays so, as `nohup` asks. With one, a signal to pause does not pause, and its
    name, as that of one to go on, is in the list that is given: nobody at the keyboard could let go meanwhile.
    Only the main thread hears signals.
    """
    came = list[str]()

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    def note(number: int, _: Any) -> None:
        came.append(signal.Signals(number).name)

    if threading.current_thread() is not threading.main_thread():
        yield came
        return
    handlers: dict[signal.Signals, Any] = {signal.SIGTERM: interrupt}
    if sys.stdin.isatty():
        handlers |= dict.fromkeys((signal.SIGINT, signal.SIGHUP), interrupt)
        handlers |= dict.fromkeys((signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU, signal.SIGCONT), note)
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def _new_recording(recording: str) -> Iterator[tuple[FilePath, TextIO]]:
    """A new file to record to and, open, the car server's log beside it, in a folder that is made.

    Without a name they are called by the time, numbered in a second. Raises ValueError where one of them is there: the
    log is made at once, so that no two sessions have one name.
    """
    now = f"runs/car-{time.strftime('%Y%m%d-%H%M%S')}"
    given = [recording] if recording else (f"{now}{f'-{n}' * (n > 1)}.mcap" for n in itertools.count(1))
    for place in map(FilePath, given):
        log = place.with_suffix(".log")
        place.parent.mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError):
            if not place.exists() and log != place:
                text = log.open("x", encoding="utf-8")
                break
    else:
        there = f"it or its log, {log}, exists already, and recordings are not overwritten; choose another name"
        raise ValueError(f"--recording {place}: {there}")
    with text:
        yield place, text


def drive(options: Options, name: str, *, minutes: float) -> dict[str, Any]:
    """`steerkit drive --car`: drive with a controller for so long (0: until `q`); returns its figures."""
    controller = loops.controller_named(name, load(options.config))  # mistakes first, processes then
    with session(options) as here, Panel(here, name):
        run = loops.drive(
            here.config,
            here.link,
            controller,
            recovery=options.recovery,
            duration=60.0 * minutes or float("inf"),
            clock=here.clock,
            watch=here.watch,
        )
    return finished(here, run)


def guided(here: Session, title: str, guide: Any, about: str, own: Mapping[str, Any] | None = None) -> Run:
    """Drive as `guide` has it, with `follow`, `step` and `status`, until it ends or the human does; as of `Panel`."""
    with Panel(here, title, guide.status, about, own):
        return run(
            guide.follow.resting,
            timer=here.clock,
            watch=lambda live: guide.step(live) or here.watch(live),
            on_miss=lambda live: loops.count_misses(live, here.link),
        )


def learn(options: Options, how: Setting, place: FilePath, *, minutes: float, seed: int) -> dict[str, Any]:
    """`steerkit learn --car`: learn to steer on it for so long (0: until `q`); returns its figures."""
    with session(options) as here:
        loops.check_allowed("element", how.doe, here.config)
        here.link.wait(timeout=10.0)
        with CarLearner(how, place, here.config, here.link, seed=seed, recovery=options.recovery) as learner:
            with Panel(here, f"learning, {how.name}", learner.status):
                run = learner.run(60.0 * minutes or float("inf"), clock=here.clock, watch=here.watch)
            print(learner.status())
            merit = learner.figures()
    print(
        f"policies and transitions in {place}; drive with them: steerkit drive --car {options.config} --controller "
        f"{'nfq' if place == loops.LEARNED else place}"
    )
    return finished(here, run) | merit


def finished(here: Session, run: Run) -> dict[str, Any]:
    """The figures of a session that has ended, printed too; raises OSError if its car server ended badly."""
    figures = run.timing.summary()
    print(", ".join(f"{k} {v:.3g}" for k, v in figures.items()))
    if not here.options.quiet:
        print("\n".join(here.watched.report()))
    print(f"recording {here.recording}" if here.recording else "recorded, if at all, by the car server that was there")
    if here.broken:
        raise OSError(here.broken)
    return {**figures, "recording": here.recording}
