"""Test drives: any controller, learned or analytic, over whole rounds of a course, for metrics and pictures."""

from __future__ import annotations

import math
import time
from dataclasses import replace

from steerkit.assembly import steering_loop
from steerkit.block import Block
from steerkit.catalogue import CONTROLLERS, make_controller
from steerkit.errors import known
from steerkit.loop import Loop
from steerkit.scenario.world import World
from steerkit.simulation import Log, Sample, simulate
from steerkit.task import TRIP


def controller(name: str, world: World) -> Block:
    """The analytic controller of that name for that world; raises ValueError with the valid names."""
    known(name, CONTROLLERS, "controller", also="the directory of a learning run")
    return make_controller(name, world.belief(clock=time.perf_counter))


def drive_loop(world: World, steering: Block, *, doe: Block | None = None, seed: int = 0, s: float = 0.0) -> Loop:
    """The loop of a test drive: a policy (with its doe) is caught by the world's recovery controller."""
    path = world.path()
    learned = "ready" in [port.name for port in steering.outputs]
    return steering_loop(
        car=world.car(path, s=s),
        path=path,
        driver=world.driver(seed),
        controller=replace(steering, ready_from=0.0) if learned else steering,  # type: ignore[call-arg]
        doe=doe,
        recovery=world.recovery() if learned else None,
        actuator=world.actuator(),
        sensors=world.sensors(seed),
        reference=world.ahead,
    )


def drive(
    world: World,
    steering: Block,
    *,
    doe: Block | None = None,
    seed: int = 0,
    rounds: float = 1.0,
    s: float = 0.0,
    progress: bool = False,
    only_while_held: bool = False,
) -> Log:
    """Drive `rounds` rounds of the world's course and return the log, 20 samples a second.

    only_while_held: end at the first sample in which the recovery controller has the wheel.
    The run also ends after the time that the slowest driver would need; then the last `path.progress` is short of
    `rounds` times the course.
    """
    loop = drive_loop(world, steering, doe=doe, seed=seed, s=s)
    length = rounds * world.round_length
    ticks = round(steering.dt / loop.dt)
    slowest = math.ceil(length / world.v_min / steering.dt) * steering.dt

    def over(sample: Sample) -> bool:
        lost = only_while_held and sample["supervisor.learning"] < 0.5
        return lost or sample["path.progress"] >= length

    return simulate(loop, slowest + 5.0, every=ticks, until=over, allow_nonfinite=True, progress=progress)


def held_all_along(log: Log, *, limit: float = TRIP) -> bool:
    """Did the controller stay within |e| <= limit [m] and, if learned, keep the wheel from the first sample on?"""
    on_course = bool((abs(log["path.e"]) <= limit).all())
    return on_course and ("supervisor.learning" not in log or bool((log["supervisor.learning"] > 0.5).all()))
