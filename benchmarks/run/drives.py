"""One test drive of one controller through one scenario, compiled where its blocks allow, and what it came to."""

import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from benchmarks.entries import controller
from benchmarks.peers.agents import SETTINGS
from benchmarks.run.policy_drives import PolicyDrives, policy_drives
from benchmarks.run.results import TRAJECTORY
from benchmarks.scenarios import open_parameters, shape, suite_loop
from steerkit.compiled import Compiled, TraceError, compile
from steerkit.compiled.trace import parameter
from steerkit.controllers.network_policy import PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop, Sample
from steerkit.diagram.simulation import Log, simulate
from steerkit.learning.settings import setting
from steerkit.metrics import measures
from steerkit.paths.path import Path
from steerkit.paths.tracker import PathTracker
from steerkit.scenario import Scenario
from steerkit.scenario.catalogue import make_element
from steerkit.task import DT, TRIP
from steerkit.vehicles import Vehicle

OFF_COURSE = 3.0
"""|e| at which a drive is over [m]."""
SIGNALS = {
    "s": "path.s",
    "x": "car.x",
    "y": "car.y",
    "psi": "car.psi",
    "e": "path.e",
    "psi_e": "path.psi_e",
    "v": "car.v",
    "delta_sw": "car.delta_sw",
    "a_y": "car.a_y",
    "learning": "supervisor.learning",
}
_LEAST = 40  # samples: 2 s; less is no drive to measure
_KEPT = 1500  # samples of a trajectory, about


@dataclass(frozen=True)
class Policy:
    """A learned controller: its net and the setting whose dynamic output element it drives."""

    block: NfqPolicy | PolicyBlock
    setting: str

    def element(self, vehicle: Vehicle) -> Block:
        """The dynamic output element, within that car's stops; that of the environments for an agent."""
        agent = isinstance(self.block, PolicyBlock)
        return make_element("integrator", vehicle) if agent else setting(self.setting).element(vehicle)

    @classmethod
    def load(cls, file: FilePath, setting: str) -> "Policy":
        """What a training has left in `file`."""
        kind: Any = PolicyBlock if setting in SETTINGS else NfqPolicy
        return cls(kind.load(file), setting)


@dataclass(frozen=True)
class Driven:
    """What a drive came to."""

    metrics: dict[str, float]
    trajectory: dict[str, np.ndarray]


def drive(
    scenario: Scenario, name: str, *, seed: int = 0, policy: Policy | None = None, timed_steps: int = 0
) -> Driven:
    """Let the controller called `name` (or the learned `policy`) drive the scenario once.

    timed_steps: over how many of its samples the controller's computing time is measured; 0: not.
    """
    form = shape(controller(name).as_believed(scenario) if policy is None else scenario)
    path = scenario.path()
    if policy is None:
        steers, doe = _steers(name, form), None
    else:
        steers, doe = policy.block, policy.element(scenario.nominal)
    loop = suite_loop(scenario, steers, doe=doe, seed=seed)
    inputs = loop.inputs_of("controller") if timed_steps else {}
    log = _driven(scenario, form, loop, name, policy, tuple(inputs.values()))
    metrics, trajectory = judged(log, scenario, path, loop)
    if timed_steps:
        times = _timed(loop.blocks["controller"], log, inputs, timed_steps)
        metrics |= {f"step_p{part}_us": 1e6 * float(np.quantile(times, 0.01 * part)) for part in (50, 99)}
    return Driven(metrics, trajectory)


def judged(log: Log, scenario: Scenario, path: Path, loop: Loop) -> tuple[dict[str, float], dict[str, np.ndarray]]:
    """Metrics of the part that the controller itself drove of the distance asked for, and its trajectory.

    held [1]: |e| <= 0.5 m to the end, and for a learned one the wheel never handed over. rounds [1]: how much of the
    distance it drove: until a learned one was first caught, or |e| was beyond 3 m. rms_e_front, max_e_front [m]: e of
    the front axle, wherever the controller has its own measured.
    """
    end, held = own_part(log, scenario.length)
    driven = {ours: log[theirs][:end] for ours, theirs in SIGNALS.items() if theirs in log}
    t = log.t[:end]
    share = float(np.clip(log["path.progress"][end - 1] / scenario.length, 0.0, 1.0)) if end else 0.0
    metrics = {"held": float(held), "rounds": scenario.course.rounds * share, "duration": float(t[-1]) if end else 0.0}
    if end >= _LEAST:
        metrics |= measures(t=t, **{k: driven[k] for k in ("e", "psi_e", "delta_sw", "a_y")})
        front = _front_error(loop, log, path, end, float(scenario.nominal.l_f))
        metrics |= {"rms_e_front": float(np.sqrt(np.mean(front**2))), "max_e_front": float(np.abs(front).max())}
    step = max(1, -(-end // _KEPT))
    kept: dict[str, np.ndarray] = {"t": t, **driven}
    return metrics, {name: kept[name][::step].astype(np.float64) for name in TRAJECTORY}


def own_part(log: Log, length: float) -> tuple[int, bool]:
    """How many samples the controller itself drove, and did it hold all of `length` [m], with |e| <= 0.5 m?"""
    off, over = _ends(log, length)
    end = min(_first(off), _first(over) + 1)
    came = bool(over.any()) and _first(over) < _first(off)
    return end, came and bool((np.abs(log["path.e"][:end]) <= TRIP).all())


def _ends(now: Sample | Log, length: float) -> tuple[Any, Any]:
    """Where a controller has left the course, or a learned one has lost the car, and where it is at its end."""
    off = ~(np.abs(now["path.e"]) <= OFF_COURSE)
    if "supervisor.learning" in now:
        off = off | (np.asarray(now["supervisor.learning"]) < 0.5) | ~(np.abs(now["path.e"]) <= TRIP)
    return off, np.asarray(now["path.progress"]) >= length


def until_end(
    loop: Loop, seconds: float, length: float, record: tuple[str, ...], compiled: PolicyDrives | None = None
) -> Log:
    """A drive that ends where `own_part` does, or a little later; by `compiled` if there is one, else interpreted."""

    def over(now: Sample | Log) -> bool:
        return any(np.any(flags) for flags in _ends(now, length))

    if compiled is not None:
        return compiled.run(loop, seconds, over=over)
    return simulate(loop, seconds, record=record, every=_every(loop), until=over, allow_nonfinite=True)


def _driven(
    scenario: Scenario, form: Scenario, loop: Loop, name: str, policy: Policy | None, extra: tuple[str, ...]
) -> Log:
    record = tuple(dict.fromkeys([n for n in (*SIGNALS.values(), "path.progress") if n in loop.units] + [*extra]))
    program, drives = None, None
    if policy is None:
        program = _program(form, name, record)
    elif isinstance(policy.block, NfqPolicy):
        drives = _policy_drives(form, policy.setting, policy.block.preview_points, record)
    if program is None:
        return until_end(loop, scenario.seconds, scenario.length, record, drives)
    values = {key: parameter(loop, key) for key in program.parameters}
    return program.run(scenario.seconds, state=loop.init(), parameters=values, allow_nonfinite=True)


@lru_cache(maxsize=16)
def _policy_drives(form: Scenario, setting: str, points: int, record: tuple[str, ...]) -> PolicyDrives | None:
    """The compiled drives that all nets with such a preview share, whatever is left open of the scenario.

    None: interpreted.
    """
    policy = Policy(NfqPolicy(preview_points=points), setting)
    loop = suite_loop(form, policy.block, doe=policy.element(form.nominal))
    return policy_drives(loop, record, open_parameters(form))


@lru_cache(maxsize=16)
def _program(form: Scenario, name: str, record: tuple[str, ...]) -> Compiled | None:
    """The compiled drive; None where a block (a solver, another's model) can only be interpreted.

    Straight-line Python and not C: the same numbers on machines without a compiler, and a program is made in a tenth
    of a second, which for the some ten drives that share one is sooner done.
    """
    loop = suite_loop(form, _steers(name, form))
    try:
        return compile(loop, backend="python", record=record, every=_every(loop), parameters=open_parameters(form))
    except TraceError:
        return None


@lru_cache(maxsize=16)
def _steers(name: str, form: Scenario) -> Block:
    make = controller(name).make
    if make is None:
        raise ValueError(f"controller '{name}' is learned; give the policy of a training")
    return make(form)


def _every(loop: Loop) -> int:
    return round(loop.blocks["controller"].dt / loop.dt)


def _first(flags: Any) -> int:
    return int(flags.argmax()) if flags.any() else len(flags)


def _front_error(loop: Loop, log: Log, path: Path, end: int, l_f: float) -> Any:
    """e of the front axle [m], (end,)."""
    if abs(float(loop.blocks["path"].reference) - l_f) < 1e-9:  # type: ignore[attr-defined]
        return log["path.e"][:end]
    front = PathTracker(path=path, reference=l_f)
    nothing = np.zeros(end)
    pose = (log["car.x"][:end], log["car.y"][:end], log["car.psi"][:end], nothing, nothing, nothing)
    u = front.U(*pose)
    return front.output(0.0, front.settle(0.0, front.init((end,)), u), u).e


def _timed(block: Block, log: Log, inputs: dict[str, str], steps: int) -> list[float]:
    """Computing times [s] of the controller, interpreted, on inputs that it had in the drive."""
    count = min(steps, len(log.t))
    rows = [_plain(log[signal][:count]) for signal in inputs.values()]
    direct = [port.direct for port in block.inputs]
    x: Any = block.init()
    times = []
    for k, column in enumerate(zip(*rows, strict=True)):
        t, u = DT * k, block.U(*column)
        d = block.D(*[value for value, sees in zip(column, direct) if sees])
        if k == 0:
            x = block.settle(t, x, d)
        began = time.perf_counter()
        y = block.output(t, x, d)
        x = block.update(t, x, u, y)
        times.append(time.perf_counter() - began)
    return times


def _plain(values: Any) -> list[Any]:
    """Floats, or tuples of floats, as blocks hand them on."""
    return [tuple(row) if isinstance(row, list) else row for row in values.tolist()]
