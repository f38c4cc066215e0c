"""The attacks: what sensors, kit, bus, clock, client, operator and car may do wrong, one at a time."""

from __future__ import annotations

import math

from tests.attack import wire
from tests.attack.bench import Attack
from tests.attack.hooks import (
    FOREIGN,
    JUNK,
    PLACES,
    POSE,
    WEAK,
    asked_at,
    beside,
    changed,
    client_gone,
    client_silent,
    flag,
    frames,
    gone,
    halting,
    held,
    misses,
    moved,
    one_more,
    order,
    repeated,
    repeats,
    replaced,
    rogue_enable,
    sign,
    silent,
    turned,
)

rad = math.radians


def _pose() -> list[Attack]:
    found = []
    everything = ("x", "y", "psi", "v", "r", "beta", "a_y")
    for where in ("bend", "straight"):
        found += [
            Attack(f"x and y stand still, {where}", sense=held("x", "y"), where=where),
            Attack(
                f"all of the pose stands still but stamp and counter, {where}", sense=held(*everything), where=where
            ),
            Attack(
                f"position, heading and yaw rate stand still, {where}", sense=held("x", "y", "psi", "r"), where=where
            ),
            Attack(f"speed and position stand still, {where}", sense=held("x", "y", "v"), where=where),
        ]
        for size in (0.2, 0.5, 1.0, 2.0):
            for side, s in sign:
                found.append(
                    Attack(
                        f"position drifts {side} at {size} m/s, {where}",
                        sense=moved(across=lambda t, r=s * size: r * t),
                        where=where,
                    )
                )
    for where in PLACES:
        found.append(
            Attack(f"heading stands still, {where}", sense=held("psi"), where=where, harmless=where == "straight")
        )
    for name in ("x", "y"):
        found.append(Attack(f"{name} stands still", sense=held(name)))
    for size in (20.0, -20.0, 30.0, 90.0, 180.0):
        found.append(Attack(f"heading jumps by {size:g} deg", sense=changed(psi=lambda p, t, a=size: p + rad(a))))
    for rate in (3.0, 10.0, -10.0, 30.0):
        found.append(
            Attack(f"heading drifts at {rate:g} deg/s", sense=changed(psi=lambda p, t, a=rate: p + rad(a) * t))
        )
    for size in (0.6, -0.6, 1.0, 3.0):
        found.append(Attack(f"position jumps {size:g} m across", sense=moved(across=lambda t, a=size: a)))
        found.append(Attack(f"position jumps {size:g} m along", sense=moved(along=lambda t, a=size: a)))
    for rate in (1.0, -1.0, 2.0):
        found.append(Attack(f"position runs {rate:g} m/s along", sense=moved(along=lambda t, a=rate: a * t)))
    found += [
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
        found.append(Attack(f"{name} not available", sense=changed(**{name: lambda value, t: math.nan})))
    return found


def _kit() -> list[Attack]:
    found = [
        Attack("steering sensor stands still", sense=held("angle"), where="entry"),
        Attack("steering sensor + 35 deg", harmless=True, sense=changed(angle=lambda a, t: a + rad(35.0))),
        Attack("steering sensor - 35 deg", harmless=True, sense=changed(angle=lambda a, t: a - rad(35.0))),
        Attack("steering sensor times 0.8", harmless=True, sense=changed(angle=lambda a, t: 0.8 * a)),
        Attack("steering sensor reversed", sense=changed(angle=lambda a, t: -a)),
        Attack(
            "motor 100 deg off, its sensor repeats the command",
            motor=lambda d, a, t: a + rad(100.0),
            sense=repeats,
            physics="the motor turns the wheel as nobody asked; only the yaw rate, later, tells",
            a_y_max=5.0,
        ),
        Attack(
            "motor 40 deg off, its sensor repeats the command",
            harmless=True,
            motor=lambda d, a, t: a - rad(40.0),
            sense=repeats,
        ),
        Attack(
            "motor turns the wrong way, its sensor repeats the command",
            motor=lambda d, a, t: -a,
            sense=repeats,
            physics="the motor turns the wheel as nobody asked; only the yaw rate, later, tells",
            a_y_max=3.6,
        ),
        Attack(
            "motor stands still, its sensor repeats the command",
            motor=lambda d, a, t: d.car.wheel,
            where="entry",
            sense=repeats,
        ),
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
        Attack("report repeated", frames=repeated(wire.REPORT)),
        Attack("report with 7 bytes", frames=frames(wire.REPORT, change=lambda d: d[:7])),
        Attack("report as a 29-bit id in its place", frames=replaced(wire.REPORT, "x")),
        Attack("report as CAN FD in its place", frames=replaced(wire.REPORT, "fd")),
        Attack("report all ones", frames=frames(wire.REPORT, change=lambda d: b"\xff" * 8)),
        Attack("report all zeros", frames=frames(wire.REPORT, change=lambda d: bytes(8))),
        Attack("somebody else enables the kit after us", act=rogue_enable, sense=flag("OVERRIDE"), seconds=2.0),
    ]
    for frame_id, name in zip(POSE, ("position", "motion", "dynamics")):
        found += [
            Attack(f"{name} frames dropped", frames=frames(frame_id, drop=True)),
            Attack(f"{name} frames repeated", frames=repeated(frame_id)),
            Attack(
                f"{name} frames with a wrong CRC", frames=frames(frame_id, change=lambda d: d[:7] + bytes([d[7] ^ 1]))
            ),
            Attack(
                f"{name} frames with a turned bit", frames=frames(frame_id, change=lambda d: bytes([d[0] ^ 4]) + d[1:])
            ),
            Attack(f"{name} frames as a 29-bit id in their place", frames=replaced(frame_id, "x")),
            Attack(f"{name} frames as CAN FD in their place", frames=replaced(frame_id, "fd")),
            Attack(f"{name} frames of 3 bytes", frames=frames(frame_id, change=lambda d: d[:3])),
        ]
    return found


def _time() -> list[Attack]:
    found = []
    for late in (0.1, 0.16, 0.2, 0.5):
        found.append(Attack(f"pose {late:g} s late", latency=lambda t, a=late: a, harmless=late < 0.15))
    found += [
        Attack("stamps 2 % fast", sense=changed(stamp=lambda s, t: s + 0.02 * t)),
        Attack(
            "stamps 2 % fast, delay growing by 20 ms a second",
            sense=changed(stamp=lambda s, t: s + 0.02 * t),
            latency=lambda t: 0.02 * t,
            seconds=15.0,
        ),
        Attack(
            "a clock 2 % slow: stamps, counters and the delay agree",
            sense=changed(stamp=lambda s, t: s + 0.02 * t),
            latency=lambda t: 0.02 * t,
            act=one_more,
            seconds=15.0,
            physics="all that has a time agrees with a clock that runs slow",
        ),
        Attack("delay growing by 20 ms a second", latency=lambda t: 0.02 * t, seconds=10.0),
        Attack("delay growing by 100 ms a second", latency=lambda t: 0.1 * t),
        Attack("stamp 5 s ahead", sense=changed(stamp=lambda s, t: s + 5.0)),
        Attack("stamp 5 s ahead and back", sense=changed(stamp=lambda s, t: s + 5.0 * (t < 0.5))),
        Attack("stamp stands still", sense=held("stamp")),
        Attack("stamps at random", sense=changed(stamp=lambda s, t: s + 0.5 * math.sin(1e4 * t))),
    ]
    return found


def _client() -> list[Attack]:
    lock, careful = rad(520.0), {"course": "careful"}
    return [
        Attack("request NaN", request=lambda d, a, t: math.nan),
        Attack("request infinite", request=lambda d, a, t: math.inf),
        Attack("request 1e9 rad", request=lambda d, a, t: 1e9),
        Attack("request 1e308 rad", request=lambda d, a, t: -1e308),
        Attack("request silent", request=lambda d, a, t: None),
        Attack("client silent", act=client_silent),
        Attack("client gone", act=client_gone),
        Attack("client asks from old data", request=asked_at(lambda d: d.onset)),
        Attack("client asks from the future", request=asked_at(lambda d: d.t + 1.0)),
        Attack("client misses deadlines", act=misses),
        Attack("full lock left", request=lambda d, a, t: lock, **careful),
        Attack("full lock right", request=lambda d, a, t: -lock, **careful),
        Attack("full lock left, straight", request=lambda d, a, t: lock, where="straight", **careful),
        Attack("bang-bang at 20 Hz", request=lambda d, a, t: lock if round(t / 0.05) % 2 else -lock, **careful),
        Attack("bang-bang at 1 Hz", request=lambda d, a, t: lock if round(t / 0.5) % 2 else -lock, **careful),
        Attack("steers the wrong way", request=lambda d, a, t: -a, **careful),
        Attack("steers twice as much", harmless=True, request=lambda d, a, t: 2.0 * a, **careful),
        Attack(
            "100 deg to the left",
            physics="at 2 m/s a steady 0.25 m off, within e_max",
            request=lambda d, a, t: a + rad(100.0),
            **careful,
        ),
        Attack("always straight ahead", request=lambda d, a, t: 0.0, **careful),
        Attack("holds the wheel", request=lambda d, a, t: d.frozen.setdefault("a", a), where="entry", **careful),
    ]


def _people_and_bus() -> list[Attack]:
    return [
        Attack("heartbeat stops", act=silent),
        Attack("the operator's terminal is gone", act=gone),
        Attack("space bar", act=order("DISENGAGE")),
        Attack("off", act=order("OFF")),
        Attack("bus silent", frames=lambda d, sent, t: []),
        Attack("bus silent for 50 ms at a time", frames=halting, harmless=True),
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


ATTACKS = {a.name: a for a in (*_pose(), *_kit(), *_time(), *_client(), *_people_and_bus())}
"""All, by name."""
