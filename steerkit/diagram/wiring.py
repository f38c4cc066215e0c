"""Wires checked: where every input comes from, and in which order the blocks of a loop compute."""

import graphlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import WiringError
from steerkit.diagram.block import Block, In, Out, Port

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


class Wiring:
    """Named blocks and the wires between them, checked; what `steerkit.diagram.loop.Loop` runs.

    source: the place that drives each input, by (number of the block, name of the input). calls: the order of the
    `output` calls in a tick. Raises WiringError as `Loop` says.
    """

    def __init__(self, blocks: Mapping[str, Block], wires: Sequence[Wire]):
        _check_blocks(blocks)
        self.blocks = tuple(blocks.values())
        self.names = tuple(blocks)
        self._index = {id(block): i for i, block in enumerate(self.blocks)}
        self.wires = tuple(self._checked(wire) for wire in wires)
        self.source = self._sources()
        self.calls = self._schedule()

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
        for i, block in enumerate(self.blocks):
            for port in block.inputs:
                if (i, port.name) not in source:
                    named = zip(self.names, self.blocks)
                    fit = [f"{name}.{out.name}" for name, b in named for out in b.outputs if out.unit == port.unit]
                    raise WiringError(
                        f"{self.names[i]}.{port.name} [{port.unit}] is not driven; "
                        f"outputs with that unit: {', '.join(fit) or 'none'}"
                    )
        return source

    def _schedule(self) -> tuple[Call, ...]:
        """Order of the `output` calls. A block that feeds itself through outputs that do not depend on the input
        in question is called twice: first for those outputs (its unknown inputs are NaN), then for all."""
        self._check_algebraic_loops()
        known: set[Place] = set()
        calls: list[Call] = []
        waiting = list(range(len(self.blocks)))

        def sources(i: int) -> list[Place]:
            return [self.source[i, p.name] for p in self.blocks[i].inputs if p.direct]

        def early(i: int) -> list[int]:
            """Outputs of i that can be had now and are not yet."""
            block = self.blocks[i]
            return [
                j
                for j, out in enumerate(block.outputs)
                if out.direct is not None
                and (i, j) not in known
                and all(self.source[i, p.name] in known for p in out.direct if p.direct)
            ]

        while waiting:
            i = next((i for i in waiting if all(s in known for s in sources(i))), None)
            if i is not None:
                waiting.remove(i)
                calls.append(Call(i, tuple(sources(i))))
                known.update((i, j) for j in range(len(self.blocks[i].outputs)))
            else:
                i = next(i for i in waiting if early(i))
                had = tuple(s if s in known else None for s in sources(i))
                calls.append(Call(i, had, tuple(early(i))))
                known.update((i, j) for j in calls[-1].early)
        return tuple(calls)

    def _check_algebraic_loops(self) -> None:
        graph: dict[str, list[str]] = {}
        for (i, name), (j, out) in self.source.items():
            graph[f"{self.names[i]}.{name}"] = [f"{self.names[j]}.{self.blocks[j].outputs[out].name}"]
        for name, block in zip(self.names, self.blocks):
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

    def tick(self, due: Sequence[bool]) -> Any:
        """One tick as a straight run of Python calls: nothing is looked up that can be known beforehand."""
        lines = ["def tick(t, x, y):", "    pass"]
        scope: dict[str, Any] = {"nan": math.nan}

        def value(source: Place | None) -> str:
            return "nan" if source is None else f"y[{source[0]}][{source[1]}]"

        for call in self.calls:
            i = call.block
            if due[i]:
                args = ", ".join(value(s) for s in call.sources)
                lines.append(f"    y[{i}] = output{i}(t, x[{i}], D{i}({args}))")
        for i, block in enumerate(self.blocks):
            scope |= {f"output{i}": block.output, f"update{i}": block.update, f"D{i}": block.D, f"U{i}": block.U}
            if due[i]:
                args = ", ".join(value(self.source[i, p.name]) for p in block.inputs)
                lines.append(f"    x[{i}] = update{i}(t, x[{i}], U{i}({args}), y[{i}])")
        exec("\n".join(lines), scope)
        return scope["tick"]


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
            raise WiringError(
                f"sample time of {name} is {block.dt:g} s, not a whole multiple of the base step {base:g} s; "
                f"sample times: {', '.join(f'{n} {b.dt:g} s' for n, b in blocks.items())}"
            )
        every.append(round(ratio))
    return base, tuple(every)
