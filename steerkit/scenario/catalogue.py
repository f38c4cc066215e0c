"""Every controller, output element and plant by name, and the one recipe by which each is made, whoever asks."""

import logging
import math
from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, replace
from typing import Any, TypeVar

from steerkit._support.errors import Checked, in_one_line, known, number, require
from steerkit._support.plugins import imported, is_outside
from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.delay import delayed_stanley
from steerkit.controllers.lqr import Lqr
from steerkit.controllers.margins import Doubt, SteeredCar, least_damping
from steerkit.controllers.offset_free import CommandCompensation, OffsetFree
from steerkit.controllers.pure_pursuit import PurePursuit
from steerkit.controllers.safety_filter import BEHIND_GATE, SafetyFilter
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block
from steerkit.diagram.units import radians_of
from steerkit.doe import Integrator, LowPass, OutputElement, PlainAngle, WithElement
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import YawDelay
from steerkit.paths.path import Path
from steerkit.plants.single_track import Car, LinearSingleTrack, NonlinearSingleTrack, SingleTrack
from steerkit.task import DT
from steerkit.vehicles import Vehicle
from steerkit.vehicles.rollout import GateModel

_T = TypeVar("_T")
_LONGEST = 2.0
"""Longest dead time that anything is made for [s]."""


@dataclass(frozen=True, kw_only=True)
class DesignModel(Checked):
    """What a controller is designed for: car, course and steering as they are believed; the truth may be another.

    `Scenario.design_model` and `CarConfig` give one; by hand:
    `DesignModel(vehicle=vehicle("vw-passat"), path=course("paper"))`.
    Raises ValueError for a time or a rate out of range.
    """

    vehicle: Vehicle
    """The car; its `delta_sw_max` is the largest angle that a controller asks for."""
    path: Path
    """The course."""
    delay: float = number(0.0, "s", low=0.0, high=_LONGEST)
    """Pure delay from a command to what is seen of it [s]: the steering's, and the age of what the controller sees."""
    lag: float = number(0.1, "s", low=0.0, high=10.0)
    """First-order time constant of the steering [s]."""
    hold: float = number(0.0, "s", low=0.0, high=1.0)
    """For how long a sampled actuator holds its angle [s], if `delay` does not count that yet. A simulated one: its dt;
    a car: 0, as its delay is measured from command to wheel, everything in between included. Half of it acts as more
    delay, which only the predictive controllers make use of: the others are tuned to samples of 50 ms without it."""
    rate_limit: float = number(radians_of(550.0), "rad/s", above=0.0)
    """Fastest steering wheel [rad/s]."""
    slew: float | None = number(None, "m/s^3", above=0.0)
    """Fastest change of the lateral acceleration of a car that is steered by torque [m/s^3]; None: by angle."""
    a_y_limit: float | None = number(None, "m/s^2", above=0.0)
    """Its largest lateral acceleration [m/s^2]; None: by angle."""
    offset: float = number(0.0, "rad", low=-3.0, high=3.0)
    """Known offset of the angle that the steering reaches [rad]: commands are given less by it."""
    gain: float = number(1.0, "1", low=0.1, high=10.0)
    """Known gain of the steering, angle reached over angle commanded [1]: commands are divided by it."""
    budget: float | None = None
    """Time within which a predictive controller has to answer [s]; None: any, so that a drive can be repeated."""
    clock: Callable[[], float] | None = None
    """Seconds, for the budget; None: no time is taken."""


@dataclass(frozen=True)
class ControllerSpec:
    """How a controller of the table is made."""

    about: str
    """One line for lists and reports."""
    make: Callable[[DesignModel], Block]
    """Makes the block."""


def _stanley(design_model: DesignModel) -> Block:
    law = Stanley.of(design_model.vehicle)
    return replace(law, rate_limit=design_model.rate_limit, slew=design_model.slew, a_y_limit=design_model.a_y_limit)


def _delayed(design_model: DesignModel) -> Block:
    steering = ("delay", "lag", "rate_limit", "slew", "a_y_limit")
    return delayed_stanley(design_model.vehicle, **{name: getattr(design_model, name) for name in steering})


_log = logging.getLogger(__name__)
_SOFT = {"share": 0.2, "k": 3.5, "k_soft": 15.0}
"""Stanley's gains where it recovers a car steered by torque: such cars overshoot small commands and creep to large ones
(`benchmarks.plants.torque_car`), and with the gains of `stanley-delay`, which follow closer, they swing."""


_DOUBT = Doubt(gain=1.35, delay=0.1)
"""For what an adaptive controller of a car steered by torque has to hold: its gain is 1.3 to 2.3, by how much is asked
of it (`benchmarks.plants.torque_car`), and what is found of it lies in between."""
_DAMPED = 0.02
"""Least damping ratio at the corners of that doubt [1]."""
_HELD_AT = (5.0, 10.0, 20.0, 30.0)
"""Speeds at which it has to be damped [m/s]."""
_V_FULL = (None, 20.0, 14.0, 10.0, 7.0, 5.0, 3.5, 2.5)
"""Stanley from fast to slow: see `Stanley.v_full` [m/s]."""
_STEPS_OF_SLEW = (1.2, 0.6, 0.3, 0.15, 0.075, 0.0375)
"""LQR from fast to slow: see `Lqr.of`."""
_OFFSET_WITHIN = (20.0, 25.0, 30.0, 40.0, 60.0, 90.0)
"""Integral action from fast to slow [s]; faster, it takes wander for an offset, and swings."""
_YAW_DOUBT_LEAST = 0.003
"""See `SafetyFilter.yaw_doubt_least` [rad/s]."""


def _soft(design_model: DesignModel) -> Block:
    """Stanley behind a predictor; by torque the fastest that is damped at all corners of the doubt."""
    block: Any = _delayed(design_model)
    if design_model.slew is None:
        return block
    law = replace(block.block, **_SOFT)

    def slower(v_full: float | None) -> Block:
        return replace(block, block=replace(law, v_full=v_full))

    return slower(_fastest(_V_FULL, slower, design_model))


def _recovering(design_model: DesignModel) -> Block:
    """What the adaptive recovery steers with: by torque with the fastest integral action that is damped likewise.

    The gain of such a car grows with what is asked of it: by one ratio alone it is up to 0.7 m off in bends at 16 m/s.
    """
    block: Any = _soft(design_model)
    if design_model.slew is None:
        return block

    def within(time: float) -> Block:
        slower = block.block.v_full
        return OffsetFree.around(block, design_model.vehicle, delay=design_model.delay, time=time, v_full=slower)

    return within(_fastest(_OFFSET_WITHIN, within, design_model))


def _slow_lqr(design_model: DesignModel) -> Block:
    """LQR; by torque the fastest that is damped at all corners of the doubt."""
    if design_model.slew is None:
        return _lqr(design_model)

    def tried(step: float) -> Block:
        return _lqr(design_model, step_of_slew=step, v_min=_HELD_AT[0], v_max=_HELD_AT[-1], v_step=_HELD_AT[0])

    return _lqr(design_model, step_of_slew=_fastest(_STEPS_OF_SLEW, tried, design_model))


_chosen: dict[Any, Any] = {}
"""What `_fastest` has found, by what it was found for: the same car is asked for again and again."""


def _fastest(numbers: Sequence[_T], make: Callable[[_T], Block], design_model: DesignModel) -> _T:
    """The first of the numbers whose controller is damped at all corners of the doubt; the last, where none is."""
    car, delay, lag = design_model.vehicle, design_model.delay, design_model.lag
    known = (numbers, car, delay, lag, design_model.rate_limit, design_model.slew, design_model.a_y_limit)
    if known not in _chosen:
        steered = SteeredCar(vehicle=car, matrices=LinearSingleTrack(vehicle=car).matrices, delay=delay, lag=lag)

        def damped(value: _T) -> float:
            return least_damping(make(value), steered, _DOUBT, _HELD_AT)

        place = bisect_left(numbers[:-1], True, key=lambda value: damped(value) >= _DAMPED)  # slower is better damped
        value = _chosen[known] = numbers[place]
        what = f"{type(make(value)).__name__} for {car.name}, {delay:.2f} s late, by torque"
        if place == len(numbers) - 1 and (least := damped(value)) < _DAMPED:
            doubt = f"gain {1 / _DOUBT.gain:.2f} to {_DOUBT.gain:.2f}, +-{_DOUBT.delay} s"
            _log.warning(
                f"{what}: damping ratio {least:.3f} within {doubt}, expected {_DAMPED} or more; there is no slower law"
            )
        elif place:
            _log.info(f"{what}: law {place + 1} of {len(numbers)}, as faster ones have no margin for what is doubted")
    return _chosen[known]


def _lqr(design_model: DesignModel, **table: Any) -> Block:
    """LQR; table: as of `Lqr.of`."""
    car = design_model.vehicle
    steering: dict[str, Any] = dict(
        delay=design_model.delay, lag=design_model.lag, slew=design_model.slew, a_y_limit=design_model.a_y_limit
    )
    block = Lqr.of(car, LinearSingleTrack(vehicle=car).matrices, **steering, **table)
    return replace(block, rate_limit=design_model.rate_limit)


_Q_RATE_OF_TORQUE = 4e-3
"""Weight of the command's rate for a car steered by torque: at that of the others, a gain 25 % off makes it swing."""
_REACH_OF_SLEW = 0.4
"""The largest |e| that such a car's programme sees, over its slew [s^3]: from further off it swings; with less, it
comes back slowly."""


def _of_slew(slew: float, kind: Any) -> dict[str, float]:
    """Settings of predictive steering for a slew [m/s^3]."""
    return {
        "q_rate": _Q_RATE_OF_TORQUE * max(1.0, 5.0 / slew) ** 2.5,
        "e_reach": min(kind.e_reach, _REACH_OF_SLEW * slew),
    }


def _predictive(name: str) -> Callable[[DesignModel], Block]:
    """What makes the predictive controller of that class."""

    def made(model: DesignModel) -> Block:
        from steerkit.controllers.mpc import block  # here, as it loads CasADi

        kind: Any = getattr(block, name)
        return kind.of(
            NonlinearSingleTrack(vehicle=model.vehicle),
            delay=model.delay + 0.5 * model.hold,
            lag=model.lag,
            rate_limit=min(model.rate_limit, kind.rate_limit),  # its own leaves the motor room to follow
            **({} if model.slew is None else _of_slew(model.slew, kind)),
            **({} if model.a_y_limit is None else {"a_y_limit": min(model.a_y_limit, kind.a_y_limit)}),
            fallback=_stanley(model),
            budget=model.budget,
            clock=model.clock,
        )

    return made


def _offset_free(make: Callable[[DesignModel], Block], **settings: float) -> Callable[[DesignModel], Block]:
    """What makes a controller with integral action around the one that `make` makes."""
    return lambda design_model: OffsetFree.around(
        make(design_model), design_model.vehicle, delay=design_model.delay, **settings
    )


_DEAD_TIME, _LATE = 0.5, 0.8
"""Longest dead time for which an adaptive controller is made, where none as long is told [s]; the second is that of
recovery controllers and of cars steered by torque. Where a longer one is needed, they swing."""
_ADAPTED_LAG = 0.1
"""Lag for which adaptive Stanley and LQR are made [s]. Of dead time and lag only the sum shows while driving, so the
lag told is no number on which the drive hangs: up to this and `_CAUTION` it changes nothing, and what is told beyond it
is where the sum begins; a recovery, which has to catch at once, begins with all of it. MPC is made for the lag told,
which is worth more to it: on a calibrated car another one costs it three times the error."""
_SURE = 0.015
"""Deviation up to which an adaptive controller of a car steered by torque believes at once that its dead time is
shorter [s]; a recovery, which is slower, always does."""
_CAUTION = 0.1
"""By how much it begins with more than is believed [s]: too much costs little for a while, too little: it swings."""


_OFFSET_TIMES = 5.0, 30.0
"""Within which an adaptive controller finds an offset, first and later [s]: it has no ratio to follow."""
_UNDERSTEER = 1e-4
"""Deviation of the understeer gradient for an adaptive controller [rad s^2/m]: it knows the data sheet's, and finds
the ratio that goes with it."""


def _adapting(
    make: Callable[[DesignModel], Block],
    design_model: DesignModel,
    *,
    lag: float = _ADAPTED_LAG,
    recovers: bool = False,
    takes_turns: bool = False,
) -> Adaptive:
    later = design_model.lag - lag
    told = design_model.delay + (later if recovers else max(later - _CAUTION, 0.0))
    least = _LATE if recovers or design_model.slew is not None else _DEAD_TIME
    longest = max(least, min(told + _CAUTION, _LONGEST))
    delays = tuple(i / 10.0 for i in range(math.ceil(10.0 * longest - 1e-6) + 1))
    car, prior = design_model.vehicle, min(max(told, 0.0), delays[-1])
    return Adaptive(
        blocks=tuple(make(replace(design_model, delay=delay, lag=lag)) for delay in delays),
        delays=delays,
        delay=YawDelay(
            vehicle=car,
            prior_delay=prior,
            prior_lag=max(lag, 0.01),
            enough=0.05,
            longest=max(YawDelay.longest, delays[-1]),
        ),
        steering=SingleTrackFilter(
            vehicle=car, understeer_prior=_UNDERSTEER, longest=max(SingleTrackFilter.longest, delays[-1])
        ),
        prior_delay=min(prior + _CAUTION, delays[-1]),
        lag=lag,
        delay_sure=Adaptive.delay_sure if recovers or design_model.slew is None else _SURE,
        limit=car.delta_sw_max,
        takes_turns=takes_turns,
    )


def _adaptive(
    make: Callable[[DesignModel], Block], *, lag: Callable[[DesignModel], float] = lambda design_model: _ADAPTED_LAG
) -> Callable[[DesignModel], Block]:
    """What makes a controller that adapts, with integral action, of those that `make` makes for that lag."""
    first, later = _OFFSET_TIMES
    made = _offset_free(make, time=first, time_late=later)
    return lambda design_model: _adapting(made, design_model, lag=lag(design_model))


_LINEAR_MPC = _predictive("MPC")
CONTROLLERS: Mapping[str, ControllerSpec] = {
    "stanley": ControllerSpec("Stanley, all terms of eq. 9", _stanley),
    "stanley-textbook": ControllerSpec(
        "Stanley, heading and cross-track terms only", lambda model: Stanley.textbook(model.vehicle)
    ),
    "stanley-delay": ControllerSpec("Stanley behind a predictor of delay and lag", _delayed),
    "pure-pursuit": ControllerSpec(
        "pure pursuit, no model", lambda model: PurePursuit.of(model.vehicle, model.path, delay=model.delay)
    ),
    "lqr": ControllerSpec("LQR with delay states and curvature preview", _lqr),
    "mpc": ControllerSpec("linear MPC over 1 s, limits and delay known", _LINEAR_MPC),
    "nonlinear-mpc": ControllerSpec("nonlinear MPC, real-time iteration", _predictive("NonlinearMPC")),
    "stanley-offset-free": ControllerSpec("stanley-delay with integral action", _offset_free(_delayed)),
    "lqr-offset-free": ControllerSpec("LQR with integral action", _offset_free(_lqr)),
    "mpc-offset-free": ControllerSpec("linear MPC with integral action", _offset_free(_LINEAR_MPC)),
    "stanley-adaptive": ControllerSpec("stanley-offset-free that adapts", _adaptive(_soft)),
    "lqr-adaptive": ControllerSpec("lqr-offset-free that adapts", _adaptive(_slow_lqr)),
    "mpc-adaptive": ControllerSpec("mpc-offset-free that adapts", _adaptive(_LINEAR_MPC, lag=lambda model: model.lag)),
}
"""The analytic controllers: they steer by themselves and learn nothing."""
OWN = "my_file.py:make, package.module:make"
"""What may stand for a controller's name besides: see `make_controller`."""
AUTO = "auto"
"""The recovery controller that fits any car: `adaptive`."""
ADAPTIVE = "adaptive"
"""The recovery controller that needs neither dead time nor ratio: it finds them while it or the learner steers."""
RECOVERIES = (AUTO, ADAPTIVE, "stanley", "stanley-delay")
"""Names of the recovery controllers: those that may take over from any state of the car."""
ELEMENTS: Mapping[str, type[OutputElement]] = {"integrator": Integrator, "low-pass": LowPass, "plain": PlainAngle}
"""The dynamic output elements."""
PLANTS: Mapping[str, type[SingleTrack]] = {"nonlinear": NonlinearSingleTrack, "linear": LinearSingleTrack}
"""The simulated cars."""


def make_controller(name: str, design_model: DesignModel) -> Block:
    """The controller of that name, made for what is believed of car, course and steering.

    name: one of `CONTROLLERS`; or `my_file.py:make`, `package.module:make`, where make(belief) returns a block of your
    own that steers by itself, or a policy and its output element, such as (PolicyBlock(...), Integrator()). Raises
    ValueError for an unknown name, with the valid ones, and for a `make` that fails or returns something else.
    """
    if is_outside(name):
        return _own(name, design_model)
    return _trimmed(CONTROLLERS[known(name, CONTROLLERS, "controller", also=OWN)].make(design_model), design_model)


def _trimmed(block: Block, design_model: DesignModel) -> Block:
    trimmed = (design_model.offset, design_model.gain) != (0.0, 1.0)
    return CommandCompensation(block=block, offset=design_model.offset, gain=design_model.gain) if trimmed else block


def _own(name: str, design_model: DesignModel) -> Block:
    make, where = imported(name, "controller"), f"controller '{name}'"
    other = f"of type {type(make).__name__}, expected a function of a DesignModel that returns a Block"
    require(callable(make), where, other)
    try:
        block = make(design_model)
    except Exception as error:
        raise ValueError(f"{where} failed: {in_one_line(error, foreign=True)}") from error
    expected = "expected a Block with an output delta_sw [rad], or a policy and its element, such as Integrator()"
    if isinstance(block, tuple) and len(block) == 2 and isinstance(block[1], OutputElement):
        block = WithElement(block=block[0], element=block[1])
    require(isinstance(block, Block), where, f"returned {_called(block)}, {expected}")
    outputs = {port.name: port.unit for port in block.outputs}
    given = ", ".join(f"{port} [{unit}]" for port, unit in outputs.items()) or "none"
    require(outputs.get("delta_sw") == "rad", where, f"{type(block).__name__} has the outputs {given}, {expected}")
    return block


def _called(thing: object) -> str:
    return f"the class {thing.__name__}" if isinstance(thing, type) else f"{thing!r:.60}"


def plant_kind(name: str) -> type[Car]:
    """The class of a simulated car: one of `PLANTS`, or `package.module:Class` for another.

    Another needs the ports of `steerkit.plants.single_track.Car` and the parameters vehicle, x0, y0, psi0 and v0; a
    `seed` is set to the drive's; it may refuse vehicles that it has no model of. Raises ValueError for an unknown name
    and for a class that is none.
    """
    if not is_outside(name):
        return PLANTS[known(name, PLANTS, "plant", also="package.module:Class")]
    kind, where = imported(name, "plant"), f"plant '{name}'"
    require(isinstance(kind, type) and issubclass(kind, Car), where, f"{_called(kind)}, expected a subclass of Car")
    lacks = {"vehicle", "x0", "y0", "psi0", "v0"} - {field.name for field in fields(kind)}
    require(not lacks, where, f"{kind.__name__} has no parameter {', '.join(sorted(lacks))}")
    return kind


def make_recovery(name: str, design_model: DesignModel, *, alone: bool = False) -> Block:
    """The recovery controller of a learned one: any of `RECOVERIES`. Raises ValueError with the valid names.

    alone: without a learned one beside it, so that nobody else's commands need to be watched.
    """
    if known(name, RECOVERIES, "recovery") in (AUTO, ADAPTIVE):
        return _trimmed(_adapting(_recovering, design_model, recovers=True, takes_turns=not alone), design_model)
    return make_controller(name, design_model)


def make_safety(design_model: DesignModel, gate: GateModel | None = None) -> SafetyFilter:
    """The safety filter for what is believed of car and steering, and for the gate behind it, if there is one.

    A gate makes the wheel slow: it is looked further ahead then, and a command is held for less. Behind the gate of a
    production car's port, with its slew, the backup is the slower law that a car steered by torque gets, and the yaw
    rate's doubt narrows where the model proves right: at 16 m/s the doubts alone else make 0.5 m of a reach.
    Raises ValueError for a car that is steered by torque without such a gate.
    """
    slew = f"slew = {design_model.slew} [m/s^3], expected none: the filter is for cars whose steering takes an angle"
    require(design_model.slew is None or gate is not None, "make_safety", slew)
    behind: dict[str, Any] = {"gate": gate, **BEHIND_GATE} if gate else {}
    if gate:  # a slow one: until the wheel has gone from one side to the other
        more = max(0.0, BEHIND_GATE["hold"] * DT + gate.turning + 0.1 - BEHIND_GATE["horizon"])
        behind["horizon"] = math.ceil((behind["horizon"] + more) / DT - 1e-9) * DT
        behind["preview_points"] += math.ceil(more / SafetyFilter.preview_dt)
    steering = dict(delay=design_model.delay, lag=design_model.lag, rate_limit=design_model.rate_limit)
    made = SafetyFilter.of(design_model.vehicle, **steering, **behind)
    slower: Any = _soft(design_model)
    return made if design_model.slew is None else replace(made, backup=slower, yaw_doubt_least=_YAW_DOUBT_LEAST)


def make_element(name: str, vehicle: Vehicle | None = None) -> OutputElement:
    """The dynamic output element of that name (see `ELEMENTS`), within the steering wheel's stops of `vehicle`.

    name: or `my_file.py:Class`, `package.module:Class`, a subclass of `OutputElement` of your own, which is made with
    its default parameters. Without a vehicle the stops are at 520 degrees. Raises ValueError for an unknown name, with
    the valid ones, and for a class that is no such element.
    """
    kind = element_kind(name)
    return kind() if vehicle is None else kind(limit=vehicle.delta_sw_max)


def element_kind(name: str) -> type[OutputElement]:
    """The class of an output element: see `make_element`."""
    if not is_outside(name):
        return ELEMENTS[known(name, ELEMENTS, "element", also="my_file.py:Class")]
    kind, where = imported(name, "element"), f"element '{name}'"
    fits = isinstance(kind, type) and issubclass(kind, OutputElement) and kind is not OutputElement
    require(fits, where, f"{_called(kind)}, expected a subclass of OutputElement (steerkit.doe)")
    asks = [f.name for f in fields(kind) if f.init and f.default is MISSING and f.default_factory is MISSING]
    require(not asks, where, f"{kind.__name__} has no default for {', '.join(asks)}, expected one for every parameter")
    return kind
