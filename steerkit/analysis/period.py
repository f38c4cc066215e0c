"""One period of a loop as a function, with taps in its wires: what linearisation and export stand on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State, set_ports, state_like
from steerkit.diagram.maths import Array

if TYPE_CHECKING:
    from steerkit.diagram.loop import Loop, LoopState
    from steerkit.diagram.simulation import Signal

_STEP = 1e-6  # of the central differences, times 1 + |value|: error about 1e-10


@dataclass(frozen=True, eq=False, kw_only=True)
class Tap(Block):
    """Reaches into a wire: y = value if it cuts, else u + value, with `value` its state, which nothing changes.

    Input u, output y: any unit, that of the wire; cut [1]: does it replace the signal? No errors.
    """

    unit: str = "1"
    """Unit of the wire."""
    cut: bool = False
    """Replace the signal, or add to it?"""

    def __post_init__(self) -> None:
        u, y = In(self.unit, direct=not self.cut), Out(self.unit, direct=() if self.cut else None)
        u.name, y.name = "u", "y"
        set_ports(self, (u,), (y,))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),)

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(x[0] if self.cut else u.u + x[0])


class Period:
    """A loop over one period: (states, tap values) -> (states, outputs), for floats or a batch of them.

    taps: signals to reach into, by name, and whether to cut there; outputs: signals to read. at: a state at the start
    of a period, where all blocks sample together, so that no held output matters and block states are all there is.
    """

    def __init__(self, loop: "Loop", taps: Mapping[str, bool], outputs: Sequence[str], at: "LoopState"):
        if at.k % loop.period:
            raise ValueError(f"analysis: state at tick {at.k}, expected a multiple of the loop's period {loop.period}")
        self._loop, names = _tapped(loop, taps)
        self._like = [*at.x, *[(0.0,)] * len(names)]  # taps come last
        self._held = [*at.y, *[(0.0,)] * len(names)]
        self._read = [self._loop.locate(name) for name in outputs]
        self._every = [loop.every[i] for i, _ in self._read]
        self.samples = [loop.period // every for every in self._every]
        """Samples of each output in a period."""
        self.labels = [f"{name}_{n}" for name, x in zip(loop.names, at.x) for n in getattr(x, "_fields", range(len(x)))]
        """Names of the states."""
        self.x0 = np.array([value for x in at.x for value in x], dtype=float)
        """The states at the start."""

    def run(self, x: Sequence[Any], taps: Sequence[Sequence[Any]], k: int) -> tuple[list[Any], list[list[Any]]]:
        """From tick k on, tap j taking the values taps[j] in turn: the states after, and all samples of each output."""
        numbers, period = iter(x), self._loop.period
        blocks = len(self._like) - len(taps)
        states = [state_like(like, [next(numbers) for _ in like]) for like in self._like[:blocks]] + [()] * len(taps)
        y, read = list(self._held), [list[Any]() for _ in self._read]
        for phase in range(period):
            for j, values in enumerate(taps):
                states[blocks + j] = (values[phase * len(values) // period],)
            self._loop.run_phase(phase, (k + phase) * self._loop.dt, states, y)
            for found, (i, j), every in zip(read, self._read, self._every):
                if phase % every == 0:
                    found.append(y[i][j])
        return [value for state in states[:blocks] for value in state], read

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


def _tapped(loop: "Loop", taps: Mapping[str, bool]) -> "tuple[Loop, list[str]]":
    """The loop with a tap behind each of these signals, and the taps' names."""
    parts: dict[str, tuple[str, Block]] = {}
    for signal, cut in taps.items():
        owner, port = signal.split(".")
        tap = Tap(unit=loop.units[signal], cut=cut, dt=loop.blocks[owner].dt)
        parts[signal] = (f"{owner}_{port}_tap", tap)
    return loop.with_inserted(parts), [name for name, _ in parts.values()]
