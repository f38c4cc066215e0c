"""Compiled loops: closed forms, continuation, parameters, errors, cache, gradients."""

from __future__ import annotations

import math
import os
import subprocess
import sys
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit import compiled, native
from steerkit import maths as m
from steerkit.block import Block, In, Out, State
from steerkit.compiled import TraceError, compile, gradient
from steerkit.compiled.graph import Graph
from steerkit.compiled.trace import trace
from steerkit.loop import Loop
from steerkit.maths import Table
from steerkit.random import normals, seed_state
from steerkit.simulation import NonFiniteError, simulate
from tests.support.places import ROOT

BACKENDS = [
    "python",
    "vm",
    pytest.param("c", marks=pytest.mark.skipif(native.compiler() is None, reason="needs a C compiler")),
]


@dataclass(frozen=True, eq=False, kw_only=True)
class Decay(Block):
    """x(k+1) = a x(k) + b u."""

    u = In("1", direct=False)
    x = Out("1", direct=())

    a: Any = 0.9
    b: float = 0.0
    x0: Any = 1.0

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.x0, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (self.a * x[0] + self.b * u.u,)


@dataclass(frozen=True, eq=False, kw_only=True)
class Held(Block):
    """A value that stays what it was at the start."""

    v = Out("1", direct=())
    value: Any = 0.5

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(self.value, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Mixed(Block):
    """Everything that equations may hold: time, tables, choices, functions, a vector port, random numbers."""

    u = In("1")
    y = Out("1")
    row = Out("1", size="n")
    noise = Out("1")
    n: int = 2
    seed: int = 1
    table: Table = field(default_factory=lambda: Table([[0.0, 1.0], [2.0, -1.0], [0.5, 0.25]]))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return seed_state(self.seed, batch)

    def output(self, t: Any, x: State, u: Any) -> Any:
        z = m.wrap(7.0 * t + u.u)
        i = m.clip(m.floor(1.0 + z), 0.0, 2.0)
        a, b = self.table(i)
        c, _ = self.table(m.floor(m.clip(a, 0.0, 2.0)))
        bent = m.where(m.both(z > 0.0, m.either(a < 1.0, b <= 0.5)), m.atan2(a, 1.0 + z * z), m.tanh(z) - m.absolute(b))
        n1, n2, _ = normals(x)
        return self.Y(bent + m.sign(z) * m.exp(-z * z) + m.sqrt(0.1 + m.absolute(c)) * m.tan(0.1 * z), (a, c), n1 + n2)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return normals(x)[2]


@dataclass(frozen=True, eq=False, kw_only=True)
class Branching(Block):
    """Not traceable: an `if` on a signal."""

    u = In("1")
    y = Out("1")

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(1.0 if u.u > 0.0 else 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Hardware(Branching):
    """Not pure."""

    pure = False


@dataclass(frozen=True, eq=False, kw_only=True)
class Derived(Decay):
    """Works a parameter into another number when it is built, and checks it."""

    def __post_init__(self) -> None:
        if not 0.0 < self.a < 1.0:
            raise ValueError("a")
        object.__setattr__(self, "twice", 2.0 * self.a)


def decay_loop(**kwargs: Any) -> Loop:
    held, decay = Held(), Decay(**kwargs)
    return Loop(blocks={"held": held, "decay": decay}, wires=[(held.v, decay.u)])


def mixed_loop(dt: float = 0.05) -> Loop:
    held, decay, mixed = Held(dt=dt), Decay(b=0.3, dt=dt), Mixed(dt=0.05)
    return Loop(blocks={"held": held, "decay": decay, "mixed": mixed}, wires=[(mixed.y, decay.u), (decay.x, mixed.u)])


def worst(a: Any, b: Any) -> float:
    assert list(a) == list(b)
    assert np.array_equal(a.t, b.t)
    return max(float(np.max(np.abs(a[n] - b[n]), initial=0.0)) for n in a)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_decay_is_its_closed_form(backend: Any) -> None:
    log = compile(decay_loop(a=0.9, b=0.2), backend=backend).run(2.0)
    k = np.arange(40)
    np.testing.assert_allclose(log["decay.x"], 1.0 + 0.0 * k, rtol=0, atol=1e-15)  # x = 0.9 x + 0.2*0.5, from 1
    log = compile(decay_loop(a=0.9), backend=backend).run(2.0)
    np.testing.assert_allclose(log["decay.x"], 0.9**k, rtol=1e-14)
    assert log.state.k == 40
    assert log.state.x[1][0] == pytest.approx(0.9**40, rel=1e-14)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("dt", [0.05, 0.025])
def test_every_operation_agrees_with_simulate(backend: Any, dt: float) -> None:
    loop = mixed_loop(dt)
    log = compile(loop, backend=backend, collapse=False).run(5.0)
    assert worst(log, simulate(loop, 5.0)) <= 1e-13
    assert log["mixed.row"].shape == (len(log.t), 2)
    many = compile(loop, backend=backend).run(2.0, batch=11)
    batch = simulate(loop, 2.0, batch=11)
    assert many["mixed.row"].shape == (len(many.t), 2, 11)
    assert worst(many, batch) <= 1e-13
    assert np.ptp(many["mixed.noise"][5]) > 0.1  # each car draws its own noise


@pytest.mark.parametrize("backend", BACKENDS)
def test_random_numbers_are_the_same_to_the_last_bit(backend: Any) -> None:
    loop = mixed_loop()
    log = compile(loop, backend=backend, record=()).run(60.0)
    assert log.state.x[2] == simulate(loop, 60.0, record=()).state.x[2]
    many = compile(loop, backend=backend, record=()).run(10.0, batch=9)
    for ours, theirs in zip(many.state.x[2], simulate(loop, 10.0, batch=9, record=()).state.x[2]):
        assert np.array_equal(ours, theirs)


@pytest.mark.parametrize("backend", BACKENDS)
def test_runs_go_on_from_any_tick_with_any_decimation(backend: Any) -> None:
    loop = mixed_loop(0.025)
    c = compile(loop, backend=backend, every=3, record=["mixed.y", "decay.x"])
    first, first_ref = c.run(0.325), simulate(loop, 0.325, every=3, record=["mixed.y", "decay.x"])
    assert worst(first, first_ref) <= 1e-13
    second = c.run(0.7, state=first.state)
    assert worst(second, simulate(loop, 0.7, state=first_ref.state, every=3, record=["mixed.y", "decay.x"])) <= 1e-13
    assert second.t[0] == pytest.approx(0.375)
    state, sample = c.step(first.state)
    expected, reference = loop.step(first_ref.state)
    assert state.k == expected.k == 14
    assert sample["mixed.y"] == pytest.approx(reference["mixed.y"], abs=1e-13)
    assert type(state.y[2]) is type(expected.y[2])
    assert simulate(loop, 0.1, state=state)["decay.x"][-1] == pytest.approx(c.run(0.1, state=state).state.y[1][0])


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_car_has_its_parameters_and_start(backend: Any) -> None:
    c = compile(decay_loop(), backend=backend, parameters=["decay.a", "decay.x0"])
    a, x0 = np.linspace(0.5, 0.95, 10), np.linspace(1.0, 2.0, 10)
    log = c.run(1.0, parameters={"decay.a": a, "decay.x0": x0})
    np.testing.assert_allclose(log["decay.x"], x0 * a ** np.arange(20)[:, None], rtol=1e-13)
    one = c.run(1.0, parameters={"decay.a": 0.5})
    np.testing.assert_allclose(one["decay.x"], 0.5 ** np.arange(20), rtol=1e-14)


@pytest.mark.parametrize("backend", BACKENDS)
def test_held_signals_become_constants_of_each_start(backend: Any) -> None:
    c = compile(decay_loop(a=0.5, b=1.0), backend=backend, collapse=True)
    loop = c.loop
    for value in (0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 0.5):
        state = loop.with_block_state(loop.init(), "held", (value,))
        log = c.run(3.0, state=state)
        assert log["decay.x"][-1] == pytest.approx(2.0 * value, rel=1e-12)
        assert log["held.v"][-1] == value
    batch = loop.with_block_state(loop.init(batch=4), "held", (np.array([1.0, 2.0, 3.0, 4.0]),))
    np.testing.assert_allclose(c.run(3.0, state=batch)["decay.x"][-1], [2.0, 4.0, 6.0, 8.0], rtol=1e-12)


def test_linear_substeps_collapse_to_one_step_matrix() -> None:
    @dataclass(frozen=True, eq=False, kw_only=True)
    class Oscillator(Block):
        v = In("1", direct=False)
        x = Out("1", direct=())

        def init(self, batch: tuple[int, ...] = ()) -> State:
            return (m.filled(1.0, batch), m.filled(0.0, batch))

        def output(self, t: Any, x: State, u: Any) -> Any:
            return self.Y(x[0])

        def update(self, t: Any, x: State, u: Any, y: Any) -> State:
            for _ in range(20):
                x = m.rk4(lambda z: (z[1], -u.v * z[0]), x, self.dt / 20)
            return tuple(x)

    held, oscillator = Held(value=4.0), Oscillator()
    loop = Loop(blocks={"held": held, "oscillator": oscillator}, wires=[(held.v, oscillator.v)])
    whole = trace(loop)
    assert whole.instructions > 300
    assert whole.with_held((4.0,) * len(whole.held)).instructions <= 6  # two rows of two products and a sum
    log = compile(loop, backend="python", collapse=True).run(5.0)
    np.testing.assert_allclose(log["oscillator.x"], np.cos(2.0 * log.t), atol=1e-9)
    assert worst(log, simulate(loop, 5.0)) < 1e-12


def test_errors_name_the_block_and_the_way_out() -> None:
    for block, message in (
        (Branching(), r"what \(Branching\) cannot be run on symbols.*m\.where"),
        (Hardware(), r"what \(Hardware\) is not pure.*simulate"),
    ):
        decay = Decay()
        loop = Loop(blocks={"what": block, "decay": decay}, wires=[(block.y, decay.u), (decay.x, block.u)])
        with pytest.raises(TraceError, match=message):
            compile(loop, backend="python")
    loop = decay_loop()
    with pytest.raises(KeyError, match=r"did you mean 'decay\.x'"):
        compile(loop, backend="python", record=["decay.z"])
    with pytest.raises(TraceError, match=r"has no field 'c'; fields: .*a, b"):
        compile(loop, backend="python", parameters=["decay.c"])
    with pytest.raises(ValueError, match="was not left open"):
        compile(loop, backend="python").run(1.0, parameters={"decay.a": 1.0})
    with pytest.raises(ValueError, match="different numbers of cars"):
        compile(loop, backend="python", parameters=["decay.a"]).run(1.0, batch=3, parameters={"decay.a": np.ones(2)})
    with pytest.raises(ValueError, match="duration"):
        compile(loop, backend="python").run(math.nan)
    with pytest.raises(ValueError, match="valid: auto, python, vm, c"):
        compile(loop, backend="fortran")  # type: ignore[arg-type]
    derived = Derived()
    with pytest.raises(TraceError, match=r"computes twice when it is built"):
        compile(loop.with_block("decay", derived), backend="python", parameters=["decay.a"])


def test_a_table_asked_outside_of_a_trace_stays_an_error_after_one() -> None:
    compile(mixed_loop(), backend="python")
    assert Table.tracer is None


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_signal_that_is_not_finite_is_an_error_with_the_log(backend: Any) -> None:
    c = compile(decay_loop(a=1e200), backend=backend)
    with pytest.raises(NonFiniteError, match=r"decay\.x \[1\] is inf at t = 0\.1 s") as caught:
        c.run(1.0)
    assert len(caught.value.log.t) == 20
    assert np.isinf(c.run(1.0, allow_nonfinite=True)["decay.x"][-1])


def test_without_a_compiler_the_vm_runs_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with pytest.warns(UserWarning, match="no C compiler found: the loop runs in CasADi's VM"):
        c = compile(decay_loop())
    assert c.backend == "vm"
    assert c.run(1.0)["decay.x"][-1] == pytest.approx(0.9**19)
    with pytest.raises(compiled.NoCompilerError, match="install gcc or set CC"):
        compile(decay_loop(), backend="c")


@pytest.mark.skipif(native.compiler() is None, reason="needs a C compiler")
def test_a_second_process_finds_the_library_in_the_cache(tmp_path: Path) -> None:
    code = (
        "from tests.unit.compiled import test_compiled as t\n"
        "c = t.compile(t.decay_loop(a=0.75), backend='c'); print(c.run(1.0)['decay.x'][-1])"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    root = ROOT
    outputs, stamps = [], []
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=root, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        outputs.append(done.stdout)
        stamps.append([(file.name, file.stat().st_mtime_ns) for file in (tmp_path / "steerkit").iterdir()])
    assert outputs[0] == outputs[1]
    assert stamps[0] == stamps[1]
    assert [name.endswith(".so") for name, _ in stamps[0]] == [True]


def test_gradients_are_those_of_the_closed_form() -> None:
    cost = gradient(decay_loop(), 1.0, parameters=["decay.a"], cost=lambda y: y["decay.x"] ** 2)
    k = np.arange(20)
    for a in (0.5, 0.9, 0.99):
        value, slope = cost([a])
        assert value == pytest.approx(np.mean(a ** (2 * k)), rel=1e-12)
        assert slope[0] == pytest.approx(np.mean(2 * k * a ** (2.0 * k - 1)), rel=1e-12)


def test_gradients_agree_with_differences_where_tables_and_rates_mix() -> None:
    loop = mixed_loop(0.025)
    cost = gradient(loop, 0.5, parameters=["decay.a", "decay.b"], cost=lambda y: y["decay.x"] ** 2)
    p, h = np.array([0.9, 0.3]), 1e-6
    value, slope = cost(p)
    assert value == pytest.approx(float(np.mean(simulate(loop, 0.5)["decay.x"] ** 2)), rel=1e-12)
    steps = h * np.eye(2)
    np.testing.assert_allclose(slope, [(cost(p + d)[0] - cost(p - d)[0]) / (2 * h) for d in steps], rtol=1e-6)


def test_the_graph_simplifies_only_what_is_exact() -> None:
    g = Graph()
    x, one, zero = g.add("in", 1), g.const(1.0), g.const(0.0)
    assert g.add("mul", one, x) == x
    assert g.nodes[g.add("mul", zero, x)][0] == "mul"  # NaN*0 is NaN
    assert g.value(g.add("add", one, one)) == 2.0
    assert g.nodes[g.add("div", one, zero)][0] == "div"
    negative = g.add("lt", x, zero)
    assert g.add("select", negative, x, x) == x
    assert g.add("not", g.add("not", negative)) == negative
    assert g.const(0.0) != g.const(-0.0)
    assert g.const(math.nan) == g.const(math.nan)


def test_first_call_cost_is_told() -> None:
    c = compile(decay_loop(), backend="python")
    assert c.first_call_seconds is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        c.run(1.0)
    assert c.first_call_seconds is not None
    assert c.first_call_seconds >= c.trace_seconds > 0.0
