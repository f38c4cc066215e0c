"""Loops: named blocks and wires, checked when they are built, then stepped."""

from __future__ import annotations

import dataclasses
import difflib
import graphlib
import math
import zipfile
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit.block import Block, In, Out, Port, State
from steerkit.errors import WiringError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Wire = tuple[Port, Port]
Values = tuple[Any, ...]


@dataclasses.dataclass(frozen=True)
class LoopState:
    """All that a loop remembers: the tick, every block's state, every block's last outputs (held by slow blocks).

    Immutable, so a copy is the object itself; `Loop.save_state` and `Loop.load_state` keep it bit for bit.
    """

    k: int
    x: tuple[State, ...]
    y: tuple[Values, ...]


class Sample(Mapping[str, Any]):
    """The outputs of all blocks at one tick: `sample["car.v"]` or `sample[car.v]`."""

    __slots__ = ("_loop", "t", "y")

    def __init__(self, loop: Loop, t: float, y: Sequence[Values]):
        self._loop, self.t, self.y = loop, t, y

    def __getitem__(self, key: str | Port) -> Any:
        i, j = self._loop.locate(key)
        return self.y[i][j]

    def __iter__(self) -> Iterator[str]:
        return iter(self._loop.units)

    def __len__(self) -> int:
        return len(self._loop.units)


@dataclasses.dataclass(frozen=True)
class Call:
    """One evaluation of `output` in a tick; `sources[n]` is (block, output) or None where not yet known."""

    block: int
    sources: tuple[tuple[int, int] | None, ...]
    final: bool


class Loop:
    """A diagram of blocks: built once, checked whole, run many ways.

    blocks: the blocks by name, in the order wanted for display. wires: pairs of ports, `(car.v, stanley.v)`: source
    first. dt: base sample time [s]; by default the smallest of the blocks'. Every block's dt must be a whole
    multiple of it.

    At tick k, t = k*dt: every block that is due computes its outputs, in an order in which each direct input is
    known before it is needed; then every due block computes its next state from all its inputs at the same t. The
    outputs of a slow block are held between its samples.

    Raises WiringError, naming both ends and their units, for: two different units or sizes on a wire, an input that
    is not driven or has two sources, a wire that is no pair of an output and an input, a block that is not in the
    loop or is in it twice, a chain of direct inputs that bites its own tail, sample times that do not divide.
    """

    def __init__(self, *, blocks: Mapping[str, Block], wires: Sequence[Wire], dt: float | None = None):
        self.blocks = dict(blocks)
        self.names = tuple(self.blocks)
        self._list = tuple(self.blocks.values())
        _check_blocks(self.blocks)
        self._index = {id(block): i for i, block in enumerate(self._list)}
        self.wires = tuple(self._checked(wire) for wire in wires)
        self.source = self._sources()
        self.dt, self.every = _base_step(self.blocks, dt)
        self.period = math.lcm(*self.every)
        self.calls = self._schedule()
        self.units = {f"{name}.{out.name}": out.unit for name, block in self.blocks.items() for out in block.outputs}
        self._where = {
            f"{name}.{out.name}": (i, j)
            for i, (name, block) in enumerate(self.blocks.items())
            for j, out in enumerate(block.outputs)
        }
        patterns = [tuple([phase % n == 0 for n in self.every]) for phase in range(self.period)]
        ticks = {due: self._compile_tick(due) for due in set(patterns)}
        self._phases = [ticks[due] for due in patterns]

    # ---- asking ---------------------------------------------------------------------------------------------

    def port_name(self, port: Port) -> str:
        """`"car.v"` for `car.v`; raises KeyError when the block is not in this loop."""
        if id(port.block) not in self._index:
            raise KeyError(f"{port!r} belongs to a block that is not in this loop (blocks: {', '.join(self.names)})")
        return f"{self.names[self._index[id(port.block)]]}.{port.spec.name}"

    def locate(self, key: str | Port) -> tuple[int, int]:
        """(block, output) numbers of a signal; raises KeyError with the nearest name."""
        name = key if isinstance(key, str) else self.port_name(key)
        if name not in self._where:
            raise KeyError(f"no signal '{name}'{_nearest(name, self._where)}; signals: {', '.join(self._where)}")
        return self._where[name]

    def __repr__(self) -> str:
        return f"Loop({', '.join(self.names)}; {len(self.wires)} wires; dt = {self.dt:g} s)"

    def plot(self) -> Figure:
        """The diagram as a matplotlib figure: blocks, ports, units, wires, rates."""
        from steerkit.plots.diagram import plot_diagram

        return plot_diagram(self)

    def _repr_png_(self) -> bytes:
        """The diagram, for a notebook."""
        from steerkit.plots.notebook import png

        return png(self.plot())

    def break_at(self, signal: str | Port, *, at: LoopState | None = None) -> Any:
        """The open loop at a scalar signal, as a discrete `control.StateSpace`; see `steerkit.analysis.break_at`."""
        from steerkit.analysis import break_at

        return break_at(self, signal, at=at)

    # ---- running --------------------------------------------------------------------------------------------

    def init(self, *, batch: int | None = None, x: Sequence[State] | None = None) -> LoopState:
        """The state at t = 0, of one car or of `batch` cars; each block settles on its first inputs.

        x: the blocks' states to settle from, in the order of the blocks, instead of their own `init`.
        """
        if batch is not None and batch < 1:
            raise ValueError(f"Loop.init: batch = {batch}, expected a number of cars >= 1, or None for one car")
        if batch is not None:
            for name, block in self.blocks.items():
                if not block.pure:
                    raise TypeError(f"{name} ({type(block).__name__}) is not pure: it cannot be batched, only stepped")
        shape = () if batch is None else (batch,)
        x = [block.init(shape) for block in self._list] if x is None else list(x)
        y: list[Any] = [None] * len(x)
        for call in self.calls:
            block = self._list[call.block]
            u = block.D(*[math.nan if s is None else y[s[0]][s[1]] for s in call.sources])
            try:
                if call.final:
                    x[call.block] = block.settle(0.0, x[call.block], u)
                y[call.block] = block.output(0.0, x[call.block], u)
            except AttributeError as error:
                if error.obj is not u:
                    raise
                raise WiringError(
                    f"{self.names[call.block]}.output read '{error.name}', which is not one of its direct inputs "
                    f"({', '.join(block.D._fields) or 'none'}); declare the port direct or move the use to update"
                ) from None
            self._check_outputs(call, y[call.block], u)
        return LoopState(0, tuple(x), tuple(y))

    def step(self, state: LoopState) -> tuple[LoopState, Sample]:
        """One tick: the outputs at t = state.k*dt and the state one base step later."""
        x, y = list(state.x), list(state.y)
        t = state.k * self.dt
        self.advance(state.k, x, y)
        return LoopState(state.k + 1, tuple(x), tuple(y)), Sample(self, t, y)

    def advance(self, k: int, x: list[State], y: list[Values]) -> None:
        """The tick k in place, on lists of states and outputs: what `step` and `simulate` stand on."""
        self._phases[k % self.period](k * self.dt, x, y)

    def run_phase(self, phase: int, t: Any, x: list[State], y: list[Values]) -> None:
        """A tick k with k % period == phase at time t, which may be a symbol: what `steerkit.compiled` traces."""
        self._phases[phase](t, x, y)

    def with_block(self, name: str, block: Block) -> Loop:
        """The same loop with one block replaced by another that has the same ports; states carry over."""
        old = self.blocks[self._known(name)]

        def moved(port: Port) -> Port:
            return getattr(block, port.spec.name) if port.block is old else port

        return Loop(
            blocks={n: block if n == name else b for n, b in self.blocks.items()},
            wires=[(moved(a), moved(b)) for a, b in self.wires],
            dt=self.dt,
        )

    def block_state(self, state: LoopState, name: str) -> State:
        """The state of one block inside a loop state."""
        return state.x[self.names.index(self._known(name))]

    def with_block_state(self, state: LoopState, name: str, x: State) -> LoopState:
        """`state` with one block's state replaced."""
        i = self.names.index(self._known(name))
        return dataclasses.replace(state, x=(*state.x[:i], x, *state.x[i + 1 :]))

    def save_state(self, state: LoopState, file: str | FilePath) -> None:
        """Write a loop state to a NumPy .npz file, bit for bit."""
        arrays = {"k": np.array(state.k)}
        for name, block, x, y in zip(self.names, self._list, state.x, state.y):
            arrays[f"x.{name}"] = _packed(x)
            arrays |= {f"y.{name}.{out.name}": _packed(value) for out, value in zip(block.outputs, y)}
        with FilePath(file).open("wb") as stream:  # a stream, since savez would append .npz to a name
            np.savez(stream, **arrays)  # type: ignore[arg-type]

    def load_state(self, file: str | FilePath) -> LoopState:
        """Read what `save_state` wrote for a loop of the same blocks; raises ValueError for any other file."""
        stored = read_npz(file, "load_state")
        signals = [f"y.{name}" for name in self.units]
        known = {"k", *(f"x.{name}" for name in self.names), *signals}
        for verb, keys in (("lacks", known - stored.keys()), ("holds", stored.keys() - known)):
            if keys:
                raise ValueError(f"load_state: {file} {verb} {min(keys)}; it is no state of {self!r}")
        x, y = [], []
        for name, block in self.blocks.items():
            template, values = block.init(), stored[f"x.{name}"]
            if len(values) != len(template):
                raise ValueError(f"load_state: {name} has {len(template)} states, {file} has {len(values)}")
            x.append(_like(template, values))
            ports = [(stored[f"y.{name}.{out.name}"], out.size is not None) for out in block.outputs]
            y.append(block.Y(*[_unpacked(value, vector=vector) for value, vector in ports]))
        return LoopState(int(stored["k"]), tuple(x), tuple(y))

    # ---- building -------------------------------------------------------------------------------------------

    def _known(self, name: str) -> str:
        if name not in self.blocks:
            raise KeyError(f"no block '{name}'{_nearest(name, self.names)}; blocks: {', '.join(self.names)}")
        return name

    def _label(self, port: Port) -> str:
        return f"{self.port_name(port)} [{port.spec.unit}]"

    def _checked(self, wire: Any) -> Wire:
        if not (isinstance(wire, tuple) and len(wire) == 2 and all(isinstance(p, Port) for p in wire)):
            raise WiringError(f"wire {wire!r}: expected a pair of ports such as (car.v, stanley.v)")
        a, b = wire
        for port in wire:
            if id(port.block) not in self._index:
                raise WiringError(
                    f"wire {a!r} -> {b!r}: {type(port.block).__name__} is not in the loop; "
                    f"blocks: {', '.join(self.names)}"
                )
        text = f"wire {self._label(a)} -> {self._label(b)}"
        if not isinstance(a.spec, Out) or not isinstance(b.spec, In):
            raise WiringError(f"{text}: a wire goes from an output to an input, here {a.spec.kind} to {b.spec.kind}")
        if a.spec.unit != b.spec.unit:
            raise WiringError(f"{text}: units differ")
        if a.size != b.size:
            raise WiringError(f"{text}: sizes differ ({a.size or 'scalar'} and {b.size or 'scalar'})")
        return a, b

    def _sources(self) -> dict[tuple[int, str], tuple[int, int]]:
        source: dict[tuple[int, str], tuple[int, int]] = {}
        labels: dict[tuple[int, str], str] = {}
        for a, b in self.wires:
            key = (self._index[id(b.block)], b.spec.name)
            if key in source:
                raise WiringError(f"{self._label(b)} has two sources: {labels[key]} and {self._label(a)}")
            outputs = [out.name for out in a.block.outputs]
            source[key] = (self._index[id(a.block)], outputs.index(a.spec.name))
            labels[key] = self._label(a)
        for i, block in enumerate(self._list):
            for port in block.inputs:
                if (i, port.name) not in source:
                    fit = [f"{n}.{o.name}" for n, b in self.blocks.items() for o in b.outputs if o.unit == port.unit]
                    raise WiringError(
                        f"{self.names[i]}.{port.name} [{port.unit}] is not driven; "
                        f"outputs with that unit: {', '.join(fit) or 'none'}"
                    )
        return source

    def _schedule(self) -> tuple[Call, ...]:
        """Order of the `output` calls. A block that feeds itself through outputs that do not depend on the input
        in question is called twice: first for those outputs (its unknown inputs are NaN), then for all."""
        self._check_algebraic_loops()
        known: set[tuple[int, int]] = set()
        calls: list[Call] = []
        waiting = list(range(len(self._list)))

        def sources(i: int) -> list[tuple[int, int]]:
            return [self.source[i, p.name] for p in self._list[i].inputs if p.direct]

        def early(i: int) -> list[int]:
            """Outputs of i that can be had now and are not yet."""
            block = self._list[i]
            return [
                j
                for j, out in enumerate(block.outputs)
                if out.direct is not None
                and (i, j) not in known
                and all(self.source[i, p.name] in known for p in out.direct if p.direct)
            ]

        while waiting:
            i = next((i for i in waiting if all(s in known for s in sources(i))), None)
            final = i is not None
            if i is None:
                i = next(i for i in waiting if early(i))
                known.update((i, j) for j in early(i))
            else:
                waiting.remove(i)
            calls.append(Call(i, tuple(s if final or s in known else None for s in sources(i)), final))
            if final:
                known.update((i, j) for j in range(len(self._list[i].outputs)))
        return tuple(calls)

    def _check_algebraic_loops(self) -> None:
        graph: dict[str, list[str]] = {}
        for (i, name), (j, out) in self.source.items():
            graph[f"{self.names[i]}.{name}"] = [f"{self.names[j]}.{self._list[j].outputs[out].name}"]
        for name, block in self.blocks.items():
            for port in block.outputs:
                direct = block.inputs if port.direct is None else port.direct
                graph[f"{name}.{port.name}"] = [f"{name}.{p.name}" for p in direct if p.direct]
        try:
            graphlib.TopologicalSorter(graph).prepare()
        except graphlib.CycleError as error:
            raise WiringError(
                f"algebraic loop: {' -> '.join(error.args[1])}; make one of these inputs direct=False, "
                "or put a block with a state between"
            ) from None

    def _compile_tick(self, due: tuple[bool, ...]) -> Any:
        """One tick as a straight run of Python calls: nothing is looked up that can be known beforehand."""
        lines = ["def tick(t, x, y):", "    pass"]
        scope: dict[str, Any] = {"nan": math.nan}

        def value(source: tuple[int, int] | None) -> str:
            return "nan" if source is None else f"y[{source[0]}][{source[1]}]"

        for call in self.calls:
            i = call.block
            if due[i]:
                args = ", ".join(value(s) for s in call.sources)
                lines.append(f"    y[{i}] = output{i}(t, x[{i}], D{i}({args}))")
        for i, block in enumerate(self._list):
            scope |= {f"output{i}": block.output, f"update{i}": block.update, f"D{i}": block.D, f"U{i}": block.U}
            if due[i]:
                args = ", ".join(value(self.source[i, p.name]) for p in block.inputs)
                lines.append(f"    x[{i}] = update{i}(t, x[{i}], U{i}({args}), y[{i}])")
        exec("\n".join(lines), scope)
        return scope["tick"]

    def _check_outputs(self, call: Call, y: Any, u: Any) -> None:
        name, block = self.names[call.block], self._list[call.block]
        if len(y) != len(block.outputs):
            raise WiringError(f"{name}.output gave {len(y)} values, expected {len(block.outputs)}: {block.Y._fields}")
        unknown = {field for field, s in zip(u._fields, call.sources) if s is None}
        for out, value in zip(block.outputs, y):
            size = getattr(block, out.name).size
            if size is not None and len(value) != size:
                raise WiringError(f"{name}.{out.name} has {len(value)} entries, expected {size}")
            independent = out.direct is not None and not unknown & {p.name for p in out.direct}
            if unknown and independent and np.isnan(np.asarray(value, dtype=float)).any():
                raise WiringError(
                    f"{name}.{out.name} is declared independent of {', '.join(sorted(unknown))}, but is NaN without it"
                )


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


def _base_step(blocks: Mapping[str, Block], dt: float | None) -> tuple[float, tuple[int, ...]]:
    base = min(block.dt for block in blocks.values()) if dt is None else dt
    if not (math.isfinite(base) and base > 0.0):
        raise WiringError(f"base sample time {base} s, expected a finite number > 0")
    every = []
    for name, block in blocks.items():
        ratio = block.dt / base
        if not math.isfinite(ratio) or round(ratio) < 1 or abs(ratio - round(ratio)) > 1e-9 * ratio:
            raise WiringError(
                f"sample time of {name} is {block.dt:g} s, not a whole multiple of the base step {base:g} s; "
                f"sample times: {', '.join(f'{n} {b.dt:g} s' for n, b in blocks.items())}"
            )
        every.append(round(ratio))
    return base, tuple(every)


def _nearest(name: str, names: Any) -> str:
    near = difflib.get_close_matches(name, list(names), n=1)
    return f"; did you mean '{near[0]}'?" if near else ""


def read_npz(file: str | FilePath, where: str) -> dict[str, np.ndarray]:
    """The arrays in a NumPy .npz file; raises ValueError, in the name of `where`, for any other or a broken file."""
    try:
        with FilePath(file).open("rb") as stream, np.lib.npyio.NpzFile(stream, allow_pickle=False) as data:
            return {key: data[key] for key in data.files}
    except FileNotFoundError:
        raise
    except (OSError, ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{where}: {file} is no NumPy .npz file, or a broken one ({error})") from error


def _packed(values: Any) -> np.ndarray:
    """Scalars as one array; those that are the same for all cars of a batch are repeated."""
    return np.array(np.broadcast_arrays(*values) if isinstance(values, tuple) and values else values, dtype=float)


def _unpacked(value: np.ndarray, *, vector: bool) -> Any:
    if vector:
        return tuple(_unpacked(v, vector=False) for v in value)
    return float(value) if value.ndim == 0 else np.array(value)


def _like(template: State, values: Any) -> State:
    scalars = [_unpacked(v, vector=False) for v in values]
    return type(template)(*scalars) if hasattr(template, "_fields") else tuple(scalars)
