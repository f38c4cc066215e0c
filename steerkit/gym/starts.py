"""Where an episode starts, and in which state: drawn, on the course, and settled in its bend."""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from steerkit._support.errors import known, require, require_within
from steerkit._support.random import OpenSeed
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, State
from steerkit.diagram.loop import LoopState
from steerkit.diagram.maths import Scalar
from steerkit.doe import HeldAngle, OutputElement
from steerkit.paths.tracker import PathTracker
from steerkit.plants.disturbed_plant import GUST_STATES, DisturbedPlant
from steerkit.plants.single_track import NonlinearSingleTrack, SingleTrackState
from steerkit.plants.steering_actuator import SteeringActuator, TorqueSteering
from steerkit.scenario import END_MARGIN

if TYPE_CHECKING:
    from steerkit.gym.task import Task

LEAST_ROOM = 30.0
"""A car on an open course starts at least so far from where it ends [m]."""


class Draw(NamedTuple):
    """Where an episode starts, and with which driver and noise."""

    seed: int
    s: float
    e: float
    psi_e: float


@dataclass(frozen=True)
class Starts:
    """The starts of a task's episodes: where on the course, how far and how much turned off it, with which seed.

    A single-track car starts in the steady state of the bend it is in: sideslip, yaw rate, wheel and motor settled.
    """

    task: "Task"

    @cached_property
    def last(self) -> float:
        """The largest s at which an episode starts [m]."""
        return (
            self.task.path.length
            if self.task.path.closed
            else max(0.0, self.task.path.length - END_MARGIN - LEAST_ROOM)
        )

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> Draw:
        """The start of an episode; `options` s [m], e [m], psi_e [rad] stand for what is drawn otherwise."""
        given = dict(options or {})
        valid = {
            "s": ("m", 0.0, self.task.path.length),
            "e": ("m", -self.task.limit, self.task.limit),
            "psi_e": ("rad", -1.6, 1.6),
        }
        for name, value in given.items():
            require_within(
                "TrackSteering.reset", name, value, *valid[known(name, valid, "TrackSteering.reset: option")]
            )
            require(np.ndim(value) == 0, "TrackSteering.reset", f"{name} = {value!r}, expected one number")
        task, seed, s = self.task, int(rng.integers(2**31)), rng.random() * self.last
        e, psi_e = rng.uniform(-task.start_e, task.start_e), task.start_psi_e * rng.uniform(-1.0, 1.0)
        chosen = {"s": 0.0 if task.start == "beginning" else s, "e": e, "psi_e": psi_e} | given
        return Draw(seed, *(float(chosen[name]) for name in ("s", "e", "psi_e")))

    def states(self, draws: Sequence[Draw]) -> LoopState:
        """The loop's state of len(draws) cars, settled."""
        s, e, psi_e = np.array([draw[1:] for draw in draws]).T
        return self.state(s, e, psi_e, [self._drawn(block, draws) for block in self.task.loop.blocks.values()])

    def state(self, s: Scalar, e: Scalar, psi_e: Scalar, drawn: Sequence[State]) -> LoopState:
        """The loop's state, settled, of cars e [m] left of the path at s [m], turned by psi_e [rad]: arrays or symbols.

        drawn: the state of each block at its start, with the random numbers of its seed.
        """
        loop, batch = self.task.loop, np.shape(s) if isinstance(s, np.ndarray) else ()
        x = dict(zip(loop.names, drawn))
        for name, block in loop.blocks.items():
            if isinstance(block, PathTracker):
                x[name] = block.X(s, 0.0 * s)
        px, py, dx, dy, ddx, ddy = self.task.path.frame(self.task.path.inside(s))
        psi, kappa = m.atan2(dy, dx), dx * ddy - dy * ddx
        px, py = px - e * m.sin(psi), py + e * m.cos(psi)
        gusts = x["car"][-GUST_STATES:] if isinstance(loop.blocks["car"], DisturbedPlant) else ()
        start = self._car_at(px, py, psi + psi_e, batch)
        x["car"] = (*start, *gusts) if gusts else start
        first = loop.init(x=[*x.values()])
        if not isinstance(start, SingleTrackState):
            return first
        car = self._car
        v, c = loop.sample(first)["driver.v"] + 0.0 * s, car.vehicle
        r = v * kappa
        beta = (c.l_r - c.m * v**2 * c.l_f / (c.c_r * c.wheelbase)) * kappa
        wheel = c.steer_ratio * (c.wheelbase + c.understeer_gradient * v**2) * kappa
        wheel = m.clip(wheel, -c.delta_sw_max, c.delta_sw_max)
        drift = m.atan2(v * m.sin(beta) + r * self.task.place.ahead, v * m.cos(beta))
        at = self._car_at(px, py, psi + (psi_e - drift), batch)
        sway = v * m.sin(beta) if isinstance(car, NonlinearSingleTrack) else beta
        start = at._replace(sway=sway, r=r, v=v, delta_sw=wheel)
        x["car"] = (*start, *gusts) if gusts else start
        if isinstance(loop.blocks["doe"], OutputElement):
            x["doe"] = HeldAngle(wheel)
        motor = loop.blocks.get("actuator")
        if isinstance(motor, SteeringActuator):
            x["actuator"] = (wheel, 0.0 * s, *[wheel] * (len(x["actuator"]) - 2))
        elif isinstance(motor, TorqueSteering):
            x["actuator"] = motor.holding(wheel, v)
        return loop.init(x=[*x.values()])

    @property
    def _car(self) -> Any:
        """The car itself, without what pushes it."""
        car = self.task.loop.blocks["car"]
        return car.block if isinstance(car, DisturbedPlant) else car

    def _car_at(self, x: Scalar, y: Scalar, psi: Scalar, batch: tuple[int, ...]) -> Any:
        """The car's state with its reference point at x, y [m] and this heading [rad]."""
        x, y = x - self.task.place.ahead * m.cos(psi), y - self.task.place.ahead * m.sin(psi)
        car = self._car
        state = car.init(batch)
        if isinstance(state, SingleTrackState):
            return state._replace(x=x, y=y, psi=psi)
        return dataclasses.replace(car, x0=x, y0=y, psi0=psi).init(batch)

    def _drawn(self, block: Block, draws: Sequence[Draw]) -> Any:
        """The block's state at the start of these cars, with their seeds if it draws random numbers."""
        if reseeded(block, 0) is block:
            return block.init((len(draws),))
        return each(lambda *values: np.array(values), *(reseeded(block, draw.seed).init() for draw in draws))


def each(call: Callable[..., Any], *states: Any) -> Any:
    """A state whose numbers are what `call` makes of those of one or more states of the same shape."""
    values = [each(call, *of) if isinstance(of[0], tuple) else call(*of) for of in zip(*states)]
    return type(states[0])(*values) if hasattr(states[0], "_fields") else tuple(values)


def reseeded(block: Any, seed: int | OpenSeed) -> Any:
    """The block with its field `seed`, or that of a block inside it, exchanged; itself if there is none."""
    changed: dict[str, Any] = {}
    for name, value in vars(block).items():
        if name == "seed":
            changed["seed"] = seed
        elif isinstance(value, Block) and (inner := reseeded(value, seed)) is not value:
            changed[name] = inner
    if not changed:
        return block
    new = copy.copy(block)  # not dataclasses.replace: its checks take most of the time of a start
    vars(new).update(changed)
    return new
