"""A policy as an ONNX model says what the block says, and refuses what it cannot say."""

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import StateDescription
from steerkit.export.onnx import check_onnx, export_onnx

RNG = np.random.default_rng(0)


def net(*units: int) -> tuple[np.ndarray, ...]:
    sizes = (7, *units, 1)
    return tuple(p for a, b in pairwise(sizes) for p in (RNG.normal(size=(b, a)), RNG.normal(size=b)))


def layers(*sizes: int) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    return tuple((RNG.normal(size=(b, a)), RNG.normal(size=b)) for a, b in pairwise(sizes))


POLICIES: list[Any] = [
    NfqPolicy(nets=(net(10, 10), net(10, 10), net(10, 10))),
    NfqPolicy(nets=(net(5), net(5)), actions=(-6.28, 6.28)),
    NfqPolicy(nets=(net(20, 20, 3),), description=StateDescription(action_scale=0.3)),
    NfqPolicy(nets=(net(10, 10), net(10, 10)), description=StateDescription(scaled_from=6.0)),
    PolicyBlock(policy=Network(layers=layers(6, 16, 16, 3)), actions=(-0.1, 0.0, 0.1)),
    PolicyBlock(policy=Network(layers=layers(6, 16, 1), activation="tanh", head="tanh")),
    PolicyBlock(policy=Network(layers=layers(6, 16, 1), head="clip"), largest=0.7),
]


def ask(file: Path, state: Any) -> dict[str, np.ndarray]:
    session = onnxruntime.InferenceSession(str(file))
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, {"state": np.atleast_2d(np.asarray(state, dtype=float))})))


@pytest.mark.parametrize("policy", POLICIES, ids=lambda p: type(p).__name__)
def test_the_model_says_what_the_block_says(policy: Any, tmp_path: Path) -> None:
    export_onnx(policy, tmp_path / "p.onnx")
    differences = check_onnx(policy, tmp_path / "p.onnx", states=20_000)
    assert set(differences) == ({"action", "q"} if isinstance(policy, NfqPolicy) else {"action"})
    assert all(difference <= 1e-6 for difference in differences.values())
    assert differences.get("q", 0.0) <= 1e-14


def test_the_check_tells_a_worse_action_and_lets_one_as_good_pass(tmp_path: Path) -> None:
    """Nets that see the action with its sign turned have the same least cost, and choose the opposite."""
    policy, turned = POLICIES[0], np.diag([1.0] * 6 + [-1.0])
    export_onnx(policy, tmp_path / "p.onnx")
    opposite = replace(policy, nets=tuple((w @ turned, *rest) for w, *rest in policy.nets))
    told = check_onnx(opposite, tmp_path / "p.onnx")
    assert told["q"] < 1e-12
    assert told["action"] > 0.1
    flat = NfqPolicy(nets=(tuple(np.zeros_like(p) for p in net(4)),), actions=(-0.5, 0.2))
    export_onnx(flat, tmp_path / "p.onnx")
    assert check_onnx(replace(flat, actions=(-0.5, 0.2, -0.1)), tmp_path / "p.onnx") == {"action": 0.0, "q": 0.0}
    assert check_onnx(replace(flat, actions=(-0.5, 0.3)), tmp_path / "p.onnx")["action"] == pytest.approx(0.1)


def test_of_equal_values_the_gentlest_action_wins_there_too(tmp_path: Path) -> None:
    flat = tuple(np.zeros_like(p) for p in net(4))
    export_onnx(NfqPolicy(nets=(flat,), actions=(-0.5, 0.2, -0.1, 0.3)), tmp_path / "p.onnx")
    told = ask(tmp_path / "p.onnx", [0.1] * 6)
    assert (told["action"].tolist(), told["q"].tolist()) == ([-0.1], [0.5])


def test_a_broken_state_gives_nan_and_spares_the_others(tmp_path: Path) -> None:
    export_onnx(POLICIES[0], tmp_path / "p.onnx")
    states = np.full((3, 6), 0.1)
    states[0, 2], states[1, 4] = np.nan, np.inf
    told = ask(tmp_path / "p.onnx", states)
    for values in told.values():
        assert np.isnan(values).tolist() == [True, True, False]


def test_what_is_no_net_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no nets: nothing was learned"):
        export_onnx(NfqPolicy(), tmp_path / "p.onnx")
    with pytest.raises(TypeError, match="valid: an NfqPolicy, or a PolicyBlock of a Network"):
        export_onnx(PolicyBlock(policy=lambda x: x[:, 0]), tmp_path / "p.onnx")


def test_far_outside_its_range_an_agent_sees_the_bound(tmp_path: Path) -> None:
    """Observations are cut off at ten half-widths, where the agent learned: beyond, nothing changes any more."""
    policy = PolicyBlock(policy=Network(layers=((np.full((1, 6), 0.01), np.zeros(1)),), head="tanh"), largest=0.7)
    export_onnx(policy, tmp_path / "p.onnx")
    d = policy.description
    for reach in (-40.0, -12.0, -9.0, 0.0, 9.0, 12.0, 40.0):
        state = d.mid + reach * d.half
        told = ask(tmp_path / "p.onnx", state)["action"]
        assert told == pytest.approx(0.7 * np.tanh(0.06 * np.clip(reach, -10.0, 10.0)))
        assert told == pytest.approx(float(policy.output(0.0, (), policy.D(*state)).action))
