"""Learned policies as ONNX models, for runtimes in other languages, and the check that they agree with the block."""

import math
import os
from dataclasses import replace
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import optional, require
from steerkit.controllers.network_policy import BOUND, Network, PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import ACTION, COLUMNS, UNITS, StateDescription
from steerkit.diagram.maths import Array

OPSET = 17


def export_onnx(block: NfqPolicy | PolicyBlock, file: str | os.PathLike[str]) -> None:
    """Write a policy as an ONNX model: scaling, nets, their mean and the choice of the action inside.

    Input `state` (N, columns): SI, columns as in the block's description, unscaled. Outputs: `action` (N,) [rad], for
    a dynamic output element, which stays outside; of an `NfqPolicy` also `q` (N,) [1], its expected cost. A state with
    a NaN or an infinity gives NaN. Numbers are float64; names, units and ranges stand in the model's metadata.

    Raises ValueError for a policy without nets, or one that is more than its nets (a forecast, actions between those of
    its set), or without onnx; TypeError for a block that holds no net.
    """
    if isinstance(block, NfqPolicy):
        require(bool(block.nets), "export_onnx", "the policy has no nets: nothing was learned yet")
        more = block.forecast is not None or block.continuous
        fault = (
            "the policy is more than its nets: it forecasts, or takes actions between those of its set. Export its "
            "loop as C (export_c), or learn with --setting model-free or --with fit.dead_time=0 --with continuous=false"
        )
        require(not more, "export_onnx", fault)
    elif not isinstance(block, PolicyBlock) or not isinstance(block.policy, Network):
        raise TypeError(f"export_onnx: {block!r}; valid: an NfqPolicy, or a PolicyBlock of a Network")
    graph = _Graph()
    actions, values = _nfq(graph, block) if isinstance(block, NfqPolicy) else (_network(graph, block), None)
    graph.finish(file, block.description, block.dt, action=actions, q=values)


def check_onnx(
    block: NfqPolicy | PolicyBlock, file: str | os.PathLike[str], *, states: int = 10_000, seed: int = 0
) -> dict[str, float]:
    """The largest differences between block and model, over random states of twice the description's ranges.

    Returns `action` [rad] and, of an NfqPolicy, `q` [1]. Actions whose costs are equal but for rounding count as one.
    """
    d = block.description
    s = d.mid + d.half * np.random.default_rng(seed).uniform(-2.0, 2.0, (states, len(d.names)))
    runtime = optional("onnxruntime", "check_onnx", "export")
    session = runtime.InferenceSession(os.fspath(file), providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]
    answers = dict(zip(names, session.run(names, {"state": s})))
    columns = dict(zip(d.names, s.T))
    u = block.D(**{port: columns.get(port, np.zeros(states)) for port in block.D._fields})
    y = block.output(0.0, (), u)
    gaps = {name: np.abs(answers[name] - getattr(y, name)) for name in names}
    if isinstance(block, NfqPolicy):
        gaps["action"][_equally_good(block, u, answers["action"])] = 0.0
    return {name: float(gap.max()) for name, gap in gaps.items()}


def _equally_good(policy: NfqPolicy, u: Any, answer: Array) -> NDArray[np.bool_]:
    """Where the answer is an action of the set whose cost is the least there is."""
    d = policy.description
    alone = replace(d, action_scale=d.scale_of(policy.actions))
    costs = np.stack([replace(policy, actions=(a,), description=alone).output(0.0, (), u).q for a in policy.actions])
    off = np.abs(np.outer(policy.actions, d.excess(u.v) ** -2.0) - answer)
    chosen = np.take_along_axis(costs, off.argmin(axis=0)[None, :], axis=0)[0]
    found: NDArray[np.bool_] = (off.min(axis=0) <= 1e-6) & (chosen - costs.min(axis=0) <= 1e-12)
    return found


def _nfq(graph: "_Graph", policy: NfqPolicy) -> tuple[str, str]:
    """The graph of the greedy policy; its nets see the state and, in the last column, the action."""
    order, d = sorted(policy.actions, key=abs), policy.description  # of equal values the gentlest action's comes first
    state, excess = "state", None
    if d.scaled_from < math.inf:  # see StateDescription.scaled
        v, e_dot, psi_e = (
            graph.op("Gather", state, graph.whole(COLUMNS.index(name)), axis=1) for name in ("v", "e_dot", "psi_e")
        )
        excess = graph.op("Max", graph.op("Div", v, graph.number(d.scaled_from)), graph.number(1.0))
        turning = graph.op("Sub", graph.op("Div", e_dot, graph.op("Max", v, graph.number(d.scaled_from))), psi_e)
        more = graph.op("Mul", turning, graph.op("Sub", graph.op("Mul", excess, excess), excess))
        state = graph.op("Mul", state, graph.op("Pow", excess, graph.number([[0.0, 0.0, -0.5, 1.0, 1.0, 2.0]])))
        state = graph.op("Sub", state, graph.op("Mul", more, graph.number([[0.0, 0.0, 0.0, 1.0, 0.0, 0.0]])))
    scaled = graph.op("Div", graph.op("Sub", state, graph.number(d.mid)), graph.number(d.half))
    of_nets = []
    for net in policy.nets or ():
        (w, b), *following = zip(net[::2], net[1::2])
        action = np.outer(np.array(order) / d.scale_of(policy.actions), w[:, ACTION]) + b
        first = graph.op("MatMul", scaled, graph.number(w[:, :ACTION].T))
        first = graph.op("Unsqueeze", first, graph.whole(1))  # (N, 1, units), to be added to (actions, units)
        h = graph.op("Sigmoid", graph.op("Add", first, graph.number(action)))
        for w, b in following:
            h = graph.op("Sigmoid", graph.op("Add", graph.op("MatMul", h, graph.number(w.T)), graph.number(b)))
        of_nets.append(h)
    q = graph.op("ReduceMean", graph.op("Concat", *of_nets, axis=2), axes=[2], keepdims=0)
    best = graph.op("ArgMin", q, axis=1, keepdims=0)
    chosen, lowest = graph.op("Gather", graph.number(order), best), graph.op("ReduceMin", q, axes=[1], keepdims=0)
    if excess is not None:
        share = graph.op("Pow", graph.op("Squeeze", excess, graph.whole(1)), graph.number(-2.0))
        chosen = graph.op("Mul", chosen, share)
    return chosen, lowest


def _network(graph: "_Graph", block: PolicyBlock) -> str:
    """The graph of a policy block's net and its head."""
    d, net = block.description, cast(Network, block.policy)
    h = graph.op("Div", graph.op("Sub", "state", graph.number(d.mid)), graph.number(d.half))
    h = graph.op("Clip", h, graph.number(-BOUND), graph.number(BOUND))
    for i, (w, b) in enumerate(net.layers):
        h = graph.op("Add", graph.op("MatMul", h, graph.number(w.T)), graph.number(b))
        if i < len(net.layers) - 1:
            h = graph.op("Relu" if net.activation == "relu" else "Tanh", h)
    if net.head == "argmax":
        return graph.op("Gather", graph.number(block.actions or ()), graph.op("ArgMax", h, axis=1, keepdims=0))
    h = graph.op("Squeeze", h, graph.whole(1))
    h = graph.op("Tanh", h) if net.head == "tanh" else graph.op("Clip", h, graph.number(-1.0), graph.number(1.0))
    return graph.op("Mul", h, graph.number(block.largest))


class _Graph:
    """Nodes and constants while a model is being made."""

    def __init__(self) -> None:
        self.onnx = optional("onnx", "export_onnx", "export")
        self._nodes: list[Any] = []
        self._constants: list[Any] = []

    def number(self, value: Any, kind: Any = np.float64) -> str:
        """A constant of numbers, floating-point ones if not told otherwise."""
        name = f"c{len(self._constants)}"
        array = np.array(value, dtype=kind)
        self._constants.append(self.onnx.numpy_helper.from_array(array, name))
        return name

    def whole(self, *value: int) -> str:
        """A constant of whole numbers."""
        return self.number(value, np.int64)

    def op(self, kind: str, *inputs: str, **attributes: Any) -> str:
        """A node; returns the name of what it computes."""
        name = f"{kind.lower()}{len(self._nodes)}"
        self._nodes.append(self.onnx.helper.make_node(kind, list(inputs), [name], **attributes))
        return name

    def finish(self, file: str | os.PathLike[str], d: StateDescription, dt: float, **outputs: str | None) -> None:
        """Write the model with these outputs, which are NaN where the state is not sound."""
        helper = self.onnx.helper
        kind = self.onnx.TensorProto.DOUBLE
        total = self.op("ReduceSum", "state", self.whole(1), keepdims=0)
        sound = self.op("LessOrEqual", self.op("Abs", total), self.number(1e300))
        written = {name: value for name, value in outputs.items() if value is not None}
        for name, value in written.items():
            self._nodes.append(helper.make_node("Where", [sound, value, self.number(np.nan)], [name]))
        columns = ", ".join(f"{name} [{UNITS[name]}]" for name in d.names)
        graph = helper.make_graph(
            self._nodes,
            "policy",
            [helper.make_tensor_value_info("state", kind, ["N", len(d.names)], f"columns {columns}")],
            [
                helper.make_tensor_value_info(name, kind, ["N"], "[rad]" if name == "action" else "[1]")
                for name in written
            ],
            self._constants,
        )
        model = helper.make_model(
            graph,
            opset_imports=[helper.make_opsetid("", OPSET)],
            ir_version=8,
            producer_name="steerkit",
            doc_string=f"Greedy policy. state (N, {len(d.names)}): {columns}; action (N,) [rad], every {dt:g} s.",
        )
        about = {"columns": columns, "low": list(d.low), "high": list(d.high), "sample_time_s": dt}
        helper.set_model_props(model, {name: str(value) for name, value in about.items()})
        self.onnx.checker.check_model(model, full_check=True)
        with open(file, "wb") as stream:
            stream.write(model.SerializeToString())
