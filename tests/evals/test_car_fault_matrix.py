"""Every fault in every state, on a clock that the test moves: what ends driving, when, and what went over the bus.

`python -m tests.evals.test_car_fault_matrix [NAME ...]` prints the table of docs/real-car.md, or these rows of it.
"""

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import pytest

from steerkit.car.config import CarConfig, load, shipped
from steerkit.car.core import Link
from steerkit.car.simulated import Fault
from steerkit.car.state_machine import Mode, Order
from steerkit.diagram.units import degrees_of
from tests.support.car_world import World

PEDALS = 0x70
DBC = """VERSION ""
BU_: PC CAR
BO_ 112 PEDALS: 2 CAR
 SG_ BRAKE_PRESSED : 3|1@1+ (1,0) [0|1] "" PC
 SG_ GAS : 9|2@1+ (1,0) [0|3] "" PC
"""
READ = """brake = { frame = "PEDALS", signal = "BRAKE_PRESSED" }
accelerator = { frame = "PEDALS", signal = "GAS" }

[read.faults]"""


@cache
def with_pedals() -> CarConfig:
    """The shipped configuration, and a frame of the car's with both pedals, fifty times a second."""
    text = shipped("dbw-kit.toml").read_text(encoding="utf-8")
    text = text.replace('"pose.dbc"]', '"pose.dbc", "pedals.dbc"]').replace("[read.faults]", READ, 1)
    text = text.replace("[protect] ", "[protect]\nPEDALS = { period = 0.02 }\n#", 1)
    with TemporaryDirectory() as folder:
        Path(folder, "pedals.dbc").write_text(DBC)
        Path(folder, "car.toml").write_text(text)
        return load(Path(folder, "car.toml"))


def pedals_say(data: bytes | None) -> Callable[[World], None]:
    """From now on; None: nothing."""

    def act(world: World) -> None:
        advance = world.car.advance
        world.car.advance = lambda t: [  # type: ignore[method-assign]
            (when, i, data if i == PEDALS else told) for when, i, told in advance(t) if data or i != PEDALS
        ]

    return act


def plant_fault(kind: str, target: str, amount: float = 0.0) -> Callable[[World], None]:
    return lambda world: world.car.faults.append(Fault(kind=kind, target=target, start=world.t, amount=amount))


def ask(change: Callable[[float, float], tuple[float, float] | None]) -> Callable[[World], None]:
    return lambda world: setattr(world, "tampered", change)


def miss_deadlines(world: World) -> None:
    world.misses += 3


def sleep(seconds: float) -> Callable[[World], None]:
    return lambda world: setattr(world, "asleep_until", world.t + seconds)


class Case(NamedTuple):
    act: Callable[[World], None]
    cause: str
    within: float
    """Time to disengage at most [s]."""
    to: Mode = Mode.FAULT


CASES = {
    "pose dropped": Case(plant_fault("drop", "pose"), "pose stale", 0.15),
    "report dropped": Case(plant_fault("drop", "report"), "report stale", 0.1),
    "pose 0.2 s late": Case(plant_fault("delay", "pose", 0.2), "pose stale", 0.15),
    "report 0.2 s late": Case(plant_fault("delay", "report", 0.2), "report stale", 0.1),
    "pose repeated": Case(plant_fault("freeze", "pose"), "integrity", 0.03),
    "report repeated": Case(plant_fault("freeze", "report"), "command echo", 0.15),
    "pose stands still": Case(plant_fault("stuck", "pose"), "integrity", 0.161),  # its first frame is still true
    "pose corrupted": Case(plant_fault("corrupt", "pose"), "integrity", 0.03),
    "report corrupted": Case(plant_fault("corrupt", "report"), "", 0.3),
    "pose counter": Case(plant_fault("counter", "pose"), "integrity", 0.03),
    "pose 0x8000": Case(plant_fault("nan", "pose"), "integrity", 0.03),
    "report 0x8000": Case(plant_fault("nan", "report"), "integrity", 0.05),
    "pose jumps 3 m": Case(plant_fault("jump", "pose", 3.0), "integrity", 0.02),
    "pose quality 0": Case(plant_fault("quality", "pose"), "pose quality", 0.02),
    "pose speed + 3 m/s": Case(plant_fault("speed", "pose", 3.0), "speed mismatch", 0.02),
    "kit speed + 3 m/s": Case(plant_fault("speed", "report", 3.0), "speed mismatch", 0.03),
    "override flag": Case(plant_fault("override", "report"), "override", 0.04, Mode.OVERRIDE),
    "human torque": Case(plant_fault("torque", "report", 5.0), "torque", 0.07, Mode.OVERRIDE),
    "kit fault": Case(plant_fault("kit_fault", "report"), "kit fault", 0.03),
    "kit watchdog flag": Case(plant_fault("timeout", "report"), "kit timeout", 0.03),
    "kit not enabled": Case(plant_fault("disabled", "report"), "kit not enabled", 0.03),
    "kit hears nothing": Case(plant_fault("deaf", "report"), "kit timeout", 0.15),
    "motor torn off": Case(plant_fault("loose", "report"), "", 2.5),
    "request NaN": Case(ask(lambda basis, delta_sw: (basis, math.nan)), "request invalid", 0.05),
    "request 1e9 rad": Case(ask(lambda basis, delta_sw: (basis, 1e9)), "request invalid", 0.05),
    "request inf": Case(ask(lambda basis, delta_sw: (basis, -math.inf)), "request invalid", 0.05),
    "requests from the future": Case(ask(lambda basis, delta_sw: (basis + 9.0, delta_sw)), "", 0.15),
    "requests from old data": Case(ask(lambda basis, delta_sw: (basis - 1.0, delta_sw)), "controller silent", 0.05),
    "controller silent": Case(ask(lambda basis, delta_sw: None), "controller silent", 0.15),
    "controller gone": Case(lambda world: world.handle(Link(world.t, 1, False)), "controller gone", 0.001),
    "3 missed deadlines": Case(miss_deadlines, "missed deadlines", 0.05),
    "car server stalls 80 ms": Case(sleep(0.08), "server late", 0.085),
    "brake": Case(plant_fault("brake", "report"), "brake: the human brakes", 0.021, Mode.OVERRIDE),
    "accelerator": Case(plant_fault("accelerator", "report"), "accelerator: the human ", 0.021, Mode.OVERRIDE),
    "space bar": Case(lambda world: world.order(Order.DISENGAGE), "operator", 0.001, Mode.STANDBY),
    "pedals not available": Case(pedals_say(b"\0\6"), "accelerator: the human ", 0.05, Mode.OVERRIDE),
    "pedals silent": Case(pedals_say(None), "report stale", 0.1),
}


class Outcome(NamedTuple):
    world: World
    began: float
    ended: float
    mode: Mode
    cause: str
    last_enabled: float


def try_out(name: str, mode: Mode) -> Outcome:
    """One fault in one state, until the state changed and a little longer."""
    case, world = CASES[name], World(config=with_pedals()).bring_to(mode)
    began, seen = world.t, len(world.modes)
    case.act(world)
    wait = max(case.within, 0.15) + 0.1 if mode is Mode.ENGAGED else 0.25
    world.until(began + wait)
    changed = world.modes[seen:]
    ended, after, cause = changed[0] if changed else (math.inf, world.mode, "")
    enabled = [s.t for s in world.sent if s.enable]
    return Outcome(world, began, ended, after, cause, max(enabled, default=-math.inf))


def test_without_a_fault_the_car_drives_the_bend() -> None:
    world = World().bring_to(Mode.ENGAGED)
    world.until(6.0)
    assert world.mode is Mode.ENGAGED
    assert world.last is not None
    assert abs(world.last.e) < 0.05
    assert max(abs(s.delta_sw) for s in world.sent) > 0.5
    world.check_bus()
    gaps = [b.t - a.t for a, b in zip(world.sent, world.sent[1:])]
    assert max(gaps) <= 0.02 + 1e-6


@pytest.mark.parametrize("name", CASES)
def test_while_engaged_it_lets_go_in_time_for_good_and_says_why(name: str) -> None:
    case, outcome = CASES[name], try_out(name, Mode.ENGAGED)
    world = outcome.world
    if case.cause == "" and case.to is Mode.FAULT:
        assert outcome.mode in (Mode.FAULT, Mode.OVERRIDE)
    else:
        assert outcome.mode is case.to
        assert outcome.cause.startswith(case.cause)
    assert outcome.ended - outcome.began <= case.within + 1e-6
    assert outcome.last_enabled <= outcome.ended + 1e-9
    world.check_bus()
    tail = [s for s in world.sent if s.t > outcome.last_enabled]
    assert all(not s.enable for s in tail)
    assert min(s.t for s in tail) <= outcome.ended + world.config.gate.dt_min + 1e-6  # told to let go at once
    # the fault ends, everything is well again, the operator sleeps: nobody engages
    world.car.faults.clear()
    world.tampered = lambda basis, delta_sw: (basis, delta_sw)
    world.until(world.t + 0.5)
    assert world.mode is outcome.mode or (case.to is Mode.STANDBY and world.mode is Mode.READY)
    assert max(s.t for s in world.sent if s.enable) == outcome.last_enabled


@pytest.mark.parametrize("name", CASES)
def test_while_ready_nothing_moves(name: str) -> None:
    outcome = try_out(name, Mode.READY)
    assert outcome.world.mode in (Mode.STANDBY, Mode.READY)
    assert outcome.last_enabled <= outcome.began
    outcome.world.check_bus()


@pytest.mark.parametrize("mode", [Mode.OFF, Mode.STANDBY, Mode.OVERRIDE, Mode.FAULT])
def test_in_every_other_state_nothing_moves_one_fault_after_the_other(mode: Mode) -> None:
    world = World(config=with_pedals()).bring_to(mode)
    began, hand = world.t, list(world.car.faults)
    for case in CASES.values():
        case.act(world)
        world.until(world.t + 0.1)
        assert world.mode is mode
        world.car.faults[:], world.tampered = hand, lambda basis, delta_sw: (basis, delta_sw)
        world.until(world.t + 0.05)
    assert not any(s.enable for s in world.sent if s.t > began)
    world.check_bus()


def test_one_late_step_trips_neither_server_nor_kit() -> None:
    world = World().bring_to(Mode.ENGAGED)
    world.due += 0.05
    world.until(world.t + 0.5)
    assert world.mode is Mode.ENGAGED
    assert not world.car.timeout
    gaps = [b.t - a.t for a, b in zip(world.sent, world.sent[1:])]
    assert 0.02 < max(gaps) < 0.1  # silent for a while, but less than the kit's watchdog


def test_a_dead_controller_is_silent_within_75_ms_of_its_data() -> None:
    world = World().bring_to(Mode.ENGAGED)
    world.tampered = lambda basis, delta_sw: None
    began = world.t
    world.until(began + 0.149)
    assert max(s.t for s in world.sent) <= began + 0.075


def test_listen_only_never_sends() -> None:
    world = World()
    world.core.config = replace(world.config, listen_only=True)
    world.order(Order.ARM)
    world.until(0.5)
    for order in Order:
        world.order(order, then=0.1)
    assert world.sent == []


def test_after_a_fault_the_operator_may_engage_again() -> None:
    world = World().bring_to(Mode.FAULT)
    world.order(Order.ENGAGE, then=0.1)
    assert world.mode is Mode.FAULT  # refused
    world.until(world.t + 1.0)
    world.order(Order.ACKNOWLEDGE, then=0.2)
    assert world.mode is Mode.READY, world.core.obstacles()
    world.order(Order.ENGAGE, then=1.0)
    assert world.mode is Mode.ENGAGED
    world.check_bus()


def table(names: Iterable[str]) -> Iterator[str]:
    """The fault table, as Markdown."""
    yield "| fault | cause | state | time to disengage [ms] | last command [deg] | after it |"
    yield "|---|---|---|---|---|---|"
    for name in names:
        o = try_out(name, Mode.ENGAGED)
        last = next(s for s in reversed(o.world.sent) if s.enable)
        after = sum(not s.enable for s in o.world.sent)
        yield (
            f"| {name} | {o.cause} | {o.mode} | {1e3 * (o.ended - o.began):.0f} | {degrees_of(last.delta_sw):.1f} "
            f"| {after} neutral frames, then silence |"
        )


if __name__ == "__main__":
    print("\n".join(table(sys.argv[1:] or CASES)))
