"""The time that predictive steering takes for a command, next to do-mpc and ipopt on the same model.

500 samples are recorded: the nonlinear car behind a motor with 0.2 s delay and 0.1 s lag drives the 795 m course
under the linear MPC, with noisy sensors, and is moved sideways by 0.8 m every 50 samples. Then every contestant is
asked for the command of each sample: CPU time from the inputs (numbers) to the checked command, data building
included, in turns of 50 samples, so that a busy machine hurts all alike; each turn is driven five times, and the
least time of a sample counts, since other processes on the same core only ever add to it. (No solver keeps anything
from call to call but the plan, which is in the block's state; do-mpc, which does, is timed once, and so is its
counterpart.)

    python -m benchmarks study mpc_solve [--quick] [--json]

`..._raw_qp_ms` is the time of the solver alone: HPIPM by CasADi's interface, called without a check on the numbers that
the block has just filled in, in place; `..._x_raw_qp` the median of the block's time over that, sample by sample: what
a sample takes beyond it are prediction over the delay, path ahead, linearisation, check, and Python.

do-mpc (extra `peers`) gets the nonlinear stage map, cost, limits and horizon of `NonlinearMPC`, with a warm start;
`dompc_x` is its median over that of `NonlinearMPC` at the same samples. u0 is compared with ipopt's: of the linear
MPC on its quadratic programme, of the nonlinear one on its nonlinear programme, one real-time iteration a sample and
iterated till it stands.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import os
import statistics
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import casadi
import numpy as np
from rich.console import Console
from rich.progress import track

from steerkit.controllers.mpc.block import MPC, NonlinearMPC, PredictiveSteering
from steerkit.controllers.mpc.programme import in_place
from steerkit.controllers.mpc.qp import DATA
from steerkit.paths.courses import course
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.sensors import Sensors
from steerkit.plants.speed_driver import CurveSpeedDriver, SpeedDriver
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.vehicles import vehicle

PASSES = 5
SUBSTEPS = 2  # as many as the block's model takes at these speeds
SAMPLES, TURN, KICK, KICK_EVERY = 500, 50, 0.8, 50
CAR = NonlinearSingleTrack(vehicle=vehicle("vw-passat"), v0=5.0)
MOTOR = SteeringActuator(delay=0.2, lag=0.1)
NEEDED = {"ltv20_ms": 0.3, "ltv20_p99_ms": 1.0, "ltv40_ms": 0.6, "nmpc20_ms": 0.6, "nmpc40_ms": 1.0, "dompc_x": 15.0}

Case = tuple[tuple[float, ...], Any]
"""A block state and its inputs."""


def recorded(samples: int, *, horizon: int = 40) -> list[list[float]]:
    """Inputs of a controller with that horizon in each sample of a drive: e, psi_e, v, beta, r, wheel, preview."""
    path = course("paper")
    mpc = MPC.of(CAR, MOTOR, horizon=horizon)
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
            x = loop.block_state(state, "car")
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


# ---- ipopt ----------------------------------------------------------------------------------------------------------


def ipopt_qp(block: PredictiveSteering) -> float:
    """The rate that ipopt finds for the quadratic programme that was last filled in [rad/s]."""
    data, found = block.qp.statement.data, block.programme.found
    d = {name: casadi.DM(data.sparsity_out(name), found[name]) for name in DATA}
    z = casadi.MX.sym("z", d["g"].shape[0])
    cost = 0.5 * casadi.bilin(d["h"], z, z) + casadi.dot(d["g"], z)
    options: Any = {"ipopt": {"print_level": 0, "tol": 1e-10, "sb": "yes"}, "print_time": False}
    problem: Any = {"x": z, "f": cost, "g": d["a"] @ z}
    solver = casadi.nlpsol("nlp", "ipopt", problem, options)
    answer = solver(lbx=d["lbx"], ubx=d["ubx"], lbg=d["lba"], ubg=d["uba"], x0=found["z"])
    return float(answer["x"][0])


class Nonlinear:
    """The nonlinear programme of a `NonlinearMPC`, for ipopt and do-mpc; soft limits at every stage that it has."""

    def __init__(self, block: NonlinearMPC, substeps: int):
        self.block, self.n = block, block.horizon
        self.step = block.model.linearised_step(substeps)

    def values(self, x: tuple[float, ...], u: Any) -> dict[str, Any]:
        """What changes from sample to sample: start, speed, curvatures, goals, P, limits of a_y."""
        block, n = self.block, self.block.pieces
        v, start, then = block._ahead(block.X(x[:n], x[n:-1], x[-1]), u)
        goal, between = then[n : n + self.n + 1, :6], then[n + self.n + 1 :]
        path = v * goal[:, 3]
        return {
            "x0": start,
            "v": v,
            "kappa": between[:, 6],
            "goal": goal,
            "p": block.model.at(v)[3],
            "low": np.minimum(-block.a_y_limit, path - block.a_y_room),
            "high": np.maximum(block.a_y_limit, path + block.a_y_room),
        }

    def stage_cost(self, x: Any, goal: Any, rate: Any, slack: Any) -> Any:
        """Cost of a stage."""
        q, r = self.block.model.stage_cost
        slacks = casadi.diag([self.block.q_e_limit, self.block.q_a_y_limit])
        return 0.5 * (casadi.bilin(q, x - goal, x - goal) + r * rate**2 + casadi.bilin(slacks, slack, slack))

    def ipopt(self) -> Callable[[dict[str, Any], Any], float]:
        """u0 [rad/s] of `values`, from a guess of the rates."""
        block, n = self.block, self.n
        opti = casadi.Opti()
        x, rate, slack = opti.variable(6, n + 1), opti.variable(1, n), opti.variable(2, n)
        x0, v, kappa, goal = opti.parameter(6), opti.parameter(), opti.parameter(n), opti.parameter(6, n + 1)
        p, low, high = opti.parameter(6, 6), opti.parameter(n + 1), opti.parameter(n + 1)
        cost = 0.5 * casadi.bilin(p, x[:, n] - goal[:, n], x[:, n] - goal[:, n])
        opti.subject_to(x[:, 0] == x0)
        for k in range(n):
            after, _, _, a_y, _ = self.step(x[:, k], rate[k], v, kappa[k])
            opti.subject_to(x[:, k + 1] == after)
            opti.subject_to(opti.bounded(-block.limit, x[5, k + 1], block.limit))
            if k in block.qp.soft:
                opti.subject_to(opti.bounded(-block.e_limit, x[0, k] - slack[0, k], block.e_limit))
                opti.subject_to(opti.bounded(low[k], a_y - slack[1, k], high[k]))
            cost += self.stage_cost(x[:, k], goal[:, k], rate[k], slack[:, k])
        opti.subject_to(opti.bounded(-block.rate_limit, rate, block.rate_limit))
        opti.minimize(cost)
        quiet: Any = {"print_level": 0, "sb": "yes", "tol": 1e-9, "hessian_approximation": "exact"}
        opti.solver("ipopt", {"print_time": False, "ipopt": quiet})

        def solve(values: dict[str, Any], guess: Any) -> float:
            for parameter, name in ((x0, "x0"), (v, "v"), (kappa, "kappa"), (p, "p"), (low, "low"), (high, "high")):
                opti.set_value(parameter, values[name])
            opti.set_value(goal, values["goal"].T)
            opti.set_initial(rate, np.array(guess)[None, :])
            opti.set_initial(x, values["goal"].T)
            return float(opti.solve().value(rate[0]))

        return solve

    def dompc(self) -> tuple[Any, dict[str, Any]]:
        """do-mpc's controller, and the dictionary from which it reads the changing values."""
        import do_mpc  # type: ignore[import-untyped, import-not-found, unused-ignore]

        block, n = self.block, self.n
        model = do_mpc.model.Model("discrete")
        model.set_variable("_x", "x", shape=(6, 1))
        for name, size in (("rate", 1), ("slack", 2)):
            model.set_variable("_u", name, shape=(size, 1))
        for name, shape in (
            ("v", (1, 1)),
            ("kappa", (1, 1)),
            ("goal", (6, 1)),
            ("low", (1, 1)),
            ("high", (1, 1)),
            ("p", (6, 6)),
        ):
            model.set_variable("_tvp", name, shape=shape)
        model.set_rhs("x", self.step(model.x["x"], model.u["rate"], model.tvp["v"], model.tvp["kappa"])[0])
        model.setup()
        x, rate, slack, goal = model.x["x"], model.u["rate"], model.u["slack"], model.tvp["goal"]
        p, low, high = (model.tvp[name] for name in ("p", "low", "high"))
        a_y = self.step(x, rate, model.tvp["v"], model.tvp["kappa"])[3]
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.n_robust = n, block.dt, 0
        mpc.settings.store_full_solution = False
        mpc.settings.supress_ipopt_output()
        mpc.set_objective(mterm=0.5 * casadi.bilin(p, x - goal, x - goal), lterm=self.stage_cost(x, goal, rate, slack))
        mpc.set_rterm(rate=0.0, slack=np.zeros((2, 1)))
        mpc.bounds["lower", "_u", "rate"], mpc.bounds["upper", "_u", "rate"] = -block.rate_limit, block.rate_limit
        far = np.array([1e4] * 5 + [block.limit])
        mpc.bounds["lower", "_x", "x"], mpc.bounds["upper", "_x", "x"] = -far, far
        for name, expression, bound in (
            ("left", x[0] - slack[0], block.e_limit),
            ("right", -x[0] + slack[0], block.e_limit),
            ("up", a_y - slack[1] - high, 0.0),
            ("down", low - a_y + slack[1], 0.0),
        ):
            mpc.set_nl_cons(name, expression, ub=bound)
        template, now = mpc.get_tvp_template(), dict[str, Any]()

        def changing(t: float) -> Any:
            values: Any = now.get("values")
            for k in range(0 if values is None else n + 1):
                for name in ("goal", "low", "high"):
                    template["_tvp", k, name] = values[name][k]
                template["_tvp", k, "kappa"] = values["kappa"][min(k, n - 1)]
                template["_tvp", k, "v"], template["_tvp", k, "p"] = values["v"], values["p"]
            return template

        mpc.set_tvp_fun(changing)
        mpc.setup()
        return mpc, now


def progress(items: Sequence[int], what: str) -> Iterable[int]:
    """The items, with a bar on the error output."""
    return track(items, what, console=Console(stderr=True))


# ---- the run --------------------------------------------------------------------------------------------------------


def measured(samples: int, peers: int) -> dict[str, Any]:
    """All figures; peers: samples for do-mpc and ipopt."""
    rows = recorded(samples)
    blocks: dict[str, PredictiveSteering] = {
        f"{name}{n}": kind.of(CAR, MOTOR, horizon=n)
        for name, kind in (("ltv", MPC), ("nmpc", NonlinearMPC))
        for n in (20, 40)
    }
    runs = {name: cases(block, rows) for name, block in blocks.items()}
    times: dict[str, list[float]] = {name: [] for name in blocks}
    raw = {name: raw_qp(blocks[name]) for name in ("ltv20", "nmpc20")}
    raw_times: dict[str, list[float]] = {name: [] for name in raw}
    unsolved = dict.fromkeys(blocks, 0)
    for first in progress(range(0, samples, TURN), "our solvers"):
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
    if importlib.util.find_spec("do_mpc") is None:
        print("do-mpc is not installed, so nothing is compared: pip install 'steerkit-control[peers]'", file=sys.stderr)
        return figures
    return figures | against_peers(blocks, runs, samples, peers)


def against_peers(blocks: dict[str, PredictiveSteering], runs: dict[str, list[Case]], samples: int, peers: int) -> Any:
    """u0 against ipopt, and the time against do-mpc."""
    chosen = [round(i) for i in np.linspace(0, samples - 1, peers)]
    linear = []
    for k in chosen:
        x, u = runs["ltv20"][k]
        linear.append(abs(blocks["ltv20"].output(0.0, x, u).plan[0] - ipopt_qp(blocks["ltv20"])))
    block = replace(blocks["nmpc20"], soft_every=1)  # do-mpc has its limits at every stage
    assert isinstance(block, NonlinearMPC)
    programme = Nonlinear(block, SUBSTEPS)
    ipopt, dompc, now = programme.ipopt(), *programme.dompc()
    once, converged, other, lived = list[float](), list[float](), list[float](), list[bool]()
    ours_ms, their_ms, ipopt_ms = list[float](), list[float](), list[float]()
    for k in progress(chosen, "do-mpc and ipopt"):
        x, u = runs["nmpc20"][k]
        values = programme.values(x, u)
        block.output(0.0, x, u)
        ms, y = timed(block.output, 0.0, x, u)
        ours_ms.append(ms)
        plan, first = y.plan, y.plan[0]
        for _ in range(20):
            plan = block.output(0.0, (*x[: block.pieces], *plan, x[-1]), u).plan
        ms, truth = timed(ipopt, values, plan)
        ipopt_ms.append(ms)
        fresh = not now
        now["values"] = values
        if fresh:
            dompc.x0 = values["x0"]
            dompc.set_initial_guess()
            dompc.make_step(values["x0"])
        ms, theirs = timed(dompc.make_step, values["x0"])
        their_ms.append(ms)
        lived.append(bool(dompc.solver_stats["success"]))
        once.append(abs(first - truth))
        converged.append(abs(plan[0] - truth))
        other.append(abs(float(theirs[0, 0]) - truth))
    return {
        "dompc_ms": statistics.median(their_ms),
        "dompc_x": statistics.median(their_ms) / statistics.median(ours_ms),
        "dompc_success": sum(lived) / len(lived),
        "ipopt_ms": statistics.median(ipopt_ms),
        "ltv20_u0_max": max(linear),
        "nmpc20_u0_once_median": statistics.median(once),
        "nmpc20_u0_once_max": max(once),
        "nmpc20_u0_within": sum(d < 1e-3 for d in once) / len(once),
        "nmpc20_u0_converged_median": statistics.median(converged),
        "nmpc20_u0_converged_max": max(converged),
        "dompc_u0_median": statistics.median(other),
        "dompc_u0_max": max(other),
    }


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """What libraries (do-mpc's ipopt) write to the standard output goes to the error output."""
    kept = os.dup(1)
    os.dup2(2, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)


def add_options(parser: argparse.ArgumentParser) -> None:
    """It has no options of its own; --quick takes 50 samples, 3 for the peers."""


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Measure and print every figure beside what was asked for."""
    with quiet():
        figures = measured(TURN, 3) if options.quick else measured(SAMPLES, 60)
    for name, value in figures.items():
        goal = f"   needed {'>=' if name == 'dompc_x' else '<'} {NEEDED[name]:g}" if name in NEEDED else ""
        print(f"{name:28s} {value:10.4g}{goal}")
    return figures
