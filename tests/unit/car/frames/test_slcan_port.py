"""The adapter's text, as the Lawicel CAN232 manual writes it."""

from __future__ import annotations

import os
import time
import tty

import pytest

from steerkit.car.frames.slcan_port import SlcanPort


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


def test_no_port_on_a_network() -> None:
    with pytest.raises(ValueError, match=r"only 127\.0\.0\.1"):
        SlcanPort("0.0.0.0:0")
