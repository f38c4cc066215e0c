"""The usual steering loop, wired in one call; everything it does can be done by hand."""

import tomllib
from collections.abc import Collection, Iterable
from dataclasses import replace
from pathlib import Path as FilePath
from typing import Any, TypeVar

from steerkit._support.errors import WiringError
from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.fail_safe import FailSafe
from steerkit.controllers.supervisor import ExceptionGuard, Supervisor
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, Wrapper
from steerkit.diagram.diagnostics import require_block
from steerkit.diagram.loop import Loop, Wire
from steerkit.doe import Corrected, OutputElement
from steerkit.paths.path import Path
from steerkit.paths.tracker import PathTracker

Car = TypeVar("Car", bound=Block)
Part = TypeVar("Part", bound=Block)


def placed(car: Car, path: Path, *, s: float = 0.0, e: float = 0.0, psi_e: float = 0.0) -> Car:
    """`car` with its start pose on `path`: at arc length s [m], e [m] to the left, turned by psi_e [rad]."""
    x, y = path.point(s)
    psi = path.psi(s)
    return replace(car, x0=x - e * m.sin(psi), y0=y + e * m.cos(psi), psi0=psi + psi_e)  # type: ignore[call-arg]


def steering_loop(
    *,
    car: Block,
    path: Path,
    driver: Block,
    controller: Block,
    doe: Block | None = None,
    recovery: Block | None = None,
    supervisor: Supervisor | None = None,
    foresight: Block | None = None,
    safety: Block | None = None,
    link: Block | None = None,
    actuator: Block | None = None,
    column: Block | None = None,
    sensors: Block | None = None,
    estimator: Block | None = None,
    reference: float = 0.0,
) -> Loop:
    """The standard wires between a car on a path, its driver and its steering controllers.

    controller: steers by itself (an output `delta_sw`), or picks actions (an output `action`) that `doe` turns into an
    angle. recovery: an analytic controller that steers while the learner is off, through `supervisor` (default: 0.5 m
    and 0.1 m, and the doe's stops), which judges |e|, or the `distance` of `foresight`; the controller is then
    `ExceptionGuard`, so that an exception in it is a fault that the supervisor answers. actuator: between the command
    and the wheel (none: the command is the angle); link: between the command and the actuator; column: between the
    actuator and the road wheels, and then it says what is measured of the wheel. sensors: what the controllers see of
    the car (none: the truth). safety: a `SafetyFilter` between whoever steers and the wheel; the doe goes on from what
    it lets through; where it fails, the recovery controller steers, if there is one (`FailSafe`). reference: where e is
    measured, m ahead of the centre of gravity (the front axle is l_f).

    The blocks are named driver, car, link, actuator, column, sensors, path, controller, doe, recovery, foresight,
    supervisor, safety.
    `path` tracks the **true** reference point, for logs and metrics; with sensors, `seen` tracks the measured one; a
    controller that wants e elsewhere (its field `reference`) or a preview gets a tracker of its own. A car with an
    output `applied` (a real one) reports the angle that it was commanded in the end; the doe is then `Corrected` by it.
    A controller's inputs are joined by name: e, e_dot, psi_e, kappa, r_e, s, progress, preview (its tracker), x, y,
    psi, v, beta, r, a_y (sensors or car), delta_sw_meas (column, actuator or car), doe (the DOE's state).

    Raises WiringError when a part is missing or an input has a name not listed here.
    """
    given = locals()
    for role, example in _EXAMPLES.items():
        if given[role] is not None or role in ("car", "driver", "controller"):
            require_block(given[role], "steering_loop", role, example)
    learns = "action" in _names(controller.outputs)
    if learns and doe is None:
        raise WiringError(f"{type(controller).__name__} picks actions and needs a doe such as Integrator()")
    if doe is not None and not learns:
        alone = "steers by itself (it has no output 'action'); leave doe out"
        raise WiringError(f"{type(controller).__name__} {alone}")
    for role in ("supervisor", "foresight"):
        if given[role] is not None and recovery is None:
            raise WiringError(f"{role} without a recovery controller; give recovery, such as Stanley.of(vehicle)")
    if recovery is not None and "ready" not in _names(controller.outputs):
        raise WiringError(f"{type(controller).__name__} has no output 'ready', which the supervisor needs to know")
    reports = "applied" in _names(car.outputs)
    if recovery is not None:
        controller = _guarded(controller)
        if safety is not None and not isinstance(safety, FailSafe):
            safety = FailSafe(block=safety)
    if doe is not None and reports:
        doe = _corrected(doe)
    bench = _Bench(path)
    bench.add("driver", driver)
    bench.add("car", car)
    parts = (("link", link), ("actuator", actuator), ("column", column))
    chain = [bench.add(name, part) for name, part in parts if part is not None]
    steered = chain[-1] if chain else car
    truth = bench.add("path", PathTracker(path=path, reference=reference, dt=controller.dt))
    bench.join(truth, car)
    bench.join(driver, truth)
    seen: Block = car
    tracker = truth
    if sensors is not None:
        seen = bench.add("sensors", sensors)
        bench.join(sensors, car)
    if estimator is not None:
        bench.estimate(estimator, seen, steered)
        seen = estimator
    if seen is not car:
        tracker = bench.add("seen", PathTracker(path=path, reference=reference, dt=controller.dt))
        bench.join(tracker, seen)
    bench.add("controller", controller)
    bench.control(controller, tracker, seen, steered, doe)
    command = controller
    if doe is not None:
        command = bench.add("doe", doe)
        bench.wire(controller, "action", doe, "action")
    if recovery is not None:
        bench.add("recovery", recovery)
        bench.control(recovery, tracker, seen, steered, doe)
        element = doe.element if isinstance(doe, Corrected) else doe  # an angle that it cannot mean is a fault
        most = element.limit if isinstance(element, OutputElement) else Supervisor.limit
        judge = bench.add("supervisor", supervisor or Supervisor(dt=controller.dt, limit=most))
        if foresight is None:
            bench.wire(tracker, "e", judge, "e")
        else:
            bench.add("foresight", foresight)
            bench.control(foresight, tracker, seen, steered, doe)
            bench.wire(foresight, "distance", judge, "e")
        bench.wire(controller, "ready", judge, "ready")
        bench.wire(command, "delta_sw", judge, "learner")
        bench.wire(recovery, "delta_sw", judge, "recovery")
        command = judge
    if safety is not None:
        bench.add("safety", safety)
        bench.wire(command, "delta_sw", safety, "command")
        if recovery is not None:
            bench.wire(recovery, "delta_sw", safety, "recovery")
        bench.control(safety, tracker, seen, steered, doe, wired=("command", "recovery"))
        command = safety
    if doe is not None:
        bench.wire(car if reports else command, "applied" if reports else "delta_sw", doe, "applied")
    for part in chain:
        into = next(name for name in ("delta_sw_cmd", "delta_sw_in") if name in _names(part.inputs))
        bench.wire(command, "delta_sw", part, into)
        if "v" in _names(part.inputs):
            bench.wire(car, "v", part, "v")
        command = part
    bench.wire(command, "delta_sw", car, "delta_sw_cmd")
    bench.wire(driver, "v", car, "v_cmd")
    return Loop(blocks=bench.blocks, wires=bench.wires)


_EXAMPLES: dict[str, str] = tomllib.loads(FilePath(__file__).with_suffix(".toml").read_text(encoding="utf-8"))
"""What would do for a part of the loop."""


def controller_of(loop: Loop) -> Block:
    """The controller that `steering_loop` was given, without the guard around it."""
    block = loop.blocks["controller"]
    return block.block if isinstance(block, ExceptionGuard) else block


def bare(controller: Block) -> Block:
    """The law itself, without a guard or a trim around it: it says where it wants e measured, and how far it looks."""
    return bare(controller.block) if isinstance(controller, Wrapper | Adaptive) else controller


def with_controller(loop: Loop, controller: Block) -> Loop:
    """A steering loop with another controller of the same ports, guarded if that was, to exchange a policy underway."""
    guarded = isinstance(loop.blocks["controller"], ExceptionGuard)
    return loop.with_block("controller", _guarded(controller) if guarded else controller)


def _guarded(controller: Block) -> ExceptionGuard:
    return controller if isinstance(controller, ExceptionGuard) else ExceptionGuard(block=controller)


def _corrected(doe: Block) -> Block:
    """A doe that goes on from the angle that the car reports."""
    if doe.inputs and all(port.direct for port in doe.inputs if port.name == "applied"):
        return doe
    if not isinstance(doe, OutputElement):
        what = "remembers the angle that it asked for, and this car reports another (its output 'applied')"
        cure = "make it a OutputElement, or its input 'applied' direct, as Corrected does"
        raise WiringError(f"{type(doe).__name__} {what}; {cure}")
    return Corrected(element=doe)


class _Bench:
    """Blocks and wires while they are being put together."""

    def __init__(self, path: Path):
        self.path = path
        self.blocks: dict[str, Block] = {}
        self.wires: list[Wire] = []

    def add(self, name: str, block: Part) -> Part:
        self.blocks[name] = block
        return block

    def wire(self, source: Block, out: str, sink: Block, into: str) -> None:
        self.wires.append((getattr(source, out), getattr(sink, into)))

    def join(self, sink: Block, source: Block) -> None:
        """Wires all inputs of `sink` that have the name of an output of `source`, or that name and `_in`."""
        for name in _names(sink.inputs):
            if name.removesuffix("_in") in _names(source.outputs):
                self.wire(source, name.removesuffix("_in"), sink, name)

    def estimate(self, block: Block, seen: Block, steered: Block) -> None:
        """Wires what is measured to an estimator; truth, or sensors that do not say their age, has none."""
        self.add("estimator", block)
        self.join(block, seen)
        if "motion_age_in" in _names(block.inputs) and "motion_age" not in _names(seen.outputs):
            self.wire(seen, "age", block, "motion_age_in")
        self.measure(block, "delta_sw_meas", steered)

    def measure(self, block: Block, name: str, steered: Block) -> None:
        """Wires the measured angle of the steering wheel."""
        self.wire(steered, name if name in _names(steered.outputs) else "delta_sw", block, name)

    def control(
        self,
        block: Block,
        tracker: PathTracker,
        seen: Block,
        steered: Block,
        doe: Block | None,
        wired: Collection[str] = (),
    ) -> None:
        """Wires a controller's inputs by name, through a tracker at its own reference point if it asks for one.

        wired: those that have a source already.
        """
        asks: Any = bare(block)
        reference = getattr(asks, "reference", tracker.reference)
        points = getattr(asks, "preview_points", 0)
        if reference != tracker.reference or points:
            role = next(name for name, b in self.blocks.items() if b is block)
            preview = {"preview_points": points, "preview_dt": getattr(asks, "preview_dt", asks.dt)} if points else {}
            tracker = self.add(f"{role}_path", PathTracker(path=self.path, reference=reference, dt=block.dt, **preview))
            self.join(tracker, seen)
        for name in _names(block.inputs):
            if name in wired:
                continue
            if name == "delta_sw_meas":
                self.measure(block, name, steered)
            elif name == "doe":
                if doe is None:
                    raise WiringError(f"{type(block).__name__}.doe: there is no doe in this loop")
                self.wire(doe, "state", block, name)
            elif name in _names(tracker.outputs):
                self.wire(tracker, name, block, name)
            elif name in _names(seen.outputs):
                self.wire(seen, name, block, name)
            else:
                known = ", ".join([*_names(tracker.outputs), *_names(seen.outputs), "delta_sw_meas", "doe"])
                what = f"no signal of that name; known: {known}; wire the loop by hand for others"
                raise WiringError(f"{type(block).__name__}.{name}: {what}")


def _names(ports: Iterable[In | Out]) -> list[str]:
    return [port.name for port in ports]
