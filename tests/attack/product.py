"""The product's own controllers as clients of an attacked drive: the loop of `drive --car`, sample by sample."""

import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any, Self

from steerkit.car import loop as loops
from steerkit.car import protocol
from steerkit.car.loop import Follow
from steerkit.diagram import realtime
from tests.attack.attacks import LIARS
from tests.attack.bench import Attack, Drive, calibrated, configuration
from tests.attack.bench import settled as own
from tests.attack.car import centred

POLICY = Path(__file__).parent / "policy.npz"
"""A learned policy: the last net of `steerkit learn --conditions hard --minutes 5 --seed 0`."""
CONTROLLERS = ("mpc", "lqr", "pure-pursuit", "nfq")
"""The product's own controllers that are attacked."""


@cache
def made(name: str, course: str, vehicle: str) -> loops.Controller:
    """A controller for a course, made once. Solutions take as long as they take: no result depends on the machine."""
    config = configuration(course, vehicle)
    if name == "nfq":
        return loops.policy_in(POLICY, "integrator", config)
    controller = loops.controller_named(name, config)
    block: Any = controller.block
    if hasattr(type(block), "budget"):
        block = replace(block, clock=None, budget=None)
    return replace(controller, block=block)


class Line:
    """The line to the car server of a controller's loop: a client writes it before each sample and reads it after."""

    last: protocol.Snapshot
    """What the car server said last."""
    asked: float | None
    """What the loop asks for [rad]."""

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        return self  # loops hold it, and copies of a loop call the same blocks

    def query(self) -> protocol.Snapshot:
        return self.last

    def request(self, delta_sw: float) -> None:
        self.asked = delta_sw

    def note(self, message: object) -> None:
        """What a controller believes of the car: for a recording, which is not made here."""


class ProductClient:
    def __init__(self, name: str, course: str, vehicle: str = ""):
        self.controller, self.car, self.line = made(name, course, vehicle), (course, vehicle), Line()
        self.follow: Follow | None = None
        self.learning = math.nan
        """Has the learned policy the wheel? NaN for a controller that does not learn."""

    def __call__(self, drive: Drive, snapshot: dict[str, float]) -> float | None:
        answer = protocol.decode(drive.answer)
        assert isinstance(answer, protocol.Snapshot)
        self.line.last, self.line.asked = answer, None
        if self.follow is None:
            if not math.isfinite(answer.x + answer.psi + answer.v + answer.delta_sw):
                return None  # as the product waits for a first pose and report
            config = configuration(*self.car)
            loop = loops.car_loop(config, self.line, self.controller.block, doe=self.controller.element)
            self.follow = Follow.of(loop, self.line)
            resting = self.follow.resting
            self.run = realtime.Run(resting, resting.init(), realtime.Timing(period=loop.dt))
        self.run.loop.advance(self.run.k, self.run.x, self.run.y)
        self.run.k += 1
        self.follow.begin(self.run)
        self.follow.choose(self.run)
        if "supervisor" in self.run.loop.blocks:
            self.learning = self.run.sample["supervisor.learning"]
        return self.line.asked


LEARNS = ("nfq",)
"""Those that may learn on: they need the shipped limits (`e_max` = 2 m); the others get those that the guide recommends
for controllers that do not learn."""
HARMLESS = 0.5
"""They have no integral action: a wheel that is 40 degrees off and says nothing of it brings them so far off [m]."""


@cache
def settled(
    name: str, course: str, where: str, speed: float, kinematic: bool, vehicle: str, lead: float = 0.0
) -> Drive:
    """A drive with that controller as far as all attacks there have in common.

    The human steers exactly, as a controller is only engaged that asks for the angle that the wheel has; pure pursuit
    wants another one in a bend, and is engaged on the straight before it.
    """
    none, lead = Attack("none", course=course, where=where), lead or (45.0 if name == "pure-pursuit" else 0.0)
    client = ProductClient(name, course, vehicle)
    how: dict[str, Any] = {"client": client, "driver": centred, "lead": lead}
    return Drive(none, speed, kinematic=kinematic, vehicle=vehicle, **how).settle()


def driven_by(
    name: str, attack: Attack, *, speed: float, kinematic: bool = False, vehicle: str = "", lead: float = 0.0
) -> Drive:
    if attack.course == "stadium" and name not in LEARNS:
        attack = replace(attack, course="careful")
    return settled(name, attack.course, attack.where, speed, kinematic, vehicle, lead).under(attack)


def lied_to(
    name: str, controller: str, speed: float, *, known: bool, kinematic: bool, lead: float = 0.0, found: float = 60.0
) -> Drive:
    """A liar's drive, steered by the attacker's own law (`own`) or one of the product's.

    known: has the car been calibrated? kinematic: does it roll where its wheels point, or is it the data sheet's?
    lead: how far it was driven before the onset, beyond the usual 2.5 s [m]. found: for how long to calibrate it [s].
    """
    attack, vehicle = LIARS[name], calibrated(kinematic, found) if known else ""
    if controller == "own":
        return own(attack.course, attack.where, speed, kinematic, vehicle, lead).under(attack)
    return driven_by(controller, attack, speed=speed, kinematic=kinematic, vehicle=vehicle, lead=lead)


def sooner(drive: Drive, *, known: bool) -> bool:
    """Did a lie lead the car further off than it may, 0.5 m, 1 m if not calibrated, and sooner than was said before?"""
    return drive.excess() > (0.5 if known else 1.0) and drive.reached(0.5) < drive.astray
