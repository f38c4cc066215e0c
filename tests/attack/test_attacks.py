"""The product against the attacker: judged by the true car, its lateral acceleration, and the bus.

All attacks at all speeds, as a table: `python -m tests.attack.table`.
"""

from __future__ import annotations

import math

import pytest

from tests.attack.attacks import ATTACKS
from tests.attack.bench import Drive

SPEEDS = (2.0, 5.0, 7.0)
FAST = (
    "x and y stand still, bend",
    "all of the pose stands still but stamp and counter, bend",
    "heading jumps by 20 deg",
    "heading jumps by 90 deg",
    "heading stands still, bend",
    "position drifts left at 1.0 m/s, bend",
    "position drifts right at 2.0 m/s, straight",
)
"""Attacks that have to end within half a second at 2 m/s and above."""


def test_there_are_enough() -> None:
    assert len(ATTACKS) >= 120


@pytest.mark.parametrize(("name", "speed"), [(name, SPEEDS[i % 3]) for i, name in enumerate(ATTACKS)])
def test_whatever_happens_the_car_stays_on_its_path(name: str, speed: float) -> None:
    attack = ATTACKS[name]
    drive = Drive(attack, speed=speed).run()
    assert drive.engaged_at_onset(), drive.core.obstacles()
    assert drive.excess() <= attack.excess_max, drive.cause()
    assert drive.a_y() <= attack.a_y_max
    assert drive.bus_faults() == []
    if not (attack.harmless or attack.physics):
        assert math.isfinite(drive.ended()), f"{name} went unnoticed"
    if attack.harmless and math.isinf(drive.ended()):
        assert drive.excess() < 0.25
    if name in FAST:
        assert drive.silence() <= 0.5


@pytest.mark.parametrize("name", FAST)
def test_what_looks_plausible_is_noticed_within_half_a_second(name: str) -> None:
    assert max(Drive(ATTACKS[name], speed=2.0, seed=seed).run().silence() for seed in (1, 2)) <= 0.5


@pytest.mark.parametrize("name", ["heartbeat stops", "the operator's terminal is gone"])
def test_without_a_heartbeat_the_wheel_is_free_after_300_ms(name: str) -> None:
    drive = Drive(ATTACKS[name], speed=5.0, seed=3).run()
    assert drive.silence() <= 0.3


@pytest.mark.parametrize("seed", [0, 1])
def test_without_an_attack_it_drives_on(seed: int) -> None:
    """Under noise, on a course of straights and bends: no false alarm."""
    from tests.attack.bench import Attack

    drive = Drive(Attack("none", seconds=40.0), speed=5.0, seed=seed).run()
    assert math.isinf(drive.ended()), drive.cause()
    assert drive.excess() < 0.25
