"""The environments: one car, N cars, also for Stable-Baselines3, and lateral acceleration without a path; pictures."""

from collections import deque
from collections.abc import Mapping, Sequence
from numbers import Integral
from operator import attrgetter
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from steerkit._support.errors import known, optional, require
from steerkit.controllers.lateral import DT, STEER, LateralMpc
from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.diagram.block import set_ports
from steerkit.gym.episodes import Backend, cars_of
from steerkit.gym.task import Agent, Task
from steerkit.metrics import lateral_cost
from steerkit.plots.animation import Moments, Scene
from steerkit.plots.style import style
from steerkit.scenario import Scenario
from steerkit.scenario.lateral import LateralTarget, lateral_loop

_SECONDS = 10.0
_WINDOW = 14.0  # m


class Painter:
    """Paints one car of a task; keeps its last ten seconds."""

    def __init__(self, task: Task):
        self._task = task
        self._seen: deque[Mapping[str, Any]] = deque(maxlen=round(_SECONDS / task.dt))
        self._scene: Scene | None = None

    def add(self, info: Mapping[str, Any]) -> None:
        """One sample: what an environment's `info` holds; with t = 0 an episode begins."""
        if info["t"] == 0.0:
            self._seen.clear()
        self._seen.append(info)

    def frame(self) -> NDArray[np.uint8]:
        """The picture of the last sample, (height, width, 3)."""
        names = [name for name in ("x", "y", "psi", "v", "delta_sw", "e") if name in self._seen[-1]]
        t, *columns = np.array([[info[name] for name in ("t", *names)] for info in self._seen], dtype=float).T
        run = Moments(t, dict(zip(names, columns)))
        with style():
            scene = self._scene = self._scene or self._new()
            scene.run = run
            scene.show(t[-1], 1.0)
            scene.strip.set_xlim(t[-1] - _SECONDS, t[-1])
            return scene.pixels()

    def _new(self) -> Scene:
        car = getattr(self._task.loop.blocks["car"], "vehicle", None)
        numbers = (("wheelbase", 2.7), ("l_f", 1.2), ("steer_ratio", 16.0))
        wheelbase, l_f, ratio = (float(np.max(getattr(car, name, usual))) for name, usual in numbers)
        before = Moments(np.array([-2.0, -1.0]) * _SECONDS, {name: np.zeros(2) for name in ("x", "y", "psi", "e")})
        scene = Scene(before, self._task.path, wheelbase, l_f, ratio, _WINDOW)
        scene.strip.set_ylim(*(np.array([-1.15, 1.15]) * self._task.limit))
        return scene


_CAR = np.array([0])


class TrackSteering(gymnasium.Env[NDArray[np.float32], Any]):
    """Steer one car along a course; `gymnasium.make("steerkit/TrackSteering-v0", course="genesis", ...)`.

    Observation, action, reward, ends and options: see `steerkit.gym.task.Task`. `reset(options={"s": ..., "e": ...,
    "psi_e": ...})` chooses a start. `info` holds the truth: e, s, progress, x, y [m], psi [rad], v [m/s], a_y
    [m/s^2], delta_sw [rad], t [s] and the cost. The same seed and actions give the same numbers, bit for bit.

    render_mode: None or `rgb_array`. backend: `python`, or `c`, faster but for some seconds the first time.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 20}

    def __init__(self, *, render_mode: str | None = None, backend: Backend = "python", **options: Any):
        if render_mode is not None:
            known(render_mode, self.metadata["render_modes"], "TrackSteering: render_mode")
        self.task = Task.of(options)
        self.render_mode = render_mode
        self.action_space = self.task.action_space
        self.observation_space = self.task.observation_space  # type: ignore[assignment]
        self._cars = cars_of(self.task, 1, backend, AutoresetMode.DISABLED)
        self._painter = Painter(self.task) if render_mode else None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode; options s [m], e [m], psi_e [rad] say where."""
        super().reset(seed=seed)
        self._cars.draw_from([self.np_random])
        self._cars.start(_CAR, [self.task.draw(self.np_random, options)])
        return self._cars.observation[0].copy(), self._info()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive one sample; raises ResetNeeded after the end of an episode."""
        if self._cars.over[0]:
            raise gymnasium.error.ResetNeeded(
                "TrackSteering.step: the episode is over, or none has begun; call reset()"
            )
        cars = self._cars
        cars.step(self.task.angle(action, ()))
        judged = float(cars.reward[0]), bool(cars.terminated[0]), bool(cars.truncated[0])
        return self._cars.observation[0].copy(), *judged, self._info()

    def render(self) -> Any:
        """The frame of this moment, (height, width, 3) uint8; None without a render_mode."""
        if self._painter is None:
            gymnasium.logger.warn("TrackSteering.render: made without render_mode; make(..., render_mode='rgb_array')")
            return None
        return self._painter.frame()

    def _info(self) -> dict[str, Any]:
        info = {name: float(values[0]) for name, values in self._cars.infos().items()}
        if self._painter:
            self._painter.add(info)
        return info


Flags = NDArray[np.bool_]


class TrackSteeringVector(VectorEnv[NDArray[np.float32], Any, NDArray[Any]]):
    """Steer N cars, each along a course of its own start, driver and noise; `gymnasium.make_vec(id, num_envs=N)`.

    Car i of `reset(seed=k)` is the car of `TrackSteering.reset(seed=k + i)`, with the same numbers to rounding (the
    backends compute sines in other orders). Options as for `TrackSteering`. In `info` every value is an (N,) array,
    with a mask under `_name`.

    autoreset_mode: `NextStep` (Gymnasium's default: the step after an episode's end starts the next one, whatever the
    action, with reward 0), `SameStep` (the end's observation and info under `final_obs` and `final_info`) or
    `Disabled` (call `reset(options={"reset_mask": ...})`). backend: `c` compiles loop, cost and starts for some seconds
    the first time, `python` runs them on arrays. threads: of `c`; by default one for 256 cars, up to the number of
    cores.

    A task with a cost or a scenario of your own that cannot be run on symbols is computed in Python, with a warning.
    """

    _np_random: Any
    _np_random_seed: Any

    def __init__(
        self,
        num_envs: int = 1,
        *,
        render_mode: str | None = None,
        backend: Backend = "c",
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        **options: Any,
    ):
        where = "TrackSteeringVector"
        for name, number in (("num_envs", num_envs), ("threads", 1 if threads is None else threads)):
            fits = isinstance(number, Integral) and number >= 1
            require(fits, where, f"{name} = {number!r}, expected a whole number >= 1")
        if render_mode is not None:
            known(render_mode, ["rgb_array"], f"{where}: render_mode")
        if not isinstance(autoreset_mode, AutoresetMode):
            known(autoreset_mode, [mode.value for mode in AutoresetMode], f"{where}: autoreset_mode")
        self.task, self.num_envs, self.render_mode = Task.of(options), num_envs, render_mode
        self._mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": ["rgb_array"], "render_fps": 20, "autoreset_mode": self._mode}
        self.single_action_space = self.task.action_space
        self.single_observation_space = self.task.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self._cars = cars_of(self.task, num_envs, backend, self._mode, threads)
        self._painters = [Painter(self.task) for _ in range(num_envs)] if render_mode else []
        self._np_random, self._np_random_seed = zip(*[seeding.np_random() for _ in range(num_envs)])

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start episodes in all cars, or in those of options["reset_mask"]; car i gets seed + i, or seed[i]."""
        given = dict(options or {})
        mask = given.pop("reset_mask", None)
        if mask is None:
            mask = np.ones(self.num_envs, dtype=bool)
        fits = isinstance(mask, np.ndarray) and mask.dtype == bool and mask.shape == (self.num_envs,) and mask.any()
        require(fits, "reset", f"reset_mask {mask!r}, expected a boolean array ({self.num_envs},), not all False")
        seeds = (
            list(seed)
            if isinstance(seed, Sequence)
            else [None if seed is None else seed + i for i in range(self.num_envs)]
        )
        require(len(seeds) == self.num_envs, "reset", f"{len(seeds)} seeds, expected {self.num_envs}, one a car")
        generators, known_seeds, cars = [*self._np_random], [*self._np_random_seed], np.flatnonzero(mask)
        for i in cars.tolist():
            if seeds[i] is not None:
                generators[i], known_seeds[i] = seeding.np_random(seeds[i])
        self._np_random, self._np_random_seed = tuple(generators), tuple(known_seeds)
        self._cars.draw_from(generators)
        self._cars.start(cars, [self.task.draw(generators[i], given) for i in cars.tolist()])
        infos = _masked(self._cars.infos(), mask)
        for i in cars.tolist() if self._painters else ():
            self._painters[i].add({name: values[i] for name, values in infos.items()})
        return self._cars.observation.copy(), infos

    def step(self, actions: Any) -> tuple[NDArray[np.float32], NDArray[Any], Flags, Flags, dict[str, Any]]:
        """Drive all cars one sample, and start those anew whose episode is over."""
        cars, stopped = self._cars, self._cars.over.copy()
        if stopped.any() and self._mode is not AutoresetMode.NEXT_STEP:
            raise gymnasium.error.ResetNeeded(f"step: the episodes of cars {np.flatnonzero(stopped)} are over; reset()")
        cars.step(self.task.angle(actions, self.action_space.shape or ()))
        infos = _masked(self._cars.infos(), np.ones(self.num_envs, dtype=bool))
        ended, same_step = cars.terminated | cars.truncated, self._mode is AutoresetMode.SAME_STEP
        for i, painter in enumerate(self._painters):
            painter.add({name: values[i] for name, values in infos.items()})
        if same_step and ended.any():
            final, (seen, last) = np.full(len(ended), None, dtype=object), cars.last()
            for car in np.flatnonzero(ended):
                final[car] = seen[car]
            infos |= {"final_obs": final, "final_info": _masked(last, ended)}
            infos |= {"_final_obs": ended.copy(), "_final_info": ended.copy()}
        return cars.observation.copy(), cars.reward.copy(), cars.terminated.copy(), cars.truncated.copy(), infos

    def render(self) -> Any:
        """A tuple of frames, one a car; None without a render_mode."""
        return tuple(painter.frame() for painter in self._painters) if self._painters else None


def _masked(infos: Mapping[str, Any], mask: Flags) -> dict[str, Any]:
    """Infos in Gymnasium's form: 0 for the others, and whose they are."""
    masked, every = dict[str, Any](), bool(mask.all())
    for name, values in infos.items():
        masked[name], masked[f"_{name}"] = values if every else np.where(mask, values, 0.0), mask.copy()
    return masked


def stable_baselines_vec(num_envs: int, **options: Any) -> Any:
    """N cars in one loop as a `VecEnv` of Stable-Baselines3; options as for `TrackSteeringVector`, without its modes.

    Its attribute `task` is the `Task`. Raises ValueError without Stable-Baselines3.
    """
    module = optional("stable_baselines3", "stable_baselines_vec", "gym").common.vec_env
    envs = TrackSteeringVector(num_envs, autoreset_mode="SameStep", **options)

    class Cars(module.VecEnv):  # type: ignore[name-defined]
        def reset(self) -> Any:
            seen, _ = envs.reset(seed=self._seeds)
            self._reset_seeds()
            return seen

        def step_async(self, actions: Any) -> None:
            self._actions = actions

        def step_wait(self) -> Any:
            seen, reward, terminated, truncated, infos = envs.step(self._actions)
            each: list[dict[str, Any]] = [{} for _ in range(num_envs)]
            for i in np.flatnonzero(terminated | truncated):
                each[i] = {"terminal_observation": infos["final_obs"][i], "TimeLimit.truncated": bool(truncated[i])}
            return seen, reward, terminated | truncated, each

        def get_attr(self, name: str, indices: Any = None) -> list[Any]:
            return [getattr(envs, name) for _ in self._get_indices(indices)]

        def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
            return [False for _ in self._get_indices(indices)]

        def set_attr(self, *_: Any, **__: Any) -> None:
            raise AttributeError("stable_baselines_vec: one loop drives all cars; options are given when it is made")

        env_method = set_attr

        def close(self) -> None:
            envs.close()

    return Cars(num_envs, envs.single_observation_space, envs.single_action_space)


_NETS = {
    "DQN": ("argmax", "q_net.q_net"),
    "SAC": ("tanh", "actor.latent_pi", "actor.mu"),
    "TD3": ("tanh", "actor.mu"),
    "PPO": ("clip", "mlp_extractor.policy_net", "action_net"),
    "A2C": ("clip", "mlp_extractor.policy_net", "action_net"),
}
"""By kind of model: what becomes of a continuous policy's last layer, and where in it the layers are."""


def from_stable_baselines(model: Any, task: Task | None = None) -> PolicyBlock:
    """The greedy policy of a trained model (DQN, SAC, TD3, PPO, A2C with an MLP) as a controller block.

    task: what it was trained on; by default that of the model's environment, which a model from a file has not. It
    steers as `model.predict(observation, deterministic=True)` does, to the rounding of float32. Raises ValueError for
    another kind of model, an unknown layer, spaces that are not the task's, or a model without task.
    """
    where, kind = "from_stable_baselines", type(model).__name__
    if task is None:
        try:
            task = model.get_env().get_attr("task")[0]
        except AttributeError:
            what = "the model has no environment of steerkit that says what it steers"
            raise ValueError(f"{where}: {what}; give the task it was trained on: task=Task(...)") from None
    same = model.observation_space == task.observation_space and model.action_space == task.action_space
    expected = f"expected those of the task: {task.observation_space}, {task.action_space}"
    require(same, where, f"a model of {model.observation_space}, {model.action_space}, {expected}")
    head, *names = _NETS[known(kind, _NETS, f"{where}: model")]
    leaves = [leaf for name in names for leaf in attrgetter(name)(model.policy).modules() if not [*leaf.children()]]
    linear = [i for i, leaf in enumerate(leaves) if type(leaf).__name__ == "Linear"]
    between = {type(leaf).__name__ for leaf in leaves[: linear[-1]]} - {"Linear"}  # what follows in TD3 is the head
    fault = f"layers {', '.join(sorted(between))}, expected Linear ones with one of ReLU, Tanh between them"
    require(between in (set(), {"ReLU"}, {"Tanh"}), where, fault)
    network = Network(
        layers=tuple([tuple(p.detach().cpu().double().numpy() for p in leaves[i].parameters()) for i in linear]),
        activation="tanh" if between == {"Tanh"} else "relu",
        head="argmax" if task.angles else head,  # type: ignore[arg-type]
    )
    return PolicyBlock(
        policy=network, actions=task.angles, largest=task.scale, description=task.description, dt=task.dt
    )


_SEEN, _NO_COMMANDS = 15, (0.0,) * 8


class LateralAcceleration(gymnasium.Env[NDArray[np.float32], Any]):
    """Follow a target of lateral acceleration, at a given speed and roll, 10 times a second.

    observation, float32: a_y_target - a_y, a_y, a_roll, v/20 - 1, the next 15 of preview - preview_roll, the last 8
    commands. action: a_y_cmd/2 in [-1, 1]. reward: minus what the sample adds to `total_cost` of `lateral_cost`, over
    100. terminated: never; truncated: at the target's end. `info`: a_y, a_y_target [m/s^2], at the end the costs too.

    scenario: as `lateral_loop` takes it, or a dictionary of its fields. target: as `LateralTarget.read` takes it; None:
    one drawn for each episode. Raises ValueError for others, and for an action outside [-1, 1].
    """

    observation_space = spaces.Box(-10.0, 10.0, (4 + _SEEN + len(_NO_COMMANDS),), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (1,), np.float32)

    def __init__(self, *, scenario: Any = None, target: str | None = None, seconds: float = 60.0):
        self.scenario = scenario if isinstance(scenario, Scenario) else Scenario.under(**(scenario or {}))
        self._fixed = None if target is None else LateralTarget.read(target, self.scenario)
        self._seconds, self._past = seconds, _NO_COMMANDS

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode."""
        super().reset(seed=seed)
        draw = int(self.np_random.integers(2**31))
        self._target = self._fixed or LateralTarget.drawn(draw, seconds=self._seconds)
        self._past, self._driven = _NO_COMMANDS, list[Any]()
        agent = Agent(dt=self._target.dt)
        set_ports(agent, (), LateralMpc.outputs)
        self._loop = lateral_loop(self.scenario, self._target, agent, seed=draw)
        self._state = self._loop.init()
        return self._look()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Drive one sample."""
        ok = np.size(action) == 1 and np.isfinite(action).all() and np.abs(action).max() <= 1.0 + 1e-6
        require(ok, "LateralAcceleration.step", f"action {action!r:.60}, expected one number within [-1, 1]")
        require(len(self._driven) < len(self._target.table), "LateralAcceleration.step", "the target is over; reset()")
        self._past = (*self._past[1:], STEER * float(np.reshape(action, -1)[0]))
        self._state = self._loop.with_block_state(self._state, "controller", (self._past[-1],))
        for _ in range(self._loop.period):
            self._state, _ = self._loop.step(self._state)
        seen, info = self._look()
        over = len(self._driven) >= len(self._target.table)
        cost = self._cost(self._driven[-2:])["total_cost"] / 100.0
        return seen, -cost, False, over, info | (self._cost(self._driven) if over else {})

    def _cost(self, driven: list[tuple[float, float]]) -> dict[str, float]:
        return lateral_cost(DT * np.arange(len(driven)), *np.array(driven).T)

    def _look(self) -> tuple[NDArray[np.float32], dict[str, Any]]:
        x, y = list(self._state.x), list(self._state.y)
        self._loop.run_phase(0, self._state.k * self._loop.dt, x, y)
        now = self._target.Y(*y[self._loop.names.index("target")])
        self._driven.append((now.a_y, now.a_y_target))
        ahead = np.subtract(now.preview, now.preview_roll)[:_SEEN]
        values = (now.a_y_target - now.a_y, now.a_y, now.a_roll, now.v / 20.0 - 1.0, *ahead, *self._past)
        seen = np.clip(values, -10.0, 10.0).astype(np.float32)
        return seen, {"a_y": float(now.a_y), "a_y_target": float(now.a_y_target)}
