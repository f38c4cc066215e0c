"""Which loop steers a real car: the whole one while engaged, one at rest while the human has the wheel."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, Self

from steerkit.car.estimates import EVERY
from steerkit.car.protocol import Adapted, Filtered
from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.supervisor import SupervisorState
from steerkit.diagram.loop import Loop
from steerkit.diagram.realtime import Run
from steerkit.scenario.assembly import controller_of, with_controller
from steerkit.scenario.catalogue import OLD_ELEMENTS
from steerkit.task import TRIP


class Seen(Protocol):
    """What `Follow` needs of a line to a car."""

    @property
    def last(self) -> Any:
        """The last snapshot."""
        ...

    def tell(self, message: Adapted) -> None:
        """Say, for the recording, what a controller is told of the car."""
        ...


@dataclass(kw_only=True)
class Follow:
    """The choice of a loop while a car is driven: ask `begin` and then `choose` after every sample.

    A pose that comes back after a pause makes the loop begin anew, so that it looks for its place on the path. While
    the human has the wheel, controllers settle on the wheel as it is, again and again: whoever engages finds no memory
    of commands that nobody obeyed. One that adapts keeps what it has found of the car, and learns nothing then; but
    after a FAULT, or a drive with more than 0.5 m beside the path, that may be what was wrong, and it begins anew.
    Depends on nothing but the snapshots, so that a recorded drive can be replayed.
    """

    link: Seen
    resting: Loop
    """The loop while not engaged, or while nobody trusts the policy: its recovery controller steers."""
    driving: Loop
    trusted: bool = True
    """May `driving` steer?"""
    engaged: bool = False
    """Was it engaged in the last sample?"""
    places: float = -1.0
    doubted: bool = False
    """Was the car off its path while engaged, or is there a fault, so that nothing found of it is to be believed?"""

    @classmethod
    def of(cls, loop: Loop, link: Seen) -> Self:
        """For a loop of `steerkit.car.loop.car_loop`."""
        resting, policy = loop, controller_of(loop)
        if isinstance(policy, NfqPolicy):
            resting = with_controller(loop, replace(policy, ready_from=math.inf))
        return cls(link=link, resting=resting, driving=loop)

    def begin(self, run: Run) -> bool:
        """Take note of who has the wheel; True when the loop began anew."""
        snapshot = self.link.last
        mode = str(snapshot.mode)
        self.engaged = mode == "ENGAGED"
        if mode == "FAULT" or (self.engaged and not abs(snapshot.e) <= TRIP):
            self.doubted = True
        lost = snapshot.places != self.places and self.places >= 0.0 and not self.engaged
        self.places = snapshot.places
        if lost or not self.engaged:
            before = None if self.doubted else run.x
            self.doubted = False
            if lost:
                run.restart(self.resting.init())
            for name in ("controller", "recovery", "safety"):
                if name in run.loop.blocks:
                    k, settled = run.loop.names.index(name), run.loop.settled(name, run.y)
                    run.x[k] = run.loop.blocks[name].on_standby(before[k], settled) if before else settled
        return lost

    def exchange(self, run: Run, driving: Loop) -> None:
        """Another policy drives from the next sample on; a fault was that of the one before."""
        self.driving = driving
        if "supervisor" in driving.blocks:
            k = driving.names.index("supervisor")
            run.x[k] = SupervisorState(run.x[k][0], 0.0)

    def choose(self, run: Run) -> None:
        """The loop of the next sample; once a second what its controller is told of the car goes to the recording."""
        run.loop = self.driving if self.engaged and self.trusted else self.resting
        if run.k % EVERY == 0 and (adapted := adapted_in(run)):
            self.link.tell(adapted)


def adapted_in(run: Run) -> Adapted | None:
    """What the controller of a loop is told of its car, or else its recovery controller; None where neither adapts."""
    for name in ("controller", "recovery"):
        block = run.loop.blocks.get(name)
        if isinstance(block, Adaptive):
            return Adapted(*block.told(run.x[run.loop.names.index(name)]))
    return None


def filtered_in(run: Run) -> Filtered:
    """What the safety filter of a loop did in its last sample."""
    asked = run.sample[run.loop.inputs_of("safety")["command"]]
    return Filtered(asked, *[run.sample[f"safety.{name}"] for name in Filtered._fields[1:]])


@dataclass(frozen=True, kw_only=True)
class Steers:
    """Who makes a drive's requests, for its recording."""

    name: str
    """A controller's name, or the file of a policy."""
    sha256: str = ""
    """Of that file."""
    doe: str = ""
    """The policy's dynamic output element: see `steerkit.learning.settings.ELEMENTS`."""
    recovery: str = "stanley"
    """Who catches the policy."""
    trusted: bool = True
    """False: its recovery controller has the wheel until the next net."""
    safe: bool = False
    """Is there a safety filter before the gate?"""

    @classmethod
    def by_policy(cls, file: Path, doe: str, **more: Any) -> Self:
        """A policy in `file`, which has to be there."""
        return cls(name=str(file.resolve()), sha256=hashlib.sha256(file.read_bytes()).hexdigest(), doe=doe, **more)

    def text(self) -> str:
        """As JSON, for `Remark`."""
        return json.dumps(vars(self))

    @classmethod
    def read(cls, text: str) -> Self:
        """What `text` wrote; raises ValueError for anything else."""
        try:
            steers = cls(**json.loads(text))
            return replace(steers, doe=OLD_ELEMENTS.get(steers.doe, steers.doe))
        except (TypeError, ValueError) as error:
            raise ValueError(f"remark {text!r}: not who steers ({error})") from error
