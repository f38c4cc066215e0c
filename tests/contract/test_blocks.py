"""What every shipped block must keep: one table of examples, one set of rules; a new block has to join the table."""

import ast
import dataclasses
import functools
import importlib
import inspect
import json
import math
import pkgutil
import re
import sys
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import control
import numpy as np
import pytest

import steerkit
from steerkit.analysis import FromControl
from steerkit.car.loop import ExcursionPredictor
from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.delay import DelayPredictor, delayed_stanley
from steerkit.controllers.delay_compensator import PREVIEW, DelayCompensator
from steerkit.controllers.fail_safe import FailSafe
from steerkit.controllers.lateral import LateralMpc
from steerkit.controllers.lqr import Lqr
from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.offset_free import CommandCompensation, OffsetFree
from steerkit.controllers.open_loop import OpenLoop, WithExcitation
from steerkit.controllers.pure_pursuit import PurePursuit
from steerkit.controllers.safety_filter import SafetyFilter
from steerkit.controllers.stanley import Stanley
from steerkit.controllers.supervisor import ExceptionGuard, Supervisor, SupervisorState
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, Wrapper
from steerkit.doe import Corrected, Integrator, LowPass, PlainAngle, WithElement
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import WheelDelay, YawDelay
from steerkit.estimators.steering_hysteresis import SteeringFriction
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.gym.task import Agent
from steerkit.paths.path import Path
from steerkit.paths.tracker import PathTracker
from steerkit.plants.disturbed_plant import DisturbedPlant
from steerkit.plants.sensors import Sensors
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed, CurveSpeedDriver, Playback, SpeedDriver, SpeedProfile
from steerkit.plants.steering_actuator import SteeringActuator, SteeringColumn, SteeringLink, TorqueSteering
from steerkit.scenario.lateral import LateralTarget
from steerkit.vehicles import VW_PASSAT as PASSAT
from steerkit.vehicles.rollout import GateLimits, GateModel
from tests.support.places import ROOT
from tests.support.road import heard
from tests.support.stepped import from_there

_round = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
OVAL = Path.from_waypoints(np.column_stack((25 * np.cos(_round), 15 * np.sin(_round))), closed=True, spacing=3.0)
_rng = np.random.default_rng(0)
AT_ONCE = dict(now=0.004, before=0.005, earlier=0.003)
TORQUE = dict(lead=0.6, fade=0.1, most=5.0, slew=8.0)
LATE = DelayCompensator(samples=3, back=0.2, slip=4e-4, yaw=0.38, straight=0.05, loss=1e-3, **AT_ONCE, **TORQUE)
FAST = dataclasses.replace(LATE, fast=1.0, tail=1e-3, trust=0.5, trust_course=0.3)
NETS = tuple(tuple(_rng.normal(size=size) for size in ((5, 7), 5, (3, 5), 3, (1, 3), 1)) for _ in range(3))
LAYERS = ((_rng.normal(size=(5, 6)), _rng.normal(size=5)), (_rng.normal(size=(3, 5)), _rng.normal(size=3)))


@dataclass(frozen=True)
class Example:
    """One block to try.

    single(block, i): the block that car i of a batch is; state: where to start instead of init; blind: inputs that it
    rightly does not look at in this state.
    """

    block: Block
    single: Callable[[Any, int], Block] = lambda block, i: block
    state: tuple[float, ...] | None = None
    blind: tuple[str, ...] = ()

    def __str__(self) -> str:
        inner = vars(self.block).get("block")  # to ask a block for what it has not takes as long as a test
        return type(self.block).__name__ + (f"-{type(inner).__name__}" if inner is not None else "")


def _seeded(block: Any, i: int) -> Block:
    return dataclasses.replace(block, seed=block.seed + i)


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Silent(Wrapper):
    """A filter that has no answer."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        y = self.inner_output(t, x, u)
        return y._replace(delta_sw=y.delta_sw * math.nan)


def _pendulum(t: float, x: Any, u: Any, params: Any) -> Any:
    return [x[1], u[0] - 2.0 * x[1] - 3.0 * x[0] - 0.3 * x[0] * x[0]]


def _careful(block: Any, i: int) -> Block:
    return dataclasses.replace(block, driver=_seeded(block.driver, i))


EXAMPLES = [
    *map(Example, (Integrator(), LowPass(), PlainAngle(), WheelDelay(prior_delay=0.05, longest=0.1, prior_lag=0.02))),
    *map(Example, (YawDelay(vehicle=PASSAT), SteeringFriction(longest=0.2))),
    Example(SingleTrackFilter(vehicle=PASSAT), blind=("psi",)),
    *map(Example, (Corrected(), Corrected(element=LowPass()), ExcursionPredictor(), Stanley.of(PASSAT))),
    *map(Example, (Stanley.textbook(PASSAT), delayed_stanley(PASSAT, delay=0.13, lag=0.1))),
    Example(DelayPredictor(block=Stanley.of(PASSAT))),
    Example(Lqr.of(PASSAT, LinearSingleTrack(vehicle=PASSAT).matrices, delay=0.13, preview_points=5, v_step=3.0)),
    *(Example(LateralMpc(response=LateralMpc.told(0.25, 0.1), gain=1.4, moves=moves)) for moves in (1, 3)),
    Example(dataclasses.replace(LateralTarget.of([0.3, -0.2, 0.5], [7.0, 8.0, 9.0], 0.1), preview_points=2)),
    Example(dataclasses.replace(Stanley.of(PASSAT), slew=5.0, a_y_limit=3.0)),
    Example(delayed_stanley(PASSAT, delay=0.13, lag=0.1, slew=20.0, a_y_limit=3.0)),
    Example(Lqr.of(PASSAT, LinearSingleTrack(vehicle=PASSAT).matrices, preview_points=5, v_step=3.0, slew=5.0)),
    Example(CommandCompensation(block=Stanley.of(PASSAT), offset=0.05, gain=1.1)),
    Example(OpenLoop(block=Stanley.of(PASSAT), wave=(0.0, 1.0, -0.5, 0.0), spacing=0.3, amplitude=0.4, wait=0.1)),
    Example(WithExcitation(block=Stanley.of(PASSAT), vehicle=PASSAT, amplitude=0.6, steepness=2.0)),
    Example(
        Adaptive(
            blocks=tuple(dataclasses.replace(Stanley.of(PASSAT), k=k) for k in (2.0, 3.0, 5.0)),
            delays=(0.02, 0.06, 0.1),
            prior_delay=0.05,
            delay=YawDelay(vehicle=PASSAT, prior_delay=0.05, longest=0.1),
            steering=SingleTrackFilter(vehicle=PASSAT, longest=0.2),
        )
    ),
    Example(
        Adaptive(
            blocks=(Stanley.of(PASSAT),) * 2,
            delays=(0.0, 0.1),
            delay=YawDelay(vehicle=PASSAT, prior_delay=0.05, longest=0.1),
            steering=SingleTrackFilter(vehicle=PASSAT, longest=0.2),
            takes_turns=True,
        ),
        blind=("doe",),
    ),
    *map(Example, (OffsetFree.around(Stanley.of(PASSAT), PASSAT), PurePursuit.of(PASSAT, OVAL))),
    Example(SafetyFilter.of(PASSAT, delay=0.05, horizon=0.35, hold=1, halvings=2)),
    Example(SafetyFilter.of(PASSAT, delay=0.07, horizon=0.5, hold=3, halvings=1, bound=3.0, yaw_doubt_least=0.002)),
    Example(SafetyFilter.of(PASSAT, horizon=0.4, hold=2, halvings=1, gate=GateModel(limits=GateLimits(jerk_max=30.0)))),
    Example(
        FailSafe(block=Silent(block=SafetyFilter.of(PASSAT, horizon=0.35, hold=1, halvings=1))), blind=("command",)
    ),
    Example(FromControl(system=control.ss([[0.5, 0.1], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.3]], 0.05))),
    Example(FromControl(system=control.nlsys(_pendulum, None, states=2, inputs=1, outputs=2), units={"u_0": "rad"})),
    Example(Supervisor(), blind=("e", "ready")),
    Example(Supervisor(), state=SupervisorState(1.0, 0.0, 0.0), blind=("recovery",)),
    *map(Example, (ExceptionGuard(block=Integrator()), ExceptionGuard(block=PathTracker(path=OVAL, preview_points=2)))),
    *map(Example, (NfqPolicy(nets=NETS), NfqPolicy(nets=NETS, ready_from=0.1))),
    Example(NfqPolicy(nets=NETS, preview_points=PREVIEW, forecast=LATE, continuous=True)),
    Example(NfqPolicy(nets=NETS, preview_points=PREVIEW, forecast=FAST), blind=("psi_e",)),
    Example(PolicyBlock(policy=Network(layers=LAYERS), actions=(-0.1, 0.0, 0.1))),
    Example(
        WithElement(block=PolicyBlock(policy=Network(layers=LAYERS), actions=(-0.1, 0.0, 0.1)), element=LowPass()),
        blind=("delta_sw_meas",),
    ),
    Example(PolicyBlock(policy=Network(layers=(LAYERS[0], (LAYERS[1][0][:1], LAYERS[1][1][:1])), head="tanh"))),
    *map(Example, (Agent(), PathTracker(path=OVAL), PathTracker(path=OVAL, reference=1.2, preview_points=3))),
    *map(Example, (LinearSingleTrack(vehicle=PASSAT, v0=5.0), NonlinearSingleTrack(vehicle=PASSAT, v0=5.0))),
    Example(
        DisturbedPlant(block=NonlinearSingleTrack(vehicle=PASSAT, v0=5.0), wind=0.3, gust=0.2, seed=3), single=_seeded
    ),
    Example(DisturbedPlant(block=LinearSingleTrack(vehicle=PASSAT, v0=5.0), bank=0.2), single=_seeded),
    *map(Example, (SteeringActuator(lag=0.1), SteeringActuator(lag=0.0, delay=0.03, gain=1.05, offset=0.02))),
    Example(TorqueSteering(delay=0.03)),
    *map(Example, (TorqueSteering.of(PASSAT, delay=0.02, lag=0.1, slew=50.0, gain=1.2, offset=0.02), SteeringColumn())),
    *map(Example, (SteeringColumn(friction=0.03, play=0.05), SteeringLink())),
    Example(SteeringLink(quantum=0.01, dead_band=0.02, jitter=0.03, seed=3), single=_seeded),
    Example(Sensors(), single=_seeded),
    Example(
        dataclasses.replace(Sensors.hard(seed=3), age_jitter=0.05, lost=0.3, jump=0.1, jump_time=0.1), single=_seeded
    ),
    Example(Sensors.real(PASSAT, seed=3), single=_seeded, blind=("beta_in",)),
    Example(VehicleState.of(NonlinearSingleTrack(vehicle=PASSAT))),
    Example(VehicleState.of(LinearSingleTrack(vehicle=PASSAT), horizon=0.0)),
    Example(
        VehicleState.of(
            NonlinearSingleTrack(vehicle=PASSAT), steering=SingleTrackFilter(vehicle=PASSAT, held=False, longest=0.2)
        )
    ),
    Example(Sensors.hard(seed=3), single=_seeded),
    Example(SpeedDriver(seed=3), single=_seeded),
    Example(ConstantSpeed()),
    Example(Playback(angles=(0.0, 0.5, 0.4, -0.2), speeds=(4.0, 5.0, 7.0, 6.0), delay=0.013)),
    Example(SpeedProfile(speeds=(4.0, 5.0, 7.0, 4.0), spacing=0.5, repeat=True)),
    Example(CurveSpeedDriver(path=OVAL, driver=SpeedDriver(seed=3)), single=_careful),
]


blocks = pytest.mark.parametrize("example", EXAMPLES, ids=str)
kinds = pytest.mark.parametrize("kind", sorted({type(e.block) for e in EXAMPLES}, key=lambda c: c.__name__))

SPAN = {
    "m": (-2.0, 2.0),
    "rad": (-0.6, 0.6),
    "m/s": (3.5, 9.0),
    "rad/s": (-0.4, 0.4),
    "1/m": (-0.04, 0.04),
    "1": (0.0, 1.0),
    "m/s^2": (-3.0, 3.0),
    "s": (0.0, 0.3),
}
CARS = 3
STEPS = 6


def concrete_blocks() -> set[type[Block]]:
    """All subclasses of Block in the package that have an `output`."""
    for module in pkgutil.walk_packages(steerkit.__path__, "steerkit."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)

    def below(cls: type[Block]) -> Iterator[type[Block]]:
        for sub in cls.__subclasses__():
            yield sub
            yield from below(sub)

    return {c for c in below(Block) if c.__module__.startswith("steerkit.") and c.output is not Block.output}


def inputs(block: Block, seed: int, shape: tuple[int, ...] = ()) -> dict[str, Any]:
    """Plausible values for all inputs, by name; floats, or arrays that nobody may write to."""
    rng = np.random.default_rng(seed)
    values: dict[str, Any] = {}
    for port in block.inputs:
        size = getattr(block, port.name).size
        arrays = [rng.uniform(*SPAN[port.unit], shape) for _ in range(1 if size is None else size)]
        for array in arrays:
            array.flags.writeable = False
        entries = tuple([array if shape else float(array) for array in arrays])
        values[port.name] = entries[0] if size is None else entries
    return values


def of_car(values: dict[str, Any], car: int) -> dict[str, Any]:
    """The inputs of one car of a batch, as floats."""
    return {
        name: tuple(float(v[car]) for v in value) if isinstance(value, tuple) else float(value[car])
        for name, value in values.items()
    }


def broken(u: dict[str, Any], name: str) -> dict[str, Any]:
    """The inputs with a NaN in one, in all of its entries."""
    return u | {name: (math.nan,) * len(u[name]) if isinstance(u[name], tuple) else math.nan}


def direct(block: Block, u: dict[str, Any]) -> Any:
    return block.D(**{name: u[name] for name in block.D._fields})


def start(example: Example, shape: tuple[int, ...] = (), u: dict[str, Any] | None = None) -> Any:
    block = example.block
    state = block.init(shape)
    if example.state is not None:
        state = type(example.state)(*[m.filled(v, shape) for v in example.state])  # type: ignore[call-arg]
    return block.settle(0.0, state, direct(block, u or inputs(block, 0, shape)))


def regimes(block: Block) -> Iterator[tuple[int, Callable[[int], dict[str, Any]]]]:
    """How many samples, and their inputs: large; small, so that no limit cuts; from backwards to 40 m/s; all constant;
    with a NaN in one input after the other."""

    def sized(u: dict[str, Any], size: float, pace: float) -> dict[str, Any]:
        by = {port.name: {"s": 1.0, "1": 1.0, "m/s": pace}.get(port.unit, size) for port in block.inputs}
        return {name: tuple(by[name] * w for w in v) if isinstance(v, tuple) else by[name] * v for name, v in u.items()}

    ports = [port.name for port in block.inputs]
    gaps = [None, *ports, *[None] * 20]
    yield STEPS, lambda k: inputs(block, k)
    yield STEPS, lambda k: sized(inputs(block, k), 0.02, 1.0)
    yield 14, lambda k: sized(inputs(block, k), 0.1, 0.4 * (k - 2))
    yield 40, lambda k: sized(inputs(block, 1), 0.1, 1.0)
    yield len(gaps), lambda k: broken(sized(inputs(block, k), 0.3, 1.0), gaps[k]) if gaps[k] else inputs(block, k)


@functools.cache
def run(
    example: Example,
    shape: tuple[int, ...] = (),
    feed: Callable[[int], dict[str, Any]] | None = None,
    steps: int = STEPS,
) -> Any:
    """(state, inputs, outputs, next state) of a few samples."""
    block = example.block
    feed = feed or (lambda k: inputs(block, k, shape))
    x, found = start(example, shape, feed(0)), []
    for k in range(steps):
        u, t = feed(k), k * block.dt
        y = block.output(t, x, direct(block, u))
        after = block.update(t, x, block.U(**u), y)
        found.append((x, u, y, after))
        x = after
    return found


def flat(values: Any) -> list[Any]:
    """The scalars in a tuple of scalars and of vector ports' entries."""
    return [scalar for value in values for scalar in (value if isinstance(value, (tuple, list)) else [value])]


def numbers(values: Any) -> np.ndarray:
    return np.array(np.broadcast_arrays(*flat(values)), dtype=float) if flat(values) else np.zeros(0)


def documents(kind: type[Block]) -> str:
    """The docstrings of a class and of its bases below Block."""
    return "\n".join(c.__doc__ or "" for c in kind.__mro__ if issubclass(c, Block) and c is not Block)


ELSEWHERE = {"PredictiveSteering", "MPC", "NonlinearMPC", "RealCar", "FmuPlant", "ChallengeController"}
"""Blocks with a suite of their own: a solver's milliseconds differ, a bus is not pure, an FMU is somebody's file, as is
a controller of the challenge, an open policy is run on symbols only."""
STARTS = {"VehicleState", "WithElement-PolicyBlock"}
"""Blocks with direct inputs that only say where to start from: no output sees them."""


def test_every_block_of_the_package_is_in_the_table() -> None:
    missing = concrete_blocks() - {type(example.block) for example in EXAMPLES}
    written = {block for block in missing if hasattr(sys.modules[block.__module__], block.__name__)}  # not made by code
    missing = {block for block in written if block.__name__ not in ELSEWHERE}
    assert not missing, f"add an Example for {', '.join(sorted(c.__qualname__ for c in missing))}"


@kinds
def test_it_is_a_frozen_keyword_only_dataclass_compared_by_identity_and_abstract_or_final(kind: type[Block]) -> None:
    parameters = kind.__dataclass_params__  # type: ignore[attr-defined]
    assert "__dataclass_fields__" in vars(kind), "the dataclass decorator is missing"
    assert parameters.frozen
    assert not parameters.eq
    assert all(field.kw_only for field in dataclasses.fields(kind) if field.init)
    assert all(base.output is Block.output for base in kind.__mro__[1:] if issubclass(base, Block))


@kinds
def test_every_field_is_documented(kind: type[Block]) -> None:
    said = set(re.findall(r"\w+", documents(kind)))
    for cls in kind.__mro__:
        if cls is not Block and issubclass(cls, Block):
            body = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0].body  # type: ignore[attr-defined]
            for line, after in pairwise(body):
                if isinstance(line, ast.AnnAssign) and isinstance(after, ast.Expr):
                    said.add(line.target.id)  # type: ignore[union-attr]
    silent = [f.name for f in dataclasses.fields(kind) if f.init and f.name != "dt" and f.name not in said]
    assert not silent, f"{kind.__name__}: no word about {', '.join(silent)}"


@kinds
def test_the_docstring_names_every_port_and_unit(kind: type[Block]) -> None:
    text = documents(kind)
    assert kind.__doc__
    assert kind.__doc__.split("\n")[0].strip().endswith((".", ":"))
    for port in (*kind.inputs, *kind.outputs):
        assert re.search(rf"\b{port.name}\b", text), f"{kind.__name__}: no word about port {port.name}"
        assert f"[{port.unit}]" in text or f"[{port.unit}, " in text, f"{kind.__name__}: unit of {port.name}"


@blocks
def test_states_are_flat_tuples_outputs_those_of_the_ports_and_one_car_is_python_floats(example: Example) -> None:
    block = example.block
    for shape in ((), (CARS,)):
        for state in (block.init(shape), start(example, shape), run(example, shape)[-1][3]):
            assert isinstance(state, tuple)
            assert all(np.shape(scalar) == shape for scalar in state)
            assert len(state) == len(block.init())
    for x, _, y, after in run(example):
        assert {type(scalar) for scalar in (*x, *flat(y), *after)} <= {float}
    y = run(example)[0][2]
    assert len(y) == len(block.outputs)
    for out, value in zip(block.outputs, y):
        size = getattr(block, out.name).size
        assert (np.ndim(value) == 0) if size is None else len(value) == size


@blocks
def test_it_gives_the_numbers_written_down(example: Example) -> None:
    """The mean of each output, and a sum over the state, in each regime (NaN counts 0), and a sum over `init`; then the
    means over each sixth of a drive, for estimators one with gaps and nonsense.

    They are of the day on which they were written down: whoever changes an equation or a default on purpose replaces
    the line in tests/golden/blocks.json by the one that the failure shows.
    """
    states, found = [numbers(example.block.init())], list[float]()
    for steps, feed in regimes(example.block):
        samples = run(example, feed=feed, steps=steps)
        states.append(numbers(samples[-1][3]))
        found += np.mean([np.nan_to_num(numbers(y)) for _, _, y, _ in samples], axis=0).tolist()
    found += [float(np.nan_to_num(state) @ np.sqrt(1.0 + np.arange(len(state)))) for state in states]
    estimates = "missing" in example.block.Y._fields
    drive = heard(example.block, broken=estimates)
    if estimates:
        ys, _ = from_there(example.block, start(example, (), drive[0]), [list(u.values()) for u in drive])
    else:
        ys = np.array([numbers(y) for _, _, y, _ in run(example, feed=drive[::4].__getitem__, steps=len(drive) // 4)])
    found += np.concatenate([np.nan_to_num(part).mean(axis=0) for part in np.array_split(ys, 6)]).tolist()
    found = [float(f"{value:.9g}") for value in found]
    before = [str(other) for other in EXAMPLES[: EXAMPLES.index(example)]]
    key = f"{example} {before.count(str(example)) + 1}"
    expected = json.loads((ROOT / "tests/golden/blocks.json").read_text(encoding="utf-8")).get(key, [])
    assert found == pytest.approx(expected, rel=1e-6, abs=1e-9), f'"{key}": {json.dumps(found)}'


def interface() -> dict[str, dict[str, str]]:
    """The defaults of all public classes, functions and methods, and the range of each field that is a `number`."""
    concrete_blocks()  # imports all modules
    found: dict[str, dict[str, str]] = {}
    for module in [module for name, module in sorted(sys.modules.items()) if name.startswith("steerkit.")]:
        own = [thing for thing in vars(module).values() if getattr(thing, "__module__", "") == module.__name__]
        for place in (module, *filter(inspect.isclass, own)):
            fields = {f.name: f.metadata for f in dataclasses.fields(place)} if dataclasses.is_dataclass(place) else {}
            functions = [getattr(thing, "__func__", thing) for thing in vars(place).values()]
            for f in filter(inspect.isfunction, functions):
                name = re.sub(r"\.__(init|new)__$", "", f.__qualname__)
                constructed = name != f.__qualname__
                if f.__module__ in (module.__name__, "builtins") and not re.search(r"(^|\.)_|<", name):
                    values = _defaults(f, fields if constructed else {})
                    found |= {f"{module.__name__.removeprefix('steerkit.')}.{name}": values} if values else {}
    return found


def _defaults(function: Callable[..., Any], fields: dict[str, Any]) -> dict[str, str]:
    shown: dict[str, str] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        default = parameter.default
        if isinstance(default, (int, float, str, tuple)):
            shown[name] = f"{default:.9g}" if isinstance(default, float) else str(default)
        if "number" in fields.get(name, {}):
            unit, low, high, above = fields[name]["number"]
            shown[name] = f"{shown.get(name, '')} {'(' if above else '['}{low:.9g}, {high:.9g}] {unit}".lstrip()
    return shown


def test_defaults_and_ranges_are_those_written_down() -> None:
    """Whoever changes one on purpose changes its line in tests/golden/interface.json."""
    expected = json.loads((ROOT / "tests/golden/interface.json").read_text(encoding="utf-8"))
    found = interface()
    changed = sorted(key for key in found.keys() | expected.keys() if found.get(key) != expected.get(key))
    assert not changed, "\n".join(f'"{key}": {json.dumps(found.get(key))},' for key in changed)


ELSEWHERE_RANGED = {"Corrected", "GateLimits"}
"""Classes whose ranges are those of others: two take their dt from what they belong to; a car's file has the gate's
(tests/unit/car/test_config.py)."""


def declaring_ranges() -> list[Any]:
    """The example of each block, and a default object of each other class, that has a field made by `number`."""
    concrete_blocks()  # imports all modules
    made = {type(example.block): example.block for example in EXAMPLES}
    own = (vars(module).values() for name, module in sorted(sys.modules.items()) if name.startswith("steerkit."))
    for kind in {kind: None for things in own for kind in things if inspect.isclass(kind)}:
        fields = [f for f in dataclasses.fields(kind) if f.init] if dataclasses.is_dataclass(kind) else []
        needed = [f for f in fields if f.default is f.default_factory is dataclasses.MISSING]
        if not needed and not issubclass(kind, Block) and any("number" in f.metadata for f in fields):
            made[kind] = kind()
    return [one for kind, one in made.items() if kind.__name__ not in ELSEWHERE_RANGED]


@pytest.mark.parametrize("made", declaring_ranges(), ids=lambda made: type(made).__name__)
def test_a_number_beyond_its_range_is_refused(made: Any) -> None:
    """Below, above, NaN, and between two whole numbers; what the range is stands in tests/golden/interface.json."""
    where = f"{type(made).__name__}: " if isinstance(made, Block) else ""
    for f in (f for f in dataclasses.fields(made) if "number" in f.metadata):
        unit, low, high, above = f.metadata["number"]
        whole = f.type is int
        beyond = [math.nan, *([low + 0.5] if whole else [low if above else low - 1e-6] * math.isfinite(low))]
        beyond += [high + (1 if whole else 1e-6)] * math.isfinite(high) + [low - 1] * whole
        for value in beyond:
            what = (
                "expected a whole number" if isinstance(value, float) and whole else rf"\[{re.escape(unit)}\], expected"
            )
            with pytest.raises(ValueError, match=rf"^{where}.*{f.name} = {re.escape(str(value))},? {what}"):
                dataclasses.replace(made, **{f.name: value})


@blocks
def test_equal_arguments_give_equal_results_and_stay_as_they_are(example: Example) -> None:
    block = example.block
    for shape in ((), (CARS,)):
        for k, (x, u, y, after) in enumerate(run(example, shape)):
            kept = numbers(x)
            for scalar in x:
                if isinstance(scalar, np.ndarray):
                    scalar.flags.writeable = False
            again = block.output(k * block.dt, x, direct(block, u))
            np.testing.assert_array_equal(numbers(again), numbers(y))
            np.testing.assert_array_equal(numbers(block.update(k * block.dt, x, block.U(**u), again)), numbers(after))
            np.testing.assert_array_equal(numbers(x), kept)


def require_same(example: Example, car: int, together: Any) -> None:
    """The samples of the example alone are those of that car of a batch."""
    for (x, _, y, after), (xs, _, ys, afters) in zip(
        run(example, (), lambda k: of_car(inputs(example.block, k, (CARS,)), car)), together
    ):
        for single, batch in ((x, xs), (y, ys), (after, afters)):
            batch = [np.broadcast_to(value, (CARS,))[car] for value in flat(batch)]
            np.testing.assert_allclose(flat(single), batch, rtol=1e-11, atol=1e-12)


@blocks
def test_a_batch_is_its_cars_one_by_one(example: Example) -> None:
    for car in range(CARS):
        one = dataclasses.replace(example, block=example.single(example.block, car))
        require_same(one, car, run(example, (CARS,)))


@pytest.mark.parametrize(
    ("block", "field", "values"),
    [
        (Integrator(), "limit", (0.3, 1.0, 9.0)),
        (LowPass(), "tau", (0.05, 0.3, 2.0)),
        (Stanley.of(PASSAT), "k", (0.5, 2.5, 4.0)),
        (Stanley.of(PASSAT), "approach_limit", (0.1, 0.2, 1.0)),
        (Supervisor(), "trip", (0.2, 0.5, 1.0)),
        (PathTracker(path=OVAL), "reference", (0.0, 1.2, 2.0)),
        (SteeringActuator(), "lag", (0.0, 0.1, 0.3)),
        (SteeringColumn(friction=0.1), "play", (0.0, 0.1, 0.3)),
        (SteeringLink(dead_band=0.1), "quantum", (0.0, 0.1, 0.3)),
        (Sensors(), "rear", (1.0, 1.1, 1.3)),
        (NonlinearSingleTrack(vehicle=PASSAT), "v0", (4.0, 5.0, 9.0)),
        (LinearSingleTrack(vehicle=PASSAT), "psi0", (-1.0, 0.0, 2.0)),
        (ConstantSpeed(), "speed", (4.0, 5.0, 6.0)),
        (Sensors(), "psi_bias", (-0.1, 0.0, 0.1)),
    ],
)
def test_a_parameter_may_differ_from_car_to_car(block: Block, field: str, values: tuple[float, ...]) -> None:
    together = run(Example(dataclasses.replace(block, **{field: np.array(values)})), (CARS,))
    for car, value in enumerate(values):
        one: Any = dataclasses.replace(block, **{field: value})
        require_same(Example(_seeded(one, car) if hasattr(one, "seed") else one), car, together)


def depends(block: Block, out: Out) -> set[str]:
    """The inputs that an output is declared to see in the same sample."""
    ports: tuple[In, ...] = block.inputs if out.direct is None else out.direct
    return {port.name for port in ports if port.direct}


@blocks
def test_declared_feedthrough_is_true(example: Example) -> None:
    block = example.block
    for k, (x, u, y, _) in enumerate(run(example)):
        for poison in block.D._fields:
            poisoned = block.output(k * block.dt, x, direct(block, broken(u, poison)))
            for out, clean, value in zip(block.outputs, y, poisoned):
                if poison not in depends(block, out):
                    assert value == clean, f"{out.name} is declared independent of {poison}, but sees it"


@pytest.mark.parametrize("name", sorted({str(example) for example in EXAMPLES}))
def test_declared_feedthrough_is_needed(name: str) -> None:
    """An input declared direct changes some output within its sample, or where the block starts; or should not be."""
    seen, direct_inputs = set(), set()
    for example in (e for e in EXAMPLES if str(e) == name):
        block = example.block
        direct_inputs |= set(block.D._fields)
        if name in STARTS:
            first = inputs(block, 0)
            begun = numbers(start(example, (), first))
            for poison in block.D._fields:
                if not np.array_equal(numbers(start(example, (), broken(first, poison))), begun, equal_nan=True):
                    seen.add(poison)
        for k, (x, u, y, _) in enumerate(run(example)):
            for poison in block.D._fields:
                other = block.output(k * block.dt, x, direct(block, broken(u, poison)))
                if not np.array_equal(numbers(other), numbers(y)):
                    seen.add(poison)
    assert seen == direct_inputs


@blocks
def test_a_nan_shows(example: Example) -> None:
    """In some output, within ten samples: as a NaN, as a fault, as missing, or in that the learner loses the wheel."""
    block = example.block
    for port in (p for p in block.inputs if p.name not in example.blind):
        clean = inputs(block, 1)
        if isinstance(block, Supervisor):
            clean |= {"e": 0.3, "ready": 1.0}
        x, shown = start(example, (), clean), False
        for k in range(10):
            u, t = broken(clean, port.name), k * block.dt
            y = block.output(t, x, direct(block, u))
            shown |= bool(np.isnan(numbers(y)).any())
            if isinstance(block, Supervisor):
                shown |= y.fault == 1.0 or y.learning < x.learning
            if "missing" in y._fields:  # an estimator goes on without the sample, and says so
                shown |= k > 0 and y.missing == 1.0
            x = block.update(t, x, block.U(**u), y)
        assert shown, f"{port.name} = NaN is hidden"


@blocks
def test_the_same_equations_trace_to_symbols(example: Example) -> None:
    import casadi

    block = example.block
    t, state = casadi.MX.sym("t"), [casadi.MX.sym(f"x{i}") for i in range(len(block.init()))]
    u = {
        name: tuple(casadi.MX.sym(name) for _ in value) if isinstance(value, tuple) else casadi.MX.sym(name)
        for name, value in inputs(block, 0).items()
    }
    x = type(block.init())(*state) if hasattr(block.init(), "_fields") else tuple(state)
    y = block.output(t, x, direct(block, u))
    after = block.update(t, x, block.U(**u), y)
    function = casadi.Function(
        "block",
        [t, casadi.vertcat(*state), casadi.vertcat(*flat(u.values()))],
        [casadi.vertcat(*flat(y)), casadi.vertcat(*after)],
    )
    for k, (x, values, y, after) in enumerate(run(example)):
        outputs, states = function(k * block.dt, list(x), flat(values.values()))
        np.testing.assert_allclose(np.array(outputs).ravel(), numbers(y).ravel(), rtol=1e-11, atol=1e-12)
        np.testing.assert_allclose(np.array(states).ravel(), numbers(after).ravel(), rtol=1e-11, atol=1e-12)
