"""Recorded drives: taken apart by controller, and replayed."""

import hashlib
import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from steerkit._support import plugins
from steerkit._support.plugins import fingerprint
from steerkit.car import protocol
from steerkit.car import replay as replays
from steerkit.car.config import CarConfig
from steerkit.car.loop import Steers, controller_named
from steerkit.car.recording import Message, Recorded
from steerkit.learning import rundir
from tests.support.car_world import CONFIG
from tests.support.own_controller import TEXT
from tests.support.places import ROOT


def client(link: int, message: protocol.Message) -> Message:
    return Message("/client", {"t": 0.0, "link": link, "data": protocol.encode(message).hex()})


def car(t: float) -> Message:
    return Message("/car", {**protocol.Snapshot(t)._asdict(), "mode": "READY"})


def test_a_drive_is_what_one_controller_saw_and_asked_for() -> None:
    stanley, mpc = Steers(name="stanley"), Steers(name="mpc")
    messages = [
        client(1, protocol.Hello(True)),
        client(2, protocol.Hello(False)),
        client(1, protocol.Remark(stanley.text())),
        car(0.1),
        car(0.15),
        client(1, protocol.Request(0.15, 0.5, 0)),
        client(2, protocol.Request(0.15, 9.0, 0)),  # refused: it is no controller
        car(0.2),
        client(1, protocol.Request(0.2, 0.6, 0)),
        Message("/client", {"t": 0.0, "link": 1, "data": "ff00"}),
        client(3, protocol.Hello(True)),
        client(3, protocol.Remark(mpc.text())),
        car(0.3),
        client(3, protocol.Request(0.3, 0.7, 0)),
    ]
    first, second = replays.drives(Recorded({}, messages, [], 0))
    assert first.requests == [(0.15, 0.5), (0.2, 0.6)]
    assert [s.t for s in first.snapshots] == [0.1, 0.15, 0.2]
    assert (first.first, first.remarks, first.who) == (2, [(0, stanley)], "stanley")
    assert (second.requests, second.first, second.who) == ([(0.3, 0.7)], 1, "mpc")


def test_a_request_that_is_no_number_is_the_same_when_it_is_none_again() -> None:
    """So it is where the wheel's report is stale: NaN is asked for, and the gate lets nothing through."""
    there: dict[str, Any] = {"x": 10.0, "y": 0.0, "psi": 0.0, "v": 5.0, "beta": 0.0, "r": 0.0, "a_y": 0.0}
    wheel = (0.1, 0.1, math.nan, math.nan, 0.1, 0.1)
    seen = [protocol.Snapshot(0.05 * k, **there, delta_sw=angle) for k, angle in enumerate(wheel)]
    drive = replays.Drive(snapshots=seen, requests=[(s.t, math.nan) for s in seen[1:]], first=2)
    none_again = 3  # two without a report, and one more whose controller remembers none
    assert replays.replayed_requests(drive, CONFIG, controller="stanley") == none_again


def forged(folder: Path, **steers: Any) -> tuple[replays.Drive, CarConfig]:
    """A recording's drive by `steers`, and its configuration, which allows just that; code that is run leaves `ran`."""
    (folder / "mine.py").write_text(f"open({str(folder / 'ran')!r}, 'w')\n{TEXT}")
    (folder / "net-0001.npz").write_bytes((ROOT / "tests/attack/policy.npz").read_bytes())
    (folder / "run.json").write_text(json.dumps({"format": rundir.FORMAT, **{key: {} for key in rundir.KEYS}}))
    place = {key: value.format(folder) for key, value in steers.items()}
    if "sha256" in place:
        place["sha256"] = hashlib.sha256((folder / "net-0001.npz").read_bytes()).hexdigest()
    seen = [protocol.Snapshot(0.05 * k, 10.0, 0.0, 0.0, 5.0, 0.0, 0.0, 0.0, 0.1) for k in range(6)]
    drive = replays.Drive(seen, [(s.t, 0.0) for s in seen[1:]], [(0, Steers(**place))], 2)
    return drive, replace(CONFIG, controllers=(place["name"], place.get("doe", "")))


@pytest.mark.parametrize(
    ("says", "steers"),
    [
        ("mine.py:make': the recording names it, and nothing that a file names is run", {"name": "{}/mine.py:make"}),
        ("element '.*mine.py:make': the rec", {"name": "{}/net-0001.npz", "sha256": "", "doe": "{}/mine.py:make"}),
        ("module_of_mine:make': the recording names it", {"name": "module_of_mine:make"}),
        ("os:abort': the recording names it", {"name": "os:abort", "code": fingerprint("os:abort", "")}),
        ("the recording: controller '/.*' is not known", {"name": "{}"}),
        ("the recording: controller '/dev/zero' is not known", {"name": "/dev/zero"}),
        ("zero: the net that drove is gone", {"name": "/dev/zero", "sha256": "0"}),
    ],
)  # fmt: skip
def test_nothing_that_a_recording_names_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, says: str, steers: dict[str, str]
) -> None:
    monkeypatch.setattr(plugins, "_mine", set())  # what other tests of this process have named
    drive, config = forged(tmp_path, **steers)
    (tmp_path / "module_of_mine.py").write_text((tmp_path / "mine.py").read_text())
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(ValueError, match=says):
        replays.replayed_requests(drive, config)
    assert not (tmp_path / "ran").exists()


def test_own_code_is_run_again_if_its_user_names_it_and_it_is_what_drove(tmp_path: Path) -> None:
    drive, config = forged(tmp_path, name="{}/mine.py:make")
    name = config.controllers[0]
    plugins.mine(name)
    with pytest.raises(ValueError, match=r"mine.py has changed since the recording was written"):
        replays.replayed_requests(drive, config)
    assert not (tmp_path / "ran").exists()
    drive.remarks = [(0, controller_named(name, config).steers)]
    assert replays.replayed_requests(drive, config) == 0  # it runs, and asks for something else
