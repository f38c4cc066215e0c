"""The greedy policy: one formula in floats, batches and symbols; faults show; files come back bit for bit."""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.delay_compensator import DelayCompensator
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import StateDescription
from steerkit.learning.nfq.iterate import STANDARD, mirror_image, patterns
from steerkit.learning.nfq.rprop import Net, forward, new_net

NETS = tuple(tuple(3.0 * p for p in new_net(seed=k)) for k in range(3))
POLICIES = [
    NfqPolicy(nets=NETS),
    NfqPolicy(nets=NETS[:1], actions=(-6.28, 6.28), description=StateDescription(action_scale=2.0)),
    NfqPolicy(nets=(new_net((7, 1), seed=1),)),
    NfqPolicy(nets=(new_net((7, 4, 3, 5, 1), seed=1), new_net((7, 4, 3, 5, 1), seed=2))),
]
policies = pytest.mark.parametrize("policy", POLICIES, ids=range(len(POLICIES)))


def cars(n: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    spread = np.array([[0.6], [2.0], [4.0], [0.5], [0.5], [8.0]])
    return rng.uniform(-1.0, 1.0, (6, n)) * spread + np.array([[0.0], [0.0], [5.0], [0.0], [0.0], [0.0]])


def ask(policy: NfqPolicy, s: Any, t: float = 0.0) -> Any:
    return policy.output(t, policy.init(), policy.D(*s))


def traced(policy: NfqPolicy) -> casadi.Function:
    s, t = casadi.SX.sym("s", 6), casadi.SX.sym("t")
    return casadi.Function("policy", [t, s], list(ask(policy, [s[i] for i in range(6)], t)))


@policies
def test_greedy_by_the_written_out_definition(policy: NfqPolicy) -> None:
    s = cars(100)
    scale = policy.description.action_scale or max(map(abs, policy.actions))
    values = []
    for a in policy.actions:
        x = np.column_stack([(s.T - STANDARD.mid) / STANDARD.half, np.full(100, a / scale)])
        values.append(np.mean([forward(tuple(p.astype(float) for p in net), x) for net in policy.nets or ()], axis=0))
    found = ask(policy, s)
    np.testing.assert_allclose(found.q, np.min(values, axis=0), atol=1e-13)
    np.testing.assert_array_equal(found.action, np.array(policy.actions)[np.argmin(values, axis=0)])
    if policy is POLICIES[0]:
        assert len(set(found.action)) > 1


@policies
@pytest.mark.parametrize("fault", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("port", range(6))
def test_a_broken_input_shows_in_every_backend(policy: NfqPolicy, port: int, fault: float) -> None:
    s = cars(3)
    s[port, 1] = fault
    one, batch = ask(policy, s[:, 1].tolist()), ask(policy, s)
    assert np.isnan([one.action, one.q]).all()
    assert np.isnan(batch.action).tolist() == np.isnan(batch.q).tolist() == [False, True, False]


@pytest.mark.parametrize("nets", [None, ()])
def test_without_a_net_it_is_not_ready(nets: Any) -> None:
    policy = NfqPolicy(nets=nets)
    assert ask(policy, [0.0] * 6) == (0.0, 0.0, 0.0)
    assert ask(policy, cars(4)).ready.tolist() == [0.0] * 4
    assert [float(value) for value in traced(policy)(1.0, [0.0] * 6)] == [0.0, 0.0, 0.0]


def test_ready_from_its_time_on() -> None:
    policy = replace(POLICIES[0], ready_from=2.0)
    assert [ask(policy, [0.0] * 6, t).ready for t in (1.9, 2.0, 3.0)] == [0.0, 1.0, 1.0]
    assert float(traced(policy)(1.9, [0.0] * 6)[1]) == 0.0
    assert ask(policy, cars(2), 1.0).ready.tolist() == [0.0, 0.0]
    assert ask(replace(policy, ready_from=np.inf), [0.0] * 6, 1e9).ready == 0.0


def test_of_equal_values_the_gentlest_action_wins_in_every_backend() -> None:
    flat_net: Net = (np.zeros((1, 7)), np.zeros(1))
    policy = NfqPolicy(nets=(flat_net,), actions=(1.0, -0.2, 0.2, -1.0))
    assert ask(policy, [0.1] * 6).action == -0.2
    assert ask(policy, cars(3)).action.tolist() == [-0.2] * 3
    assert float(traced(policy)(0.0, [0.1] * 6)[0]) == -0.2


@pytest.mark.parametrize("continuous", [False, True])
def test_mirrored_nets_steer_to_the_other_side(continuous: bool) -> None:
    """Turning the signs of the first layer's columns turns the car around: the actions swap sign."""
    policy = replace(POLICIES[0], continuous=continuous)
    turned = replace(policy, nets=tuple(mirror_image(net, STANDARD) for net in NETS))
    s = cars(50)
    here, there = ask(policy, s), ask(turned, np.array(STANDARD.mirror_signs)[:, None] * s)
    np.testing.assert_allclose(there.action, -here.action, atol=1e-9)
    np.testing.assert_allclose(there.q, here.q, atol=1e-14)


@policies
def test_saved_and_loaded_bit_for_bit(tmp_path: Path, policy: NfqPolicy) -> None:
    policy = replace(policy, ready_from=1.5, dt=0.1)
    policy.save(tmp_path / "a.npz")
    again = NfqPolicy.load(tmp_path / "a.npz")
    again.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert (again.actions, again.ready_from, again.dt) == (policy.actions, 1.5, 0.1)
    assert again.description == policy.description
    s = cars(1)[:, 0].tolist()
    assert ask(again, s, 2.0) == ask(policy, s, 2.0)
    for net, other in zip(policy.nets or (), again.nets or (), strict=True):
        assert [p.dtype for p in net] == [p.dtype for p in other]


def test_broken_and_foreign_files_are_named(tmp_path: Path) -> None:
    file = tmp_path / "p.npz"
    POLICIES[0].save(file)
    whole = file.read_bytes()
    np.savez(file, x=np.zeros(3))
    with pytest.raises(ValueError, match="expected 'steerkit policy 1'"):
        NfqPolicy.load(file)
    contents = dict(np.load(io.BytesIO(whole)))
    np.savez(file, **contents, combine="max")
    with pytest.raises(ValueError, match="not to be joined by their mean; learn anew"):
        NfqPolicy.load(file)
    contents["net0_2"] = np.full((10, 10), np.nan)
    np.savez(file, **contents)
    with pytest.raises(ValueError, match=r"p\.npz: .*layer 1 holds a NaN"):
        NfqPolicy.load(file)
    del contents["net0_2"], contents["actions"]
    np.savez(file, **contents)
    with pytest.raises(ValueError, match="does not hold together"):
        NfqPolicy.load(file)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"actions": ()}, "expected one or more"),
        ({"actions": (0.0, np.nan)}, "each finite"),
        ({"actions": (0.0, 36.4)}, r"36.4\) \[rad\], expected .* within \+-36"),
        ({"nets": (new_net((5, 10, 1)),)}, r"expected W \(n_out, 7\)"),
        ({"nets": (new_net((7, 10, 2)),)}, "the last layer has 2 units"),
        ({"nets": (new_net(), new_net((7, 1)))}, "one layout"),
        ({"nets": (new_net()[:3],)}, "a net of 3 arrays"),
        (
            {"description": StateDescription(names=("e",), low=(-1.0,), high=(1.0,), mirror_signs=(1.0,), goal=(0.1,))},
            "expected 6",
        ),
        ({"forecast": DelayCompensator()}, "preview_points"),
    ],
)
def test_wrong_parameters_are_taught(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        NfqPolicy(**wrong)


def test_at_speed_the_net_is_told_scaled_numbers_and_turns_the_wheel_less() -> None:
    plain = NfqPolicy(nets=NETS, description=StateDescription(action_scale=2.0), continuous=True)
    policy = replace(plain, description=replace(plain.description, scaled_from=4.0))
    e, e_dot, v, psi_e, r_e, doe = s = cars(200)
    x = np.maximum(v / 4.0, 1.0)
    assert 0 < (x > 1.0).sum() < 200
    asked = ask(policy, s)
    course = e_dot / np.maximum(v, 1.0)
    by_course = np.where(x > 1.0, course * x - (course - psi_e) * x**2, psi_e)
    by_hand = ask(plain, (e, e_dot, v / np.sqrt(x), by_course, r_e * x, doe * x**2))
    np.testing.assert_allclose(asked.action, by_hand.action / x**2, rtol=1e-10)
    np.testing.assert_allclose(asked.q, by_hand.q, rtol=1e-12)
    one_by_one = [ask(policy, tuple(float(value) for value in column)) for column in s.T]
    np.testing.assert_allclose([y.action for y in one_by_one], asked.action, rtol=1e-9)
    symbols = traced(policy)
    np.testing.assert_allclose([float(symbols(0.0, column)[0]) for column in s.T], asked.action, rtol=1e-9)
    of_the_set = ask(replace(policy, continuous=False), s)
    seen = patterns(policy.description, s.T, of_the_set.action, 2.0).astype(float)  # as training sees it
    np.testing.assert_allclose(np.mean([forward(net, seen) for net in NETS], axis=0), of_the_set.q, atol=2e-6)
