"""Peers that nobody here wrote, in the same drives: Stable-Baselines3's agents and do-mpc's MPC."""

import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from benchmarks.run.results import CURVE
from steerkit.controllers.network_policy import PolicyBlock
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import DT, STOP

FAILURE_COST = 4.0
"""What a failure costs an agent that discounts by 0.98: above 0.05 a sample for ever, or failing would pay."""
_CHECKS = 10  # test drives along a training
_NET = [64, 64]
SETTINGS = {"sb3-dqn": "DQN", "sb3-sac": "SAC"}
"""What controllers name as their setting, and the agent it means."""
AGENTS: dict[str, tuple[str, dict[str, Any]]] = {
    "DQN": (
        "steerkit/TrackSteering-v0",
        dict(train_freq=4, gradient_steps=2, target_update_interval=500)
        | dict(exploration_fraction=0.3, exploration_final_eps=0.02),
    ),
    "SAC": ("steerkit/TrackSteeringContinuous-v0", {"train_freq": 4, "gradient_steps": 2}),
}
"""Environment and settings of each agent that are not the library's own."""
_COMMON = {"learning_rate": 5e-4, "buffer_size": 100_000, "learning_starts": 300, "batch_size": 128, "gamma": 0.98}

Judge = Callable[[PolicyBlock], dict[str, float]]


def stable_baselines(name: str, *, steps: int, seed: int, judge: Judge) -> tuple[PolicyBlock, dict[str, np.ndarray]]:
    """An agent that drove `steps` samples of the 800 m course, and its learning curve (columns of `CURVE`).

    It learns in episodes of a minute from anywhere on the course, exploring, and a failure just begins another: not
    the paper's protocol of one car, recovery and hand-over, so its minutes are driving time, not wall time at the wheel
    of one car. judge: the metrics of a test drive. The policy is the last one.
    """
    import gymnasium
    import stable_baselines3

    import steerkit.gym  # noqa: F401  registers the environments
    from steerkit.gym.vector_env import from_stable_baselines

    environment, own = AGENTS[name]
    with _one_thread():
        env = gymnasium.make(environment, course="paper", failure=FAILURE_COST)
        task = env.unwrapped.task  # type: ignore[attr-defined]
        agent = getattr(stable_baselines3, name)
        model = agent("MlpPolicy", env, seed=seed, device="cpu", policy_kwargs={"net_arch": _NET}, **_COMMON, **own)
        rows, block = [], None
        for check in range(_CHECKS):
            model.learn(steps // _CHECKS, reset_num_timesteps=check == 0, progress_bar=False)
            block = from_stable_baselines(model, task)
            steps_until = {"t": model.num_timesteps * task.dt, "transitions": model.num_timesteps}
            row = {"iterations": check + 1, **steps_until, **judge(block)}
            rows.append([float(row.get(column, np.nan)) for column in CURVE])
    assert block is not None
    return block, dict(zip(CURVE, np.array(rows).T, strict=True))


@contextmanager
def _one_thread() -> Iterator[None]:
    """torch with one thread: the order of sums must not hang on the machine's cores."""
    import torch

    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@dataclass(frozen=True, eq=False, kw_only=True)
class DoMpc(Block):
    """do-mpc's nonlinear MPC (collocation, IPOPT) on the linear single track in path coordinates.

    e' = v sin(psi_e + beta) + reference r cos(psi_e),  psi_e' = r - v kappa cos(psi_e)/(1 - kappa e),
    (beta, r)' = A(v) (beta, r) + B delta,  delta' = (u - delta)/lag,  u' = rate,
    min sum_k q_e e^2 + q_rate (steer_ratio rate)^2  over `horizon` samples, |u|, |rate| within limits.

    Speed and curvature are known ahead (preview), the steering's dead time is not: that is do-mpc's own model. Every
    sample is solved from the same cold start, so that the block has no memory but the command; it takes some 20 ms.

    Inputs, at `reference`: e [m], psi_e [rad], preview [1/m]; v [m/s], beta [rad], r [rad/s], delta_sw_meas [rad].
    Output: delta_sw [rad]. State: the last command [rad]. Interpreted floats only. Raises ImportError without do-mpc.
    Source: Fiedler et al. 2023 (do-mpc); Rajamani 2012, section 2.5 (the model).
    """

    e = In("m")
    psi_e = In("rad")
    v = In("m/s")
    beta = In("rad")
    r = In("rad/s")
    delta_sw_meas = In("rad")
    preview = In("1/m", size="preview_points")
    delta_sw = Out("rad")

    pure = False  # it runs a solver

    matrices: Callable[[Any], Any]
    """v -> A, B of (beta, r)' = A (beta, r) + B delta; `LinearSingleTrack.matrices` is one."""
    steer_ratio: Scalar
    """Steering-wheel angle over road-wheel angle [1]."""
    reference: float
    """Where e is measured, metres ahead of the centre of gravity."""
    lag: float = 0.1
    """First-order time constant of the steering [s]."""
    horizon: int = 20
    """Samples planned."""
    q_e: float = 1.0
    """Weight of e^2 [1/m^2]."""
    q_rate: float = 3e-4
    """Weight of the wheel's rate [s^2]."""
    limit: float = STOP
    """Largest |delta_sw| [rad]."""
    rate_limit: float = radians_of(500.0)
    """Fastest command [rad/s]."""
    preview_points: int = 21
    """Entries of the preview: one more than the horizon."""
    preview_dt: float = DT
    """Time between them [s]."""

    @cached_property
    def _mpc(self) -> tuple[Any, Any]:
        """do-mpc's controller, and the table of what is known ahead that it reads."""
        import casadi

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of its optional parts that are not there
            import do_mpc

        model = do_mpc.model.Model("continuous")
        e, psi_e, beta, r, delta, u = (model.set_variable("_x", n) for n in ("e", "psi_e", "beta", "r", "delta", "u"))
        rate = model.set_variable("_u", "rate")
        v, kappa = (model.set_variable("_tvp", n) for n in ("v", "kappa"))
        a11, a12, a21, a22, b1, b2 = (model.set_variable("_tvp", n) for n in ("a11", "a12", "a21", "a22", "b1", "b2"))
        model.set_rhs("e", v * casadi.sin(psi_e + beta) + self.reference * r * casadi.cos(psi_e))
        model.set_rhs("psi_e", r - v * kappa * casadi.cos(psi_e) / casadi.fmax(1.0 - kappa * e, 0.2))
        model.set_rhs("beta", a11 * beta + a12 * r + b1 * delta)
        model.set_rhs("r", a21 * beta + a22 * r + b2 * delta)
        model.set_rhs("delta", (u - delta) / self.lag)
        model.set_rhs("u", rate)
        model.setup()
        mpc = do_mpc.controller.MPC(model)
        mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.store_full_solution = self.horizon, self.dt, False
        mpc.settings.supress_ipopt_output()
        cost = self.q_e * e**2
        mpc.set_objective(mterm=cost, lterm=cost + self.q_rate * (self.steer_ratio * rate) ** 2)
        mpc.set_rterm(rate=0.0)
        for sign, bound in ((1.0, "upper"), (-1.0, "lower")):
            mpc.bounds[bound, "_x", "u"] = sign * self.limit / self.steer_ratio
            mpc.bounds[bound, "_u", "rate"] = sign * self.rate_limit / self.steer_ratio
        known = mpc.get_tvp_template()
        mpc.set_tvp_fun(lambda _: known)
        mpc.setup()
        return mpc, known

    def init(self, batch: tuple[int, ...] = ()) -> State:
        if batch:
            raise ValueError("DoMpc: one car at a time; it cannot be batched")
        return (0.0,)

    def settle(self, t: float, x: State, u: Any) -> State:
        return (float(u.delta_sw_meas),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        mpc, known = self._mpc
        a, b = self.matrices(u.v)
        for k in range(self.horizon + 1):
            row = (u.v, u.preview[k], *a[0], *a[1], *b)
            for name, value in zip(("v", "kappa", "a11", "a12", "a21", "a22", "b1", "b2"), row, strict=True):
                known["_tvp", k, name] = value
        delta, command = u.delta_sw_meas / self.steer_ratio, x[0] / self.steer_ratio
        mpc.reset_history()
        mpc.x0 = np.array([u.e, u.psi_e, u.beta, u.r, delta, command])
        mpc.u0 = np.zeros(1)
        mpc.set_initial_guess()
        rate = float(np.asarray(mpc.make_step(mpc.x0)).ravel()[0])
        wanted = x[0] + self.dt * self.steer_ratio * rate
        return self.Y(float(np.clip(wanted, -self.limit, self.limit)))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (y.delta_sw,)
