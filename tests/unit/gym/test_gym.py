"""The Gymnasium environments keep Gymnasium's rules, start as physics says, and agree with each other."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import steerkit.gym
from steerkit import native
from steerkit.assembly import steering_loop
from steerkit.block import Block
from steerkit.compiled import TraceError, compile
from steerkit.controllers.nfq_policy import IDOE_ACTIONS, StateDescription
from steerkit.doe import Integrator
from steerkit.gym import Network, PolicyBlock, Task, TrackSteering, TrackSteeringVector
from steerkit.gym.task import Agent
from steerkit.learning.costs import IdoeCost
from steerkit.plants.human_driver import ConstantSpeed, RecordedDriver
from steerkit.scenario.drive import drive_loop
from steerkit.scenario.world import World
from steerkit.simulation import simulate
from steerkit.units import radians_of

ID = "steerkit/TrackSteering-v0"
CONTINUOUS = "steerkit/TrackSteeringContinuous-v0"
HOLD = IDOE_ACTIONS.index(0.0)
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")
backends = pytest.mark.parametrize("backend", ["python", pytest.param("c", marks=needs_compiler)])


@dataclass(frozen=True, kw_only=True)
class SteadyWorld(World):
    """A driver of 6 m/s."""

    def driver(self, seed: int) -> Block:
        return ConstantSpeed(speed=6.0)


# ---- Gymnasium's rules ------------------------------------------------------------------------------------------


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "options",
    [
        {"render_mode": "rgb_array"},
        {"conditions": "hard", "cost": "paper"},
        {"actions": "bang-bang", "cost": "paper", "world": {"plant": "linear", "vehicle_name": "bmw-320i"}},
        {"actions": "continuous", "course": "genesis"},
        {"actions": "continuous", "doe": "low-pass", "start": "beginning"},
        {"actions": (-0.1, 0.1), "course": "random-3"},
    ],
    ids=str,
)
def test_the_checker_has_nothing_to_say(options: dict[str, Any]) -> None:
    env = gymnasium.make(ID, **options)
    check_env(env.unwrapped, skip_render_check="render_mode" not in options)


def test_stable_baselines3_has_nothing_to_say() -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    for name in (ID, CONTINUOUS):
        checker.check_env(gymnasium.make(name).unwrapped, warn=True)


def test_one_import_is_enough_and_loads_no_torch() -> None:
    code = f"""
import sys, gymnasium
env = gymnasium.make("steerkit.gym:{ID}")
env.reset(seed=0); env.step(0)
print([name for name in ("torch", "casadi", "control", "matplotlib") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


def test_frames_show_the_car_and_change_with_it() -> None:
    env = gymnasium.make(ID, render_mode="rgb_array", course="circle")
    env.reset(seed=0)
    first: Any = env.render()
    env.step(HOLD)
    second: Any = env.render()
    assert first.shape == (480, 720, 3)
    assert first.dtype == np.uint8
    assert (first == (0x1F, 0x6F, 0xA8)).all(axis=-1).sum() > 3000  # the car's blue
    assert (first != second).any()
    with pytest.warns(UserWarning, match="made without render_mode"):
        assert gymnasium.make(ID).unwrapped.render() is None


# ---- what happens in it -----------------------------------------------------------------------------------------


def test_the_steps_are_those_of_the_same_loop_simulated() -> None:
    actions = np.random.default_rng(0).integers(0, 5, 15)
    env = gymnasium.make(ID, world=SteadyWorld(course="circle"), start_e=0.0)
    env.reset(seed=5)
    infos = [env.step(a)[4] for a in actions]
    task = env.unwrapped.task  # type: ignore[attr-defined]

    @dataclass(frozen=True, eq=False, kw_only=True)
    class Script(Block):
        action = Agent.action
        angles: tuple[float, ...]

        def output(self, t: Any, x: Any, u: Any) -> Any:
            return self.Y(self.angles[min(round(t / self.dt), len(self.angles) - 1)])

    world = task.place
    loop = task.loop.with_block("controller", Script(angles=tuple(IDOE_ACTIONS[a] for a in actions)))
    start = task.starts([task.draw(np.random.default_rng(5))])
    x = [
        type(b)(*[float(v[0]) for v in b]) if hasattr(b, "_fields") else tuple(float(v[0]) for v in b) for b in start.x
    ]
    x[loop.names.index("controller")] = ()
    log = simulate(loop, 16 * 0.05, state=loop.init(x=x), every=5)
    assert world.ahead == pytest.approx(0.45 * 2.71)
    for name in ("e", "s", "x", "v", "a_y", "delta_sw"):
        signal = f"path.{name}" if name in ("e", "s") else f"car.{name}"
        assert [info[name] for info in infos] == log[signal][1:].tolist()


def test_a_car_starts_in_the_steady_state_of_its_bend() -> None:
    for plant in ("linear", "nonlinear"):
        env = gymnasium.make(ID, world=SteadyWorld(course="circle", plant=plant), start_e=0.0, start_psi_e=0.0)
        env.reset(seed=2)
        infos = [env.step(HOLD)[4] for _ in range(40)]
        assert max(abs(info["e"]) for info in infos) < 0.02  # 12 m of bend with the wheel held
        kappa = env.unwrapped.task.path.kappa(0.0)  # type: ignore[attr-defined]
        assert infos[0]["a_y"] == pytest.approx(6.0**2 * kappa, rel=0.02)


def test_the_reward_is_minus_the_cost_and_failure_ends_the_episode() -> None:
    cost = IdoeCost(trip=0.3)
    env = gymnasium.make(ID, cost=cost, failure=7.0, course="straight", start_e=0.0, start_psi_e=0.0)
    observation, _ = env.reset(seed=0)
    description = StateDescription()
    for _ in range(100):
        before = observation * description.half + description.mid
        observation, reward, terminated, truncated, info = env.step(4)  # 60 degrees to the left, each time
        after = observation * description.half + description.mid
        expected, failed = cost(before[None], np.array([IDOE_ACTIONS[4]]), after[None])
        assert terminated == failed[0] == (info["e"] > 0.3)
        assert reward == (-7.0 if terminated else -expected[0])
        if terminated:
            break
    assert terminated
    assert not truncated
    assert 0.3 < info["e"] < 0.8
    with pytest.raises(gymnasium.error.ResetNeeded, match="call reset"):
        env.unwrapped.step(HOLD)


def test_time_and_the_end_of_an_open_course_truncate() -> None:
    env = gymnasium.make(ID, course="straight", duration=0.5, start_e=0.0, start_psi_e=0.0)
    env.reset(seed=0)
    ends = [env.step(HOLD)[2:4] for _ in range(10)]
    assert ends == [(False, False)] * 9 + [(False, True)]
    env = gymnasium.make(ID, course="straight", start_e=0.0, start_psi_e=0.0)
    length = env.unwrapped.task.path.length  # type: ignore[attr-defined]
    env.reset(seed=0, options={"s": length - 8.0})
    for _ in range(40):
        _, _, terminated, truncated, info = env.step(HOLD)
        if truncated:
            break
    assert truncated
    assert not terminated
    assert length - 5.0 <= info["s"] < length - 4.5


def test_seeds_repeat_exactly_and_differ_from_each_other() -> None:
    def episode(seed: int, backend: str = "python") -> list[Any]:
        env = gymnasium.make(ID, conditions="hard", backend=backend)
        rows = [env.reset(seed=seed)[0].tolist()]
        return rows + [env.step(k % 5)[0].tolist() for k in range(20)]

    assert episode(3) == episode(3)
    assert episode(3) != episode(4)
    if native.compiler():
        np.testing.assert_allclose(episode(3, "c"), episode(3), atol=1e-6)


def test_options_choose_the_start() -> None:
    env = gymnasium.make(ID)
    observation, info = env.reset(seed=0, options={"s": 100.0, "e": -0.2, "psi_e": 0.0})
    assert (info["s"], info["e"]) == (pytest.approx(100.0, abs=1e-6), pytest.approx(-0.2, abs=1e-6))
    assert observation[0] == pytest.approx(-0.2, abs=1e-6)
    assert observation[1] == pytest.approx(0.0, abs=1e-3)  # e stays as it is at first


# ---- many cars --------------------------------------------------------------------------------------------------


def rolled(env: Any, actions: np.ndarray, seed: int) -> list[tuple[Any, ...]]:
    observation, info = env.reset(seed=seed)
    rows: list[tuple[Any, ...]] = [(observation.copy(), info["e"], info["x"])]
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        rows.append((observation.copy(), reward.copy(), terminated.copy(), truncated.copy(), info["e"], info["x"]))
    return rows


@backends
@pytest.mark.parametrize(("name", "conditions"), [(ID, "hard"), (CONTINUOUS, "clean")])
def test_many_cars_are_the_single_ones_through_ends_and_starts(name: str, conditions: str, backend: str) -> None:
    rng = np.random.default_rng(0)
    wide = rng.integers(0, 5, (90, 3)) if name == ID else rng.uniform(-0.4, 0.4, (90, 3, 1)).astype(np.float32)
    options: dict[str, Any] = {"conditions": conditions, "duration": 3.0}
    one_by_one = rolled(gymnasium.make_vec(name, 3, vectorization_mode="sync", **options), wide, 11)
    together = rolled(gymnasium.make_vec(name, 3, backend=backend, **options), wide, 11)
    assert sum(row[2].sum() + row[3].sum() for row in together[1:]) >= 3
    for single, many in zip(one_by_one, together):
        for a, b in zip(single, many):
            np.testing.assert_allclose(np.asarray(b, float), np.asarray(a, float), atol=1e-9)


def test_the_three_ways_to_go_on_after_an_end() -> None:
    fail = np.full(2, 4)  # 60 degrees to the left until it fails

    def until_an_end(env: Any) -> tuple[Any, ...]:
        env.reset(seed=0)
        for _ in range(60):
            result = env.step(fail)
            if result[2].any():
                return result
        raise AssertionError("nothing failed")

    next_step = gymnasium.make_vec(ID, 2, backend="python", course="straight")
    assert next_step.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observation, _, over, _, info = until_an_end(next_step)
    assert abs(observation[over, 0]) == pytest.approx(abs(info["e"][over]), rel=1e-5)
    assert abs(info["e"][over]) > 0.5
    observation, reward, terminated, _, info = next_step.step(fail)
    assert (reward[over], info["t"][over], terminated[over]) == (0.0, 0.0, False)
    assert abs(info["e"][over]) <= 0.1

    same_step = gymnasium.make_vec(ID, 2, backend="python", course="straight", autoreset_mode="SameStep")
    observation, reward, over, _, info = until_an_end(same_step)
    assert abs(info["e"][over]) <= 0.1
    assert reward[over] == -1.0
    (car,) = np.flatnonzero(over)
    assert abs(info["final_obs"][car][0]) > 0.5
    assert abs(info["final_info"]["e"][car]) > 0.5
    assert info["_final_info"].tolist() == over.tolist()

    by_hand = gymnasium.make_vec(ID, 2, backend="python", course="straight", autoreset_mode="Disabled")
    _, _, over, _, info = until_an_end(by_hand)
    others = info["e"][~over]
    with pytest.raises(gymnasium.error.ResetNeeded):
        by_hand.step(fail)
    _, info = by_hand.reset(options={"reset_mask": over})
    assert abs(info["e"][over]) <= 0.1
    by_hand.step(fail)
    assert np.isfinite(others).all()


@needs_compiler
def test_a_loop_that_asks_for_the_time_is_not_compiled_for_many() -> None:
    class Recorded(World):
        def driver(self, seed: int) -> Block:
            return RecordedDriver(speeds=(4.0, 6.0, 5.0), spacing=1.0)

    with pytest.raises(ValueError, match="depends on the time t"):
        TrackSteeringVector(2, world=Recorded())
    wide = np.random.default_rng(0).integers(0, 5, (50, 2))
    options: dict[str, Any] = {"world": Recorded(), "duration": 1.0}
    together = rolled(TrackSteeringVector(2, backend="python", **options), wide, 1)
    one_by_one = rolled(gymnasium.make_vec(ID, 2, vectorization_mode="sync", **options), wide, 1)
    for single, many in zip(one_by_one, together):
        np.testing.assert_allclose(many[-1], single[-1], atol=1e-9)


# ---- mistakes ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"action": "continuous"}, "option .'action'. is not known; valid: course, conditions, world, actions"),
        ({"actions": "steps"}, "valid: i-doe, bang-bang, continuous, or angles"),
        ({"actions": (0.1,)}, "at least two angles"),
        ({"doe": "filter"}, "valid: integrator, low-pass, direct"),
        ({"cost": "quadratic"}, "valid: smooth, paper"),
        ({"world": {"corse": "paper"}}, "world has no field .'corse'.; valid: course"),
        ({"world": World(), "course": "genesis"}, "belong to the world"),
        ({"backend": "vm"}, "valid: python, c"),
        ({"course": "papr"}, "did you mean 'paper'"),
        (
            {"description": StateDescription(names=("e", "e_dot", "w", "psi_e", "r_e", "doe"))},
            "'w' is no signal; valid",
        ),
    ],
)
def test_mistakes_in_options_are_named_with_the_valid_ones(options: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        TrackSteering(**options)


def test_actions_out_of_range_are_refused() -> None:
    env = TrackSteering()
    env.reset(seed=0)
    for action in (5, -1, 1.5, np.array([1, 2])):
        with pytest.raises(ValueError, match="expected 0 to 4"):
            env.step(action)
    env = TrackSteering(actions="continuous")
    env.reset(seed=0)
    for value in (1.5, float("nan")):
        with pytest.raises(ValueError, match=r"within \[-1, 1\]"):
            env.step(np.array([value]))
    with pytest.raises(ValueError, match=r"option .'x'. is not known; valid: s, e, psi_e"):
        env.reset(options={"x": 3.0})


# ---- from the agent to the loop ---------------------------------------------------------------------------------


def test_a_policy_block_steers_as_its_policy_did_in_the_environment() -> None:
    rng = np.random.default_rng(1)
    net = Network(
        layers=((rng.normal(size=(8, 6)), rng.normal(size=8)), (0.2 * rng.normal(size=(1, 8)), np.zeros(1))),
        head="tanh",
    )
    env = gymnasium.make(CONTINUOUS, world=SteadyWorld(course="circle"), start_e=0.0)
    observation, _ = env.reset(seed=4)
    task: Task = env.unwrapped.task  # type: ignore[attr-defined]
    seen = []
    for _ in range(12):
        observation, *_, info = env.step(net(observation[None]).astype(np.float32))
        seen.append((info["e"], info["delta_sw"]))
    block = PolicyBlock(policy=net, largest=task.scale)
    world = task.place
    loop = steering_loop(
        car=world.car(task.path),
        path=task.path,
        driver=world.driver(0),
        controller=block,
        doe=Integrator(),
        actuator=world.actuator(),
        reference=world.ahead,
    )
    start = dict(zip(task.loop.names, task.starts([task.draw(np.random.default_rng(4))]).x)) | {"controller": ()}
    floats = [
        type(x)(*[float(v[0]) for v in x]) if hasattr(x, "_fields") else tuple(float(v[0]) for v in x)
        for x in (start[name] for name in loop.names)
    ]
    log = simulate(loop, 13 * 0.05, state=loop.init(x=floats), every=5)
    np.testing.assert_allclose(np.array(seen), np.column_stack((log["path.e"], log["car.delta_sw"]))[1:], atol=1e-5)


@pytest.mark.parametrize("head", ["argmax", "tanh", "clip"])
def test_a_policy_block_of_a_network_can_be_compiled(head: Any) -> None:
    towards = np.array([-0.6, -1.0, 0.0, 0.0, -0.3, 0.0])  # the path: z = h0 - h1 is how fast to turn left
    last = [[-4.0, 4.0], [0.0, 0.0], [4.0, -4.0]] if head == "argmax" else [[1.0, -1.0]]
    layers = ((np.array([towards, -towards]), np.zeros(2)), (np.array(last), np.array([0.0, 0.1, 0.0][: len(last)])))
    net = Network(layers=layers, head=head)
    actions = (-0.05, 0.0, 0.05) if head == "argmax" else None
    world = World(course="circle")
    loop = drive_loop(world, PolicyBlock(policy=net, actions=actions, largest=0.05), doe=Integrator())
    slow, fast = simulate(loop, 3.0), compile(loop, backend="python").run(3.0)
    np.testing.assert_allclose(fast["controller.action"], slow["controller.action"], atol=1e-12)
    assert np.ptp(slow["controller.action"]) > 0.0
    other = PolicyBlock(policy=lambda x: np.zeros(len(x)))
    with pytest.raises(TraceError, match="is no Network: it cannot be traced"):
        compile(drive_loop(world, other, doe=Integrator()), backend="python")


def test_a_policy_block_comes_back_from_its_file(tmp_path: Any) -> None:
    rng = np.random.default_rng(2)
    net = Network(layers=((rng.normal(size=(4, 6)), rng.normal(size=4)), (rng.normal(size=(5, 4)), rng.normal(size=5))))
    block = PolicyBlock(policy=net, actions=IDOE_ACTIONS)
    block.save(tmp_path / "p.npz")
    again = PolicyBlock.load(tmp_path / "p.npz")
    u = block.D(*rng.normal(size=(6, 50)))
    np.testing.assert_array_equal(again.output(0.0, (), u).action, block.output(0.0, (), u).action)
    (tmp_path / "p.npz").write_bytes(b"PK no more")
    with pytest.raises(ValueError, match="cut short or not a steerkit policy block file"):
        PolicyBlock.load(tmp_path / "p.npz")
    with pytest.raises(TypeError, match="only weights can be written"):
        PolicyBlock(policy=lambda x: np.zeros(len(x))).save(tmp_path / "q.npz")


def test_any_function_may_steer_and_its_mistakes_are_named() -> None:
    u = PolicyBlock.D(*[0.1] * 6)
    lazy = PolicyBlock(policy=lambda x: np.full(len(x), -0.5), largest=radians_of(20.0))
    assert lazy.output(0.0, (), u).action == pytest.approx(radians_of(-10.0))
    assert np.isnan(lazy.output(0.0, (), u._replace(v=float("inf"))).action)
    for policy, says in ((lambda x: [2.0], r"within \[-1, 1\]"), (lambda x: [0.0, 0.0], "answered 2 numbers for 1")):
        with pytest.raises(ValueError, match=says):
            PolicyBlock(policy=policy).output(0.0, (), u)


@pytest.mark.parametrize("kind", ["DQN", "SAC", "TD3", "PPO"])
def test_the_block_of_a_stable_baselines3_model_predicts_what_the_model_does(kind: str) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    task = Task(actions="i-doe" if kind == "DQN" else "continuous")
    env = TrackSteering(actions="i-doe" if kind == "DQN" else "continuous")
    model = getattr(sb3, kind)("MlpPolicy", env, seed=0, policy_kwargs={"net_arch": [16, 16]})
    block = steerkit.gym.from_stable_baselines(model, task)
    observations = np.random.default_rng(0).uniform(-2.0, 2.0, (200, 6)).astype(np.float32)
    actions, _ = model.predict(observations, deterministic=True)
    d = task.description
    told = block.output(0.0, (), block.D(*(observations.astype(float) * d.half + d.mid).T)).action
    np.testing.assert_allclose(told, task.angle(actions, np.shape(actions)), atol=1e-5)
    other = Task(actions="bang-bang")
    with pytest.raises(ValueError, match="expected those of the task"):
        steerkit.gym.from_stable_baselines(model, other)
