"""The loop on a car: its course, its controllers by name, its wires, and a drive at 20 Hz."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

from steerkit._support.clock import Clock
from steerkit._support.errors import require
from steerkit._support.plugins import is_outside
from steerkit.car import learner as on_car
from steerkit.car.client import CarClient, CarLink, RealCar
from steerkit.car.config.config import CarConfig
from steerkit.car.configured import course_of
from steerkit.car.follow import Follow, Steers
from steerkit.controllers.excursion_predictor import ExcursionPredictor
from steerkit.controllers.fail_safe import FailSafe
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.with_excitation import WAVES, with_excitation
from steerkit.diagram import realtime
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.doe import Integrator, OutputElement
from steerkit.learning import rundir
from steerkit.paths.path import Path
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario.assembly import steering_loop
from steerkit.scenario.catalogue import (
    AUTO,
    CONTROLLERS,
    DesignModel,
    make_controller,
    make_element,
    make_recovery,
    make_safety,
)
from steerkit.vehicles.rollout import GateModel

MPC_BUDGET = 0.03
"""A solution that took longer is not used [s]: the plan before is followed, then the fallback law."""
SAFETY_BUDGET = 0.03
"""An answer of the safety filter that took longer is not used [s]: the recovery controller's is."""
LEARNED = FilePath("runs/car")
"""Where `steerkit learn --car` keeps its run unless told otherwise, and where `nfq` is looked for."""
VALID = (
    f"{', '.join(CONTROLLERS)}, one of these with a wave on top ({', '.join(f'stanley+{wave}' for wave in WAVES)}), "
    f"nfq (the newest net in {LEARNED}), a learning run's directory, a policy's .npz file, "
    "my_file.py:make if the car's file allows it"
)


def design_model_of(config: CarConfig) -> DesignModel:
    """What controllers are told of a car: its vehicle, its course, the delay and lag of its kit, the gate's limits.

    The delay is that from command to wheel, as it was measured: nothing is added to it.
    """
    stop = min(float(config.vehicle.delta_sw_max), config.gate.delta_sw_max)
    return DesignModel(
        vehicle=replace(config.vehicle, delta_sw_max=stop),
        path=course_of(config),
        delay=config.delay,
        lag=config.lag,
        rate_limit=min(DesignModel.rate_limit, config.gate.rate_max),
        budget=MPC_BUDGET,
        clock=time.perf_counter,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Controller:
    """A controller for a car."""

    block: Block
    """It steers by itself, or picks the actions of `element`."""
    steers: Steers
    """What to tell the recording."""
    element: OutputElement | None = None
    """A learned policy's dynamic output element."""


def controller_named(name: str, config: CarConfig, *, in_time: bool = False) -> Controller:
    """A controller by name, or a learned policy by its place; raises ValueError with the valid ones.

    in_time: whatever it solves is in time, however long it takes; for replays.
    """
    check_allowed("controller", name, config)
    design_model = design_model_of(config)
    if in_time:
        design_model = replace(design_model, budget=None, clock=None)
    base, plus, wave = name.partition("+")
    if plus and base in CONTROLLERS:
        block = with_excitation(make_controller(base, design_model), wave, config.vehicle)
        return Controller(block=block, steers=Steers(name=name))
    if name in CONTROLLERS or is_outside(name):
        return Controller(block=make_controller(name, design_model), steers=Steers(name=name))
    place = LEARNED if name == "nfq" else FilePath(name)
    if place.is_dir():
        nets = [f for f in sorted(place.glob("nets/net-*.npz")) if f.stem != "net-0000"]
        if nets:
            return policy_in(nets[-1], element_of(place), config)
    elif place.is_file():
        return policy_in(place, element_of(place.parent.parent), config)
    if name == "nfq":
        raise ValueError(f"controller 'nfq': no net in {place}; learn one first: steerkit learn --car FILE")
    raise ValueError(f"controller {name!r} is not known, nor a place with a trained policy; valid: {VALID}")


def check_allowed(what: str, name: str, config: CarConfig) -> None:
    """Raise ValueError for a controller or an output element of somebody's own that the car's file does not name."""
    if is_outside(name):
        allowed = ", ".join(config.controllers) or "none"
        hint = f"a car takes only those of your own that its file names: [controllers] allow = [{name!r}]"
        require(name in config.controllers, f"{what} {name!r}", f"not allowed; {hint}; allowed are: {allowed}")


def policy_in(file: FilePath, doe: str, config: CarConfig) -> Controller:
    """The learned policy in `file`, with the output element of that name."""
    check_allowed("element", doe, config)
    element = make_element(doe, design_model_of(config).vehicle)
    return Controller(block=NfqPolicy.load(file), steers=Steers.by_policy(file, doe), element=element)


def element_of(place: FilePath) -> str:
    """The name of the output element that a run's policies were trained with; raises ValueError when nothing tells."""
    if (place / "car.json").is_file():
        return on_car.setting_of(place).doe
    if (place / "run.json").is_file():
        return rundir.experiment_of(place).setting.doe
    raise ValueError(
        f"{place} is no run directory (neither car.json nor run.json), so nothing tells the output "
        "element of its policies"
    )


def recovery_named(name: str, config: CarConfig) -> Block:
    """The controller that catches a learned one; raises ValueError with the valid names."""
    return make_recovery(name, design_model_of(config))


def car_loop(
    config: CarConfig,
    path: Path,
    link: CarLink,
    controller: Block,
    *,
    doe: OutputElement | None = None,
    recovery: str = AUTO,
    safe: bool = False,
    clock: Callable[[], float] | None = time.perf_counter,
) -> Loop:
    """The loop of the simulated runs with a `RealCar` in the plant's place: 20 Hz, e at the front axle.

    controller: a block that steers, or a policy, which gets `doe` (default: an Integrator), corrected by what the gate
    let through, and the recovery controller of that name, called in time for the gate to let it turn the wheel.
    safe: put a `SafetyFilter` that knows the gate before it; where it fails, or takes longer than `SAFETY_BUDGET` by
    `clock` (None: no time is taken), the recovery controller steers. Raises ValueError for safe with a controller that
    is no policy.
    """
    learned = any(port.name == "action" for port in controller.outputs)
    require(learned or not safe, "car_loop", "safe = True, expected a policy: the filter is for learned controllers")
    element = doe or Integrator()
    element = replace(element, limit=min(element.limit, design_model_of(config).vehicle.delta_sw_max))
    return steering_loop(
        car=RealCar(link=link),
        path=path,
        driver=ConstantSpeed(speed=0.0),  # the human in the car keeps the speed; nobody reads this
        controller=controller,
        doe=element if learned else None,
        recovery=recovery_named(recovery, config) if learned else None,
        foresight=foresight(config) if learned else None,
        safety=safety(config, clock) if safe else None,
        reference=config.vehicle.l_f,
    )


def gate_model(config: CarConfig, **settings: float) -> GateModel:
    """What is known of the gate of `config` when one looks ahead; settings: other fields of `GateModel`."""
    limits = config.gate
    same = ("a_y_max", "jerk_max", "rate_max", "delta_sw_max", "v_floor", "steer_ratio", "wheelbase", "arm", "quantum")
    return GateModel(**{name: getattr(limits, name) for name in same} | settings)


def foresight(config: CarConfig) -> ExcursionPredictor:
    """How far the car will get behind the gate of `config`."""
    return ExcursionPredictor(gate=gate_model(config, v_doubt=0.0))


def safety(config: CarConfig, clock: Callable[[], float] | None = None) -> FailSafe:
    """The safety filter before the gate of `config`."""
    budget = None if clock is None else SAFETY_BUDGET
    return FailSafe(block=make_safety(design_model_of(config), gate_model(config)), budget=budget, clock=clock)


def drive(
    config: CarConfig,
    path: Path,
    link: CarClient,
    controller: Controller,
    *,
    recovery: str = AUTO,
    duration: float = float("inf"),
    clock: Clock | None = None,
    watch: Callable[[realtime.Run], bool | None] | None = None,
    line: CarLink | None = None,
) -> realtime.Run:
    """Run a controller at 20 Hz on the car behind `link`, engaged or not, for `duration` [s].

    line: what the loop's car asks, such as `steerkit.car.estimates.Watched` around the link (default: the link).
    Missed deadlines go to the car server with the next request; it disengages when they repeat. Raises CarLost
    when the car server ends.
    """
    link.wait(timeout=10.0)
    loop = car_loop(config, path, line or link, controller.block, doe=controller.element, recovery=recovery)
    follow = Follow.of(loop, link)

    def step(run: realtime.Run) -> bool:
        follow.begin(run)
        follow.choose(run)
        return bool(watch and watch(run))

    link.remark(replace(controller.steers, recovery=recovery).text())
    return realtime.run(
        follow.resting, duration, timer=clock or Clock(), watch=step, on_miss=lambda run: count_misses(run, link)
    )


def count_misses(run: realtime.Run, link: CarClient) -> None:
    """Tell the car server about missed deadlines, with the next request."""
    link.misses = run.timing.misses
