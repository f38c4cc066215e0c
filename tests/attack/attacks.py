"""The attacks: what sensors, kit, bus, clock, client, operator and car may do wrong, one at a time."""

import math
import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from steerkit.car.core import Link
from tests.attack import wire
from tests.attack.bench import STEP, Attack, Drive, Sensed
from tests.attack.car import centred

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


def steady(size: float) -> Callable[[float], float]:
    return lambda t: size


def growing(rate: float) -> Callable[[float], float]:
    return lambda t: rate * t


def plus(name: str, error: Callable[[float], float]) -> Sense:
    return changed(**{name: lambda value, t: value + error(t)})


NOTHING = steady(0.0)


def moved(along: Callable[[float], float] = NOTHING, across: Callable[[float], float] = NOTHING) -> Sense:
    """The position is off, along or across the heading [m]."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        a, c, psi = along(since), across(since), drive.car.psi
        values.x += a * math.cos(psi) - c * math.sin(psi)
        values.y += a * math.sin(psi) + c * math.cos(psi)

    return sense


def flag(*names: str, up: bool = True) -> Sense:
    """Flags of the kit's report."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        values.flags = values.flags | set(names) if up else values.flags - set(names)

    return sense


def frames(*ids: int, change: Callable[[bytes], bytes] = bytes, drop: bool = False) -> Any:
    """Frames of these ids come changed, or not at all."""
    return lambda drive, sent, since: [
        (i, change(d) if i in ids else d, k) for i, d, k in sent if not (drop and i in ids)
    ]


def beside(*more: tuple[int, bytes, str], times: int = 1) -> Any:
    """Frames of another sender, after ours."""
    return lambda drive, sent, since: [*sent, *(list(more) * times)]


def replaced(frame_id: int, kind: str) -> Any:
    """The true frame stays away; the last one before the onset comes again and again, as one of that kind."""
    return lambda drive, sent, since: [
        (i, drive.frozen.setdefault(i, d), kind) if i == frame_id else (i, d, k) for i, d, k in sent
    ]


def once(what: Callable[[Drive], None]) -> Any:
    """At the onset, and not again."""

    def act(drive: Drive, since: float) -> None:
        if not drive.frozen.get(act):
            drive.frozen[act] = True
            what(drive)

    return act


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


def another_panel(drive: Drive, since: float) -> None:
    """The panel that engaged stands still; another one, which came meanwhile, goes on reading its keys."""
    drive.beating = False
    if drive.frozen.setdefault("came", drive.k) == drive.k:
        drive.handle(Link(drive.t, 3, True))
        drive.packet(3, wire.HELLO[False])
    drive.packet(3, wire.BEAT)


WEAK = wire.report(0.0, 0.0, 5.0, 0.0, {"ENABLED"})
FOREIGN = struct.pack("<hBB4x", 300, 1, 0)
JUNK = (0x333, bytes(8), "")
SLIGHT = "at 2 m/s a steady 0.25 m off, within e_max"
UNASKED = "the motor turns the wheel as nobody asked; only the yaw rate, later, tells"


def turned(rate: float) -> Sense:
    def sense(drive: Drive, values: Sensed, since: float) -> None:
        cos, sin = math.cos(rate * since), math.sin(rate * since)
        values.x, values.y = cos * values.x - sin * values.y, sin * values.x + cos * values.y
        values.psi += rate * since

    return sense


def repeats(drive: Drive, values: Sensed, since: float) -> None:
    if drive.kit_enabled:
        values.angle = drive.command


rad = math.radians


def another_drive(pace: float = 1.0) -> Sense:
    """The pose is that of another car, which from now on drives the course exactly: it agrees with itself in all."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        car, ghost = drive.car, drive.frozen.setdefault("ghost", replace(drive.car))
        for _ in range(2):
            ghost.steer(centred(*ghost.error()[:2], ghost.v, ghost.r, ghost.error()[2]), STEP)
            ghost.move(STEP, pace * drive.speed)
        for name in ("x", "y", "psi", "v", "r"):
            setattr(values, name, getattr(values, name) + getattr(ghost, name) - getattr(car, name))
        values.beta, values.a_y = math.atan2(ghost.slide, max(ghost.v, 0.5)), ghost.a_y

    return sense


def reckoned(bias: float, told: float = 0.0) -> Sense:
    """Heading and position are reckoned from a yaw rate with a bias, of which the yaw rate tells a share."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        car, dt = drive.car, 2.0 * STEP
        x, y = drive.frozen.get("reckoned", (0.0, 0.0))
        off = bias * since
        for side, angle in ((1.0, car.psi + off), (-1.0, car.psi)):
            cos, sin = math.cos(angle), math.sin(angle)
            x += side * dt * (car.v * cos - car.slide * sin)
            y += side * dt * (car.v * sin + car.slide * cos)
        drive.frozen["reckoned"] = x, y
        values.x, values.y, values.psi, values.r = values.x + x, values.y + y, values.psi + off, values.r + told * bias

    return sense


def slow(share: float) -> Sense:
    """What was, played back slower than it happened, with fresh stamps."""

    def sense(drive: Drive, values: Sensed, since: float) -> None:
        past = drive.frozen.setdefault("past", [])
        past.append({name: getattr(values, name) for name in ("x", "y", "psi", "v", "r", "beta", "a_y")})
        for name, value in past[int((1.0 - share) * (len(past) - 1))].items():
            setattr(values, name, value)

    return sense


def both(*senses: Sense) -> Sense:
    def sense(drive: Drive, values: Sensed, since: float) -> None:
        for one in senses:
            one(drive, values, since)

    return sense


def _liars() -> Iterator[Attack]:
    """What agrees with itself in all that the positioning system says; only the kit tells."""
    for where in ("bend", "entry", "straight"):
        lies: dict[str, dict[str, Any]] = {
            "the pose of another, perfect drive": {"sense": another_drive()},
            "the pose of another drive, 3 % faster": {"sense": another_drive(1.03)},
            "reckoned from a yaw rate 2.3 deg/s off, told": {"sense": reckoned(rad(2.3), 1.0)},
            "reckoned from a yaw rate 0.4 deg/s off, hidden": {"sense": reckoned(rad(0.4))},
            "reckoned from a yaw rate -0.4 deg/s off, told": {"sense": reckoned(rad(-0.4), 1.0)},
            "pose 0.8 m/s too fast in all": {"sense": both(moved(along=growing(0.8)), plus("v", steady(0.8)))},
            "pose 0.8 m/s too slow in all": {"sense": both(moved(along=growing(-0.8)), plus("v", steady(-0.8)))},
            "values 5.5 % slower than time": {"sense": slow(0.055)},
            "jumps of 0.24 m every 4.2 s": {"sense": moved(across=lambda t: 0.24 * math.ceil(t / 4.2))},
            "jumps of 0.14 m every 4.2 s": {"sense": moved(across=lambda t: 0.14 * math.ceil(t / 4.2))},
            "a sideslip of 2 degrees that is none": {
                "sense": both(
                    lambda d, v, t: moved(across=growing(d.speed * rad(2.0)))(d, v, t), plus("beta", steady(rad(2.0)))
                )
            },
            "gain of the motor and its sensor 0.6": {
                "sense": changed(angle=lambda a, t: a / max(0.6, 1.0 - t)),
                "motor": lambda d, a, t: max(0.6, 1.0 - t) * a,
            },
        }
        for what, lie in lies.items():
            yield Attack(f"{what}, {where}", where=where, course="careful", seconds=12.0, **lie)


def _pose() -> Iterator[Attack]:
    for where in ("bend", "straight"):
        for what, names in (
            ("x and y stand still", "x y"),
            ("all of the pose stands still but stamp and counter", "x y psi v r beta a_y"),
            ("position, heading and yaw rate stand still", "x y psi r"),
            ("speed and position stand still", "x y v"),
        ):
            yield Attack(f"{what}, {where}", sense=held(*names.split()), where=where)
        for size in (0.2, 0.5, 1.0, 2.0):
            for side, rate in (("left", size), ("right", -size)):
                name = f"position drifts {side} at {size} m/s, {where}"
                yield Attack(name, sense=moved(across=growing(rate)), where=where)
    for where in ("bend", "straight", "entry"):
        yield Attack(f"heading stands still, {where}", sense=held("psi"), where=where, harmless=where == "straight")
    for name in ("x", "y"):
        yield Attack(f"{name} stands still", sense=held(name))
    for size in (20.0, -20.0, 30.0, 90.0, 180.0):
        yield Attack(f"heading jumps by {size:g} deg", sense=plus("psi", steady(rad(size))))
    for rate in (3.0, 10.0, -10.0, 30.0):
        yield Attack(f"heading drifts at {rate:g} deg/s", sense=plus("psi", growing(rad(rate))))
    for size in (0.6, -0.6, 1.0, 3.0):
        yield Attack(f"position jumps {size:g} m across", sense=moved(across=steady(size)))
        yield Attack(f"position jumps {size:g} m along", sense=moved(along=steady(size)))
    for rate in (1.0, -1.0, 2.0):
        yield Attack(f"position runs {rate:g} m/s along", sense=moved(along=growing(rate)))
    yield from [
        Attack("position swings across by 1 m in 2 s", sense=moved(across=lambda t: math.sin(math.pi * t))),
        Attack("heading swings by 10 deg", sense=changed(psi=lambda p, t: p + rad(10.0) * math.sin(math.pi * t))),
        Attack("position and heading turn together about the origin at 3 deg/s", sense=turned(rad(3.0))),
        Attack("yaw rate reversed", sense=changed(r=lambda r, t: -r)),
        Attack("yaw rate stands still", sense=held("r"), where="entry"),
        Attack("yaw rate is zero", sense=changed(r=lambda r, t: 0.0)),
        Attack("yaw rate + 0.2 rad/s", sense=changed(r=lambda r, t: r + 0.2)),
        Attack("yaw rate halved", sense=changed(r=lambda r, t: 0.5 * r)),
        Attack(
            "heading and yaw rate + 0.1 rad/s together",
            sense=changed(r=lambda r, t: r + 0.1, psi=lambda p, t: p + 0.1 * t),
        ),
        Attack("speed of the pose stands still while the car slows", sense=held("v"), speed=lambda d, v, t: 0.3 * v),
        Attack("speed of the pose halved", sense=changed(v=lambda v, t: 0.5 * v)),
        Attack("both speeds halved", sense=changed(v=lambda v, t: 0.5 * v, v_kit=lambda v, t: 0.5 * v)),
        Attack("both speeds times 1.5", sense=changed(v=lambda v, t: 1.5 * v, v_kit=lambda v, t: 1.5 * v)),
        Attack("both speeds zero", sense=changed(v=lambda v, t: 0.0, v_kit=lambda v, t: 0.0)),
        Attack("quality 0", sense=changed(quality=lambda q, t: 0.0)),
    ]
    for name in ("x", "y", "psi", "v", "r"):
        yield Attack(f"{name} not available", sense=changed(**{name: lambda value, t: math.nan}))


def _kit() -> Iterator[Attack]:
    yield from [
        Attack("steering sensor stands still", sense=held("angle"), where="entry"),
        Attack("steering sensor + 35 deg", harmless=True, sense=plus("angle", steady(rad(35.0)))),
        Attack("steering sensor - 35 deg", harmless=True, sense=plus("angle", steady(rad(-35.0)))),
        Attack("steering sensor times 0.8", harmless=True, sense=changed(angle=lambda a, t: 0.8 * a)),
        Attack("steering sensor reversed", sense=changed(angle=lambda a, t: -a)),
    ]
    motors: tuple[tuple[str, Any, dict[str, Any]], ...] = (
        ("100 deg off", lambda d, a, t: a + rad(100.0), {"physics": UNASKED, "a_y_max": 5.0}),
        ("40 deg off", lambda d, a, t: a - rad(40.0), {"harmless": True}),
        ("turns the wrong way", lambda d, a, t: -a, {"physics": UNASKED, "a_y_max": 3.6}),
        ("stands still", lambda d, a, t: d.car.wheel, {"where": "entry"}),
    )
    for what, motor, more in motors:
        yield Attack(f"motor {what}, its sensor repeats the command", motor=motor, sense=repeats, **more)
    yield from [
        Attack("motor torn off", motor=lambda d, a, t: d.car.wheel, where="entry"),
        Attack(
            "motor runs to the left",
            physics="the motor turns as nobody asked, to its stop",
            a_y_max=6.0,
            motor=lambda d, a, t: d.car.wheel + 0.5 if d.kit_enabled else a,
        ),
        Attack("echo of another command", sense=changed(echo=lambda a, t: a + rad(5.0))),
        Attack("override flag", sense=flag("OVERRIDE")),
        Attack("kit fault", sense=flag("FLTPWR")),
        Attack("two kit faults", sense=flag("FLTBUS1", "FLTCAL")),
        Attack("kit watchdog flag", sense=flag("TMOUT")),
        Attack("kit not enabled", sense=flag("ENABLED", up=False)),
        Attack("torque 5 N m", sense=changed(torque=lambda m, t: 5.0)),
        Attack(
            "torque - 7.5 N m, a foreign sender of weak reports",
            sense=changed(torque=lambda m, t: -7.5),
            frames=beside((wire.REPORT, WEAK, "")),
        ),
        Attack("a foreign sender of the report", frames=beside((wire.REPORT, WEAK, ""))),
        Attack("a foreign sender of the command", frames=beside((wire.COMMAND, FOREIGN, ""))),
        Attack("report speed + 3 m/s", sense=changed(v_kit=lambda v, t: v + 3.0)),
        Attack("report dropped", frames=frames(wire.REPORT, drop=True)),
        Attack("report repeated", frames=replaced(wire.REPORT, "")),
        Attack("report with 7 bytes", frames=frames(wire.REPORT, change=lambda d: d[:7])),
        Attack("report as a 29-bit id in its place", frames=replaced(wire.REPORT, "x")),
        Attack("report as CAN FD in its place", frames=replaced(wire.REPORT, "fd")),
        Attack("report all ones", frames=frames(wire.REPORT, change=lambda d: b"\xff" * 8)),
        Attack("report all zeros", frames=frames(wire.REPORT, change=lambda d: bytes(8))),
        Attack("somebody else enables the kit after us", act=rogue_enable, sense=flag("OVERRIDE"), seconds=2.0),
    ]
    for frame_id, name in ((wire.POSITION, "position"), (wire.MOTION, "motion"), (wire.DYNAMICS, "dynamics")):
        for what, edit in (
            ("dropped", frames(frame_id, drop=True)),
            ("repeated", replaced(frame_id, "")),
            ("with a wrong CRC", frames(frame_id, change=lambda d: d[:7] + bytes([d[7] ^ 1]))),
            ("with a turned bit", frames(frame_id, change=lambda d: bytes([d[0] ^ 4]) + d[1:])),
            ("as a 29-bit id in their place", replaced(frame_id, "x")),
            ("as CAN FD in their place", replaced(frame_id, "fd")),
            ("of 3 bytes", frames(frame_id, change=lambda d: d[:3])),
        ):
            yield Attack(f"{name} frames {what}", frames=edit)


def _time() -> Iterator[Attack]:
    for late in (0.1, 0.16, 0.2, 0.5):
        yield Attack(f"pose {late:g} s late", latency=steady(late), harmless=late < 0.15)
    fast = plus("stamp", growing(0.02))
    yield from [
        Attack("stamps 2 % fast", sense=fast),
        Attack("stamps 2 % fast, delay growing by 20 ms a second", sense=fast, latency=growing(0.02), seconds=15.0),
        Attack(
            "a clock 2 % slow: stamps, counters and the delay agree",
            sense=fast,
            latency=growing(0.02),
            act=one_more,
            seconds=15.0,
            harmless=True,
        ),
        Attack("delay growing by 20 ms a second", latency=growing(0.02), seconds=10.0),
        Attack("delay growing by 100 ms a second", latency=growing(0.1)),
        Attack("stamp 5 s ahead", sense=plus("stamp", steady(5.0))),
        Attack("stamp 5 s ahead and back", sense=changed(stamp=lambda s, t: s + 5.0 * (t < 0.5))),
        Attack("stamp stands still", sense=held("stamp")),
        Attack("stamps at random", sense=changed(stamp=lambda s, t: s + 0.5 * math.sin(1e4 * t))),
    ]


def _client() -> Iterator[Attack]:
    lock, careful = rad(520.0), {"course": "careful"}
    yield from [
        Attack("request NaN", request=lambda d, a, t: math.nan),
        Attack("request infinite", request=lambda d, a, t: math.inf),
        Attack("request 1e9 rad", request=lambda d, a, t: 1e9),
        Attack("request 1e308 rad", request=lambda d, a, t: -1e308),
        Attack("request silent", request=lambda d, a, t: None),
        Attack("client silent", act=lambda d, t: setattr(d, "controlling", False)),
        Attack("client gone", act=once(lambda d: d.hang_up(1))),
        Attack("client asks from old data", request=asked_at(lambda d: d.onset)),
        Attack("client asks from the future", request=asked_at(lambda d: d.t + 1.0)),
        Attack("client misses deadlines", act=lambda d, t: setattr(d, "misses", int(t / 0.06))),
        Attack("full lock left", request=lambda d, a, t: lock, **careful),
        Attack("full lock right", request=lambda d, a, t: -lock, **careful),
        Attack("full lock left, straight", request=lambda d, a, t: lock, where="straight", **careful),
        Attack("bang-bang at 20 Hz", request=lambda d, a, t: lock if round(t / 0.05) % 2 else -lock, **careful),
        Attack("bang-bang at 1 Hz", request=lambda d, a, t: lock if round(t / 0.5) % 2 else -lock, **careful),
        Attack("steers the wrong way", request=lambda d, a, t: -a, **careful),
        Attack("steers twice as much", harmless=True, request=lambda d, a, t: 2.0 * a, **careful),
        Attack("100 deg to the left", request=lambda d, a, t: a + rad(100.0), physics=SLIGHT, **careful),
        Attack("always straight ahead", request=lambda d, a, t: 0.0, **careful),
        Attack("holds the wheel", request=lambda d, a, t: d.frozen.setdefault("a", a), where="entry", **careful),
    ]


def _people_and_bus() -> Iterator[Attack]:
    yield from [
        Attack("heartbeat stops", act=lambda d, t: setattr(d, "beating", False)),
        Attack("heartbeat stops, another panel goes on", act=another_panel),
        Attack("the operator's terminal is gone", act=once(lambda d: d.hang_up(2))),
        Attack("space bar", act=once(lambda d: d.order("DISENGAGE"))),
        Attack("off", act=once(lambda d: d.order("OFF"))),
        Attack("bus silent", frames=lambda d, sent, t: []),
        Attack(
            "bus silent for 50 ms at a time", frames=lambda d, sent, t: sent if t % 0.1 < 0.05 else [], harmless=True
        ),
        Attack("a flood of other frames", frames=beside(JUNK, times=30), seconds=3.0, harmless=True),
        Attack("a flood of garbled lines", frames=beside((-1, b"T00", "bad"), times=3)),
        Attack(
            "a garbled line now and then",
            frames=lambda d, sent, t: [*sent, (-1, b"?", "bad")] if d.k % 400 == 0 else sent,
            harmless=True,
        ),
        Attack("frames shuffled", frames=lambda d, sent, t: sent[::-1], harmless=True),
        Attack("every frame twice", frames=lambda d, sent, t: [f for frame in sent for f in (frame, frame)]),
        Attack("reversing", speed=lambda d, v, t: -2.0),
        Attack(
            "reversing, speeds without a sign",
            speed=lambda d, v, t: -2.0,
            sense=changed(v=lambda v, t: abs(v), v_kit=lambda v, t: abs(v)),
        ),
        Attack("standstill", speed=lambda d, v, t: 0.0),
        Attack("faster and faster", speed=lambda d, v, t: v + 2.0 * t, where="straight"),
        Attack("the open course ends", course="road", seconds=90.0),
    ]


LIARS = {a.name: a for a in _liars()}
"""Those that agree with themselves, by name."""
ATTACKS = {a.name: a for a in (*_pose(), *_kit(), *_time(), *_client(), *_people_and_bus())}
"""All, by name."""

OF_A_KIT = tuple(
    name
    for name in ATTACKS
    if name.startswith(("report ", "kit ", "two kit ", "echo ", "a foreign sender of the ", "bang-bang at "))
    and name != "report speed + 3 m/s"
)
"""Those on a kit's own frames and flags, and those that a slow gate makes harmless: not for production cars."""
