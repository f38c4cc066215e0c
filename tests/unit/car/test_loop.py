"""The loop on a car: what controllers believe, which net drives, which loop steers in each sample, how far it will get.

How far: closed forms, the mirror, and what the real gate makes of it.
"""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.car import loop as loops
from steerkit.car.client import ReplayLink
from steerkit.car.gate import gate
from steerkit.car.loop import ExcursionPredictor, Follow
from steerkit.car.state_machine import Mode, Order
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block
from steerkit.diagram.units import radians_of
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.settings import setting
from steerkit.scenario.catalogue import make_controller
from steerkit.vehicles.rollout import GateLimits, GateModel
from tests.support.car_world import CONFIG, World


def test_controllers_are_told_the_kits_delay_lag_and_rate_and_the_lower_of_two_stops() -> None:
    config = replace(CONFIG, delay=0.07, lag=0.31, gate=replace(CONFIG.gate, delta_sw_max=5.0, rate_max=3.0))
    told = loops.design_model_of(config)
    assert (told.delay, told.lag, told.rate_limit, told.vehicle.delta_sw_max) == (0.07, 0.31, 3.0, 5.0)
    car = replace(config.vehicle, delta_sw_max=4.0)
    assert loops.design_model_of(replace(config, vehicle=car)).vehicle.delta_sw_max == 4.0


def test_foresight_reckons_with_every_limit_of_the_gate() -> None:
    gate = replace(CONFIG.gate, a_y_max=2.5, jerk_max=4.5, rate_max=8.0, delta_sw_max=8.5, v_floor=1.5, quantum=0.002)
    assert loops.foresight(replace(CONFIG, gate=gate)).gate.limits == gate


@pytest.mark.parametrize("name", ["mpc", "mpc-adaptive"])
def test_a_solver_has_its_budget_on_the_road_and_all_the_time_it_needs_in_a_replay(name: str) -> None:
    def solvers(block: Any) -> list[Any]:
        if hasattr(block, "budget"):
            return [block]
        return [solver for inner in getattr(block, "blocks", None) or (block.block,) for solver in solvers(inner)]

    for in_time, budget in ((False, loops.BUDGET), (True, None)):
        found = solvers(loops.controller_named(name, CONFIG, in_time=in_time).block)
        assert {solver.budget for solver in found} == {budget}
        assert all((solver.clock is None) is in_time for solver in found)


def test_e_is_measured_at_the_front_axle() -> None:
    loop = loops.car_loop(CONFIG, ReplayLink([]), Stanley.of(CONFIG.vehicle))
    tracker: Any = loop.blocks["path"]
    assert tracker.reference == CONFIG.vehicle.l_f
    assert loop.inputs_of("controller")["e"] == "path.e"


def policy(number: int = 0) -> NfqPolicy:
    """A net that has learned nothing, and is ready from the start."""
    how = setting("default")
    nets = nfq.fresh_nets(how.fit, how.description(), seed=number)
    return NfqPolicy(nets=nets, actions=how.actions, description=how.description())


def test_the_newest_net_of_a_run_drives_but_not_the_one_before_any_learning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(loops, "element_of", lambda place: setting("default").doe)
    (tmp_path / "nets").mkdir()
    for number in (0, 3, 1, 2):
        policy(number).save(tmp_path / "nets" / f"net-{number:04d}.npz")
        if number == 0:
            with pytest.raises(ValueError, match="is not known, nor a place with a trained policy"):
                loops.controller_named(str(tmp_path), CONFIG)
    steers = loops.controller_named(str(tmp_path), CONFIG).steers
    assert Path(steers.name).name == "net-0003.npz"
    older = tmp_path / "nets" / "net-0002.npz"
    assert loops.controller_named(str(older), CONFIG).steers.name == str(older.resolve())


def world_of(controller: Block | None = None) -> World:
    return World(s=20.0, v=(5.0, 5.0), controller=controller)


def steered_by(world: World, seconds: float) -> set[str]:
    """Whose angle went out in each sample."""
    who, end = set(), world.t + seconds
    while world.t < end:
        world.until(world.t + 0.05)
        sample = world.run.sample
        who.add("net" if sample["supervisor.learning"] > 0.5 else "recovery")
        chosen = sample["doe.delta_sw"] if sample["supervisor.learning"] > 0.5 else sample["recovery.delta_sw"]
        assert sample["supervisor.delta_sw"] == chosen
    return who


def test_a_net_steers_while_engaged_and_trusted_and_never_else() -> None:
    world = world_of(policy()).bring_to(Mode.READY)
    assert steered_by(world, 0.3) == {"recovery"}, "the human has the wheel"
    world.order(Order.ENGAGE, then=0.05)
    assert "net" in steered_by(world, 0.15)
    world.follow.trusted = False
    world.until(world.t + 0.05)
    assert steered_by(world, 2.0) == {"recovery"}, "nobody trusts it"
    assert world.mode is Mode.ENGAGED
    world.follow.trusted = True
    world.until(world.t + 0.05)
    assert "net" in steered_by(world, 0.5)
    world.order(Order.DISENGAGE, then=0.1)
    assert steered_by(world, 0.5) == {"recovery"}


def test_while_a_human_steers_the_controller_settles_on_the_wheel_as_it_is() -> None:
    world = world_of().bring_to(Mode.READY)
    number = world.run.loop.names.index("controller")
    for _ in range(10):
        world.until(world.t + 0.05)
        assert world.run.x[number] == world.run.loop.settled("controller", world.run.y)
        assert world.run.x[number].command == world.run.sample["car.delta_sw"]
    world.order(Order.ENGAGE, then=0.3)
    assert world.run.x[number].command == world.run.sample["controller.delta_sw"]


@pytest.mark.parametrize(("mode", "anew"), [(Mode.READY, True), (Mode.STANDBY, True), (Mode.ENGAGED, False)])
def test_a_pose_that_comes_back_makes_the_loop_begin_anew_once_but_never_while_engaged(mode: Mode, anew: bool) -> None:
    world = world_of()
    world.until(1.0)
    line: Any = SimpleNamespace(last=world.last)
    line.last = line.last._replace(places=1.0, mode=mode)
    follow = Follow.of(world.run.loop, line)
    assert not follow.begin(world.run), "the first one is no return"
    assert world.run.k > 5
    line.last = line.last._replace(places=2.0, mode=mode)
    assert follow.begin(world.run) is anew
    assert (world.run.k == 0) is anew
    assert not follow.begin(world.run), "once"


@pytest.mark.parametrize(
    ("e", "then", "kept"),
    [
        (0.5, Mode.OVERRIDE, True),
        (-0.5, Mode.STANDBY, True),
        (0.51, Mode.OVERRIDE, False),
        (-0.51, Mode.OVERRIDE, False),
        (math.nan, Mode.OVERRIDE, False),
        (0.0, Mode.FAULT, False),
    ],
)
def test_what_was_found_of_a_car_that_got_off_its_path_or_into_a_fault_is_not_believed(
    e: float, then: Mode, kept: bool
) -> None:
    adaptive: Any = make_controller("stanley-adaptive", loops.design_model_of(CONFIG))
    world = world_of(adaptive)
    world.until(0.3)
    line: Any = SimpleNamespace(last=world.last)
    number = world.run.loop.names.index("controller")
    follow = Follow.of(world.run.loop, line)
    world.run.x[number] = (*world.run.x[number][:-2], 0.31, 1.2)
    for mode, now in ((Mode.ENGAGED, e), (Mode.ENGAGED, 0.0), (then, 0.0), (Mode.READY, 0.0)):
        line.last = line.last._replace(mode=mode, e=now)
        follow.begin(world.run)
    anew = adaptive.believed(adaptive.init())
    assert adaptive.believed(world.run.x[number]) == ((0.31, 1.2) if kept else anew)
    world.run.x[number] = (*world.run.x[number][:-2], 0.31, 1.2)
    for mode in (Mode.ENGAGED, Mode.READY):
        line.last = line.last._replace(mode=mode)
        follow.begin(world.run)
    assert adaptive.believed(world.run.x[number]) == (0.31, 1.2), "the next drive is another one"


RATIO, LENGTH = 15.6, 2.71


def reach(e: float, psi_e: float, kappa: float, v: float, doe: float, **settings: Any) -> float:
    block = ExcursionPredictor(**settings)
    return float(block.output(0.0, (), block.D(e, psi_e, kappa, v, doe)).reach)


def test_a_steady_bend_is_left_no_further_than_the_wheel_is_turned() -> None:
    """At the front axle psi_e = -delta in the steady bend; kappa is that of the front axle's circle, sin(delta)/L."""
    delta = radians_of(200.0) / RATIO
    assert reach(0.0, -delta, math.sin(delta) / LENGTH, 4.0, RATIO * delta) == pytest.approx(0.0, abs=1e-9)


def test_while_the_wheels_are_held_it_goes_straight_on() -> None:
    """With the whole horizon held and no bend, e grows by v T sin(psi_e)."""
    v, psi_e = 3.0, 0.2
    far = reach(0.1, psi_e, 0.0, v, 0.0, hold=9.0, horizon=1.0)
    assert far == pytest.approx(0.1 + v * 1.0 * math.sin(psi_e), abs=1e-12)


def test_the_slower_the_wheel_the_further() -> None:
    """Small angles: e' = v (psi_e + delta), delta' = -w: from psi_e the car has turned when delta = -psi_e, at once
    for a fast wheel; then it is psi_e^2 v / (2 w) off."""
    v, psi_e, jerk = 1.0, 0.1, 0.2
    turn = LENGTH * jerk / v**2  # rad/s of the road wheels
    gates = [
        GateModel(v_doubt=0.0, limits=GateLimits(quantum=1e-9, jerk_max=j)) for j in (2.0 * jerk, jerk, 0.5 * jerk)
    ]
    fast, found, slow = (reach(0.0, psi_e, 0.0, v, 0.0, hold=0.0, gate=gate) for gate in gates)
    assert found == pytest.approx(v * psi_e**2 / (2.0 * turn), rel=0.05)  # psi_e turns a little meanwhile
    assert fast < found < slow


small = st.floats(-1.0, 1.0)


@given(e=small, psi_e=small, kappa=st.floats(-0.1, 0.1), v=st.floats(0.0, 10.0), doe=st.floats(-9.0, 9.0))
def test_it_is_the_same_in_the_mirror_and_never_nearer_than_now(
    e: float, psi_e: float, kappa: float, v: float, doe: float
) -> None:
    far = reach(e, psi_e, kappa, v, doe)
    assert far >= abs(e)
    assert far == reach(-e, -psi_e, -kappa, v, -doe)
    block = ExcursionPredictor()
    assert block.output(0.0, (), block.D(e, psi_e, kappa, v, doe)).distance == max(abs(e), 0.4 * far)


def driven(psi_e: float, kappa: float, v: float, doe: float) -> float:
    """How far the front axle of a kinematic car gets from a circle in the plane, its rear axle rolling at v, stepped
    finely, its wheel turned back by the real gate, frame by frame [m]."""
    limits, h = GateLimits(), 0.004
    furthest = 0.0
    for lock in (-radians_of(520.0), radians_of(520.0)):
        x, y, psi, command = -LENGTH * math.cos(psi_e), -LENGTH * math.sin(psi_e), psi_e, doe  # of the rear axle
        for n in range(500):
            if n % 5 == 0 and n * h >= 0.15:
                command = gate(limits, lock, command, (v, v), 5 * h).delta_sw
            half = 0.5 * h * v * math.tan(command / RATIO) / LENGTH
            x, y, psi = x + h * v * math.cos(psi + half), y + h * v * math.sin(psi + half), psi + 2.0 * half
            front = x + LENGTH * math.cos(psi), y + LENGTH * math.sin(psi)
            away = math.hypot(kappa * front[0], kappa * front[1] - 1.0)  # from the circle's centre, in radii
            e = (1.0 - away) / kappa if abs(kappa) > 1e-6 else front[1]
            furthest = max(furthest, abs(e) if e * lock < 0.0 else 0.0)
    return furthest


def test_nor_from_states_drawn_uniformly() -> None:
    """Hypothesis likes small and round numbers; the gate's rounding and its bounds show in all the others."""
    rng = np.random.default_rng(0)
    states = [(0.0, 0.0, 9.0, 2.0), *(rng.uniform(-1.0, 1.0, (150, 4)) * (0.5, 0.05, 4.0, 3.0) + (0.0, 0.0, 5.0, 0.0))]
    for state in np.array(states).tolist():
        promised, far = reach(0.0, *state), driven(*state)
        assert far - 0.01 <= promised <= 1.15 * far + 0.03, state
