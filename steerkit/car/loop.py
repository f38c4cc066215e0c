"""The loop on a car: its controllers by name, its wires, who steers in each sample, and a drive at 20 Hz."""

import hashlib
import json
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import Any, Self

from steerkit._support.clock import Clock
from steerkit._support.errors import number, require
from steerkit._support.files import read_bytes
from steerkit._support.plugins import fingerprint, is_outside, named_in
from steerkit.car.client import CarClient, RealCar
from steerkit.car.config import CarConfig
from steerkit.car.estimates import EVERY
from steerkit.car.protocol import Adapted, Filtered, Remark
from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.fail_safe import FailSafe
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.open_loop import WAVES, OpenLoop, with_excitation
from steerkit.controllers.supervisor import SupervisorState
from steerkit.diagram import maths as m
from steerkit.diagram import realtime
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Scalar
from steerkit.diagram.realtime import Run
from steerkit.doe import Integrator, OutputElement
from steerkit.learning import rundir
from steerkit.learning.settings import Setting
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.proving.manoeuvre import Conditions, Input, Manoeuvre
from steerkit.scenario import catalogue
from steerkit.scenario.assembly import controller_of, steering_loop, with_controller
from steerkit.task import TRIP
from steerkit.vehicles.rollout import GateModel, beside, yaw_gain

_STEP = 0.05
"""Time between two points of the roll-out [s]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class ExcursionPredictor(Block):
    """What a `Supervisor` should judge instead of |e| where a gate lets the wheel turn only so fast.

    At 6 m/s a gate of 3 m/s^2 and 5 m/s^3 needs 1.2 s from lock to lock; a recovery controller that takes over at
    |e| = 0.5 m gets 2 m off before the car has turned. So a kinematic car is rolled out (see `beside`), its wheel held
    at the last command for `hold`, then turned against the drift as fast as the gate allows at the least (see
    `GateModel.pushed`), once to the left and once to the right:

        reach = max(e(t) while turning right, -e(t) while turning left),   t up to `horizon`, by midpoints of 0.05 s
        distance = max(|e|, weight * reach)

    A kinematic car behind the gate gets no further than `reach` (within 1 cm, for |psi_e| <= 0.5 rad,
    |kappa| <= 0.05 /m, v <= 9 m/s, |doe| <= 3 rad), and hardly ever 15 % less far.

    Inputs: e [m], psi_e [rad], kappa [1/m] of the path, all at the **front axle** (a tracker with reference = l_f);
    v [m/s] of the rear axle; doe [rad], the angle that was commanded in the end (a DOE's `state`). Outputs:
    distance [m]; reach [m]. No state. Valid for v >= 0, |doe| <= delta_sw_max. NaN in any input gives NaN out, which a
    `Supervisor` answers. Raises ValueError for parameters that are not positive.
    """

    e = In("m")
    psi_e = In("rad")
    kappa = In("1/m")
    v = In("m/s")
    doe = In("rad")
    distance = Out("m")
    reach = Out("m")

    gate: GateModel = field(default_factory=lambda: GateModel(v_doubt=0.0))
    """The gate, and the car's geometry and ratio."""
    hold: float = number(0.15, "s", low=0.0, high=100.0)
    """Time until the wheels turn back: a sample, and the motor's lag [s]."""
    horizon: float = number(2.0, "s", above=0.0)
    """How far to look ahead [s]."""
    weight: float = number(0.4, "1", above=0.0)
    """A trip at |e| = 0.5 m becomes one at a reach of 0.5/weight = 1.25 m too."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        left, right = self._reach(u, 1.0), self._reach(u, -1.0)
        reach = m.maximum(left, right)
        return self.Y(m.maximum(self.weight * reach, m.absolute(u.e)), reach)

    def _reach(self, u: Any, side: float) -> Scalar:
        """The furthest that the car gets to the left (side = 1) or right (-1) while it is steered the other way [m]."""
        limits = self.gate.limits
        ratio, length, gain = limits.steer_ratio, limits.wheelbase, yaw_gain(u.v, limits.wheelbase, limits.understeer)
        e, psi_e, kappa, wheel = side * u.e, side * u.psi_e, side * u.kappa, side * u.doe  # the right is mirrored
        furthest = e
        for n in range(round(self.horizon / _STEP)):
            before = wheel
            if n * _STEP >= self.hold:
                wheel = self.gate.pushed(-limits.delta_sw_max, wheel, u.v, _STEP)
            r = gain * m.tan(0.5 * (before + wheel) / ratio)
            e, psi_e = beside(e, psi_e, _STEP, u.v, r, length, kappa)
            furthest = m.maximum(e, furthest)
        return furthest


@dataclass(kw_only=True)
class Follow:
    """The choice of a loop while a car is driven: ask `begin` and then `choose` after every sample.

    A pose that comes back after a pause makes the loop begin anew, so that it looks for its place on the path. While
    the human steers, controllers settle on the wheel as it is in every sample: none engages with a memory of commands
    that were not sent. One that adapts keeps what it has found of the car, and learns nothing then; but
    after a FAULT, or a drive with more than 0.5 m beside the path, that may be what was wrong, and it begins anew.
    Depends on nothing but the snapshots, so that a recorded drive can be replayed.
    """

    link: Any
    """The line to the car server: see `RealCar`."""
    resting: Loop
    """The loop while not engaged, or while the policy is not trusted: its recovery controller steers."""
    driving: Loop
    trusted: bool = True
    """May `driving` steer?"""
    engaged: bool = False
    """Was it engaged in the last sample?"""
    places: float = -1.0
    doubted: bool = False
    """Was the car off its path while engaged, or is there a fault, so that nothing found of it is to be believed?"""

    @classmethod
    def of(cls, loop: Loop, link: Any) -> Self:
        """For a loop of `steerkit.car.loop.car_loop`."""
        resting, policy = loop, controller_of(loop)
        if isinstance(policy, NfqPolicy):
            resting = with_controller(loop, replace(policy, ready_from=math.inf))
        return cls(link=link, resting=resting, driving=loop)

    def begin(self, run: Run) -> bool:
        """Take note of who steers; True when the loop began anew."""
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
            if "supervisor" in run.loop.blocks:  # the recovery controller has not waited while the human steered
                k = run.loop.names.index("supervisor")
                run.x[k] = SupervisorState(run.x[k][0], run.x[k][1], 0.0)
        return lost

    def exchange(self, run: Run, driving: Loop) -> None:
        """Another policy drives from the next sample on; a fault was that of the one before."""
        self.driving = driving
        if "supervisor" in driving.blocks:
            k = driving.names.index("supervisor")
            run.x[k] = SupervisorState(run.x[k][0], 0.0, run.x[k][2])

    def choose(self, run: Run) -> None:
        """The loop of the next sample; once a second what its controller believes of the car goes to the recording."""
        run.loop = self.driving if self.engaged and self.trusted else self.resting
        if run.k % EVERY == 0 and (adapted := adapted_in(run)):
            self.link.note(adapted)


def adapted_in(run: Run) -> Adapted | None:
    """What the controller of a loop believes of its car, or else its recovery controller; None where neither adapts."""
    for name in ("controller", "recovery"):
        block = run.loop.blocks.get(name)
        if isinstance(block, Adaptive):
            return Adapted(*block.believed(run.x[run.loop.names.index(name)]))
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
    code: str = ""
    """Fingerprint of a user's own code: the controller's, or that of `doe`."""
    doe: str = ""
    """The policy's dynamic output element: see `steerkit.learning.settings.ELEMENTS`."""
    recovery: str = "stanley"
    """The policy's recovery controller."""
    trusted: bool = True
    """False: its recovery controller steers until the next net."""
    safe: bool = False
    """Is there a safety filter before the gate?"""
    run: str = ""
    """Of a proving ground, what begins or ends here, as JSON: see `with_run`."""

    @classmethod
    def by_policy(cls, file: FilePath, doe: str, **more: Any) -> Self:
        """A policy in `file`, which has to be there."""
        more["code"] = fingerprint(doe, "element") if is_outside(doe) else ""
        return cls(name=str(file.resolve()), sha256=hashlib.sha256(read_bytes(file)).hexdigest(), doe=doe, **more)

    def text(self) -> str:
        """As JSON, for `Remark`."""
        return json.dumps(vars(self))

    @classmethod
    def read(cls, text: str) -> Self:
        """What `text` wrote; raises ValueError for anything else."""
        try:
            steers = cls(**json.loads(text))
            kinds = [type(value) for value in vars(steers).values()]
            require(kinds == [*5 * [str], bool, bool, str], "fields", "of another type")
            return steers
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f"remark {text[:2000]!r}: not who steers ({error})") from error


BUDGET = 0.03
"""A solution of MPC that took longer is not used [s]: the plan before is followed, then the fallback law; nor is an
answer of the safety filter: the recovery controller's is."""
RUN_FORMAT = "steerkit car run 1"
"""How `car.json`, the setting of a learning run on a car, names its format."""
LEARNED = FilePath("runs/car")
"""Where `steerkit learn --car` keeps its run by default, and where `nfq` is looked for."""
VALID = (
    f"{', '.join(catalogue.CONTROLLERS)}, one of these with a wave on top "
    f"({', '.join(f'stanley+{wave}' for wave in WAVES)}), nfq (the newest net in {LEARNED}), a learning run's "
    "directory, a policy's .npz file, my_file.py:make if the car's file allows it"
)


def design_model_of(config: CarConfig) -> catalogue.DesignModel:
    """What controllers believe of a car: its vehicle, its course, the delay and lag of its kit, the gate's limits.

    The delay is that from command to wheel, as it was measured: nothing is added to it.
    """
    stop = min(float(config.vehicle.delta_sw_max), config.gate.delta_sw_max)
    port = config.port_limits
    return catalogue.DesignModel(
        vehicle=replace(config.vehicle, delta_sw_max=stop),
        path=config.course,
        delay=config.delay,
        lag=config.lag + (port.late if port else 0.0),
        rate_limit=min(catalogue.DesignModel.rate_limit, float(config.gate.rate(config.states.v_engage_max))),
        slew=(port.slew or min(config.gate.jerk_max, port.turning)) if port else None,
        a_y_limit=(port.torque_limit or config.gate.a_y_max) if port else None,
        budget=BUDGET,
        clock=time.perf_counter,
    )


@dataclass(frozen=True, eq=False, kw_only=True)
class Controller:
    """A controller for a car."""

    block: Block
    """It steers by itself, or picks the actions of `element`."""
    steers: Steers
    """What the recording notes of it."""
    element: OutputElement | None = None
    """A learned policy's dynamic output element."""


def controller_named(name: str, config: CarConfig, *, in_time: bool = False, run: str = "") -> Controller:
    """A controller by name, or a learned policy by its place; raises ValueError with the valid ones.

    in_time: whatever it solves is in time, however long it takes; for replays. run: what a recording notes of a
    manoeuvre, `Steers.run`: without it, none is made of a name such as `stanley+step-steer@8.0,0.5,left,3`.
    """
    if run:
        made = controller_named(name.partition("+")[0], config, in_time=in_time)
        return replace(made, block=with_run(made.block, run, config), steers=replace(made.steers, name=name, run=run))
    check_allowed("controller", name, config)
    design_model = design_model_of(config)
    if in_time:
        design_model = replace(design_model, budget=None, clock=None)
    base, plus, wave = name.partition("+")
    if plus and base in catalogue.CONTROLLERS:
        block = with_excitation(catalogue.make_controller(base, design_model), wave, config.vehicle)
        return Controller(block=block, steers=Steers(name=name))
    if name in catalogue.CONTROLLERS or is_outside(name):
        block = catalogue.make_controller(name, design_model)
        code = fingerprint(name, "controller") if is_outside(name) else ""
        return Controller(block=block, steers=Steers(name=name, code=code))
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


def with_run(controller: Block, run: str, config: CarConfig) -> Block:
    """`controller` with what a proving ground's run has it steer; one that adapts gets it inside.

    run: JSON with `input`, `v` and `side` while a wave is steered, `on_top` of the controller or instead of
    it; without `input` the controller steers alone. Raises ValueError for anything else.
    """
    if isinstance(controller, Adaptive):
        return replace(controller, blocks=tuple(with_run(block, run, config) for block in controller.blocks))
    try:
        told = json.loads(run)
        if not told.get("input"):
            return OpenLoop(block=controller, on_top=True)
        size: dict[str, Any] = {k: tuple(x) if isinstance(x, list) else x for k, x in told["input"].items()}
        about: dict[str, Any] = {"name": "run", "title": "", "norm": "", "about": "", "evaluation": "request"}
        manoeuvre = Manoeuvre(**about, input=Input(**size), conditions=Conditions(v=told["v"]))
        how: dict[str, Any] = {"number": 1.0, "on_top": told["on_top"] is True}
        return manoeuvre.open_loop(controller, config.vehicle, told["side"], **how)
    except (AttributeError, KeyError, TypeError, RecursionError) as error:
        raise ValueError(f"run {run[:2000]!r}: not what is driven in it ({error!r})") from error


def check_allowed(what: str, name: str, config: CarConfig) -> None:
    """Raise ValueError for a controller or an output element of somebody's own that the car's file does not name."""
    if is_outside(name):
        allowed = ", ".join(config.controllers) or "none"
        hint = f"a car takes only those of your own that its file names: [controllers] allow = [{name!r}]"
        require(name in config.controllers, f"{what} {name!r}", f"not allowed; {hint}; allowed are: {allowed}")


def policy_in(file: FilePath, doe: str, config: CarConfig) -> Controller:
    """The learned policy in `file`, with the output element of that name."""
    check_allowed("element", doe, config)
    element = catalogue.make_element(doe, design_model_of(config).vehicle)
    return Controller(block=NfqPolicy.load(file), steers=Steers.by_policy(file, doe), element=element)


def element_of(place: FilePath) -> str:
    """The output element that a run's policies were trained with; raises ValueError where it is not known."""
    if (place / "car.json").is_file():
        return setting_of(place).doe
    return rundir.experiment_of(place).setting.doe


def setting_of(place: FilePath) -> Setting:
    """How a run on a car learns; raises ValueError for a directory that holds none."""
    data = rundir.document(place, "car.json", RUN_FORMAT, ["setting"])
    with named_in(f"{place}/car.json", data.get("code")):
        return rundir.from_plain(data["setting"], str(place / "car.json"), Setting)


def car_loop(
    config: CarConfig,
    link: Any,
    controller: Block,
    *,
    doe: OutputElement | None = None,
    recovery: str = catalogue.AUTO,
    safe: bool = False,
    clock: Callable[[], float] | None = time.perf_counter,
) -> Loop:
    """The loop of the simulated runs with a `RealCar` in the plant's place: 20 Hz, e at the front axle.

    controller: a block that steers, or a policy, which gets `doe` (default: an Integrator), corrected by what the gate
    let through, and the recovery controller of that name, called in time for the gate to let it turn the wheel.
    safe: put a `SafetyFilter` that knows the gate before it; where it fails, or takes longer than `BUDGET` by
    `clock` (None: no time is taken), the recovery controller steers. Raises ValueError for safe without a policy.
    """
    learned = any(port.name == "action" for port in controller.outputs)
    require(learned or not safe, "car_loop", "safe = True, expected a policy: the filter is for learned controllers")
    design_model, element = design_model_of(config), doe or Integrator()
    element = replace(element, limit=min(element.limit, design_model.vehicle.delta_sw_max))
    return steering_loop(
        car=RealCar(link=link),
        path=config.course,
        driver=ConstantSpeed(speed=0.0),  # the human in the car keeps the speed; nobody reads this
        controller=controller,
        doe=element if learned else None,
        recovery=catalogue.make_recovery(recovery, design_model) if learned else None,
        foresight=foresight(config) if learned else None,
        safety=safety(config, clock) if safe else None,
        reference=config.vehicle.l_f,
    )


def foresight(config: CarConfig) -> ExcursionPredictor:
    """How far the car will get behind the gate of `config`."""
    return ExcursionPredictor(gate=GateModel(limits=config.gate, v_doubt=0.0))


def safety(config: CarConfig, clock: Callable[[], float] | None = None) -> FailSafe:
    """The safety filter before the gate of `config`."""
    budget = None if clock is None else BUDGET
    return FailSafe(
        block=catalogue.make_safety(design_model_of(config), GateModel(limits=config.gate)),
        budget=budget,
        clock=clock or time.perf_counter,
    )


def drive(
    config: CarConfig,
    link: CarClient,
    controller: Controller,
    *,
    recovery: str = catalogue.AUTO,
    duration: float = float("inf"),
    clock: Clock | None = None,
    watch: Callable[[realtime.Run], bool | None] | None = None,
) -> realtime.Run:
    """Run a controller at 20 Hz on the car behind `link`, engaged or not, for `duration` [s].

    Missed deadlines go to the car server with the next request; it disengages when they repeat. Raises CarLost when the
    car server ends.
    """
    link.wait(timeout=10.0)
    loop = car_loop(config, link, controller.block, doe=controller.element, recovery=recovery)
    follow = Follow.of(loop, link)

    def step(run: realtime.Run) -> bool:
        follow.begin(run)
        follow.choose(run)
        return bool(watch and watch(run))

    link.note(Remark(replace(controller.steers, recovery=recovery).text()))
    return realtime.run(
        follow.resting, duration, timer=clock or Clock(), watch=step, on_miss=lambda run: count_misses(run, link)
    )


def count_misses(run: realtime.Run, link: CarClient) -> None:
    """Tell the car server about missed deadlines, with the next request."""
    link.misses = run.timing.misses
