"""What is to be steered, with which actions, from which starts, and what counts: all that an environment is made of."""

import copy
import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from numbers import Real
from pathlib import Path as FilePath
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from steerkit._support.errors import check_numbers, known, made_of, number, require, require_within
from steerkit._support.random import OpenSeed
from steerkit.controllers.network_policy import BOUND, angles_of
from steerkit.controllers.nfq_policy import IDOE_ACTIONS
from steerkit.controllers.policy import StateDescription
from steerkit.controllers.safety_filter import SafetyFilter
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, Out, State
from steerkit.diagram.loop import Loop, LoopState
from steerkit.diagram.maths import Array, Scalar
from steerkit.diagram.units import radians_of
from steerkit.doe import HeldAngle, Integrator, OutputElement
from steerkit.learning.costs import COSTS, BandCost, Cost, IdoeCost, SmoothCost, TanhCost
from steerkit.learning.nfq.iterate import STANDARD
from steerkit.paths.path import Path
from steerkit.paths.tracker import PathTracker
from steerkit.plants.disturbed_plant import GUST_STATES, DisturbedPlant
from steerkit.plants.single_track import NonlinearSingleTrack, SingleTrackState
from steerkit.plants.steering_actuator import SteeringActuator, TorqueSteering
from steerkit.scenario import END_MARGIN, Scenario, read_scenario
from steerkit.scenario.catalogue import ELEMENTS, make_element, make_safety
from steerkit.scenario.drive import assembled
from steerkit.task import STOP, STOP_DEG, TRIP

LEAST_ROOM = 30.0
"""A car on an open course starts at least so far from where it ends [m]."""


class Draw(NamedTuple):
    """Where an episode starts, and with which driver and noise."""

    seed: int
    s: float
    e: float
    psi_e: float


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


ACTIONS: dict[str, tuple[tuple[float, ...] | None, str]] = {
    "i-doe": (IDOE_ACTIONS, "integrator"),
    "bang-bang": ((-STOP, STOP), "plain"),
    "continuous": (None, "integrator"),
}
"""Action sets by name: their angles [rad], and the dynamic output element they are made for."""
COST_KINDS: dict[str, Any] = {cost.__name__: cost for cost in COSTS}
INFO = (
    *("path.e", "path.s", "path.progress", "car.x", "car.y", "car.psi", "car.v", "car.a_y", "car.delta_sw"),
    *("safety.correction", "safety.share"),
)
"""The true signals that `info` reports by their last names, where the loop has them."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Agent(Block):
    """Stands in a loop for whoever decides outside of it: its output is what was written into its state.

    No inputs. Output, of state only: action [rad]. State: that number, 0 until it is written.
    """

    action = Out("rad", direct=())

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (np.zeros(batch) if batch else 0.0,)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0])


@dataclass(frozen=True, kw_only=True)
class Task:
    """Steer along a course, judged 20 times a second; the options of the environments.

    observation: (s - mid)/half of the learner's state s (`description`), as the sensors see it, float32, cut at +-10.
    action: a number of `actions`, or a in [-1, 1], which means a*largest [rad]; what an action does is up to `doe`.
    reward: -cost(s, a, s_next), and -failure in the step in which |e| > limit, which terminates the episode.
    truncated: after `duration`, or 5 m before the end of an open course.
    start: e and psi_e are drawn, the place too; a single-track car starts in the steady state of its bend.

    Raises ValueError for options that do not fit, naming the valid ones.
    """

    course: str = "paper"
    """Name of a course, `random-7`, or a CSV file: see `steerkit.scenario.Scenario`."""
    vehicle: str = "vw-passat"
    """Name of a car, or a vehicle file, whose [steering] is then the motor's."""
    conditions: str = "clean"
    """`clean`; `hard`: pose noise, sensor delay, a slower motor; or `real`: and noisy v, no sideslip, lost samples."""
    scenario: Any = None
    """Instead of course, vehicle and conditions: a `Scenario`, also one of your own with other blocks; a dictionary of
    its fields, or its TOML file."""
    actions: str | Sequence[float] = "i-doe"
    """`i-doe` (the paper's steps), `bang-bang` (+-520 degrees at once), `continuous`, or angles [rad] of your own."""
    doe: str | Block | None = None
    """Output element: `integrator`, `low-pass`, `plain` or a block; by default the action set's own."""
    largest: float | None = number(None, "rad", above=0.0, high=20.0)
    """Angle of a continuous action of 1 [rad]; by default 25 degrees a sample with the integrator, else 520 degrees."""
    cost: Any = "smooth"
    """`smooth` (`SmoothCost` of the wheel's steps), `paper` (`IdoeCost`; `BandCost` where no action is 0), any `Cost`,
    also a function of yours, or the fields of one with its class under `kind`."""
    limit: float = number(TRIP, "m", above=0.05, high=10.0)
    """|e| [m] beyond which the episode has failed, for a cost given by name (others bring their own `trip`)."""
    failure: float = number(1.0, "1", low=0.0, high=1e9)
    """What a failure costs. The costs are made for NFQ, where 1 is the worst there is; a learner with discount g may
    find that worth its while unless it is above cost/(1 - g) of staying."""
    duration: float = number(60.0, "s", low=0.05, high=1e9)
    """Longest episode [s]."""
    start: str = "anywhere"
    """Where episodes start: `anywhere` along the course, or at its `beginning`."""
    start_e: float = number(0.1, "m", low=0.0)
    """Largest |e| at the start [m], at the scenario's reference point."""
    start_psi_e: float = number(0.02, "rad", low=0.0, high=1.0)
    """Largest turn at the start [rad], away from the heading that keeps e as it is."""
    safe: bool | Mapping[str, Any] = False
    """Is there a `SafetyFilter` between the agent and the wheel? It keeps |e| of the front axle within 0.5 m, whatever
    the agent does. `info` holds `correction` [rad] and `share` [1] then: an agent that is corrected should observe it.
    A mapping has fields of the filter that are not to be its own: `{"delay_doubt": 0.1}`."""
    description: Any = STANDARD
    """The observation's columns and ranges: names of the tracker's or the sensors' outputs, or `doe`; column 0 is e. A
    mapping of columns to what becomes -1 and 1, `{"e": (-1.0, 1.0), "v": (0.0, 10.0)}`, becomes a description."""

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> "Task":
        """The task with these options; raises ValueError naming an unknown one and all valid ones."""
        valid = [field.name for field in dataclasses.fields(cls)]
        for name in options:
            known(name, valid, "TrackSteering: option")
        return cls(**options)

    def __post_init__(self) -> None:
        where = "TrackSteering"
        if isinstance(self.actions, str):
            known(self.actions, ACTIONS, f"{where}: actions", also="angles [rad] of your own")
        else:
            angles = np.array(self.actions, dtype=object)
            fits = angles.ndim == 1 and all(isinstance(a, Real) and abs(float(a)) < 20.0 for a in angles)
            expected = f"expected at least two angles [rad] within +-20, or one of {', '.join(ACTIONS)}"
            require(fits and len(angles) > 1, where, f"actions = {self.actions!r}, {expected}")
            object.__setattr__(self, "actions", tuple(map(float, angles)))
        fits = isinstance(self.doe, Block) and {"action"} <= {port.name for port in self.doe.inputs}
        choices = f"valid: {', '.join(ELEMENTS)}, or a block with an input action [rad], such as Integrator()"
        require(fits or self.doe in (None, *ELEMENTS), where, f"doe {self.doe!r}; {choices}")
        require(self.start in ("anywhere", "beginning"), where, f"start {self.start!r}; valid: anywhere, beginning")
        check_numbers(self, where)
        require(self.start_e < self.limit, where, f"start_e = {self.start_e} [m], expected below limit, {self.limit:g}")
        object.__setattr__(self, "description", _described(self.description))
        require(self.description.names[0] == "e", where, f"column 0 is '{self.description.names[0]}', expected 'e'")
        plain = (self.course, self.vehicle, self.conditions) == ("paper", "vw-passat", "clean")
        words = "course, vehicle and conditions belong to the scenario; give them inside `scenario`, or no scenario"
        require(self.scenario is None or plain, where, words)
        known_place = (
            f"scenario {self.scenario!r:.60}, expected a Scenario, a dictionary of its fields, or its TOML file"
        )
        require(isinstance(self.place, Scenario), where, known_place)
        require(isinstance(self.safe, bool | Mapping), where, f"safe {self.safe!r}; valid: False, True, or its fields")
        for name in self.safe if isinstance(self.safe, Mapping) else ():
            known(name, [field.name for field in dataclasses.fields(SafetyFilter)], "field of safe")
        for n in (1, 3):
            self._try_cost(np.tile(self.description.mid, (n, 1)))

    def _try_cost(self, s: Array) -> None:
        """Raise ValueError unless the cost answers as it has to, for cars in these states (n, columns)."""
        price, n = self.price, len(s)
        where = f"TrackSteering: cost {getattr(price, '__name__', type(price).__name__)}"
        expected = (
            f"expected of s, s_next {s.shape} [{', '.join(self.description.names)}] and a ({n},) [rad] two arrays: the "
            f"cost ({n},) [1], float, and who has failed ({n},), bool"
        )
        try:
            cost, failed = (np.asarray(part) for part in price(s, np.zeros(n), s))
        except Exception as error:
            raise ValueError(f"{where}: {type(error).__name__}: {error}; {expected}") from error
        fits = cost.shape == failed.shape == (n,) and cost.dtype.kind in "fiu" and failed.dtype == bool
        given = f"{cost.dtype} {cost.shape} and {failed.dtype} {failed.shape}"
        require(fits, where, f"gave {given}, {expected}")
        require(np.isfinite(cost), where, f"gave {cost[0]} [1] for s = s_next = {s[0]}, expected a finite number")

    @cached_property
    def place(self) -> Scenario:
        """The scenario."""
        try:
            if self.scenario is None:
                return Scenario.under(self.conditions, course=self.course, vehicle=self.vehicle)
            if isinstance(self.scenario, Mapping):
                return Scenario.under(**self.scenario)
            if isinstance(self.scenario, str | FilePath):
                return read_scenario(self.scenario)
        except ValueError as error:
            raise ValueError(f"TrackSteering: {error}") from error
        return self.scenario

    @cached_property
    def path(self) -> Path:
        """The course's path."""
        return self.place.path()

    @cached_property
    def angles(self) -> tuple[float, ...] | None:
        """The discrete actions [rad]; None for continuous ones."""
        return ACTIONS[self.actions][0] if isinstance(self.actions, str) else tuple(self.actions)

    @cached_property
    def element(self) -> Block:
        """The dynamic output element."""
        if isinstance(self.doe, Block):
            return self.doe
        own = ACTIONS[self.actions][1] if isinstance(self.actions, str) else "integrator"
        return make_element(self.doe or own, self.place.nominal)

    @cached_property
    def scale(self) -> float:
        """The angle of a continuous action of 1 [rad]."""
        return self.largest or radians_of(25.0 if isinstance(self.element, Integrator) else STOP_DEG)

    @cached_property
    def price(self) -> Cost:
        """The cost."""
        if isinstance(self.cost, Mapping):
            fields = dict(self.cost)
            kind = COST_KINDS[known(str(fields.pop("kind", None)), COST_KINDS, "TrackSteering: kind of cost")]
            made: Cost = made_of(kind, fields, f"TrackSteering: {kind.__name__}")
            return made
        if callable(self.cost) and not isinstance(self.cost, type):
            return self.cost
        choices = f"a Cost, a function cost(s, a, s_next), or fields with a kind: {', '.join(COST_KINDS)}"
        if known(f"{self.cost}", ("smooth", "paper"), "TrackSteering: cost", also=choices) == "paper":
            return IdoeCost(trip=self.limit) if self.angles and 0.0 in self.angles else BandCost(trip=self.limit)
        well = TanhCost(goal=min(0.15, 0.5 * self.limit), trip=self.limit, action_cost=0.0)
        if isinstance(self.element, Integrator):
            unit = max(map(abs, self.angles or (self.scale,)))
            return SmoothCost(cost=well, jerk_cost=0.0, wheel_cost=0.01, wheel_unit=unit)
        return well

    @cached_property
    def loop(self) -> Loop:
        """The loop with an `Agent` for a controller."""
        fields = self.safe if isinstance(self.safe, Mapping) else {}
        safety = None if self.safe is False else dataclasses.replace(make_safety(self.place.design_model()), **fields)
        loop = assembled(self.place, Agent(dt=self.element.dt), doe=self.element, safety=safety)
        whole = round(self.element.dt / loop.dt) == loop.period
        expected = f"expected none longer than the agent's, which is the output element's, {self.element.dt} s"
        require(whole, "TrackSteering", f"sample times of {loop!r}, {expected}")
        return loop

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """The signals that the observation is made of."""
        names = self.loop.units
        tracker, seen = ("seen", "sensors") if "sensors" in self.loop.blocks else ("path", "car")
        signals = []
        for name in self.description.names:
            of = ["doe.state"] if name == "doe" else [f"{tracker}.{name}", f"{seen}.{name}", f"car.{name}"]
            found = [signal for signal in of if signal in names]
            valid = [n.split(".")[1] for n in names if n.split(".")[0] in (tracker, seen)]
            signals.append(found[0] if found else known(name, [*valid, "doe"], "TrackSteering: description column"))
        return tuple(signals)

    @property
    def dt(self) -> float:
        """Time between two decisions [s]."""
        return self.element.dt

    @cached_property
    def info(self) -> tuple[str, ...]:
        """The true signals that `info` reports."""
        return tuple([name for name in INFO if name in self.loop.units])

    @property
    def longest(self) -> int:
        """Steps of the longest episode."""
        return round(self.duration / self.dt)

    @property
    def end(self) -> float:
        """The true s [m] from which on an episode is truncated."""
        return math.inf if self.path.closed else self.path.length - END_MARGIN

    @cached_property
    def action_space(self) -> spaces.Space[Any]:
        """Discrete(n), or Box(-1, 1, (1,))."""
        return spaces.Discrete(len(self.angles)) if self.angles else spaces.Box(-1.0, 1.0, (1,), np.float32)

    @cached_property
    def observation_space(self) -> spaces.Box:
        """Box(-10, 10, (columns,)); most of what happens lies in [-1, 1]."""
        return spaces.Box(-BOUND, BOUND, (len(self.columns),), np.float32)

    def angle(self, actions: Any, shape: tuple[int, ...]) -> Array:
        """The actions [rad] (N,) that an agent's actions mean; raises ValueError for one outside of the space."""
        return angles_of(actions, math.prod(shape), self.angles, self.scale, "TrackSteering.step: action")

    def observation(self, s: Array) -> NDArray[np.float32]:
        """What the agent sees of states (N, columns)."""
        d = self.description
        return np.minimum(np.maximum((s - d.mid) / d.half, -BOUND), BOUND).astype(np.float32)

    @cached_property
    def last_start(self) -> float:
        """The largest s at which an episode starts [m]."""
        return self.path.length if self.path.closed else max(0.0, self.path.length - END_MARGIN - LEAST_ROOM)

    def draw(self, rng: np.random.Generator, options: Mapping[str, Any] | None = None) -> Draw:
        """The start of an episode; `options` s [m], e [m], psi_e [rad] stand for what is drawn otherwise."""
        given = dict(options or {})
        valid = {"s": ("m", 0.0, self.path.length), "e": ("m", -self.limit, self.limit), "psi_e": ("rad", -1.6, 1.6)}
        for name, value in given.items():
            require_within(
                "TrackSteering.reset", name, value, *valid[known(name, valid, "TrackSteering.reset: option")]
            )
            require(np.ndim(value) == 0, "TrackSteering.reset", f"{name} = {value!r}, expected one number")
        seed, s = int(rng.integers(2**31)), rng.random() * self.last_start
        e, psi_e = rng.uniform(-self.start_e, self.start_e), self.start_psi_e * rng.uniform(-1.0, 1.0)
        chosen = {"s": 0.0 if self.start == "beginning" else s, "e": e, "psi_e": psi_e} | given
        return Draw(seed, *(float(chosen[name]) for name in ("s", "e", "psi_e")))

    def starts(self, draws: Sequence[Draw]) -> LoopState:
        """The loop's state of len(draws) cars, settled."""
        s, e, psi_e = np.array([draw[1:] for draw in draws]).T
        return self.start_state(s, e, psi_e, [self._drawn(block, draws) for block in self.loop.blocks.values()])

    def start_state(self, s: Scalar, e: Scalar, psi_e: Scalar, drawn: Sequence[State]) -> LoopState:
        """The loop's state, settled, of cars e [m] left of the path at s [m], turned by psi_e [rad]: arrays or symbols.

        drawn: the state of each block at its start, with the random numbers of its seed. A single-track car is in the
        steady state of its bend: sideslip, yaw rate, wheel and motor settled.
        """
        loop, batch = self.loop, np.shape(s) if isinstance(s, np.ndarray) else ()
        x = dict(zip(loop.names, drawn))
        for name, block in loop.blocks.items():
            if isinstance(block, PathTracker):
                x[name] = block.X(s, 0.0 * s)
        px, py, dx, dy, ddx, ddy = self.path.frame(self.path.inside(s))
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
        drift = m.atan2(v * m.sin(beta) + r * self.place.ahead, v * m.cos(beta))
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
        car = self.loop.blocks["car"]
        return car.block if isinstance(car, DisturbedPlant) else car

    def _car_at(self, x: Scalar, y: Scalar, psi: Scalar, batch: tuple[int, ...]) -> Any:
        """The car's state with its reference point at x, y [m] and this heading [rad]."""
        x, y = x - self.place.ahead * m.cos(psi), y - self.place.ahead * m.sin(psi)
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


def require_finite(signals: Sequence[str], values: Array, steps: Array) -> None:
    """Raise FloatingPointError naming the first of the values (signals and the cost, N) that is no finite number."""
    for row, car in np.argwhere(~np.isfinite(values)):
        what = f"{[*signals, 'the cost'][row]} of car {car} is {values[row, car]} after {steps[car]} steps"
        raise FloatingPointError(f"TrackSteering: {what}; a block of the scenario, or an action, is out of its range")


def _described(columns: Any) -> StateDescription:
    """The description that a task was given, or the one of these columns and their ranges."""
    if isinstance(columns, StateDescription):
        return columns
    fits = isinstance(columns, Mapping) and len(columns) > 0 and all(np.shape(r) == (2,) for r in columns.values())
    expected = "expected a StateDescription, or columns and their ranges, such as {'e': (-1.0, 1.0), 'v': (0.0, 10.0)}"
    require(fits, "TrackSteering", f"description {columns!r:.60}, {expected}")
    low, high = zip(*columns.values())
    ones = (1.0,) * len(columns)
    return StateDescription(names=tuple(columns), low=low, high=high, mirror_signs=ones, goal=ones)
