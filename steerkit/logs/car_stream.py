"""A car to look at in Foxglove while it drives: what its car server says of itself, asked as any onlooker may."""

from __future__ import annotations

import math
from collections.abc import Callable

from steerkit._support.clock import Clock
from steerkit._support.errors import require
from steerkit.car.client import CarClient
from steerkit.car.protocol import Snapshot
from steerkit.logs.stream import Server

_NAMES = {name: f"car.{name}" for name in Snapshot._fields if name not in ("t", "mode", "text")}
_NAMES |= {"e": "path.e", "psi_e": "path.psi_e", "command": "gate.delta_sw"}
"""What a snapshot tells, and its name among a drive's signals."""
LONGEST_RATE = 200.0
"""The most samples a second that the car server may be asked for."""


def follow(link: CarClient, server: Server, *, rate: float = 20.0, until: Callable[[], bool] = lambda: False) -> None:
    """Show a car's snapshots until it is gone (CarLost), or `until` says so.

    The car waits for nothing of this: it answers a question as it does the panel's, and no order is ever given.
    link: to the car server, with `controller=False`. rate: how often it is asked [1/s].
    """
    require(
        0.0 < rate <= LONGEST_RATE, "car stream", f"rate = {rate} 1/s, expected more than 0, up to {LONGEST_RATE:g}"
    )
    server.begin(list(_NAMES.values()))
    clock, last = Clock(), -math.inf
    while not until():
        began, now = clock.now(), link.query()
        if now.t > last:
            server.show(now.t, [float(getattr(now, name)) for name in _NAMES])
            server.tell("/state", {"mode": str(now.mode), "text": now.text}, now.t)
            last = now.t
        clock.sleep_until(began + 1.0 / rate)
