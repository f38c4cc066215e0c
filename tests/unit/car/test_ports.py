"""Ports of a CAN bus: python-can without its MF4, and the far end of an slcan line."""

import os
import subprocess
import sys
import time
import tty
from pathlib import Path

import pytest

from steerkit.car.ports import SlcanPort, open_bus


def test_it_does_not_load_asammdf_which_stays_there_for_who_asks_for_it() -> None:
    text = """
import sys
from steerkit.car.ports import python_can
can = python_can()
assert can.Message(arbitration_id=3, data=b"ab").dlc == 2
import cantools
assert "asammdf" not in sys.modules  # it takes seconds
assert python_can() is can
"""
    subprocess.run([sys.executable, "-c", text], check=True)


def test_frames_as_text_in_both_directions() -> None:
    port = SlcanPort()
    fd = os.open(port.channel, os.O_RDWR | os.O_NOCTTY)
    try:
        tty.setraw(fd)
        port.send(0x1AB, b"\x01\xfe")
        assert os.read(fd, 100) == b"t1AB201FE\r"
        port.send(0x5, b"")
        assert os.read(fd, 100) == b"t0050\r"
        # a good one; 3 bytes said, 2 there; open; no number; a half; its rest
        os.write(fd, b"t1002AABB\rt1003AABB\rO\rt1002XXYY\rt06")
        frames = port.wait(5.0)
        os.write(fd, b"41FF\r")
        end = time.monotonic() + 30.0
        while len(frames) < 2 and time.monotonic() < end:
            frames += port.wait(1.0)
        assert frames == [(0x100, b"\xaa\xbb"), (0x064, b"\xff")]
    finally:
        os.close(fd)
        port.close()


def test_nothing_is_read_from_python_cans_own_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "can.conf").write_text("[default]\nreceive_own_messages = True\n")
    monkeypatch.setenv("HOME", f"{tmp_path}")
    with open_bus({"interface": "virtual", "channel": f"{tmp_path}"}) as bus:
        assert bus.receive_own_messages is False
