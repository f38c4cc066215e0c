"""Other libraries' controllers and learners drive and repeat themselves."""

import math

import numpy as np
import pytest

from benchmarks.entries import controller
from benchmarks.peers import agents as peers
from benchmarks.run.drives import drive
from benchmarks.scenarios import scene
from steerkit.vehicles import VW_PASSAT as PASSAT

STEP = scene(name="step", course="curvature-step", driver={"v_min": 7.0, "v_max": 7.0})


def test_do_mpc_holds_a_steady_bend_and_steers_back_onto_the_path() -> None:
    pytest.importorskip("do_mpc")
    block = controller("do-mpc").make(STEP)  # type: ignore[misc]
    p, v, kappa = PASSAT, 7.0, 1.0 / 27.0
    # the front axle on the circle: v_front = r/kappa, sideways of it against the path 0
    delta = (p.wheelbase + p.understeer_gradient * v**2) * kappa
    beta = p.l_r * kappa - p.m * p.l_f * v**2 * kappa / (p.c_r * p.wheelbase)
    psi_e = -math.atan2(math.sin(beta) + p.l_f * kappa, math.cos(beta))
    steady = block.U(0.0, psi_e, v, beta, v * kappa, p.steer_ratio * delta, (kappa,) * 21)
    command = block.output(0.0, (p.steer_ratio * delta,), steady).delta_sw
    assert command == pytest.approx(p.steer_ratio * delta, rel=0.05)
    left = block.U(0.1, 0.0, v, 0.0, 0.0, 0.0, (0.0,) * 21)
    assert block.output(0.0, (0.0,), left) == block.output(0.0, (0.0,), left)
    right = block.output(0.0, (0.0,), left._replace(e=-0.1)).delta_sw
    assert block.output(0.0, (0.0,), left).delta_sw == pytest.approx(-right, rel=1e-3)
    assert right > 0.01
    with pytest.raises(ValueError, match="cannot be batched"):
        block.init((2,))


def test_an_agent_learns_the_same_again_and_its_net_drives() -> None:
    pytest.importorskip("stable_baselines3")
    from benchmarks.run.drives import Policy

    one, two = (peers.stable_baselines("DQN", steps=330, seed=1, judge=lambda block: {"held": 0.0}) for _ in range(2))
    assert list(one[1]["iterations"]) == list(range(1, 11))
    assert one[1]["transitions"][-1] >= 330.0
    first, again = (np.concatenate([w.ravel() for w, _ in block.policy.layers]) for block, _ in (one, two))  # type: ignore[attr-defined]
    assert (first == again).all()
    driven = drive(STEP, "sb3-dqn", policy=Policy(one[0], "sb3-dqn"))
    assert 0.0 < driven.metrics["rounds"] <= 1.0
