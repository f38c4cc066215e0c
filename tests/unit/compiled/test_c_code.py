"""Generated C: what Python's numbers and tables are there, and where a batch of cars goes on."""

import ctypes
import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steerkit._support import native
from steerkit.compiled import compile
from steerkit.compiled.c_code import MANY, ONE, run_source, scheduled, table_source
from steerkit.compiled.graph import BOOLEAN, FUNCTIONS, INFIX, Graph
from steerkit.compiled.python_code import PythonProgram
from steerkit.compiled.trace import trace
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, Out, State
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Table
from tests.support.places import ROOT
from tests.support.traced_blocks import mixed_loop, oscillating_loop

pytestmark = pytest.mark.skipif(native.compiler() is None, reason="needs a C compiler")


@dataclass(frozen=True, eq=False, kw_only=True)
class Counts(Block):
    """Counts up from `start`; `floor` bounds what it shows from below."""

    count = Out("1", direct=())
    start: float = 0.0
    floor: float = -math.inf

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.start, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(m.maximum(x[0], self.floor))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (x[0] + 1.0,)


@pytest.mark.parametrize("floor", [-math.inf, -2.0])
def test_infinite_parameters_keep_their_sign(floor: float) -> None:
    loop = Loop(blocks={"counts": Counts(floor=floor)}, wires=[])
    start = loop.with_block_state(loop.init(), "counts", (-5.0,))
    log = compile(loop, backend="c").run(0.3, state=start, allow_nonfinite=True)
    np.testing.assert_array_equal(log["counts.count"], np.maximum(np.arange(-5.0, 1.0), floor))


def test_a_loops_instructions_come_once_each_after_its_operands() -> None:
    for tick in trace(mixed_loop(0.05)).ticks:
        order = scheduled(tick.graph, tick.roots)
        assert sorted(order) == sorted(tick.graph.order(tick.roots))
        place = {i: n for n, i in enumerate(order)}
        assert all(place[j] < place[i] for i in order for j in tick.graph.operands(i))


def drawn_graph(seed: int) -> Graph:
    """A graph of all operations, each of operands that were drawn among the last ones."""
    graph, rng = Graph(), np.random.default_rng(seed)
    nodes = [graph.add("in", slot) for slot in range(8)]
    two, condition = [*INFIX, "atan2"], graph.add("lt", *nodes[:2])
    for op in rng.permutation([*INFIX, *sorted(FUNCTIONS), "neg", "abs", "not", "select", "row", "call"] * 12).tolist():
        a, b = rng.choice(nodes[-24:], 2).tolist()
        match op:
            case "select":
                node = graph.add(op, condition, a, b)
            case "row":
                node = graph.add(op, 0, a, 3)
            case "call":
                node = graph.add("result", graph.add(op, 0, 2, a, b), 1)
            case _:
                node = graph.add(op, *((a, b) if op in two else (a,)))
        condition = node if op in BOOLEAN else condition
        nodes.append(graph.number(node))
    return graph


def generated() -> dict[str, str]:
    """The text of generated code, and the order of instructions of all kinds."""
    found = {}
    for seed in range(3):
        graph = drawn_graph(seed)
        found[f"order {seed}"] = str(scheduled(graph, range(len(graph.nodes))))
    for name, loop in (("mixed", mixed_loop(0.1)), ("fast", mixed_loop(0.05)), ("oscillating", oscillating_loop())):
        made, recorded = trace(loop), (1, 2)
        found[f"{name} Python"] = PythonProgram(made, recorded, 3).source
        for many in (False, True):
            found[f"{name} C{' lanes' * many}"] = run_source(made, recorded, many=many)
    return found


def test_generated_code_is_what_was_written_down() -> None:
    """Which order is fastest shows in no result: whoever changes one on purpose replaces tests/golden/code.json."""
    found = {name: hashlib.sha256(text.encode()).hexdigest()[:12] for name, text in generated().items()}
    assert found == json.loads((ROOT / "tests/golden/code.json").read_text(encoding="utf-8")), json.dumps(found)


NAMES = ("sin", "cos", "tan", "atan", "asin", "acos", "tanh", "exp", "log", "sqrt", "floor")
TABLE = Table(np.arange(35.0).reshape(5, 7))


def library(head: str) -> ctypes.CDLL:
    """go(which, n, a, b, out): n a multiple of LANES; which: NAMES, then atan2, then column 4 of TABLE."""
    cases = [f"case {i}: y = CALL1({name}, x); break;" for i, name in enumerate(NAMES)]
    source = f"""#include <math.h>
{head}
{table_source((TABLE,), lanes=head is MANY)}
void go(int which, int n, const double *a, const double *b, double *out)
{{
  for (int i = 0; i < n; i += LANES)
  {{
    real x, z, y;
    memcpy(&x, a + i, sizeof x);
    memcpy(&z, b + i, sizeof z);
    switch (which)
    {{
      {" ".join(cases)}
      case {len(NAMES)}: y = CALL2(atan2, x, z); break;
      default: {{ ROW(row, 0, x); y = AT(row, 4); }}
    }}
    memcpy(out + i, &y, sizeof y);
  }}
}}
"""
    return native.load(source, fused=True, vector_maths=head is MANY)


@pytest.fixture(scope="module", params=[ONE, MANY], ids=["one car", "lanes"])
def call(request: pytest.FixtureRequest) -> Callable[..., np.ndarray]:
    made = library(request.param)

    def values(name: str, a: np.ndarray, b: np.ndarray | None = None) -> np.ndarray:
        n = -(-len(a) // 8) * 8
        first, second = (np.resize(np.asarray(v, dtype=float), n) for v in (a, a if b is None else b))
        out = np.empty(n)
        which = [*NAMES, "atan2", "row"].index(name)
        made.go(which, n, *[ctypes.c_void_p(v.ctypes.data) for v in (first, second, out)])
        return out[: len(a)]

    return values


def units(found: np.ndarray, true: np.ndarray) -> float:
    """The largest difference in units of the last place of the true value."""
    return float((np.abs(found - true) / np.spacing(np.abs(true))).max())


RNG = np.random.default_rng(5)
ANGLES = np.concatenate(
    [
        RNG.uniform(-8.0, 8.0, 4000),
        RNG.uniform(-1e5, 1e5, 2000),
        10.0 ** RNG.uniform(-300, 0, 500),
        [0.0, math.pi / 2.0],
    ]
)


@pytest.mark.parametrize(("name", "bound"), [("sin", 2.0), ("cos", 2.0), ("tan", 3.0)])
def test_functions_of_an_angle(call: Callable[..., np.ndarray], name: str, bound: float) -> None:
    assert units(call(name, ANGLES), getattr(np, name)(ANGLES)) <= bound


def test_arc_tangents_in_all_quadrants(call: Callable[..., np.ndarray]) -> None:
    x = np.concatenate([RNG.normal(0.0, 1.0, 4000), 10.0 ** RNG.uniform(-300, 300, 500), [0.0, -0.0, 1.0, math.inf]])
    for sign in (1.0, -1.0):
        assert units(call("atan", sign * x), np.arctan(sign * x)) <= 2.0
    near = np.tan(np.linspace(-1.55, 1.55, 2001))  # dense about the octants' ends
    assert units(call("atan", near), np.arctan(near)) <= 2.0
    y, z = RNG.normal(0.0, 1.0, (2, 4000))
    assert units(call("atan2", y, z), np.arctan2(y, z)) <= 2.0
    zero, some = np.zeros(4), np.array([0.0, 2.0, -2.0, math.inf])
    np.testing.assert_array_equal(call("atan2", zero, some), [0.0, 0.0, math.pi, 0.0])
    np.testing.assert_array_equal(call("atan2", some, zero), np.arctan2(some, zero))
    np.testing.assert_array_equal(call("atan2", -some[1:], zero[1:]), np.arctan2(-some[1:], zero[1:]))


def test_odd_functions_are_odd_to_the_last_bit(call: Callable[..., np.ndarray]) -> None:
    for name in ("sin", "tan", "atan"):
        np.testing.assert_array_equal(call(name, -ANGLES), -call(name, ANGLES))
    np.testing.assert_array_equal(call("cos", -ANGLES), call("cos", ANGLES))


@pytest.mark.parametrize("name", [*NAMES, "atan2", "row"])
def test_a_nan_stays_one(call: Callable[..., np.ndarray], name: str) -> None:
    broken, fine = np.full(3, math.nan), np.full(3, 0.5)
    assert np.isnan(call(name, broken, fine)).all()
    if name == "atan2":
        assert np.isnan(call(name, fine, broken)).all()


@pytest.mark.parametrize("name", ["asin", "acos", "tanh", "exp", "log", "sqrt", "floor"])
def test_the_others_are_the_librarys(call: Callable[..., np.ndarray], name: str) -> None:
    a = np.linspace(0.01, 0.99, 100)
    inverse = {"asin": "arcsin", "acos": "arccos"}.get(name, name)
    assert units(call(name, a), getattr(np, inverse)(a)) <= 4.0


def test_rows_of_a_table_and_none_outside_of_it(call: Callable[..., np.ndarray]) -> None:
    index = np.array([4.0, 0.0, -1.0, 2.0, 5.0, 1.0, 3.0, 1e300, -math.inf])
    expected = [TABLE.rows[int(i), 4] if 0.0 <= i < 5.0 else math.nan for i in index]
    np.testing.assert_array_equal(call("row", index), expected)
