"""Nets in C have the bits of the nets that NumPy computes, and open policies those of the policies they stand for."""

from __future__ import annotations

import math
import operator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit._support.native import compiler
from steerkit.controllers import nfq_native
from steerkit.controllers.delay_compensator import LONGEST, PREVIEW, DelayCompensator
from steerkit.controllers.nfq_native import Kind, NativeNets, NotTheSameError, OpenPolicy, numbers_of
from steerkit.controllers.nfq_policy import BANG_BANG_ACTIONS, COMBINATIONS, NfqPolicy
from steerkit.controllers.state_description import StateDescription

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C compiler")


def policy(hidden: tuple[int, ...] = (10, 10), nets: int = 4, **changes: Any) -> NfqPolicy:
    rng = np.random.default_rng(5)
    sizes = (7, *hidden, 1)
    made = tuple(
        tuple(p for n, k in zip(sizes[1:], sizes) for p in (rng.normal(size=(n, k)), rng.normal(size=n)))
        for _ in range(nets)
    )
    return NfqPolicy(nets=made, **changes)


def states(count: int) -> Any:
    about = StateDescription()
    return (about.mid + about.half * np.random.default_rng(2).uniform(-2.0, 2.0, (count, 6))).tolist()


@pytest.mark.parametrize("combine", COMBINATIONS)
@pytest.mark.parametrize(
    ("hidden", "nets", "actions"),
    [((10, 10), 16, 7), ((10, 10), 1, 5), ((20, 7), 3, 19), ((5,), 2, 2), ((), 2, 5), ((6, 5, 4), 2, 8)],
)
def test_the_values_have_the_same_bits(combine: Any, hidden: tuple[int, ...], nets: int, actions: int) -> None:
    one = policy(hidden, nets, combine=combine, actions=tuple(np.linspace(-0.4, 0.5, actions)))
    native = NativeNets(one)
    for state in states(300):
        assert np.array(native(*state)).tobytes() == one._values(np.array(state)[:, None]).tobytes()


def test_a_machine_whose_functions_are_others_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = nfq_native._loop_of
    monkeypatch.setattr(nfq_native, "_loop_of", lambda function: whole(np.sin if function is np.tanh else function))
    with pytest.raises(NotTheSameError, match="differ"):
        NativeNets(policy())


def test_numpy_with_another_layout_is_found_out() -> None:
    with pytest.raises(NotTheSameError, match="elsewhere"):
        nfq_native._loop_of(np.bitwise_and)  # it has none over doubles


def test_what_differs_is_open_and_what_does_not_is_the_kind() -> None:
    one = policy()
    assert Kind(one) == Kind(policy((5,), 2, ready_from=3.0))
    for other in (
        policy(actions=BANG_BANG_ACTIONS),
        policy(continuous=True),
        policy(preview_points=PREVIEW),
        policy(dt=0.1),
        policy(description=replace(StateDescription(), scaled_from=8.0)),
    ):
        assert Kind(one) != Kind(other)
    told = policy(preview_points=PREVIEW, forecast=DelayCompensator(samples=3, now=0.4), ready_from=2.0)
    assert numbers_of(told)[:4] == (2.0, 1.0, 3.0, 0.4)
    assert numbers_of(policy(preview_points=PREVIEW))[:3] == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("samples", [None, 0, 1, 2, 5, LONGEST])
def test_an_open_policy_is_the_policy_at_every_dead_time(samples: int | None) -> None:
    """On symbols, with the numbers put in: to the last bit, by the Python that is generated of it."""
    import casadi

    from steerkit.compiled.graph import from_symbols
    from steerkit.compiled.trace import exact_arithmetic, recorded_lookups

    car = DelayCompensator(
        now=0.02, before=0.03, earlier=0.01, back=0.3, slip=0.001, yaw=0.4, straight=0.05, trust=0.3, loss=0.002
    )
    told = None if samples is None else replace(car, samples=samples)
    about = replace(StateDescription(), scaled_from=8.0)
    one = policy(preview_points=PREVIEW, forecast=told, continuous=True, description=about)
    opened = OpenPolicy.of(one)
    numbers = numbers_of(one)
    p = [casadi.SX.sym(f"p{i}") for i in range(len(numbers))]
    x = [casadi.SX.sym(f"x{i}") for i in range(len(one.init()))]
    u = [casadi.SX.sym(f"u{i}") for i in range(6 + PREVIEW)]
    t = casadi.SX.sym("t")
    block = replace(opened, numbers=tuple(p))
    with recorded_lookups({}, {}) as questions, exact_arithmetic():
        given = block.U(*u[:6], tuple(u[6:]))
        y = block.output(t, tuple(x), given)
        after = block.update(t, tuple(x), given, y)
    graph, roots = from_symbols([casadi.SX(v) for v in (*y, *after)], [t, *x, *u, *p], questions)
    native = NativeNets(one)
    rng = np.random.default_rng(7)
    for state in states(30):
        remembered = (*tuple(rng.uniform(-0.5, 0.5, len(x) - 2).tolist()), 6.0, 0.01)
        seen = [*state, *rng.uniform(-0.02, 0.02, PREVIEW).tolist()]
        seen[2] = abs(seen[2]) + 2.0
        inputs = one.U(*seen[:6], tuple(seen[6:]))
        theirs = one.output(1.0, remembered, inputs)
        expected = [*theirs, *one.update(1.0, remembered, inputs, theirs)]
        assert computed(graph, roots, [1.0, *remembered, *seen, *numbers], native) == expected


def computed(graph: Any, roots: Any, inputs: list[float], nets: NativeNets) -> list[float]:
    """The roots of a graph, in Python's floats."""
    binary = {
        "add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "lt": operator.lt,
        "le": operator.le, "eq": operator.eq, "ne": operator.ne, "and": operator.and_, "or": operator.or_,
    }  # fmt: skip
    values: dict[int, Any] = {}
    for i in graph.order(roots):
        op, *rest = graph.nodes[i]
        if op == "const":
            values[i] = float.fromhex(rest[0])
        elif op == "in":
            values[i] = inputs[rest[0]]
        elif op == "call":
            values[i] = nets(*[values[j] for j in rest[2:]])
        elif op == "result":
            values[i] = values[rest[0]][rest[1]]
        elif op == "select":
            values[i] = values[rest[1]] if values[rest[0]] else values[rest[2]]
        elif op in binary:
            values[i] = binary[op](*[values[j] for j in rest])
        else:
            values[i] = {"neg": operator.neg, "abs": abs, "not": operator.not_, "sqrt": math.sqrt}[op](values[rest[0]])
    return [values[i] for i in roots]
