"""What a process of a car begins with: its file, its course, its bus; and nothing of the learner."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from steerkit.on_car.configured import bus_of, course_of, loaded
from steerkit.plants.real_car.file.config import shipped
from steerkit.plants.real_car.file.reading import load

KIT = "dbw-kit.toml"
SLCAN = {"interface": "slcan", "bitrate": 500000, "sleep_after_open": 0.0}


@pytest.mark.parametrize(
    ("channel", "bus"),
    [
        ("", None),
        ("socketcan:vcan0", {"interface": "socketcan", "channel": "vcan0"}),
        ("/dev/pts/7", {"channel": "/dev/pts/7", **SLCAN}),
        ("socket://127.0.0.1:5000", {"channel": "socket://127.0.0.1:5000", **SLCAN}),
    ],
)
def test_a_channel_is_a_bus(channel: str, bus: Any) -> None:
    assert bus_of(channel) == bus


def test_the_file_s_bus_is_taken_unless_a_channel_is_given() -> None:
    (usual, path), (other, same) = loaded(KIT), loaded(KIT, "virtual:x")
    assert usual.bus == load(KIT).bus
    assert other.bus == {"interface": "virtual", "channel": "x"} != usual.bus
    assert path is same is course_of(usual)


def test_a_course_that_nobody_knows_is_told_with_its_place(tmp_path: Path) -> None:
    config = tmp_path / "car.toml"
    text = shipped(KIT).read_text(encoding="utf-8")
    config.write_text(text.replace(f'name = "{load(KIT).course["name"]}"', 'name = "papre"'), encoding="utf-8")
    with pytest.raises(ValueError, match=r"car.toml: \[course\] name: .*papre"):
        loaded(str(config))


@pytest.mark.parametrize("command", ["server", "simulate"])
def test_a_process_of_the_car_imports_no_learner(command: str) -> None:
    """Nor a command line: it is up sooner, and what is not there cannot fail. The bus is refused, after all imports."""
    words = [command, json.dumps({"config": KIT, "channel": "nowhere:x"})]
    code = f"import sys\nfrom steerkit.on_car.serving import main\ntry: main({words!r})\n"
    code += "except BaseException as error: print(error, file=sys.stderr)\nprint(*sorted(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60.0)
    names = done.stdout.splitlines()[-1].split()
    assert {"steerkit.on_car.configured", "can"} <= {*names}, done.stderr
    others = ("steerkit.learning", "steerkit.scenario", "steerkit.roads", "steerkit.cli", "typer", "pydantic", "rich")
    assert [n for n in names if n.startswith(others)] == []
