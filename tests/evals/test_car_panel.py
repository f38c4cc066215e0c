"""The live panel on a real terminal (a pseudo-terminal): what it shows, and the space bar."""

import contextlib
import fcntl
import os
import pty
import re
import select
import signal
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from steerkit.car import recording as recordings
from steerkit.car.client import CarClient
from steerkit.car.state_machine import Mode
from tests.support.programs import Forked

WAIT = 60.0
"""Longest wait for anything [s]; the machine may be busy."""
DRIVE = ("drive", "--car", "dbw-kit.toml", "--controller", "stanley", "--recovery", "stanley", "--simulated")
SLOWLY = ("--time-scale", "0.25")  # the car waits for a machine that is busy
HELD = 0.1
"""In these programs, a key `e` that comes again so soon is held down [s]; otherwise half of the time went into that."""
PROGRAM = f"from steerkit.car import panel; panel.HELD = {HELD}; from steerkit.cli.app import main; main()"


class Terminal:
    """A program on a pseudo-terminal of 100 columns, whose session it leads, as with `ssh -t`: nothing suspends it."""

    def __init__(self, folder: Path, *words: str, **environment: str):
        """Its parent had it ignore SIGINT, as a shell does with what runs in the background."""

        def lead() -> None:
            os.setsid()
            fcntl.ioctl(0, termios.TIOCSCTTY, 0)
            signal.signal(signal.SIGINT, signal.SIG_IGN)

        self.master, slave = pty.openpty()
        command = [sys.executable, "-c", PROGRAM, *words]
        env = {**os.environ, "TERM": "xterm", "COLUMNS": "100", "LINES": "30", **environment}
        self.process = Forked(command, stdin=slave, stdout=slave, stderr=slave, cwd=folder, env=env, preexec_fn=lead)
        os.close(slave)
        self.text = ""

    def until(self, pattern: str) -> str:
        """Read until the screen has shown something; returns all since the last call."""
        end, before = time.monotonic() + WAIT, self.text
        self.text = ""
        while not re.search(pattern, self.text):
            assert time.monotonic() < end, f"no {pattern!r} within {WAIT} s; before: {before[-500:]} now: {self.text}"
            ready, _, _ = select.select([self.master], [], [], 1.0)
            if ready:
                try:
                    self.text += os.read(self.master, 65536).decode(errors="replace")
                except OSError:
                    pytest.fail(f"ended before {pattern!r}: {self.text}")
        return self.text

    def press(self, key: str) -> None:
        os.write(self.master, key.encode())

    def end(self) -> int:
        """Read what is left; the exit code."""
        end = time.monotonic() + WAIT
        with contextlib.suppress(OSError):  # the terminal is closed with its last program
            while self.process.poll() is None or select.select([self.master], [], [], 0.0)[0]:
                assert time.monotonic() < end, f"still running after {WAIT} s; last: {self.text[-500:]}"
                if select.select([self.master], [], [], 0.1)[0]:
                    self.text += os.read(self.master, 65536).decode(errors="replace")
        return self.process.wait(WAIT)


@contextlib.contextmanager
def terminal(folder: Path, *words: str, **environment: str) -> Iterator[Terminal]:
    there = Terminal(folder, *words, **environment)
    try:
        yield there
    finally:
        there.process.kill()
        there.process.wait(WAIT)
        os.close(there.master)


def test_the_panel_shows_what_counts_and_every_key_or_a_pause_lets_go_and_rings(tmp_path: Path) -> None:
    """Ctrl-S too, which would have stopped the screen, and Ctrl-Z; every other key: tests/unit/car/test_panel.py."""
    words = ("state", "e, psi_e", "wheel", "speed", "ages", "p99", "space let go", "this panel", "\x1b[1;32mENGAGED")
    with terminal(tmp_path, *DRIVE, *SLOWLY, "--recording", "drive.mcap") as there:
        for key in (" ", "\x13", "\x1a", ""):
            there.until("READY")
            there.press(key)  # nobody drives: nothing to let go of
            time.sleep(HELD)
            there.press("e")
            screen = there.until(r"ENGAGED[\s\S]*╰")
            screen += there.until(r"steps +\d+, misses")
            assert [word for word in words if word not in screen] == [], "what is last is green and bold"
            assert "\a" not in there.text
            there.press(key)
            if not key:
                there.process.send_signal(signal.SIGSTOP)
                time.sleep(0.05)
                there.process.send_signal(signal.SIGCONT)
            there.until("\a")  # the bell
        there.until("READY")
        there.press("q")
        assert there.end() == 0
        assert "recording drive.mcap" in there.text.replace("\r", "")
        assert "\x1b[?25h" in there.text  # the cursor is back
    changes = [(v["from"], v["to"], v["cause"]) for v in recordings.read(tmp_path / "drive.mcap").of("/state")]
    assert ("READY", "ENGAGED", "operator: engage") in changes
    assert [change[1:] for change in changes if change[0] == "ENGAGED"] == [("STANDBY", "operator: disengage")] * 4


def test_a_terminal_that_reads_nothing_more_or_is_gone_lets_go(tmp_path: Path) -> None:
    """It is wide, so that it is full soon."""
    socket = str(tmp_path / "socket")
    with terminal(tmp_path, *DRIVE, *SLOWLY, "--recording", "drive.mcap", "--socket", socket, COLUMNS="400") as there:
        there.until("READY")
        there.press("e")
        there.until("ENGAGED")
        with CarClient(socket, controller=False) as link:  # from here on, the screen is not read
            silent = link.wait(Mode.FAULT, timeout=WAIT).text
            assert silent.startswith("operator silent: the panel that engaged (stanley, process ")
        there.until("FAULT[\\s\\S]*\a|\a[\\s\\S]*FAULT")
        there.press("a")
        there.until("READY")
        time.sleep(HELD)
        there.press("e")
        there.until("ENGAGED")
        os.close(there.master)
        there.process.wait(WAIT)
        there.master = os.open(os.devnull, os.O_RDONLY)
    recorded = recordings.read(tmp_path / "drive.mcap")
    assert recorded.whole
    causes = [v["cause"].split(":")[0] for v in recorded.of("/state") if v["from"] == "ENGAGED"]
    assert causes == ["operator silent", "operator"]
    assert recorded.of("/state")[-1]["to"] == "OFF"


def test_a_dumb_terminal_gets_lines_and_still_keys_and_ends_in_order(tmp_path: Path) -> None:
    """Ctrl-C works at a keyboard even where a parent had it ignored; the car server gets the order to let go."""
    with terminal(tmp_path, *DRIVE, *SLOWLY, "--realtime", "--recording", "drive.mcap", TERM="dumb") as there:
        said = there.until("keys: space let go") + there.until("READY: all checks hold")
        assert re.search(r"SCHED_FIFO 50: (granted|not permitted; .*; going on without)", said)
        assert "╭" not in said
        assert "\x1b" not in said
        there.press("e")
        there.until("ENGAGED: operator: engage")
        there.process.send_signal(signal.SIGINT)
        assert there.end() == 130
        assert "Traceback" not in there.text
    recorded = recordings.read(tmp_path / "drive.mcap")
    (left,) = [v["cause"] for v in recorded.of("/state") if v["from"] == "ENGAGED"]
    assert left == "operator: disengage"
    assert recorded.of("/state")[-1]["to"] == "OFF"
