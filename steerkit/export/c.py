"""Blocks and controller parts of loops as self-contained C99, for an ECU."""

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import known, require
from steerkit.compiled.c_code import SCALAR_TYPES, c_number, phase_labels, statements, table_source
from steerkit.compiled.trace import Trace, TraceError, start_of, trace
from steerkit.diagram.block import Block, Out, State
from steerkit.diagram.loop import Loop, Wire
from steerkit.diagram.maths import filled
from steerkit.diagram.simulation import simulate

_ROWS = 200  # of the recorded log in the test program
_TYPICAL = {"rad": 0.5, "rad/s": 0.3, "m": 0.6, "m/s": 8.0, "1/m": 0.05, "1": 1.0}  # of made-up inputs, by unit


def export_c(what: Block | Loop, out: str | Path, *, blocks: Sequence[str] = (), name: str | None = None) -> list[Path]:
    """Write a block, or some `blocks` of a loop, as C99 with a header, a CMake file and a test that replays a log.

    The C is one file with no allocation, no recursion and nothing of libc but math.h::

        void <name>_init(<name>_state *s);
        void <name>_step(<name>_state *s, const <name>_inputs *u, <name>_outputs *y);

    one call of `step` a sample (`<NAME>_DT` seconds); state, inputs and outputs are structs of doubles. Inputs are
    the signals that the chosen blocks take from outside; their units, and the parameters with all limits, stand in
    the header. `init` gives the state that the loop (or the block) starts from here: a start that depends on the
    first inputs (`settle`) is worked out now, not on the ECU.

    `<name>_test.c` replays recorded inputs and returns 0 if every output agrees to 1e-9*(1 + |value|): of a loop 200
    samples of its simulation; of a single block made-up inputs through the block itself.

    blocks: of a loop, the names of the parts to export, such as ("controller", "doe", "recovery", "supervisor").
    name: of files, functions and structs (default: the block's class, or "controller"). Returns the files. Raises
    TraceError naming a block that cannot be exported; ValueError for a bad name or no blocks.
    """
    alone = isinstance(what, Block)
    loop, chosen = (_fed(what), ("block",)) if isinstance(what, Block) else (what, blocks)
    require(bool(chosen), "export_c", f"which blocks of the loop? blocks=(...) of: {', '.join(loop.names)}")
    part = _Part.of_loop(loop, chosen, alone)
    title = name or (re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", type(what).__name__).lower() if alone else "controller")
    fits = re.fullmatch(r"[a-z][a-z0-9_]*", title)
    require(bool(fits), "export_c", f"name {title!r}, expected a C identifier in lower case, such as 'recovery'")
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    texts = {
        f"{title}.h": part.header(title),
        f"{title}.c": part.source(title),
        f"{title}_test.c": part.test(title),
        "CMakeLists.txt": from_template("CMakeLists.txt.in", name=title),
    }
    for file, text in texts.items():
        (folder / file).write_text(text, encoding="utf-8")
    return [folder / file for file in texts]


def _external(units: Mapping[str, str], dt: float, rows: Sequence[Sequence[float]] | None = None) -> Block:
    """A block that stands for the outside: its state is what comes in, row after row, and its outputs show it."""

    def init(self: Block, batch: tuple[int, ...] = ()) -> State:
        return tuple(rows[0]) if rows else tuple(filled(0.0, batch) for _ in units)

    def output(self: Block, t: Any, x: State, u: Any) -> Any:
        return self.Y(*x)

    def update(self: Block, t: Any, x: State, u: Any, y: Any) -> State:
        return tuple(rows[min(round(t / dt) + 1, len(rows) - 1)]) if rows else x

    ports = {signal: Out(unit, direct=()) for signal, unit in units.items()}
    kind: Any = type("External", (Block,), {**ports, "init": init, "output": output, "update": update})
    return dataclasses.dataclass(frozen=True, eq=False, kw_only=True)(kind)(dt=dt)


def _fed(block: Block) -> Loop:
    """A loop of the block and of made-up inputs."""
    kind, units = type(block).__name__, {p.name: p.unit for p in block.inputs}
    if not block.pure:
        raise TraceError(f"export_c: {kind} is not pure, so it cannot be exported")
    if any(getattr(block, name).size is not None for name in units):
        raise TraceError(f"export_c: {kind} has a vector input; export it as a part of its loop")
    if not units:
        return Loop(blocks={"block": block}, wires=[])
    rows = np.random.default_rng(0).normal(size=(_ROWS, len(units)))
    rows *= [_TYPICAL.get(unit, 1.0) for unit in units.values()]
    speeds = [unit == "m/s" for unit in units.values()]
    rows[:, speeds] = np.abs(rows[:, speeds])
    made_up = _external(units, block.dt, rows.tolist())
    return Loop(
        blocks={"made_up": made_up, "block": block}, wires=[(getattr(made_up, n), getattr(block, n)) for n in units]
    )


@dataclasses.dataclass(frozen=True)
class _Part:
    """What is exported, with names for C, and a recording of it."""

    trace: Trace
    start: list[float]
    inputs: dict[str, str]
    outputs: dict[str, str]
    rows: np.ndarray
    expected: np.ndarray

    @classmethod
    def of_loop(cls, loop: Loop, names: Sequence[str], alone: bool) -> "_Part":
        """The named blocks of a loop, with a piece of its simulation. alone: ports are named without their block."""
        for name in names:
            known(name, loop.names, "block of the loop")
        chosen = {n: loop.blocks[n] for n in loop.names if n in names}
        sources = {
            loop.port_name(a): a for a, b in loop.wires if b.block in chosen.values() and a.block not in chosen.values()
        }
        for signal, port in sources.items():
            if port.size is not None:
                raise TraceError(f"export_c: {signal} is a vector; export {signal.split('.')[0]} along with the others")
        dt = min(block.dt for block in chosen.values())

        def c_name(signal: str) -> str:
            return signal.split(".")[1] if alone else signal.replace(".", "_")

        units = {c_name(signal): port.spec.unit for signal, port in sources.items()}
        outside = _external(units, dt)
        wires: list[Wire] = []
        for a, b in loop.wires:
            if b.block in chosen.values():
                inner = a.block in chosen.values()
                wires.append((a if inner else getattr(outside, c_name(loop.port_name(a))), b))
        inside = {"inputs": outside, **chosen} if sources else chosen
        start, every = start_of(loop), round(dt / loop.dt)
        made = trace(Loop(blocks=inside, wires=wires, dt=dt))
        log = simulate(loop, _ROWS * dt, state=start, every=every)
        x = [(0.0,) * len(sources)] * bool(sources) + [start.x[loop.names.index(n)] for n in chosen]
        y = [(0.0,) * len(sources)] * bool(sources) + [start.y[loop.names.index(n)] for n in chosen]
        signals = [s for s in made.layout.signals if not s.startswith("inputs.") or "inputs" in loop.blocks]
        columns = [log[s].reshape(len(log.t), -1) for s in signals]
        return cls(
            made,
            made.layout.pack(x, y),
            units,
            {c_name(signal): signal for signal in signals},
            np.column_stack([log[s] for s in sources] or [np.empty((len(log.t), 0))]),
            np.column_stack(columns),
        )

    @property
    def state(self) -> dict[int, str]:
        """Slots that go from sample to sample, with their C names."""
        layout, own = self.trace.layout, [slot for slot in self.trace.persistent if slot >= len(self.inputs)]
        first = min(slot for slot, _ in layout.signals.values())
        names = {slot: re.sub(r"\W", "_", layout.names[slot]) for slot in own}
        return {slot: f"{'held' if slot >= first else 'x'}_{name}_{slot}" for slot, name in names.items()}

    @property
    def results(self) -> list[tuple[str, int, str]]:
        """(C name, slot, unit) of every output."""
        rows = []
        for c_name, signal in self.outputs.items():
            slots = self.trace.layout.slots_of(signal)
            _, size = self.trace.layout.signals[signal]
            unit = self.trace.loop.units[signal]
            rows += [(c_name if size is None else f"{c_name}_{i}", slot, unit) for i, slot in enumerate(slots)]
        return rows

    def header(self, name: str) -> str:
        """The text of <name>.h."""
        numbers = ""
        for block_name, block in self.trace.loop.blocks.items():
            named = [name] if block_name == "block" else [name, block_name]
            fields = {"_".join([*named, field]).upper(): value for field, value in _numbers(block)}
            numbers += "\n" * bool(fields)
            numbers += "".join(f"#define {macro} {c_number(value)}\n" for macro, value in fields.items())
        inputs = [f"  double {field}; /* [{unit}] */\n" for field, unit in self.inputs.items()]
        return from_template(
            "block.h.in",
            name=name,
            guard=name.upper(),
            dt=c_number(self.trace.loop.dt),
            numbers=numbers,
            period=len(self.trace.ticks),
            state="".join(f"  double {field};\n" for field in self.state.values()),
            inputs="".join(inputs or ["  double none;\n"]),
            outputs="".join(f"  double {field}; /* [{unit}] */\n" for field, _, unit in self.results),
        )

    def source(self, name: str) -> str:
        """The text of <name>.c."""
        state, inputs = self.state, list(self.inputs)
        assert len(self.trace.layout) == len(self.start)

        def text(slot: int) -> str:
            if slot == 0:
                return "s->k"
            return f"u->{inputs[slot - 1]}" if slot <= len(inputs) else f"s->{state[slot - 1]}"

        slots = [*state, *(slot for _, slot, _ in self.results)]
        places = [*(f"s->{field}" for field in state.values()), *(f"y->{field}" for field, _, _ in self.results)]
        ticks, cases = "", ""
        for number, ((tick, _), label) in enumerate(zip(self.trace.kinds, phase_labels(self.trace, "u"))):
            roots = [tick.roots[slot] for slot in slots]
            ends = [f"  {place} = v{i};" for place, i in zip(places, roots)]
            code = "\n".join([*statements(tick.graph, roots, text, self.trace.tables), *ends])
            given = f"{name}_state *s, const {name}_inputs *u, {name}_outputs *y"
            ticks += f"static void tick{number}({given})\n{{\n  (void)u;\n{code}\n}}\n\n"
            cases += f"    {label} tick{number}(s, u, y); break;\n"
        return from_template(
            "block.c.in",
            name=name,
            types=SCALAR_TYPES,
            tables=table_source(self.trace.tables),
            ticks=ticks,
            start="".join(f"  s->{field} = {c_number(float(self.start[slot]))};\n" for slot, field in state.items()),
            cases=cases,
            period=len(self.trace.ticks),
        )

    def test(self, name: str) -> str:
        """The text of <name>_test.c."""
        results = [field for field, _, _ in self.results]

        def array(kind: str, rows: np.ndarray) -> str:
            width = max(1, rows.shape[1])
            text = ",\n".join("  {" + (", ".join(c_number(v) for v in row) or "0.0") + "}" for row in rows.tolist())
            return f"static const double {kind}[{len(rows)}][{width}] = {{\n{text}\n}};\n"

        copies = [f"    u.{field} = inputs[i][{j}];" for j, field in enumerate(self.inputs)]
        given = "\n".join(copies or ["    u.none = 0.0;"])
        seen = ", ".join(f"y.{field}" for field in results)
        labels = ", ".join(f'"{field}"' for field in results)
        return from_template(
            "replay_test.c.in",
            name=name,
            inputs=array("inputs", self.rows),
            expected=array("expected", self.expected),
            given=given,
            seen=seen,
            labels=labels,
            rows=len(self.rows),
            width=len(results),
        )


def _numbers(block: Block) -> list[tuple[str, float]]:
    values = [(f.name, getattr(block, f.name)) for f in dataclasses.fields(block) if f.name != "dt"]
    numbers = [(n, v) for n, v in values if isinstance(v, int | float) and not isinstance(v, bool)]
    return [(n, float(v)) for n, v in numbers if math.isfinite(v)]


def from_template(template: str, **values: Any) -> str:
    """The text of a file beside this one, with what stands for each @name@."""
    text = (Path(__file__).parent / template).read_text(encoding="utf-8")
    return re.sub(r"@(\w+)@", lambda found: str(values[found[1]]), text)
