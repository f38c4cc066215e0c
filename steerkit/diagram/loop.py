"""Loops: named blocks and wires, checked and put in order when they are built, then stepped."""

import dataclasses
import functools
import graphlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit._support.errors import WiringError, nearest, require
from steerkit._support.files import read_npz, write_npz
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, Port, State, state_like
from steerkit.diagram.diagnostics import check_outputs, check_state, explained

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Wire = tuple[Port, Port]
Place = tuple[int, int]
"""A signal as (number of the block, number of its output)."""


@dataclass(frozen=True)
class Call:
    """One evaluation of `output` in a tick; `sources[n]` is None where it is not yet known."""

    block: int
    sources: tuple[Place | None, ...]
    early: tuple[int, ...] = ()
    """The numbers of the outputs that are meant, which can be had without the unknown inputs; none: all are known."""


def _check_blocks(blocks: Mapping[str, Block]) -> None:
    if not blocks:
        raise WiringError("a loop needs at least one block")
    seen: dict[int, str] = {}
    for name, block in blocks.items():
        if not isinstance(name, str) or not name.isidentifier():
            raise WiringError(f"block name {name!r}: expected a Python identifier such as 'car'")
        if not isinstance(block, Block):
            raise WiringError(f"block '{name}' is a {type(block).__name__}, expected a Block")
        if id(block) in seen:
            raise WiringError(f"'{seen[id(block)]}' and '{name}' are the same block object; make a second one")
        seen[id(block)] = name


def base_step(blocks: Mapping[str, Block], dt: float | None) -> tuple[float, tuple[int, ...]]:
    """The base sample time [s], by default the smallest of the blocks', and how many make a sample of each block."""
    base = min(block.dt for block in blocks.values()) if dt is None else dt
    if not (math.isfinite(base) and base > 0.0):
        raise WiringError(f"base sample time {base} s, expected a finite number > 0")
    every = []
    for name, block in blocks.items():
        ratio = block.dt / base
        if not math.isfinite(ratio) or round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            times = ", ".join(f"{n} {b.dt:g} s" for n, b in blocks.items())
            what = f"is {block.dt:g} s, not a whole multiple of the base step {base:g} s"
            raise WiringError(f"sample time of {name} {what}; sample times: {times}")
        every.append(round(ratio))
    return base, tuple(every)


Values = tuple[Any, ...]


@dataclasses.dataclass(frozen=True)
class LoopState:
    """All that a loop remembers: the tick, every block's state, every block's last outputs (held by slow blocks).

    Immutable, so a copy is the object itself; `Loop.save_state` and `Loop.load_state` keep it bit for bit.
    """

    k: int
    x: tuple[State, ...]
    y: tuple[Values, ...]


class Layout:
    """The numbers of a loop state in a row of slots: all block states, then all held outputs.

    x: states of the blocks, whose kinds and lengths count.
    """

    def __init__(self, loop: "Loop", x: Sequence[State]):
        self.x, self._blocks = tuple(x), tuple(loop.blocks.values())
        self.names: list[str] = []
        self.signals: dict[str, tuple[int, int | None]] = {}
        for name, state in zip(loop.names, self.x):
            fields = getattr(state, "_fields", range(len(state)))
            self.names += [f"{name}.{field}" for field in fields]
        for name, block in loop.blocks.items():
            for out in block.outputs:
                size = getattr(block, out.name).size
                self.signals[f"{name}.{out.name}"] = len(self.names), size
                self.names += [f"{name}.{out.name}"] * (1 if size is None else size)

    def __len__(self) -> int:
        return len(self.names)

    def pack(self, x: Sequence[Any], y: Sequence[Any]) -> list[Any]:
        """The numbers (or arrays, or symbols) of a state in slot order."""
        held = zip(self.signals.values(), [value for values in y for value in values])
        return [v for state in x for v in state] + [
            v for (_, size), value in held for v in ([value] if size is None else value)
        ]

    def unpack(self, values: Sequence[Any]) -> tuple[list[Any], list[Any]]:
        """States and outputs, shaped as in the loop, from numbers in slot order."""
        numbers = iter(values)
        x = [state_like(state, [next(numbers) for _ in state]) for state in self.x]
        y = []
        for block in self._blocks:
            sizes = [getattr(block, out.name).size for out in block.outputs]
            entries = [next(numbers) if n is None else tuple([next(numbers) for _ in range(n)]) for n in sizes]
            y.append(block.Y(*entries))
        return x, y

    def slots_of(self, signal: str) -> list[int]:
        """The slots of a signal: one, or as many as a vector port has entries."""
        first, size = self.signals[signal]
        return list(range(first, first + (1 if size is None else size)))


def require_batch(where: str, batch: int | None) -> None:
    """Raise ValueError unless `batch` is a number of cars, or None for one car."""
    if batch is not None and not (isinstance(batch, int | np.integer) and batch >= 1):
        raise ValueError(f"{where}: batch = {batch!r}, expected a number of cars >= 1, or None for one car")


class Sample(Mapping[str, Any]):
    """The outputs of all blocks at one tick: `sample["car.v"]` or `sample[car.v]`."""

    __slots__ = ("_loop", "t", "y")

    def __init__(self, loop: "Loop", t: float, y: Sequence[Values]):
        self._loop, self.t, self.y = loop, t, y

    def __getitem__(self, key: str | Port) -> Any:
        i, j = self._loop.locate(key)
        return self.y[i][j]

    def __contains__(self, key: object) -> bool:  # not by what `locate` raises, which looks for the nearest name
        return key in self._loop.units if isinstance(key, str) else super().__contains__(key)

    def __iter__(self) -> Iterator[str]:
        return iter(self._loop.units)

    def __len__(self) -> int:
        return len(self._loop.units)


class Loop:
    """A diagram of blocks: built once, checked whole, run many ways.

    blocks: the blocks by name, in the order wanted for display. wires: pairs of ports, `(car.v, stanley.v)`: source
    first. dt: base sample time [s]; by default the smallest of the blocks'. Each block's must be a multiple of it.

    At tick k, t = k*dt: every block that is due computes its outputs, in an order in which each direct input is
    known before it is needed; then every due block computes its next state from all its inputs at the same t. The
    outputs of a slow block are held between its samples.

    Raises WiringError, naming both ends and their units, for: two different units or sizes on a wire, an input that
    is not driven or has two sources, a wire that is no pair of an output and an input, a block that is not in the
    loop or is in it twice, a chain of direct inputs that bites its own tail, sample times that do not divide.
    """

    def __init__(self, *, blocks: Mapping[str, Block], wires: Sequence[Wire], dt: float | None = None):
        _check_blocks(blocks)
        self.blocks, self._blocks, self.names = dict(blocks), tuple(blocks.values()), tuple(blocks)
        self._index = {id(block): i for i, block in enumerate(self._blocks)}
        self.wires = tuple(self._checked(wire) for wire in wires)
        self._source = self._sources()
        """The place that drives each input, by (number of the block, name of the input)."""
        self._calls = self._schedule()
        """The `output` calls of a tick, in their order."""
        self.dt, self.every = base_step(self.blocks, dt)
        self.period = math.lcm(*self.every)
        self.units = {f"{name}.{out.name}": out.unit for name, block in self.blocks.items() for out in block.outputs}
        self._where = {
            f"{name}.{out.name}": (i, j)
            for i, (name, block) in enumerate(self.blocks.items())
            for j, out in enumerate(block.outputs)
        }
        self._phases = self.phases()

    def port_name(self, port: Port) -> str:
        """`"car.v"` for `car.v`; raises KeyError when the block is not in this loop."""
        if id(port.block) not in self._index:
            raise KeyError(f"{port!r} belongs to a block that is not in this loop (blocks: {', '.join(self.names)})")
        return f"{self.names[self._index[id(port.block)]]}.{port.spec.name}"

    def _label(self, port: Port) -> str:
        return f"{self.port_name(port)} [{port.spec.unit}]"

    def _checked(self, wire: Any) -> Wire:
        if not (isinstance(wire, tuple) and len(wire) == 2 and all(isinstance(p, Port) for p in wire)):
            raise WiringError(f"wire {wire!r}: expected a pair of ports such as (car.v, stanley.v)")
        a, b = wire
        for port in wire:
            if id(port.block) not in self._index:
                what = f"{type(port.block).__name__} is not in the loop; blocks: {', '.join(self.names)}"
                raise WiringError(f"wire {a!r} -> {b!r}: {what}")
        text = f"wire {self._label(a)} -> {self._label(b)}"
        if not isinstance(a.spec, Out) or not isinstance(b.spec, In):
            raise WiringError(f"{text}: a wire goes from an output to an input, here {a.spec.kind} to {b.spec.kind}")
        if a.spec.unit != b.spec.unit:
            raise WiringError(f"{text}: units differ")
        if a.size != b.size:
            raise WiringError(f"{text}: sizes differ ({a.size or 'scalar'} and {b.size or 'scalar'})")
        return a, b

    def _sources(self) -> dict[tuple[int, str], Place]:
        source: dict[tuple[int, str], Place] = {}
        labels: dict[tuple[int, str], str] = {}
        for a, b in self.wires:
            key = (self._index[id(b.block)], b.spec.name)
            if key in source:
                raise WiringError(f"{self._label(b)} has two sources: {labels[key]} and {self._label(a)}")
            outputs = [out.name for out in a.block.outputs]
            source[key] = (self._index[id(a.block)], outputs.index(a.spec.name))
            labels[key] = self._label(a)
        for i, block in enumerate(self._blocks):
            for port in block.inputs:
                if (i, port.name) not in source:
                    named = zip(self.names, self._blocks)
                    fit = [f"{name}.{out.name}" for name, b in named for out in b.outputs if out.unit == port.unit]
                    what = f"is not driven; outputs with that unit: {', '.join(fit) or 'none'}"
                    raise WiringError(f"{self.names[i]}.{port.name} [{port.unit}] {what}")
        return source

    def _schedule(self) -> tuple[Call, ...]:
        """Order of the `output` calls. A block that feeds itself through outputs that do not depend on the input
        in question is called twice: first for those outputs (its unknown inputs are NaN), then for all."""
        self._check_algebraic_loops()
        known: set[Place] = set()
        calls: list[Call] = []
        waiting = list(range(len(self._blocks)))

        def sources(i: int) -> list[Place]:
            return [self._source[i, p.name] for p in self._blocks[i].inputs if p.direct]

        def early(i: int) -> list[int]:
            """Outputs of i that can be had now and are not yet."""
            block = self._blocks[i]
            return [
                j
                for j, out in enumerate(block.outputs)
                if out.direct is not None
                and (i, j) not in known
                and all(self._source[i, p.name] in known for p in out.direct if p.direct)
            ]

        while waiting:
            i = next((i for i in waiting if all(s in known for s in sources(i))), None)
            if i is not None:
                waiting.remove(i)
                calls.append(Call(i, tuple(sources(i))))
                known.update((i, j) for j in range(len(self._blocks[i].outputs)))
            else:
                i = next(i for i in waiting if early(i))
                had = tuple(s if s in known else None for s in sources(i))
                calls.append(Call(i, had, tuple(early(i))))
                known.update((i, j) for j in calls[-1].early)
        return tuple(calls)

    def _check_algebraic_loops(self) -> None:
        graph: dict[str, list[str]] = {}
        for (i, name), (j, out) in self._source.items():
            graph[f"{self.names[i]}.{name}"] = [f"{self.names[j]}.{self._blocks[j].outputs[out].name}"]
        for name, block in zip(self.names, self._blocks):
            for port in block.outputs:
                direct = block.inputs if port.direct is None else port.direct
                graph[f"{name}.{port.name}"] = [f"{name}.{p.name}" for p in direct if p.direct]
        try:
            graphlib.TopologicalSorter(graph).prepare()
        except graphlib.CycleError as error:
            cure = "make one of these inputs direct=False, or put a block with a state between"
            raise WiringError(f"algebraic loop: {' -> '.join(error.args[1])}; {cure}") from None

    def _tick(self, due: Sequence[bool], taps: Mapping[Place, str] = {}) -> Any:
        """One tick as a straight run of Python calls: nothing is looked up that can be known beforehand.

        taps: what all users of a place get in its stead, an expression of y and of u, the function's last argument.
        """
        lines = ["def tick(t, x, y, u=()):", "    pass"]
        scope: dict[str, Any] = {"nan": math.nan}

        def value(source: Place | None) -> str:
            return "nan" if source is None else taps.get(source, f"y[{source[0]}][{source[1]}]")

        for call in self._calls:
            i = call.block
            if due[i]:
                args = ", ".join(value(s) for s in call.sources)
                lines.append(f"    y[{i}] = output{i}(t, x[{i}], D{i}({args}))")
        for i, block in enumerate(self._blocks):
            scope |= {f"output{i}": block.output, f"update{i}": block.update, f"D{i}": block.D, f"U{i}": block.U}
            if due[i]:
                args = ", ".join(value(self._source[i, p.name]) for p in block.inputs)
                lines.append(f"    x[{i}] = update{i}(t, x[{i}], U{i}({args}), y[{i}])")
        exec("\n".join(lines), scope)
        return scope["tick"]

    def locate(self, key: str | Port) -> tuple[int, int]:
        """(number of the block, number of its output) of a signal: `y[i][j]` is its value.

        Raises KeyError with the nearest name.
        """
        name = key if isinstance(key, str) else self.port_name(key)
        if name not in self._where:
            raise KeyError(f"no signal '{name}'{nearest(name, self._where)}; signals: {', '.join(self._where)}")
        return self._where[name]

    def inputs_of(self, name: str) -> dict[str, str]:
        """The signal that drives each input of a block, in the block's order: `{"e": "path.e", ...}`."""
        i, block = self._number(name), self.blocks[name]
        return {port.name: self._signal(self._source[i, port.name]) for port in block.inputs}

    @property
    def order(self) -> tuple[str, ...]:
        """The blocks in the order in which all of their direct inputs are known within a tick."""
        return tuple(self.names[call.block] for call in self._calls if not call.early)

    def sample(self, state: LoopState) -> Sample:
        """The outputs that a state holds: those of the tick before it, or of the first one in a state of `init`."""
        return Sample(self, max(0, state.k - 1) * self.dt, state.y)

    def __repr__(self) -> str:
        return f"Loop({', '.join(self.names)}; {len(self.wires)} wires; dt = {self.dt:g} s)"

    def plot(self) -> "Figure":
        """The diagram as a matplotlib figure: blocks, ports, units, wires, rates."""
        from steerkit.plots.diagram import plot_diagram

        return plot_diagram(self)

    def _repr_png_(self) -> bytes:
        """The diagram, for a notebook."""
        from steerkit.plots.style import png

        return png(self.plot())

    def init(self, *, batch: int | None = None, x: Sequence[State] | None = None) -> LoopState:
        """The state at t = 0, of one car or of `batch` cars; each block settles on its first inputs.

        x: the blocks' states to settle from, in the order of the blocks, instead of their own `init`. Where a block's
        outputs are needed before it can settle, and settling changes them, all settle once more; raises WiringError
        when that comes to no end.
        """
        require_batch("Loop.init", batch)
        if batch is not None:
            for name, block in self.blocks.items():
                if not block.pure:
                    raise TypeError(f"{name} ({type(block).__name__}) is not pure: it cannot be batched, only stepped")
        shape = () if batch is None else (batch,)
        try:
            return self._started(shape, x)[0]
        except Exception as error:
            if (teaching := explained(error, self.blocks)) is not None:
                raise teaching from error
            raise

    def settled(self, name: str, y: Sequence[Values]) -> State:
        """The state of a block as it would start if `y` (the outputs of all blocks, of one car) were the first sample.

        For a block that begins anew in a loop that goes on: `x[i] = loop.settled("controller", y)`.
        """
        i, block = self._number(name), self.blocks[name]
        sources = [self._source[i, port.name] for port in block.inputs if port.direct]
        return block.settle(0.0, block.init(), block.D(*[y[a][b] for a, b in sources]))

    def step(self, state: LoopState) -> tuple[LoopState, Sample]:
        """One tick: the outputs at t = state.k*dt and the state one base step later."""
        x, y = list(state.x), list(state.y)
        t = state.k * self.dt
        self.advance(state.k, x, y)
        return LoopState(state.k + 1, tuple(x), tuple(y)), Sample(self, t, y)

    def check(self, before: Sequence[State], x: Sequence[State]) -> None:
        """Raise WiringError where a block's `update` made something else than a state like the one `before`."""
        for (name, block), old, new in zip(self.blocks.items(), before, x):
            check_state(name, block, new, "update", like=old)

    def advance(self, k: int, x: list[State], y: list[Values]) -> None:
        """The tick k in place, on lists of states and outputs: what `step` and `simulate` stand on."""
        self._phases[k % self.period](k * self.dt, x, y)

    def due(self, phase: int) -> tuple[bool, ...]:
        """Which blocks compute in a tick k with k % period == phase."""
        return tuple([phase % n == 0 for n in self.every])

    def phases(self, taps: Mapping[Place, str] = {}) -> list[Any]:
        """The ticks of a period as functions of t, x, y, and of what `taps` read; see `_tick`."""
        patterns = [self.due(phase) for phase in range(self.period)]
        ticks = {due: self._tick(due, taps) for due in set(patterns)}
        return [ticks[due] for due in patterns]

    def run_phase(self, phase: int, t: Any, x: list[State], y: list[Values]) -> None:
        """A tick k with k % period == phase at time t, which may be a symbol: what `steerkit.compiled` traces."""
        self._phases[phase](t, x, y)

    def with_block(self, name: str, block: Block) -> "Loop":
        """The same loop with one block replaced by another that has the same ports; states carry over."""
        old = self.blocks[self.names[self._number(name)]]

        def moved(port: Port) -> Port:
            return getattr(block, port.spec.name) if port.block is old else port

        return Loop(
            blocks={n: block if n == name else b for n, b in self.blocks.items()},
            wires=[(moved(a), moved(b)) for a, b in self.wires],
            dt=self.dt,
        )

    def with_block_state(self, state: LoopState, name: str, x: State) -> LoopState:
        """`state` with one block's state replaced."""
        i = self._number(name)
        return dataclasses.replace(state, x=(*state.x[:i], x, *state.x[i + 1 :]))

    def save_state(self, state: LoopState, file: str | FilePath) -> None:
        """Write a loop state to a NumPy .npz file, bit for bit."""
        layout = Layout(self, state.x)
        numbers = np.array(np.broadcast_arrays(*layout.pack(state.x, state.y)), dtype=float)
        write_npz(file, {"k": np.array(state.k), "names": np.array(layout.names), "numbers": numbers})

    def load_state(self, file: str | FilePath) -> LoopState:
        """Read what `save_state` wrote for a loop of the same blocks; raises ValueError for any other file."""
        stored = read_npz(file, "load_state")
        missing = {"k", "names", "numbers"} - stored.keys()
        require(not missing, "load_state", f"{file} lacks {min(missing, default='')}; it is no state of {self!r}")
        layout = Layout(self, [block.init() for block in self._blocks])
        names, numbers = stored["names"].tolist(), stored["numbers"]
        for verb, odd in (("lacks", {*layout.names} - {*names}), ("holds", {*names} - {*layout.names})):
            require(not odd, "load_state", f"{file} {verb} {min(odd, default='')}; it is no state of {self!r}")
        fits = names == layout.names and len(numbers) == len(names)
        require(fits, "load_state", f"{file} holds the same names in another order or number; {self!r} cannot read it")
        x, y = layout.unpack(numbers.tolist() if numbers.ndim == 1 else list(numbers))
        return LoopState(int(stored["k"]), tuple(x), tuple(y))

    def _number(self, name: str) -> int:
        if name not in self.blocks:
            raise KeyError(f"no block '{name}'{nearest(name, self.names)}; blocks: {', '.join(self.names)}")
        return self.names.index(name)

    def _signal(self, place: Place) -> str:
        i, j = place
        return f"{self.names[i]}.{self._blocks[i].outputs[j].name}"

    @functools.cached_property
    def _rounds(self) -> int:
        """How often all blocks settle until nothing changes any more."""
        _, rounds = self._started((), None)
        return rounds

    def _started(self, shape: tuple[int, ...], x: Sequence[State] | None) -> tuple[LoopState, int]:
        """The settled state, and how often all blocks had to settle."""
        start = [block.init(shape) for block in self._blocks] if x is None else list(x)
        cars = shape if x is None else None  # states that are given say themselves of how many cars they are
        for (name, block), state in zip(self.blocks.items(), start):
            check_state(name, block, state, "init", cars)
        settled = start
        if any(m.is_symbol(number) for state in start for number in state):  # whether they changed cannot be asked
            for _ in range(self._rounds):
                settled, y, _ = self._settle_all(start, settled, cars)
            return LoopState(0, tuple(settled), tuple(y)), self._rounds
        for rounds in range(1, len(start) + 2):
            settled, y, changed = self._settle_all(start, settled, cars)
            if not changed:
                return LoopState(0, tuple(settled), tuple(y)), rounds
        what = "is needed before its block can settle, and is another one after it has, however often all blocks settle"
        raise WiringError(f"{changed} {what}; make it independent of what `settle` finds")

    def _settle_all(
        self, start: list[State], before: list[State], shape: tuple[int, ...] | None
    ) -> tuple[list[State], list[Values], str]:
        """All blocks settled from their states `start`, their outputs, and the first output, by name, that was handed
        on as of the states `before` and is another one now."""
        x, y, early = list(start), list[Any]([None] * len(start)), dict[Place, Any]()
        for call in self._calls:
            i, block, name = call.block, self._blocks[call.block], self.names[call.block]
            u = block.D(*[math.nan if s is None else y[s[0]][s[1]] for s in call.sources])
            if not call.early:
                x[i] = block.settle(0.0, x[i], u)
                check_state(name, block, x[i], "settle", shape, like=start[i])
            y[i] = block.output(0.0, before[i] if call.early else x[i], u)
            check_outputs(name, block, y[i], shape)
            self._check_independence(call, y[i], u)
            early |= {(i, j): y[i][j] for j in call.early}
        changed = [(i, j) for (i, j), value in early.items() if not m.is_symbol(y[i][j]) and not _same(value, y[i][j])]
        return x, y, self._signal(changed[0]) if changed else ""

    def _check_independence(self, call: Call, y: Any, u: Any) -> None:
        name, block = self.names[call.block], self._blocks[call.block]
        unknown = {field for field, s in zip(u._fields, call.sources) if s is None}
        for out, value in zip(block.outputs, y):
            independent = out.direct is not None and not unknown & {p.name for p in out.direct}
            if unknown and independent and not m.is_symbol(value) and np.isnan(np.asarray(value, dtype=float)).any():
                of = ", ".join(sorted(unknown))
                raise WiringError(f"{name}.{out.name} is declared independent of {of}, but is NaN without it")


def _same(a: Any, b: Any) -> bool:
    """Are two outputs equal, NaN to NaN, one number standing for all cars?"""
    first, second = np.broadcast_arrays(np.asarray(a, dtype=float), np.asarray(b, dtype=float))
    return bool(np.array_equal(first, second, equal_nan=True))
