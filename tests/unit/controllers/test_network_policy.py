"""Networks and any function as controllers: as in the environment, compiled, from their file."""

from typing import Any

import numpy as np
import pytest

from steerkit.compiled import TraceError, compile
from steerkit.controllers.nfq_policy import IDOE_ACTIONS
from steerkit.controllers.policy import StateDescription
from steerkit.diagram.units import radians_of
from steerkit.doe import Integrator
from steerkit.gym import Network, PolicyBlock
from steerkit.scenario import Scenario
from steerkit.scenario.drive import drive_loop


def test_only_a_network_can_be_compiled() -> None:
    other = PolicyBlock(policy=lambda x: np.zeros(len(x)))
    with pytest.raises(TraceError, match="is no Network: it cannot be traced"):
        compile(drive_loop(Scenario(course="circle"), other, doe=Integrator()), backend="python")


def test_a_policy_block_comes_back_from_its_file(tmp_path: Any) -> None:
    rng = np.random.default_rng(2)
    net = Network(layers=((rng.normal(size=(4, 6)), rng.normal(size=4)), (rng.normal(size=(5, 4)), rng.normal(size=5))))
    block = PolicyBlock(policy=net, actions=IDOE_ACTIONS)
    block.save(tmp_path / "p.npz")
    again = PolicyBlock.load(tmp_path / "p.npz")
    u = block.D(*rng.normal(size=(6, 50)))
    np.testing.assert_array_equal(again.output(0.0, (), u).action, block.output(0.0, (), u).action)
    assert again.description == block.description
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
    edge = PolicyBlock(policy=lambda x: [-1.0])
    assert edge.output(0.0, (), u).action == pytest.approx(radians_of(-25.0))
    assert PolicyBlock(policy=lambda x: [2], actions=(-0.1, 0.0, 0.1)).output(0.0, (), u).action == 0.1
    for wrong in ([3.0], [-1.0], [0.5]):
        with pytest.raises(ValueError, match="expected whole numbers 0 to 2"):
            PolicyBlock(policy=lambda x, wrong=wrong: wrong, actions=(-0.1, 0.0, 0.1)).output(0.0, (), u)
    seen: list[np.ndarray] = []
    PolicyBlock(policy=lambda x: seen.append(x) or [0.0]).output(0.0, (), u._replace(e=99.0, e_dot=-99.0))
    assert seen[0][0, :2].tolist() == [10.0, -10.0]
    for policy, says in (
        (lambda x: [1.01], r"within \[-1, 1\]"),
        (lambda x: [0.0, 0.0], "answered .0.0, 0.0., expected .*: 1 in all"),
    ):
        with pytest.raises(ValueError, match=says):
            PolicyBlock(policy=policy).output(0.0, (), u)


@pytest.mark.parametrize("value", [-0.7, -0.2, 0.0, 0.5])
@pytest.mark.parametrize("name", StateDescription().names)
def test_a_policy_sees_each_column_as_a_share_of_its_range(name: str, value: float) -> None:
    """A net that hands one column on: 0 in the middle of its range, 1 at its upper end."""
    d = StateDescription()
    row = [[float(n == name) for n in d.names]]
    block = PolicyBlock(policy=Network(layers=((np.array(row), np.zeros(1)),), head="clip"), largest=0.4)
    low, high = d.low[d.names.index(name)], d.high[d.names.index(name)]
    middle = {n: 0.5 * (a + b) for n, a, b in zip(d.names, d.low, d.high)}
    u = block.D(**middle | {name: 0.5 * (low + high) + value * 0.5 * (high - low)})
    assert block.output(0.0, (), u).action == pytest.approx(0.4 * value, abs=1e-9)


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"layers": ()}, "no layers"),
        ({"layers": ((np.ones((2, 6)), np.zeros(3)),)}, r"layer 0: W \(2, 6\), b \(3,\)"),
        ({"layers": ((np.ones((2, 6)), np.zeros(2)), (np.ones((1, 3)), np.zeros(1)))}, r"layer 1: .*\(n_out, 2\)"),
        ({"layers": ((np.ones(6), np.zeros(6)),)}, "layer 0: W"),
        ({"layers": ((1.0, 0.0),)}, "layer 0: W"),
        ({"layers": ((np.full((2, 6), np.inf), np.zeros(2)),)}, "layer 0 holds a NaN or an infinity"),
        ({"layers": ((np.ones((2, 6)), np.array([0.0, np.nan])),)}, "layer 0 holds a NaN or an infinity"),
        ({"head": "tanh"}, "2 outputs, expected 1 for the head 'tanh'"),
        ({"head": "softmax"}, "valid: argmax, tanh, clip"),
        ({"activation": "sigmoid"}, "valid: relu, tanh"),
    ],
)
def test_a_network_that_does_not_fit_together_is_refused(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        Network(**{"layers": ((np.ones((2, 6)), np.zeros(2)),)} | wrong)


@pytest.mark.parametrize(("activation", "hidden"), [("relu", lambda z: np.maximum(z, 0.0)), ("tanh", np.tanh)])
def test_a_network_by_hand(activation: Any, hidden: Any) -> None:
    rng = np.random.default_rng(3)
    (a, b), (c, d) = layers = tuple((rng.normal(size=(n, k)), rng.normal(size=n)) for n, k in ((4, 6), (1, 4)))
    x = rng.normal(size=(20, 6))
    z = (c @ hidden(a @ x.T + b[:, None]) + d[:, None])[0]
    for head, last in (("tanh", np.tanh(z)), ("clip", np.clip(z, -1.0, 1.0))):
        net = Network(layers=layers, activation=activation, head=head)  # type: ignore[arg-type]
        np.testing.assert_allclose(net(x), last, atol=1e-12)
        np.testing.assert_allclose([net.symbolic(row.tolist(), ()) for row in x], last, atol=1e-12)
