"""The product against the attacker: judged by the true car, its lateral acceleration, and the bus.

All attacks at all speeds, as a table: `python -m tests.attack.table`.
"""

import math
from dataclasses import replace

import pytest

from tests.attack.attacks import ATTACKS, LIARS, OF_A_KIT
from tests.attack.bench import SPEEDS, Attack, Drive, calibrated, driven, through_port
from tests.attack.product import CONTROLLERS, HARMLESS, driven_by, lied_to, sooner

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
HEARTBEAT = ("heartbeat stops", "heartbeat stops, another panel goes on", "the operator's terminal is gone")
SOON = dict.fromkeys(FAST, 0.5) | dict.fromkeys(HEARTBEAT, 0.3)
"""By when the wheel has to be free [s]."""


def watched(attack: Attack) -> Attack:
    """It, watched for a third as long if nothing has to be noticed: what it does to the car, it has done by then."""
    return replace(attack, seconds=attack.seconds / 3.0) if attack.harmless or attack.physics else attack


@pytest.mark.parametrize(("name", "speed"), [(name, SPEEDS[i % 3]) for i, name in enumerate(ATTACKS)])
def test_whatever_happens_the_car_stays_on_its_path(name: str, speed: float) -> None:
    drive = driven(watched(ATTACKS[name]), speed=speed)
    assert drive.complaints() == []
    assert drive.silence() <= SOON.get(name, math.inf)


@pytest.mark.parametrize("controller", CONTROLLERS)
def test_without_an_attack_the_product_s_own_controllers_drive_on(controller: str) -> None:
    drive = driven_by(controller, Attack("none", seconds=2.0), speed=5.0)
    assert math.isinf(drive.ended()), drive.cause()
    assert drive.excess() < 0.1
    assert {"nfq": 1.0}.get(controller, math.nan) == pytest.approx(drive.client.learning, nan_ok=True)


def test_a_slow_clock_that_only_speed_and_wheel_contradict_brings_nobody_off_the_path() -> None:
    drive = driven_by("nfq", ATTACKS["a clock 2 % slow: stamps, counters and the delay agree"], speed=7.0)
    assert drive.silence() < 10.0, drive.cause()
    assert drive.excess() < 0.5


LIES = (
    ("the pose of another, perfect drive, bend", "own", 1.5, False, True, 12.0),
    ("the pose of another drive, 3 % faster, bend", "own", 1.5, False, True, 12.0),
    ("pose 0.8 m/s too fast in all, bend", "own", 1.5, False, True, 12.0),
    ("pose 0.8 m/s too slow in all, straight", "pure-pursuit", 1.5, True, False, 15.0),
    ("reckoned from a yaw rate 0.4 deg/s off, hidden, straight", "pure-pursuit", 1.5, True, False, 15.0),
    ("reckoned from a yaw rate -0.4 deg/s off, told, straight", "pure-pursuit", 1.5, True, False, 15.0),
    ("jumps of 0.24 m every 4.2 s, straight", "pure-pursuit", 1.5, True, False, 15.0),
    ("a sideslip of 2 degrees that is none, straight", "pure-pursuit", 1.5, True, False, 15.0),
    ("reckoned from a yaw rate 2.3 deg/s off, told, straight", "mpc", 2.0, True, False, 0.0),
    ("reckoned from a yaw rate 2.3 deg/s off, told, straight", "lqr", 2.0, True, False, 0.0),
    ("reckoned from a yaw rate 2.3 deg/s off, told, straight", "nfq", 2.0, True, False, 0.0),
)
"""A lie, controller, speed [m/s], is the car calibrated, kinematic, lead [m]: without the witness each leads the car
off sooner than was said. Slower than that, in the 12 s that liars are watched, are values 5.5 % slower than time, jumps
of 0.14 m, and a motor and its sensor of gain 0.6."""


@pytest.mark.parametrize(("name", "controller", "speed", "known", "kinematic", "lead"), LIES)
def test_a_lie_that_agrees_with_itself_leads_nobody_further_off_than_the_panel_says(
    name: str, controller: str, speed: float, known: bool, kinematic: bool, lead: float
) -> None:
    """At most 0.5 m for a calibrated car, 1 m for another; or else not sooner than was said when it began."""
    drive = lied_to(name, controller, speed, known=known, kinematic=kinematic, lead=lead, found=8.0)
    assert drive.engaged_at_onset()
    assert not sooner(drive, known=known)
    assert drive.bus_faults() == []


def test_the_pose_of_another_drive_is_found_out_before_it_leads_anybody_off() -> None:
    """It led a car 25 m off in 8 s. This one has driven a third of a lap before."""
    attack = LIARS["the pose of another, perfect drive, entry"]
    drive = Drive(attack, 7.0, vehicle=calibrated(False, 8.0), lead=100.0).settle().run()
    assert drive.silence() < 2.0, drive.cause()
    assert drive.excess() < 0.3


PACE = {"mpc": 5.0, "lqr": 2.0, "pure-pursuit": 7.0, "nfq": 5.0}
"""At one speed each [m/s], as drives have the way to the onset in common."""
CASES = [
    (who, name, PACE[who]) for i, name in enumerate(ATTACKS) if i % 8 == i // 8 % 8 for who in [CONTROLLERS[i % 4]]
]
"""An eighth of the attacks, each on one of the controllers; all, at all speeds: `tests.attack.table`."""


@pytest.mark.parametrize(("controller", "name", "speed"), CASES)
def test_whoever_steers_the_car_stays_on_its_path(controller: str, name: str, speed: float) -> None:
    drive = driven_by(controller, watched(ATTACKS[name]), speed=speed)
    assert drive.complaints(HARMLESS) == []
    assert drive.silence() <= SOON.get(name, math.inf)


PORTS = ("TESLA_MODEL_3", "NISSAN_LEAF")
"""Of production cars whose bends are as tight as the attacker's."""


@pytest.mark.parametrize(
    ("name", "i"), [(name, i) for i, name in enumerate(ATTACKS) if i % 32 == 3 and name not in OF_A_KIT]
)
def test_through_the_port_of_a_production_car_the_same_bounds_hold(name: str, i: int) -> None:
    """Some of the attacks; all: `python -m tests.attack.table --ports TESLA_MODEL_3 NISSAN_LEAF`."""
    pytest.importorskip("opendbc")
    drive = through_port(PORTS[i // 32 % 2], watched(ATTACKS[name]), speed=SPEEDS[i % 3])
    assert drive.complaints() == []
