"""Systems to and from python-control, and a loop over its period as one."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import control
import numpy as np

from steerkit._support.errors import require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State, set_ports
from steerkit.diagram.loop import Layout
from steerkit.diagram.maths import Array

if TYPE_CHECKING:
    from steerkit.diagram.loop import Loop, LoopState
    from steerkit.diagram.simulation import Signal


_STEP = 1e-6  # of the central differences, times 1 + |value|: error about 1e-10


class Period:
    """A loop over one period: (states, tap values) -> (states, outputs), for floats or a batch of them.

    taps: signals to reach into, by name, and whether to cut there; outputs: signals to read. at: a state at the start
    of a period, where all blocks sample together, so that no held output matters and block states are all there is.
    """

    def __init__(self, loop: "Loop", taps: Mapping[str, bool], outputs: Sequence[str], at: "LoopState"):
        if at.k % loop.period:
            raise ValueError(f"analysis: state at tick {at.k}, expected a multiple of the loop's period {loop.period}")
        places = {f"u[{n}]": loop.locate(name) for n, name in enumerate(taps)}
        cuts = zip(places.items(), taps.values())
        instead = {(i, j): u if cut else f"y[{i}][{j}] + {u}" for (u, (i, j)), cut in cuts}
        self._loop, self._phases = loop, loop.phases(instead)
        self._read = [loop.locate(name) for name in outputs]
        self._every = [loop.every[i] for i, _ in self._read]
        self.samples = [loop.period // every for every in self._every]
        """Samples of each output in a period."""
        self._layout = Layout(loop, at.x)
        start, count = self._layout.pack(at.x, at.y), sum(map(len, at.x))
        self._held = start[count:]
        self.labels = port_names(self._layout.names[:count])
        """Names of the states."""
        self.x0 = np.array(start[:count], dtype=float)
        """The states at the start."""

    def run(self, x: Sequence[Any], taps: Sequence[Sequence[Any]], k: int) -> tuple[list[Any], list[list[Any]]]:
        """From tick k on, tap j taking the values taps[j] in turn: the states after, and all samples of each output."""
        period, read = self._loop.period, [list[Any]() for _ in self._read]
        states, y = self._layout.unpack([*x, *self._held])
        for phase, tick in enumerate(self._phases):
            tick((k + phase) * self._loop.dt, states, y, [values[phase * len(values) // period] for values in taps])
            for found, (i, j), every in zip(read, self._read, self._every):
                if phase % every == 0:
                    found.append(y[i][j])
        return [value for state in states for value in state], read

    def matrices(self, x: Array, taps: Sequence[Sequence[float]], k: int) -> tuple[Array, Array, Array, Array]:
        """A, B, C, D about states and tap values by central differences, all columns at once as a batch."""
        n, flat = len(x), np.array([value for values in taps for value in values])
        point = np.concatenate((x, flat))
        h = _STEP * (1.0 + np.abs(point))
        rows = iter(np.hstack((point[:, None] + np.diag(h), point[:, None] - np.diag(h))))
        after, read = self.run([next(rows) for _ in x], [[next(rows) for _ in values] for values in taps], k)
        results = [*after, *[value for samples in read for value in samples]]
        wide = np.array([np.broadcast_to(np.asarray(value, dtype=float), 2 * len(h)) for value in results])
        slope = (wide[:, : len(h)] - wide[:, len(h) :]) / (2.0 * h)
        return slope[:n, :n], slope[:n, n:], slope[n:, :n], slope[n:, n:]


def signal_name(loop: "Loop", signal: "Signal") -> str:
    """The name of a scalar signal; raises KeyError for an unknown one, ValueError for a vector."""
    name = signal if isinstance(signal, str) else loop.port_name(signal)
    loop.locate(name)
    owner, port = name.split(".")
    require(getattr(loop.blocks[owner], port).size is None, "analysis", f"{name} is a vector; give a scalar signal")
    return name


@dataclass(frozen=True, eq=False, kw_only=True)
class FromControl(Block):
    """A python-control input/output system, `control.NonlinearIOSystem` or `control.StateSpace`, as a block.

        x(t + dt) = f(t, x, u),  y = h(t, x, u)

    is a discrete system's own step (its dt must be this block's); a continuous one takes `substeps` Runge-Kutta steps
    (order 4) with u held.

    Ports: the system's inputs and outputs by their names (u[0] is u_0), with the units given.
    State: the system's, from `x0` [0] on. A StateSpace runs in all ways; a nonlinear one runs batched car by car, and
    compiled if its functions take symbols (one made by `control.interconnect` does not). A NaN goes where the system
    lets it. Raises ValueError for a port that is no Python name, a unit for no port, a wrong sample time or start.
    Source: Astrom, Murray 2021, chapter 3, whose conventions are python-control's.
    """

    system: Any
    """The system."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Unit of each input and output, by name; "1" where none is given."""
    direct: bool = True
    """Does the output see the input of the same sample? A StateSpace's D answers by itself."""
    x0: tuple[float, ...] = ()
    """Start; zeros if empty."""
    substeps: int = 4
    """Runge-Kutta steps a sample, of a continuous system."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where, names = "FromControl", [*_ports(self.system.input_labels), *_ports(self.system.output_labels)]
        odd = [name for name in names if not name.isidentifier()]
        require(not odd, where, f"port {odd[:1]}, expected a Python name; give the system inputs=[...], outputs=[...]")
        unknown = set(self.units) - set(names)
        require(not unknown, where, f"units for {', '.join(sorted(unknown))}; ports: {', '.join(names)}")
        discrete = self._discrete
        same = not discrete or self.system.dt is True or math.isclose(self.system.dt, self.dt)
        require(same, where, f"dt = {self.dt} s, but the system has {self.system.dt} s")
        require(len(self.x0) in (0, self.system.nstates), where, f"x0 of {len(self.x0)}, {self.system.nstates} states")
        direct = self.direct if self._matrices is None else bool(np.any(self._matrices[3]))
        unit = {name: self.units.get(name, "1") for name in names}
        ins = [In(unit[name], direct=direct) for name in _ports(self.system.input_labels)]
        outs = [Out(unit[name], direct=None if direct else ()) for name in _ports(self.system.output_labels)]
        ports: list[In | Out] = [*ins, *outs]
        for port, name in zip(ports, names):
            port.name = name
        set_ports(self, tuple(ins), tuple(outs))

    @cached_property
    def _discrete(self) -> bool:
        return bool(self.system.isdtime(strict=True))

    @cached_property
    def _matrices(self) -> tuple[Array, ...] | None:
        """A, B, C, D of a linear system."""
        if not hasattr(self.system, "A"):
            return None
        return tuple(np.asarray(getattr(self.system, name), dtype=float) for name in "ABCD")

    def init(self, batch: tuple[int, ...] = ()) -> State:
        start = self.x0 or (0.0,) * self.system.nstates
        return tuple(m.filled(float(value), batch) for value in start)

    def output(self, t: Any, x: State, u: Any) -> Any:
        values = list(u) or [0.0] * len(self.inputs)
        if self._matrices is not None:
            _, _, c, d = self._matrices
            return self.Y(*_affine(c, x, d, values))
        return self.Y(*self._called(self.system.output, t, x, values))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        if self._discrete:
            return self._rhs(t, x, u)
        for _ in range(self.substeps):
            x = m.rk4(lambda z: self._rhs(t, z, u), x, self.dt / self.substeps)
        return x

    def _rhs(self, t: Any, x: Sequence[Any], u: Any) -> State:
        if not x:
            return ()
        if self._matrices is not None:
            a, b, _, _ = self._matrices
            return tuple(_affine(a, x, b, list(u)))
        return tuple(self._called(self.system.dynamics, t, x, list(u)))

    def _called(self, function: Callable[..., Any], t: Any, x: Sequence[Any], u: Sequence[Any]) -> list[Any]:
        """The system's own function: of one car, of each car of a batch, or on symbols."""
        values, n = [*x, *u], len(x)
        if any(m.is_symbol(value) for value in values):
            return list(function(t, np.array([*x], dtype=object), np.array([*u], dtype=object)))
        shape = np.broadcast_shapes(*[np.shape(value) for value in values])
        cars = np.array([np.broadcast_to(value, shape or (1,)) for value in values], dtype=float).T
        answers = np.array([np.atleast_1d(function(t, car[:n], car[n:])) for car in cars], dtype=float)
        return list(answers.T.copy()) if shape else [float(value) for value in answers[0]]


def to_control(
    loop: "Loop", *, inputs: "Sequence[Signal]" = (), outputs: "Sequence[Signal]", at: "LoopState | None" = None
) -> Any:
    """The whole loop, as it is (not linearised), as a discrete `control.NonlinearIOSystem`, one step a period.

    Each input is added to its signal and held over a period; outputs are as at the period's start. The system's
    parameter `x0` is the state to start from: `control.input_output_response(s, t, u, s.params["x0"])`. Its time counts
    from that state. Raises ValueError for a loop with a block that is not pure.
    """
    impure = [n for n, b in loop.blocks.items() if not b.pure]
    require(not impure, "to_control", f"{', '.join(impure)} is not pure: python-control would call it many times")
    state = loop.init() if at is None else at
    added, shown = [signal_name(loop, s) for s in inputs], [signal_name(loop, s) for s in outputs]
    period = Period(loop, dict.fromkeys(added, False), shown, state)
    dt = loop.dt * loop.period

    def run(t: float, x: Array, u: Array) -> tuple[list[float], list[list[float]]]:
        k = state.k + loop.period * round(t / dt)
        return period.run(x.tolist(), [[value] for value in np.atleast_1d(u).tolist()], k)

    def update(t: float, x: Array, u: Array, params: Any) -> Any:
        return run(t, x, u)[0]

    def output(t: float, x: Array, u: Array, params: Any) -> Any:
        return [samples[0] for samples in run(t, x, u)[1]]

    return control.nlsys(
        update,
        output,
        name="loop",
        dt=dt,
        states=period.labels,
        params={"x0": period.x0},
        inputs=port_names(added),
        outputs=port_names(shown),
    )


def _affine(a: Array, x: Sequence[Any], b: Array, u: Sequence[Any]) -> list[Any]:
    """A x + B u in plain arithmetic, for floats, batches and symbols."""
    rows = zip(a.tolist(), b.tolist())
    return [sum((c * v for c, v in zip((*ra, *rb), (*x, *u))), 0.0) for ra, rb in rows]


def port_names(signals: Sequence[str]) -> list[str]:
    """Signal names as python-control takes them: without the dot."""
    return [name.replace(".", "_") for name in signals]


def _ports(labels: Sequence[str]) -> list[str]:
    return [label.replace("[", "_").replace("]", "") for label in labels]
