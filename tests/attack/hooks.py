"""What an attack does: hooks that change sensors, frames, requests, or what people do, from its onset on."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any

from tests.attack import wire
from tests.attack.bench import Drive, Sensed

Sense = Callable[[Drive, Sensed, float], None]


def held(*names: str) -> Sense:
    """These values stand still."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        kept = drive.frozen.setdefault(names, tuple(getattr(values, name) for name in names))
        for name, value in zip(names, kept):
            setattr(values, name, value)

    return sense


def changed(**changes: Callable[[float, float], float]) -> Sense:
    """value -> change(value, time since the onset)."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        for name, change in changes.items():
            setattr(values, name, change(getattr(values, name), since))

    return sense


def moved(along: Callable[[float], float] | None = None, across: Callable[[float], float] | None = None) -> Sense:
    """The position is off, along or across the heading [m]."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        a, c = (along(since) if along else 0.0), (across(since) if across else 0.0)
        psi = drive.car.psi
        values.x += a * math.cos(psi) - c * math.sin(psi)
        values.y += a * math.sin(psi) + c * math.cos(psi)

    return sense


def flag(*names: str, up: bool = True) -> Sense:
    """Flags of the kit's report."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        values.flags = values.flags | set(names) if up else values.flags - set(names)

    return sense


POSE = (wire.POSITION, wire.MOTION, wire.DYNAMICS)
Frames = list[tuple[int, bytes, str]]


def frames(*ids: int, change: Callable[[bytes], bytes] = bytes, kind: str = "", drop: bool = False) -> Any:
    """Frames of these ids come changed, as another kind, or not at all."""

    def edit(drive: Drive, sent: Frames, since: float) -> Frames:
        return [(i, change(d), kind or k) if i in ids else (i, d, k) for i, d, k in sent if not (drop and i in ids)]

    return edit


def repeated(*ids: int) -> Any:
    """The last frame before the onset comes again and again, counter and all."""

    def edit(drive: Drive, sent: Frames, since: float) -> Frames:
        return [(i, drive.frozen.setdefault(i, d), k) if i in ids else (i, d, k) for i, d, k in sent]

    return edit


def beside(*more: tuple[int, bytes, str], times: int = 1) -> Any:
    """Frames of another sender, after ours."""

    def edit(drive: Drive, sent: Frames, since: float) -> Frames:
        return [*sent, *(list(more) * times)]

    return edit


def replaced(frame_id: int, kind: str) -> Any:
    """The true frame stays away; one of another kind with its number comes, as it was at the onset."""

    def edit(drive: Drive, sent: Frames, since: float) -> Frames:
        return [(i, drive.frozen.setdefault(i, d), kind) if i == frame_id else (i, d, k) for i, d, k in sent]

    return edit


def order(name: str) -> Any:
    """The operator presses a key once."""

    def act(drive: Drive, since: float) -> None:
        if drive.frozen.setdefault("pressed", False) is False:
            drive.frozen["pressed"] = True
            drive.order(name)

    return act


def silent(drive: Drive, since: float) -> None:
    drive.beating = False


def gone(drive: Drive, since: float) -> None:
    if drive.beating:
        drive.beating = False
        drive.hang_up(2)


def client_gone(drive: Drive, since: float) -> None:
    if drive.controlling:
        drive.controlling = False
        drive.hang_up(1)


def client_silent(drive: Drive, since: float) -> None:
    drive.controlling = False


def misses(drive: Drive, since: float) -> None:
    drive.misses = int(since / 0.06)


def one_more(drive: Drive, since: float) -> None:
    """One frame of each kind more every half second: a hundred a second although they come later and later."""
    if drive.k % 100 == 0:
        drive.transmit()


def asked_at(when: Callable[[Drive], float]) -> Any:
    """The request says that it was computed from another moment's data."""

    def request(drive: Drive, angle: float, since: float) -> float:
        drive.snapshot["t"] = when(drive)
        return angle

    return request


def rogue_enable(drive: Drive, since: float) -> None:
    """After our end, somebody else keeps the kit enabled."""
    if drive.mode != "ENGAGED":
        drive.kit_enabled, drive.heard = True, drive.t


def halting(drive: Drive, sent: Frames, since: float) -> Frames:
    """Every other 50 ms without frames."""
    return sent if since % 0.1 < 0.05 else []


WEAK = wire.report(0.0, 0.0, 5.0, 0.0, {"ENABLED"})
FOREIGN = struct.pack("<hBB4x", 300, 1, 0)
JUNK = (0x333, bytes(8), "")
sign = [("left", 1.0), ("right", -1.0)]
PLACES = ("bend", "straight", "entry")


def turned(rate: float) -> Sense:
    def sense(drive: Drive, values: Sensed, since: float) -> None:
        cos, sin = math.cos(rate * since), math.sin(rate * since)
        values.x, values.y = cos * values.x - sin * values.y, sin * values.x + cos * values.y
        values.psi += rate * since

    return sense


def repeats(drive: Drive, values: Sensed, since: float) -> None:
    if drive.kit_enabled:
        values.angle = drive.command
