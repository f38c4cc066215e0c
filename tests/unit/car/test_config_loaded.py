"""What a process of a car begins with: its file, its course, its bus."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from steerkit.car.config import bus_of, course_of, load, loaded, shipped

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
