"""The live panel of a drive, and its keys: on a line of its own to the car server, should the controller hang.

Keys are read, the picture is drawn and the heartbeat is sent by one thread: a terminal that takes no more text, or is
gone, stops the heartbeat, and the car is the human's 300 ms later; so does a suspended panel, or one in the background.
"""

import contextlib
import math
import os
import select
import signal
import sys
import termios
import threading
import time
import tty
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import Any, Self

from rich.live import Live
from rich.panel import Panel as Box
from rich.table import Table
from rich.text import Text

from steerkit._support.clock import Clock
from steerkit.car.client import CarClient, CarLost
from steerkit.car.motion import ASTRAY, HORIZON
from steerkit.car.protocol import Adapted, Beat, Filtered, Snapshot
from steerkit.car.state_machine import Mode, Order, age_ms
from steerkit.controllers.fail_safe import said
from steerkit.controllers.safety_filter import doubted
from steerkit.diagram.units import degrees_of

PERIOD = 0.04
"""Longest wait for a key [s]: a heartbeat follows each."""
KEYS = {" ": Order.DISENGAGE, "e": Order.ENGAGE, "a": Order.ACKNOWLEDGE, "r": Order.ARM, "o": Order.OFF}
KEYS["q"] = Order.DISENGAGE  # and the drive ends
ENDING = " qo"
"""The keys that mean while engaged what they always mean; every other one lets go."""
HELD = 1.0
"""A key `e` that comes again so soon is one that is held down, and engages nothing [s]."""
NEXT = {
    Mode.OFF: ("white", "r arms"),
    Mode.STANDBY: ("yellow", "wait until nothing is against it"),
    Mode.READY: ("cyan", "e engages"),
    Mode.ENGAGED: ("green", "any key lets go"),
    Mode.OVERRIDE: ("magenta", "a acknowledges"),
    Mode.FAULT: ("red", "a acknowledges"),
}
"""A mode's colour, and the way on to ENGAGED."""
HELP = "space let go · e engage · a acknowledge · r arm · o off · q quit"
STEERS = {None: "", True: " by the learner", False: " by the recovery controller"}
SHOWN = {name: f"car.{name}" for name in Snapshot._fields if name not in ("t", "mode", "holder", "text")}
SHOWN |= {"e": "path.e", "psi_e": "path.psi_e", "command": "gate.delta_sw"}
"""What a snapshot holds, and its name among a drive's signals."""
UNRECORDED = ("not recorded: ", "recording: ")
"""How what a snapshot says against its recording begins."""
STREAMED = 0.05
"""Time between two samples for Foxglove [s]."""


class Panel:
    """Shows who steers and why, and turns keys into orders; unless the session is `live` it prints transitions only.

    session: with `socket`, `timing`, `asked`, `learner_steers`, `adapted`, `filtered`, `watched`,
    `signals`, which came since and let go, and `ending`, which ends the drive: so does a panel that breaks, as no key
    could disengage any more, and one whose parent has ended.
    more: a line of text of somebody else, and what it is about. own: keys of somebody else, which order nothing.
    """

    def __init__(
        self,
        session: Any,
        title: str,
        more: Callable[[], str] | None = None,
        about: str = "learning",
        own: Mapping[str, Callable[[], None]] | None = None,
    ):
        self.own = own or {}
        self.session, self.title, self.live, self.more, self.about = session, title, session.live, more, about
        self._thread = threading.Thread(target=self._run, name="panel", daemon=True)
        self._over = self._engaged = False
        self._attended = sys.stdin.isatty() or session.options.simulated
        self._lost: CarLost | None = None
        self.name = f"{title}, process {os.getpid()}{_terminal()}"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._over = True
        self._thread.join(5.0)
        if self._lost and error is None:
            raise self._lost

    def _run(self) -> None:
        # a terminal in whose background this is then gives errors, instead of stopping the process
        signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGTTIN, signal.SIGTTOU))
        try:
            with CarClient(self.session.socket, controller=False, timeout=2.0, name=self.name) as link:
                try:
                    self._serve(link)
                finally:  # in order, before the heartbeat goes with the line
                    with contextlib.suppress(CarLost):
                        link.order(Order.DISENGAGE)
                    if self._engaged:  # whatever ended it; the car server may be gone
                        ring()
        except CarLost as error:
            self._lost = error
        finally:
            self.session.ending = True

    def _serve(self, link: CarClient) -> None:
        link.order(Order.ARM)
        last: Snapshot | None = None
        said, told, drawn, unrecorded = "", "", -math.inf, ""
        period, e_came = PERIOD / self.session.options.time_scale, -math.inf
        parent = os.getppid() if sys.stdin.isatty() else None
        if not self.live and sys.stdin.isatty():
            print(f"keys: {HELP}", flush=True)
        with _keys() as read, self._screen() as show:
            while not self._over:
                key = read(period)
                if key is None or parent not in (None, os.getppid()):  # the terminal is gone, or who started this
                    return
                if key == "q":
                    self.session.ending = True
                if key in self.own:
                    self.own[key]()
                elif key:
                    said, order = "", KEYS.get(key, Order.DISENGAGE)
                    if self._engaged and key not in ENDING:  # it asks for something: disengaging is the safe answer
                        order = Order.DISENGAGE
                    before, e_came = e_came, time.monotonic() if key == "e" else e_came
                    if order is Order.ENGAGE and e_came - before < HELD:
                        said = f"e again within {HELD:g} s, as of a key that is held down: press it once, later"
                    else:
                        link.order(order)
                while self.session.signals:  # a pause, or a wish to have one
                    said = f"let go: {self.session.signals.pop()} came"
                    link.order(Order.DISENGAGE)
                here = _in_foreground()
                if self._engaged and not here:
                    said = "let go: this is not in the terminal's foreground"
                    link.order(Order.DISENGAGE)
                if self._attended and here:
                    link.note(Beat())
                snapshot = link.query()
                engaged, self._engaged = self._engaged, snapshot.mode is Mode.ENGAGED
                if engaged and not self._engaged:
                    ring()
                if link.refused:
                    said = link.refused[-1]
                    link.refused.clear()
                if not self.live and (last is None or snapshot.mode is not last.mode):
                    held = f"held by {snapshot.holder}; " if snapshot.holder else ""
                    print(f"{line_of(snapshot)} ({held}{NEXT[snapshot.mode][1]})", flush=True)
                if not self.live and said not in ("", told):
                    print(said, flush=True)
                told = said
                lost = next((w for w in snapshot.text.split("\n") if w.startswith(UNRECORDED)), unrecorded)
                if not self.live and lost != unrecorded:
                    print(unrecorded := lost, file=sys.stderr, flush=True)
                if snapshot.mode is not (last and last.mode) or time.monotonic() - drawn > 0.12:
                    show(snapshot, said)
                    drawn = time.monotonic()
                last = snapshot
        if self.live and last is not None:
            print(line_of(last), flush=True)

    @contextlib.contextmanager
    def _screen(self) -> Any:
        if not self.live:
            yield lambda snapshot, said: None
            return
        with Live(auto_refresh=False, transient=True) as live:
            yield lambda snapshot, said: live.update(self._picture(snapshot, said), refresh=True)

    def _picture(self, s: Snapshot, said: str) -> Any:
        cause, *against = s.text.split("\n")
        here, timing, (colour, way) = self.session, self.session.timing, NEXT[s.mode]
        asked = "nothing yet" if here.asked is None else f"{degrees_of(here.asked):+.1f} deg"
        sent = f"{degrees_of(s.command):+.1f} deg" if s.mode is Mode.ENGAGED else "nothing"
        who = STEERS[here.learner_steers] if s.mode is Mode.ENGAGED else ""
        steps = (
            timing
            and timing.steps
            and f"{timing.steps}, misses {timing.misses}, p99 {1e3 * timing.jitter(0.99):.2f} ms late"
        )
        rows: list[tuple[str, Any]] = [
            ("state", Text(f"{s.mode}", style=f"bold {colour}")),
            ("cause", cause),
            ("next", way),
            ("held by", s.holder and f"{s.holder}{' (this panel)' if s.holder == self.name else ''}"),
            ("e, psi_e", f"{s.e:+.3f} m   {degrees_of(s.psi_e):+.1f} deg"),
            ("wheel", f"{degrees_of(s.delta_sw):+.1f} deg, sent {sent}, asked for {asked}{who}"),
            ("speed", f"{s.v:.2f} m/s, kit {s.v_kit:.2f} m/s   torque {s.torque:+.1f} N m"),
            ("ages", f"pose {age_ms(s.pose_age)}, report {age_ms(s.report_age)}, request {age_ms(s.request_age)}"),
            ("witness", witness_line(s.astray)),
            ("errors", f"{s.errors:.0f}   frames sent {s.frames_sent:.0f}"),
            ("steps", steps),
            *(("warning" if s.mode is Mode.ENGAGED else "against", line) for line in against),
            ("refused", said),
            ("believed", here.adapted and adapted_line(here.adapted)),
            ("filter", here.filtered and filter_line(here.filtered)),
            (self.about, self.more and self.more()),
            *here.watched.rows(),
        ]
        table = Table.grid(padding=(0, 2))
        for row in rows:
            if row[1]:
                table.add_row(*[Text(cell) if isinstance(cell, str) else cell for cell in row])  # no markup
        keys = HELP if sys.stdin.isatty() else "no keyboard here: no key disengages, a real car stays with the human"
        return Box(table, title=f"steerkit car: {self.title}", subtitle=keys)


def ring() -> None:
    """The terminal's bell, past whatever draws on it, which takes such characters out."""
    for stream in (sys.stdout, sys.stderr, sys.stdin):
        if stream.isatty():
            with contextlib.suppress(OSError):  # of a terminal that is gone
                os.write(stream.fileno(), b"\a")
            return


def line_of(s: Snapshot) -> str:
    """A snapshot's state and cause in one line."""
    return f"{s.mode}: {s.text.splitlines()[0]}"


def witness_line(astray: float) -> str:
    """What a positioning system that lies unnoticed can do."""
    told = (
        "not known yet" if math.isnan(astray) else f"in {astray:.1f} s" if astray < HORIZON else f"not in {HORIZON:g} s"
    )
    return f"a pose that lies unnoticed leads the car {ASTRAY:g} m off: {told}"


def adapted_line(told: Adapted) -> str:
    """What a controller that adapts believes of the car."""
    return f"dead time {told.delay:.3f} s, steering ratio {told.ratio:.3f} times the data sheet's"


def filter_line(last: Filtered) -> str:
    """What the safety filter did last, and what it doubts more."""
    share = f", {100.0 * last.share:.0f} % backup" if 0.0 < last.share < 1.0 else ""
    beyond = f"; {found}" if (found := doubted(last.late, last.widened)) else ""
    return f"{said(last.reason)}{share}, reach {last.reach:.2f} m{beyond}"


def _in_foreground() -> bool:
    """Are the terminal's keys for this program? Also where there is none, or one that does not control it."""
    try:
        return not sys.stdin.isatty() or os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:
        return True


def _terminal() -> str:
    with contextlib.suppress(OSError):
        return f" on {os.ttyname(sys.stdin.fileno())}" if sys.stdin.isatty() else ""
    return ""


@contextlib.contextmanager
def _keys() -> Any:
    """A function that waits for a key for some seconds and returns it, "" for none, None when the terminal is gone."""
    if not sys.stdin.isatty():

        def wait(seconds: float) -> str:
            time.sleep(seconds)
            return ""

        yield wait
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)

    def read(seconds: float) -> str | None:
        if not _in_foreground():  # what is typed is another program's, and so is how the terminal is set
            time.sleep(seconds)
            return ""
        try:
            if termios.tcgetattr(fd)[3] & termios.ICANON:  # at first, and after another program had it
                tty.setcbreak(fd)
                plain = termios.tcgetattr(fd)
                plain[0] &= ~(termios.IXON | termios.IXOFF)  # Ctrl-S is a key like others, and does not stop the screen
                plain[6][termios.VSUSP] = b"\0"  # nor does Ctrl-Z stop the program, which could not let go then
                termios.tcsetattr(fd, termios.TCSADRAIN, plain)
            ready, _, _ = select.select([fd], [], [], seconds)
            if not ready:
                return ""
            data = os.read(fd, 1)
        except (OSError, termios.error):
            return None
        return data.decode(errors="replace") if data else None

    try:
        yield read
    finally:
        with contextlib.suppress(termios.error):  # of a terminal that is gone
            if _in_foreground():
                termios.tcsetattr(fd, termios.TCSANOW, before)


def stream(link: CarClient, server: Any) -> None:
    """Show a car's snapshots in Foxglove until the car server ends (CarLost): a car, seen live from a second terminal.

    The car waits for nothing of this: it answers a query as it does the panel's, and no order is ever given.
    link: to the car server, with `controller=False`. server: `steerkit.logs.foxglove.Server`.
    """
    server.begin(list(SHOWN.values()))
    clock, last = Clock(), -math.inf
    while True:
        began, now = clock.now(), link.query()
        if now.t > last:
            server.show(now.t, [float(getattr(now, name)) for name in SHOWN])
            server.note("/state", {"mode": str(now.mode), "text": now.text}, now.t)
            last = now.t
        clock.sleep_until(began + STREAMED)
