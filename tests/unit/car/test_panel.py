"""The panel without a terminal, and a car seen live."""

import contextlib
import io
import itertools
import math
import os
import signal
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any, Self

import pytest
from rich.console import Console

from steerkit.car import panel
from steerkit.car import session as sessions
from steerkit.car.client import CarLost, ReplayLink
from steerkit.car.panel import Panel, adapted_line, filter_line, stream, witness_line
from steerkit.car.protocol import Adapted, Beat, Filtered, Snapshot
from steerkit.car.state_machine import Mode, Order
from steerkit.logs import foxglove


class Line:
    """A line to a car server that goes through some states, and then stays or is lost."""

    text = "why"

    def __init__(self, modes: list[Mode], lost: bool):
        self.modes, self.lost, self.refused = modes, lost, list[str]()
        self.beats, self.rings, self.orders = 0, 0, list[Order]()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        """Nothing to close."""

    def note(self, message: Beat) -> None:
        self.beats += isinstance(message, Beat)

    def order(self, order: Order) -> None:
        self.orders.append(order)

    def ring(self) -> None:
        self.rings += 1

    def query(self) -> Snapshot:
        if len(self.modes) == 1 and self.lost:
            raise CarLost("the car server has ended")
        return Snapshot(t=0.0, mode=self.modes.pop(0) if len(self.modes) > 1 else self.modes[0], text=self.text)


def pressed(
    monkeypatch: pytest.MonkeyPatch,
    modes: list[Mode],
    keys: list[str],
    *signals: str,
    lost: bool = False,
    simulated: bool = False,
    keyboard: bool = True,
    seconds: float = 5.0,
    **system: Any,
) -> tuple[Line, Any]:
    """A panel over these states of the car; what it ordered in between, with so long between two keys."""
    line, coming, clock = Line(modes, lost), iter(["", *keys]), itertools.count(0.0, seconds)
    session: Any = SimpleNamespace(socket="", live=False, ending=False, timing=None, signals=[])
    session.options = SimpleNamespace(simulated=simulated, time_scale=1.0)

    @contextlib.contextmanager
    def typed() -> Iterator[Any]:
        def read(seconds: float) -> str | None:
            key = next(coming, None)
            session.signals += signals if key == "" and line.beats else []
            return key

        yield read

    monkeypatch.setattr(panel, "CarClient", lambda *words, **more: line)
    monkeypatch.setattr(panel, "_keys", typed)
    monkeypatch.setattr(panel, "ring", line.ring)
    monkeypatch.setattr(panel, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    monkeypatch.setattr(panel.sys, "stdin", SimpleNamespace(isatty=lambda: keyboard, fileno=lambda: 0))
    monkeypatch.setattr(panel.os, "ttyname", lambda fd: "/dev/pts/3")
    for name, answer in ({"tcgetpgrp": lambda fd: os.getpgrp()} | system).items():
        monkeypatch.setattr(panel.os, name, answer)
    with pytest.raises(CarLost) if lost else contextlib.nullcontext(), Panel(session, "a drive") as shown:
        shown._thread.join(60.0)
    assert session.ending
    assert (line.orders[0], line.orders[-1]) == (Order.ARM, Order.DISENGAGE)
    line.orders[:] = line.orders[1:-1]
    return line, shown


@pytest.mark.parametrize("says", ["not recorded: the disk is full", "recording: the disk is full"])
def test_a_recording_that_is_lost_is_told_without_a_live_panel_once(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], says: str
) -> None:
    monkeypatch.setattr(Line, "text", f"why\nspeed 9 m/s\n{says}", raising=False)
    pressed(monkeypatch, [Mode.READY, Mode.STANDBY, Mode.STANDBY, Mode.READY], [""] * 4)
    assert capsys.readouterr().err.splitlines() == [says]


@pytest.mark.parametrize("after", [Mode.STANDBY, Mode.READY, Mode.OVERRIDE, Mode.FAULT, Mode.OFF])
def test_it_rings_at_every_takeover_and_else_not(monkeypatch: pytest.MonkeyPatch, after: Mode) -> None:
    modes = [Mode.OFF, Mode.STANDBY, Mode.READY, Mode.ENGAGED, Mode.ENGAGED, after, after]
    assert pressed(monkeypatch, modes, [""] * 7)[0].rings == 1
    assert pressed(monkeypatch, [Mode.READY, after, after], [""] * 3)[0].rings == 0


@pytest.mark.parametrize(("mode", "rings"), [(Mode.ENGAGED, 1), (Mode.STANDBY, 0)])
def test_it_rings_when_the_car_server_is_lost_while_it_steers(
    monkeypatch: pytest.MonkeyPatch, mode: Mode, rings: int
) -> None:
    assert pressed(monkeypatch, [Mode.READY, mode, mode], [""] * 4, lost=True)[0].rings == rings


@pytest.mark.parametrize("simulated", [False, True])
def test_without_a_keyboard_a_real_car_hears_no_heartbeat(monkeypatch: pytest.MonkeyPatch, simulated: bool) -> None:
    line, _ = pressed(monkeypatch, [Mode.STANDBY], [""] * 4, simulated=simulated, keyboard=False)
    assert (line.beats > 0) is simulated


LETS_GO = dict.fromkeys(("e", "a", "g", "r", " ", "q", "x", "E", "\x1a", "\x1b", "\n", "\ufffd"), Order.DISENGAGE)


@pytest.mark.parametrize("mode", Mode)
def test_every_key_lets_go_while_engaged_and_else_those_of_the_list_do_what_they_say(
    monkeypatch: pytest.MonkeyPatch, mode: Mode
) -> None:
    listed = {"e": Order.ENGAGE, "a": Order.ACKNOWLEDGE, "r": Order.ARM}
    expected = LETS_GO | {"o": Order.OFF} | ({} if mode is Mode.ENGAGED else listed)
    assert {key: pressed(monkeypatch, [mode], [key])[0].orders for key in expected} == {
        key: [order] for key, order in expected.items()
    }


@pytest.mark.parametrize(("seconds", "orders"), [(0.3, 1), (2.0, 3)])
def test_a_key_that_is_held_down_engages_once(monkeypatch: pytest.MonkeyPatch, seconds: float, orders: int) -> None:
    line, _ = pressed(monkeypatch, [Mode.READY], ["e"] * 3, seconds=seconds)
    assert line.orders == [Order.ENGAGE] * orders
    assert pressed(monkeypatch, [Mode.ENGAGED], ["e"] * 3, seconds=seconds)[0].orders == [Order.DISENGAGE] * 3


@pytest.mark.parametrize("mode", [Mode.ENGAGED, Mode.READY])
def test_a_panel_that_was_to_pause_or_did_lets_go(monkeypatch: pytest.MonkeyPatch, mode: Mode) -> None:
    """It may have been engaged since it was READY."""
    assert pressed(monkeypatch, [mode], [""], "SIGCONT")[0].orders == [Order.DISENGAGE]


@pytest.mark.parametrize("keyboard", [True, False])
def test_a_drive_at_a_keyboard_hears_signals_to_pause_and_ends_in_order_with_its_terminal(
    monkeypatch: pytest.MonkeyPatch, keyboard: bool
) -> None:
    monkeypatch.setattr(panel.sys, "stdin", SimpleNamespace(isatty=lambda: keyboard))
    pauses = [signal.SIGTSTP, signal.SIGTTIN, signal.SIGTTOU, signal.SIGCONT]
    before = {number: signal.getsignal(number) for number in (*pauses, signal.SIGHUP)}
    with sessions._ended_in_order() as came:
        if keyboard:
            for number in pauses:
                signal.getsignal(number)(number, None)  # type: ignore[operator, misc]
            with pytest.raises(KeyboardInterrupt):
                signal.getsignal(signal.SIGHUP)(signal.SIGHUP, None)  # type: ignore[operator, misc]
        else:
            assert {number: signal.getsignal(number) for number in before} == before
    assert came == ([number.name for number in pauses] if keyboard else [])
    assert {number: signal.getsignal(number) for number in before} == before


def test_a_panel_in_the_background_or_of_a_parent_that_is_gone_lets_go(monkeypatch: pytest.MonkeyPatch) -> None:
    behind, _ = pressed(monkeypatch, [Mode.ENGAGED], ["", ""], tcgetpgrp=lambda fd: -1)
    assert (behind.beats, behind.orders) == (0, [Order.DISENGAGE] * 2)
    parents = iter([7, 7, 7, 1])
    orphan, _ = pressed(monkeypatch, [Mode.ENGAGED], [""] * 9, getppid=lambda: next(parents))
    assert (orphan.beats, orphan.orders) == (2, []), "it ended, and its last order is to let go"


def no_terminal(fd: int) -> int:
    raise OSError("not the terminal that controls this")


def test_a_terminal_that_controls_nothing_is_in_front(monkeypatch: pytest.MonkeyPatch) -> None:
    assert pressed(monkeypatch, [Mode.READY], [""], tcgetpgrp=no_terminal)[0].beats == 2
    line, here = pressed(monkeypatch, [Mode.READY], [""], ttyname=no_terminal)
    assert (line.beats, here.name) == (2, f"a drive, process {os.getpid()}")
    assert pressed(monkeypatch, [Mode.READY], [])[1].name == f"a drive, process {os.getpid()} on /dev/pts/3"


def test_the_picture_names_the_panel_that_engaged_and_the_way_on(monkeypatch: pytest.MonkeyPatch) -> None:
    _, here = pressed(monkeypatch, [Mode.READY], [])
    here.session.__dict__.update(asked=None, adapted=None, filtered=None, learner_steers=None)
    here.session.watched = SimpleNamespace(rows=list)
    for holder, named in ((here.name, "(this panel)"), ("[/b] other", "[/b] other"), ("", "")):
        console = Console(width=120, record=True, file=io.StringIO())
        console.print(here._picture(Snapshot(t=0.0, mode=Mode.FAULT, holder=holder, text="why"), ""))
        text = console.export_text()
        assert "a acknowledges" in text
        assert ("held by" in text) is bool(holder)
        assert named in text


LATE = Filtered(0.3, 0.0, 1.0, 0.2, 7.0, math.nan, math.nan)
DOUBTS = "commands arrive 0.15 s later than believed, ratio and tyres doubted 2.0 times as much"


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (adapted_line(Adapted(0.2144, 1.0831)), "dead time 0.214 s, steering ratio 1.083 times the data sheet's"),
        (witness_line(1.26), "a pose that lies unnoticed leads the car 0.5 m off: in 1.3 s"),
        (witness_line(math.nan).partition(": ")[2], "not known yet"),
        (filter_line(Filtered(0.3, 0.2, 0.25, 0.61, 2.0, 0.0, 1.4)), "corrected, 25 % backup, reach 0.61 m"),
        (filter_line(LATE), "recovery: the filter was late, reach 0.20 m"),
        (filter_line(Filtered(0.3, 0.3, 0.0, 0.2, 0.0, 0.15, 2.04)), f"passed, reach 0.20 m; {DOUBTS}"),
    ],
)
def test_what_lines_of_the_panel_say(line: str, says: str) -> None:
    assert line == says


def test_snapshots_are_shown_under_the_names_of_the_layouts() -> None:
    one = Snapshot(t=7.0, x=1.0, y=2.0, psi=0.1, v=5.0, r=0.2, delta_sw=0.3, e=0.04, psi_e=0.05, command=0.6)
    link = ReplayLink([one, one, one._replace(t=7.1, mode=Mode.ENGAGED, text="key e")])
    names, rows, words = list[str](), list[Any](), list[Any]()
    server = SimpleNamespace(
        begin=names.extend, show=lambda *row: rows.append(row), note=lambda *n: words.append(n[:2])
    )
    with pytest.raises(CarLost, match="has ended"):
        stream(link, server)
    assert [t for t, _ in rows] == [7.0, 7.1]
    now = dict(zip(names, rows[0][1], strict=True))
    shown = {name: now[source] for name, source in foxglove.shown_as(names).items()}
    wanted = {"/car/x": 1.0, "/car/y": 2.0, "/car/psi": 0.1, "/car/v": 5.0, "/car/r": 0.2, "/path/e": 0.04}
    wanted |= {"/path/psi_e": 0.05, "/wheel/delta_sw": 0.3, "/wheel/delta_sw_cmd": 0.6}
    assert {name: shown[name] for name in wanted} == wanted
    assert words == [("/state", {"mode": "OFF", "text": ""}), ("/state", {"mode": "ENGAGED", "text": "key e"})]
    assert link.requests == []
