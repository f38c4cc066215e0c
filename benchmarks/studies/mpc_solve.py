"""The time that predictive steering takes for a command, next to that of its solver alone.

500 samples are recorded: the nonlinear car behind a motor with 0.2 s delay and 0.1 s lag drives the 795 m course
under the linear MPC, with noisy sensors, and is moved sideways by 0.8 m every 50 samples. Then every contestant is
asked for the command of each sample: CPU time from the inputs (numbers) to the checked command, data building
included, in turns of 50 samples, so that a busy machine hurts all alike; each turn is driven five times, and the
least time of a sample counts, since other processes on the same core only ever add to it.

    python -m benchmarks study mpc_solve [--quick] [--json]

`..._raw_qp_ms` is the time of the solver alone: HPIPM by CasADi's interface, called without a check on the numbers that
the block has just filled in, in place; `..._x_raw_qp` the median of the block's time over that, sample by sample: what
a sample takes beyond it are prediction over the delay, path ahead, linearisation, check, and Python.
"""

import argparse
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import casadi
import numpy as np

from benchmarks.tables import show_figures
from steerkit.controllers.mpc.block import MPC, NonlinearMPC, PredictiveSteering
from steerkit.controllers.mpc.programme import DATA, in_place
from steerkit.paths.courses import course
from steerkit.plants.sensors import Sensors
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import CurveSpeedDriver, SpeedDriver
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.vehicles import vehicle

PASSES = 5
SAMPLES, TURN, KICK, KICK_EVERY = 500, 50, 0.8, 50
CAR = NonlinearSingleTrack(vehicle=vehicle("vw-passat"), v0=5.0)
MOTOR = SteeringActuator(delay=0.2, lag=0.1)
STEERING = {"delay": MOTOR.delay + 0.5 * MOTOR.dt, "lag": MOTOR.lag}

Case = tuple[tuple[float, ...], Any]
"""A block state and its inputs."""


def recorded(samples: int) -> list[list[float]]:
    """Inputs of the longest horizon's controller in each sample of a drive: e, psi_e, v, beta, r, wheel, preview."""
    path = course("paper")
    mpc = MPC.of(CAR, **STEERING, horizon=40)
    loop = steering_loop(
        car=placed(CAR, path, s=1.0),
        path=path,
        driver=CurveSpeedDriver(path=path, driver=SpeedDriver(seed=1)),
        controller=mpc,
        actuator=MOTOR,
        sensors=Sensors(seed=1),
    )
    sources = {port.spec.name: loop.port_name(out) for out, port in loop.wires if port.block is mpc}
    state, rows = loop.init(), []
    for k in range(samples * 5):
        if k % (5 * KICK_EVERY) == 250 % (5 * KICK_EVERY) and k:
            side = KICK if (k // (5 * KICK_EVERY)) % 2 else -KICK
            x = state.x[loop.names.index("car")]
            x = x._replace(x=x.x - side * np.sin(x.psi), y=x.y + side * np.cos(x.psi))  # type: ignore[attr-defined]
            state = loop.with_block_state(state, "car", x._replace(x=float(x.x), y=float(x.y)))
        state, sample = loop.step(state)
        if k % 5 == 0:
            rows.append([sample[sources[name]] for name in mpc.D._fields])
    return rows


def cases(block: PredictiveSteering, rows: list[list[float]]) -> list[Case]:
    """The block's own states along the record, and its inputs."""
    x, points = None, []
    for *scalars, preview in rows:
        u = block.D(*scalars, tuple(preview[: block.preview_points]))  # type: ignore[index]
        x = block.settle(0.0, block.init(), u) if x is None else x
        points.append((x, u))
        x = block.update(0.0, x, u, block.output(0.0, x, u))
    return points


def timed(run: Callable[..., Any], *arguments: Any) -> tuple[float, Any]:
    """CPU time of a call [ms], and what it returned; of this thread, since idle threads of BLAS take some, too."""
    start = time.thread_time_ns()
    answer = run(*arguments)
    return (time.thread_time_ns() - start) * 1e-6, answer


def raw_qp(block: PredictiveSteering) -> Callable[[], None]:
    """The bare solver on the numbers in the block's programme: no check, and its answer goes elsewhere."""
    qp = replace(block.qp)  # with a solver of its own, since one keeps its place in memory for each function around it
    symbols = {name: casadi.MX.sym(name, qp.statement.data.sparsity_out(name)) for name in DATA}
    answer = qp.solver(**symbols)
    parts = [answer[name] for name in ("x", "lam_x", "lam_a")]  # CasADi's interface needs all three to be asked for
    function = casadi.Function("raw", list(symbols.values()), [casadi.vertcat(*parts)], list(symbols), ["raw"])
    return in_place(function, block.programme.found | {"raw": np.zeros(function.nnz_out(0))})


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure and print every figure."""
    samples = TURN if options.quick else SAMPLES
    rows = recorded(samples)
    blocks: dict[str, PredictiveSteering] = {
        f"{name}{n}": kind.of(CAR, **STEERING, horizon=n)
        for name, kind in (("ltv", MPC), ("nmpc", NonlinearMPC))
        for n in (20, 40)
    }
    runs = {name: cases(block, rows) for name, block in blocks.items()}
    times: dict[str, list[float]] = {name: [] for name in blocks}
    raw = {name: raw_qp(blocks[name]) for name in ("ltv20", "nmpc20")}
    raw_times: dict[str, list[float]] = {name: [] for name in raw}
    unsolved = dict.fromkeys(blocks, 0)
    for first in range(0, samples, TURN):
        for name, block in blocks.items():
            turn = runs[name][first : first + TURN]
            passes = [[timed(block.output, 0.0, x, u) for x, u in turn] for _ in range(PASSES)]
            times[name] += [min(ms for ms, _ in sample) for sample in zip(*passes)]
            unsolved[name] += sum(y.status != 0.0 for _, y in passes[0])
            for x, u in turn if name in raw else ():
                block.output(0.0, x, u)
                raw_times[name].append(min(timed(raw[name])[0] for _ in range(PASSES)))
    figures: dict[str, Any] = {}
    for name in blocks:
        figures[f"{name}_ms"] = statistics.median(times[name])
        figures[f"{name}_p99_ms"] = float(np.percentile(times[name], 99))
        figures[f"{name}_unsolved"] = unsolved[name]
    for name, values in raw_times.items():
        figures[f"{name}_raw_qp_ms"] = statistics.median(values)
        figures[f"{name}_x_raw_qp"] = statistics.median([ours / theirs for ours, theirs in zip(times[name], values)])
    show_figures(figures)
    return figures
