"""Recorded drives through their controllers again: are the requests the same, bit for bit?

The car server records which controller steers: a controller by name, or a learner's net by its file and
SHA-256, from which request on, and whether it was trusted. So a drive whose nets changed on the way can be replayed
too, as long as its run directory keeps them.
"""

import contextlib
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import known
from steerkit._support.files import read_bytes
from steerkit._support.plugins import is_outside, named_in
from steerkit.car import loop as loops
from steerkit.car.client import CarLost, ReplayLink
from steerkit.car.config import CarConfig
from steerkit.car.estimates import CarEstimators, message_of
from steerkit.car.loop import Follow, Steers
from steerkit.car.protocol import Estimates, Filtered, Hello, Remark, Request, Snapshot, decode, encode
from steerkit.car.recording import Recorded
from steerkit.car.state_machine import Mode
from steerkit.controllers.fail_safe import LATE
from steerkit.diagram import realtime
from steerkit.diagram.loop import Loop
from steerkit.scenario.catalogue import CONTROLLERS


@dataclass
class Drive:
    """What one controller saw and asked for."""

    snapshots: list[Snapshot] = field(default_factory=list)
    requests: list[tuple[float, float]] = field(default_factory=list)
    """(basis, delta_sw)."""
    remarks: list[tuple[int, Steers]] = field(default_factory=list)
    """Who steers, each with the number of snapshots before it."""
    first: int = 0
    """Snapshots before the first request."""
    samples: list[Snapshot | None] = field(default_factory=list)
    """The snapshot that each request was computed from; None where it is lost."""
    estimates: list[tuple[int, Estimates]] = field(default_factory=list)
    """What was said to be found of the car, each with the number of requests before it."""
    filtered: list[Filtered] = field(default_factory=list)
    """What the safety filter was said to have done, request by request."""

    @property
    def who(self) -> str:
        """Who steered, in short."""
        names = list(dict.fromkeys(FilePath(s.name).name for _, s in self.remarks))
        return names[0] if len(names) == 1 else f"{names[0]} to {names[-1]}" if names else "unknown"


def drives(recorded: Recorded) -> Iterator[Drive]:
    """The drives of a recording, one for each controller that was connected and asked for anything."""
    drive, link = Drive(), -1
    for topic, values, *_ in recorded.messages:
        if topic == "/car":
            drive.snapshots.append(Snapshot(**{**values, "mode": Mode(values["mode"])}))
        elif topic == "/client":
            match _message(values["data"]):
                case Hello(controller=True):
                    if drive.requests:
                        yield drive
                    drive, link = Drive(), values["link"]
                case Request() as asked if values["link"] == link:
                    drive.first = drive.first or len(drive.snapshots)
                    drive.requests.append((asked.basis, asked.delta_sw))
                    last = drive.snapshots[-1] if drive.snapshots else None
                    drive.samples.append(last if last is not None and last.t == asked.basis else None)
                case Estimates() as found if values["link"] == link:
                    drive.estimates.append((len(drive.requests), found))
                case Filtered() as did if values["link"] == link:
                    drive.filtered.append(did)
                case Remark(text=text) if values["link"] == link:
                    drive.remarks.append((len(drive.snapshots), Steers.read(text)))
    if drive.requests:
        yield drive


def _message(data: str) -> object:
    """The message in a recorded packet; None for one that the car server refused as unknown."""
    try:
        return decode(bytes.fromhex(data))
    except ValueError:
        return None


class Nets:
    """The loops of those who steered, each made once.

    run: directory of the learning run, should it have moved since; "" takes the recorded one. named: were they named by
    the user, not by the recording, which is data? Of the latter only a user's own code is run that the user has named
    too (`steerkit --code`), and which still is what drove.
    """

    def __init__(self, config: CarConfig, link: ReplayLink, run: str = "", *, named: bool = False):
        self.config, self.link, self.run, self.named = config, link, run, named
        self.late = False
        """Is the safety filter late in this sample, as it was in the drive?"""
        self._seconds = 0.0
        self._known: dict[tuple[str, str, str, bool, str], Follow] = {}

    def clock(self) -> float:
        """The filter's clock, asked before and after its answer: no time passes between, or too much."""
        self._seconds += 2.0 * loops.BUDGET if self.late else 0.0
        return self._seconds

    def follow(self, steers: Steers) -> Follow:
        """How to follow a drive of that controller; raises ValueError when it is gone or no longer the same."""
        key = steers.name, steers.sha256, steers.recovery, steers.safe, steers.run
        if key not in self._known:
            self._known[key] = Follow.of(self._loop(steers), self.link)
        return self._known[key]

    def _controller(self, steers: Steers) -> loops.Controller:
        if not steers.sha256:
            if not (self.named or is_outside(steers.name)):
                known(steers.name.partition("+")[0], CONTROLLERS, "the recording: controller")
            return loops.controller_named(steers.name, self.config, in_time=True, run=steers.run)
        file = FilePath(steers.name)
        file = FilePath(self.run) / "nets" / file.name if self.run else file
        if not file.is_file():
            raise ValueError(f"{file}: the net that drove is gone; name its run's directory with --run")
        if hashlib.sha256(read_bytes(file)).hexdigest() != steers.sha256:
            raise ValueError(f"{file} is not the net that drove: its SHA-256 differs from the recorded one")
        return loops.policy_in(file, steers.doe, self.config)

    def _loop(self, steers: Steers) -> Loop:
        code = {name.rpartition(":")[0]: steers.code for name in (steers.name, steers.doe)}
        with contextlib.nullcontext() if self.named else named_in("the recording", code, loaded=False):
            controller = self._controller(steers)
        how: dict[str, Any] = {"doe": controller.element, "recovery": steers.recovery, "safe": steers.safe}
        return loops.car_loop(self.config, self.link, controller.block, **how, clock=self.clock)


def replayed_requests(drive: Drive, config: CarConfig, *, controller: str = "", run: str = "") -> int:
    """How many of a drive's requests come out bit for bit the same when its controllers see the recorded snapshots.

    A solution that came too late in the drive comes in time here: its request, and a few after it, then differ. A
    safety filter that was late is late here too. controller: name of another one to put in their place, throughout.
    run: see `Nets`. Raises ValueError when the recording does not name who steered, or that controller is gone.
    """
    begin = max(0, drive.first - 2)  # the last snapshot before that of the first request began the loop
    link = ReplayLink(drive.snapshots[begin:])
    nets = Nets(config, link, run, named=bool(controller))
    remarks = [(0, Steers(name=controller))] if controller else [(n - begin, s) for n, s in drive.remarks]
    if not remarks:
        raise ValueError("the recording does not name who steered; say it with --controller")
    now = nets.follow(remarks.pop(0)[1])
    follow = Follow(link=link, resting=now.resting, driving=now.driving)
    live = realtime.Run(follow.resting, follow.resting.init(), realtime.Timing(period=now.driving.dt))
    filtered = iter(drive.filtered)
    try:
        while True:
            did = next(filtered, None) if "safety" in live.loop.blocks else None
            nets.late = did is not None and did.reason == LATE
            live.loop.advance(live.k, live.x, live.y)
            live.k += 1
            follow.begin(live)
            while remarks and remarks[0][0] <= link.count:
                steers = remarks.pop(0)[1]
                follow.trusted, driving = steers.trusted, nets.follow(steers).driving
                if driving is not follow.driving:
                    follow.exchange(live, driving)
            follow.choose(live)
    except CarLost:
        return sum(repr(one) == repr(other) for one, other in zip(drive.requests, link.requests))  # NaN is NaN again


def replayed_estimates(drive: Drive, config: CarConfig) -> tuple[CarEstimators, int]:
    """The estimators as they were at a drive's end, and how many of the recorded estimates they say bit for bit again.

    It depends on what was measured and commanded alone, not on who steered.
    """
    estimators, said, same = CarEstimators(config), iter(drive.estimates), 0
    count, recorded = next(said, (0, None))
    for k, sample in enumerate(drive.samples, start=1):
        if sample is not None:
            estimators.sample(sample)
        while recorded is not None and count == k:
            same += encode(message_of(estimators.found())) == encode(recorded)  # as bytes: a NaN equals itself
            count, recorded = next(said, (0, None))
    return estimators, same
