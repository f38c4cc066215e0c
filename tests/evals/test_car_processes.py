"""Real processes on a real (pseudo-terminal) slcan line; generous limits, as the machine may be busy."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from benchmarks.studies.car_realtime import attended
from steerkit.car import config as configured
from steerkit.car import loop as loops
from steerkit.car import processes
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car import session as sessions
from steerkit.car.client import CarClient, CarLost
from steerkit.car.core import Core
from steerkit.car.ports import open_bus
from steerkit.car.state_machine import Mode, Order
from tests.support.programs import Forked, alive
from tests.support.recordings import full_disk

CONFIG = "dbw-kit.toml"


@pytest.fixture
def forked(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processes as forks of this one; that they start from nothing is seen where a simulated car's starter ends."""
    monkeypatch.setattr(subprocess, "Popen", Forked)


@pytest.fixture
def bench(tmp_path: Path, forked: None) -> Iterator[SimpleNamespace]:
    """A simulated car and its server, which records."""
    here = SimpleNamespace(socket=str(tmp_path / "socket"), record=tmp_path / "drive.mcap", log=tmp_path / "car.jsonl")
    simulated, here.channel = processes.start_simulated(CONFIG, log=str(here.log))
    with (tmp_path / "server.log").open("w") as log:
        here.server = processes.start_car_server(
            CONFIG, here.socket, recording=str(here.record), channel=here.channel, log=log
        )
    yield here
    for process in (here.server, simulated):
        process.terminate()
        process.wait(20.0)


def drive(socket: str, most: int) -> int:
    """Engage once, and drive with Stanley's controller, for so many engaged steps at most; returns how many."""
    config = configured.load(CONFIG)
    modes: list[Mode] = []
    with (
        attended(socket),
        CarClient(socket, timeout=5.0) as link,
        CarClient(socket, controller=False, timeout=5.0) as operator,
    ):

        def watch(run: Any) -> bool:
            assert link.last is not None
            modes.append(link.last.mode)
            if modes[-1] is Mode.OFF:
                operator.order(Order.ARM)
            elif modes[-1] is Mode.READY and Mode.ENGAGED not in modes:
                operator.order(Order.ENGAGE)
            return modes.count(Mode.ENGAGED) > most

        loops.drive(config, link, loops.controller_named("stanley", config), duration=20.0, watch=watch)
    return modes.count(Mode.ENGAGED)


def test_drive_record_replay_and_an_orderly_end(bench: SimpleNamespace) -> None:
    engaged = drive(bench.socket, 24)
    bench.server.terminate()
    assert bench.server.wait(20.0) == 0
    assert engaged > 0
    recorded = recordings.read(bench.record)
    assert recorded.whole
    config = recordings.config_of(recorded)
    frames, same = recordings.replayed_exactly(recorded, Core(config))
    assert frames == same > 0
    (driven,) = replays.drives(recorded)
    assert driven.who == "stanley"
    assert replays.replayed_requests(driven, config) == len(driven.requests) > 20
    time.sleep(0.3)  # it writes what it heard every 0.25 s
    lines = [json.loads(line) for line in bench.log.read_text().splitlines() if line.endswith("}")]
    heard = [line["enable"] for line in lines if "enable" in line]
    assert any(heard)
    assert not heard[-1]


@pytest.mark.usefixtures("forked")
def test_a_bus_that_is_not_there_is_named_and_so_is_the_log(tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"bus interface = 'nope', channel = 'x': cannot be opened \(.* is not known"):
        open_bus({"interface": "nope", "channel": "x"})
    with (tmp_path / "server.log").open("w") as log, pytest.raises(CarLost, match=r"/dev/nowhere.*server\.log"):
        processes.start_car_server(CONFIG, str(tmp_path / "socket"), channel="/dev/nowhere", log=log)
    (tmp_path / "other.log").touch()
    assert processes.last_line(str(tmp_path / "other.log")).startswith("it said nothing")


@pytest.mark.usefixtures("forked")
def test_a_drive_whose_recording_failed_ends_with_exit_code_2(tmp_path: Path) -> None:
    words = ["drive", "stanley", "--car", CONFIG, "--simulated", "--minutes", "0.02", "--quiet"]
    command = [sys.executable, "-m", "steerkit", *words, "--recording", "drive.mcap"]
    with full_disk(20_000):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=180.0)
    assert done.returncode == 2, done.stderr
    assert "the car server ended badly: " in done.stderr
    assert "drive.log" in done.stderr
    assert recordings.read(tmp_path / "drive.mcap").lost


def test_a_second_process_on_the_same_adapter_is_refused_and_the_first_does_not_notice(
    bench: SimpleNamespace, tmp_path: Path
) -> None:
    def errors() -> float:
        with CarClient(bench.socket, controller=False) as link:
            assert link.wait(timeout=10.0).pose_age < 1.0
            assert link.last is not None
            return link.last.errors

    def unnoticed() -> bool:
        before = errors()
        refused = pytest.raises(CarLost, match="another process has the adapter; end it first")
        with (tmp_path / "second.log").open("w") as log, refused:
            processes.start_car_server(CONFIG, str(tmp_path / "second"), channel=bench.channel, log=log)
        return errors() == before

    assert any(unnoticed() for _ in range(5)), "a busy machine may be too late for some frames, not each time"


def test_a_simulated_car_ends_with_the_program_that_started_it_however_that_ends() -> None:
    start = f"from steerkit.car.processes import start_simulated as it; print(it({CONFIG!r})[0].pid, flush=True)"
    with subprocess.Popen(
        [sys.executable, "-c", f"{start}; input()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as starter:
        assert starter.stdout is not None
        number = int(starter.stdout.readline())
        assert alive(number)
        starter.kill()
    end = time.monotonic() + 30.0
    while alive(number) and time.monotonic() < end:
        time.sleep(0.05)
    if alive(number):
        os.kill(number, signal.SIGKILL)
        pytest.fail("the simulated car stayed behind")


def test_drives_that_begin_in_one_second_have_recordings_of_their_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sessions.time, "strftime", lambda form: "20261125-000748")
    for name in ("car-20261125-000748", "car-20261125-000748-2", "car-20261125-000748-3"):
        with sessions._new_recording("") as (place, _):
            assert place == Path("runs", f"{name}.mcap")
    place.touch()
    place.with_suffix(".log").unlink()
    with pytest.raises(ValueError, match=r"748-3\.mcap: it or its log, .* exists already, and recordings are not over"):
        sessions._new_recording("runs/car-20261125-000748-3.mcap").__enter__()
    Path("lap.log").write_text("(1.0) can0 064#00")
    for name in ("lap.mcap", "new.log"):
        with pytest.raises(ValueError, match=r"its log, \w+\.log, exists already"):
            sessions._new_recording(name).__enter__()
    assert Path("lap.log").read_text() == "(1.0) can0 064#00"
