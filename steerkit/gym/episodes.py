"""N cars of a task in compiled C, episode after episode: one call a step, arrays in place, no Python a car."""

import ctypes
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from steerkit._support import native
from steerkit._support.errors import require
from steerkit._support.random import RandomState
from steerkit.compiled.c_code import function_source, head_source
from steerkit.compiled.trace import Tick, Trace, TraceError, trace, traced
from steerkit.controllers.network_policy import BOUND
from steerkit.diagram.loop import LoopState
from steerkit.diagram.maths import Array, Table
from steerkit.gym.task import Draw, Task, each, require_finite, reseeded

_HOW = {AutoresetMode.NEXT_STEP: 0, AutoresetMode.SAME_STEP: 1, AutoresetMode.DISABLED: 2}
_A_THREAD = 256  # cars for which a second thread is worth its start
_THREADS = 64  # as many as the C has room for


class Episodes:
    """N cars of a task in C: each step drives, judges and observes all of them, and begins ended episodes anew.

    Loop, cost and starts are traced and compiled together, and the starts are drawn from the cars' own NumPy
    generators: the same numbers, to rounding, as those of `Drives`, which is the same in Python. All arrays are written
    in place: what is to be kept has to be copied. What goes on after an end is Gymnasium's `AutoresetMode`.

    threads: by default one for 256 cars, up to the number of cores. observation: where to write what the agents see, a
    C-contiguous float32 array (N, columns); by default its own. Raises TraceError for a loop, cost or start that
    cannot be run on symbols, ValueError for sample times that do not fit, NoCompilerError without a C compiler.
    """

    observation: NDArray[np.float32]
    """What the agents see, (N, columns)."""
    reward: Array
    """(N,); so are the others."""
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    over: NDArray[np.bool_]
    """Whose episode is over and has not begun anew."""

    def __init__(
        self,
        task: Task,
        cars: int,
        mode: AutoresetMode,
        threads: int | None = None,
        observation: NDArray[np.float32] | None = None,
    ):
        self.task, self.n, self._how = task, cars, ctypes.c_int(_HOW[mode])
        self._names = [name.split(".")[1] for name in task.info]
        self._signals = [*task.columns, *task.info]
        source, carried = episode_code(task)
        self._library = native.load(source, vector_maths=True)
        lanes = self._library.lanes()
        groups = -(-cars // lanes)
        padded = groups * lanes
        cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        chosen = min(cores, cars // _A_THREAD) if threads is None else threads
        self._threads = ctypes.c_int(min(max(1, chosen), groups, _THREADS))
        columns, info = len(task.columns), len(task.info)
        self._arrays: dict[str, NDArray[Any]] = {
            "mid": np.array(task.description.mid, dtype=float),
            "half": np.array(task.description.half, dtype=float),
            "action": np.zeros(padded),
            "state": np.zeros((groups, carried, lanes)),
            "signals": np.zeros((groups, len(self._signals), lanes)),
            "observation": np.zeros((cars, columns), np.float32) if observation is None else observation,
            "last_observation": np.zeros((cars, columns), np.float32),
            "info": np.zeros((info, padded)),
            "last_info": np.zeros((info + 2, padded)),
            **{name: np.zeros(padded) for name in ("reward", "cost")},
            "steps": np.zeros(padded, np.int64),
            **{name: np.zeros(padded, np.bool_) for name in ("terminated", "truncated")},
            "over": np.ones(padded, np.bool_),
            "seed": np.zeros(padded, np.uint64),
            "start": np.zeros((padded, 3)),
            "generator": np.zeros(cars, np.uint64),
        }
        self._fleet = Fleet(
            failure=task.failure,
            longest=task.longest,
            end=task.end,
            far=task.last_start,
            start_e=task.start_e,
            start_psi_e=task.start_psi_e,
            cars=cars,
            padded=padded,
            groups=groups,
            **{name: array.ctypes.data for name, array in self._arrays.items()},
        )
        seen = self._arrays["observation"]
        fits = seen.shape == (cars, columns) and seen.dtype == np.float32 and seen.flags.c_contiguous
        given = f"observation {seen.dtype} {seen.shape}"
        require(fits, "Episodes", f"{given}, expected float32 {(cars, columns)}, contiguous")
        self._generators: list[np.random.Generator] = []
        for name in ("observation", "reward", "terminated", "truncated", "over"):
            setattr(self, name, self._arrays[name][:cars])

    def draw_from(self, generators: Sequence[np.random.Generator]) -> None:
        """Draw the starts of car i from generator i, which goes on as if Python had drawn them."""
        self._generators = list(generators)  # kept, as C is given their addresses
        faces = [generator.bit_generator.ctypes for generator in generators]
        self._arrays["generator"][:] = [face.state_address for face in faces]
        self._fleet.next_uint32 = ctypes.cast(faces[0].next_uint32, ctypes.c_void_p)
        self._fleet.next_double = ctypes.cast(faces[0].next_double, ctypes.c_void_p)

    def start(self, cars: NDArray[np.intp], draws: Sequence[Draw]) -> None:
        """Put the cars of these numbers where they were drawn."""
        self._arrays["seed"][cars] = [draw.seed for draw in draws]
        self._arrays["start"][cars] = [draw[1:] for draw in draws]
        which = np.zeros(len(self._arrays["over"]), np.bool_)
        which[cars] = True
        self._library.place(ctypes.byref(self._fleet), ctypes.c_void_p(which.ctypes.data))

    def step(self, actions: Array) -> None:
        """Drive all cars one sample with these actions [rad], and go on with the next episode where one has ended.

        Raises FloatingPointError when a signal is no finite number any more, ResetNeeded before the first start.
        """
        if not self._generators:  # C would draw from nothing
            raise gymnasium.error.ResetNeeded("step: no episode has begun; call reset()")
        self._arrays["action"][: self.n] = actions
        self._library.step(ctypes.byref(self._fleet), self._how, self._threads)
        if not np.isfinite(self._arrays["cost"][: self.n]).all() or not np.isfinite(self._arrays["info"]).all():
            signals = self._arrays["signals"].transpose(1, 0, 2).reshape(len(self._signals), -1)
            values = np.vstack([signals, self._arrays["cost"]])[:, : self.n]
            require_finite(self._signals, values, self._arrays["steps"])

    def infos(self) -> dict[str, Array]:
        """What an agent need not know but people want to, (N,) each: SI; copies."""
        return self._named(self._arrays["info"].copy(), self._arrays["steps"], self._arrays["cost"])

    def last(self) -> tuple[NDArray[np.float32], dict[str, Array]]:
        """Observations and infos at the end of the episodes that ended in the last step; of other cars, older ones."""
        rows = self._arrays["last_info"].copy()
        return self._arrays["last_observation"].copy(), self._named(rows[:-2], rows[-2], rows[-1])

    def _named(self, rows: Array, steps: NDArray[Any], cost: Array) -> dict[str, Array]:
        named = {name: row[: self.n] for name, row in zip(self._names, rows)}
        return named | {"t": steps[: self.n] * self.task.dt, "cost": cost[: self.n].copy()}


_AT = ctypes.c_void_p
_NUMBER = ctypes.c_double


class Fleet(ctypes.Structure):
    """The struct `fleet` of `episodes.c`: where the arrays are, and the task's numbers."""

    _fields_ = [
        *((name, _AT) for name in ("mid", "half", "action", "state", "signals", "observation", "last_observation")),
        *((name, _AT) for name in ("info", "last_info", "reward", "cost", "steps", "terminated", "truncated", "over")),
        *((name, _AT) for name in ("seed", "start", "generator", "next_uint32", "next_double")),
        *((name, _NUMBER) for name in ("failure", "longest", "end", "far", "start_e", "start_psi_e")),
        *((name, ctypes.c_longlong) for name in ("cars", "padded", "groups")),
    ]


_SOURCE = Path(__file__).with_suffix(".c")


class _Columns:
    """Stands for a batch of states in a cost: column i of it is a symbol."""

    def __init__(self, symbols: Sequence[Any]):
        self.symbols = symbols

    def __getitem__(self, place: tuple[slice, int]) -> Any:
        return self.symbols[place[1]]


def episode_code(task: Task) -> tuple[str, int]:
    """The C of the task's episodes, and how many numbers of state a car has.

    Raises TraceError naming a loop, cost or start that does not run on symbols, ValueError where a block needs t.
    """
    graphs = trace(task.loop)
    graphs.require_timeless("TrackSteering")
    tables = list(graphs.tables)
    carried, columns = graphs.persistent, len(task.columns)
    rows = [graphs.layout.slots_of(name)[0] for name in (*task.columns, *task.info)]
    begin, streams = _begin(task, graphs, [*carried, *rows], tables)
    judge = traced("the cost", lambda symbol: _judged(task, symbol, columns), tables)

    state, seen = [f"s[{i}]" for i in range(len(carried))], [f"v[{i}]" for i in range(len(rows))]

    def slot(number: int) -> str:
        return state[carried.index(number - 1)]

    def function(head: str, tick: Tick, names: Sequence[str], source: Callable[[int], str]) -> str:
        return function_source(head, tick, names, source, tables)

    ticks = [Tick(tick.graph, tuple([tick.roots[i] for i in carried])) for tick in graphs.ticks]
    look = Tick(graphs.ticks[0].graph, tuple([graphs.ticks[0].roots[row] for row in rows]))
    arguments = [*(f"b[{i}]" for i in range(columns)), "a", *seen[:columns]]
    agent = sum(len(x) for x in graphs.layout.x[: task.loop.names.index("controller")])
    numbers = {
        "COLUMNS": columns,
        "ROWS": len(rows),
        "INFOS": len(rows) - columns,
        "CARRIED": len(carried),
        "AGENT": carried.index(agent),
        "PLACE": columns + task.info.index("path.s"),
        "RANDOM": 6 * len(streams),
        "STREAMS": ", ".join(map(str, streams or [0])),
        "BOUND": BOUND,
        "BEGINNING": int(task.start == "beginning"),
        "TICKS(s)": " ".join(f"tick{phase}(s);" for phase in range(len(ticks))),
    }
    parts = [
        head_source(tables),
        *(function(f"tick{phase}(real *s)", tick, state, slot) for phase, tick in enumerate(ticks)),
        function("look(const real *s, real *v)", look, seen, slot),
        function("begin(const real *d, real *s, real *v)", begin, [*state, *seen], "d[{}]".format),
        function(
            "judge(const real *b, real a, const real *v, real *cost, real *failed)",
            judge,
            ["*cost", "*failed"],
            arguments.__getitem__,
        ),
        *(f"#define {name} {value}" for name, value in numbers.items()),
        _SOURCE.read_text(encoding="utf-8"),
    ]
    return "\n".join(parts), len(carried)


def _begin(task: Task, graphs: Trace, slots: Sequence[int], tables: list[Table]) -> tuple[Tick, list[int]]:
    """These slots at a start, of s, e, psi_e and six numbers for each of the streams of random numbers; the streams."""
    streams: dict[int, RandomState] = {}

    def start(symbol: Callable[[], Any]) -> list[Any]:
        s, e, psi_e = symbol(), symbol(), symbol()

        def states(stream: int) -> RandomState:
            if stream not in streams:
                streams[stream] = tuple([symbol() for _ in range(6)])
            return streams[stream]

        drawn = [reseeded(block, states).init() for block in task.loop.blocks.values()]
        first = task.start_state(s, e, psi_e, drawn)
        values = graphs.layout.pack(first.x, first.y)
        return [values[slot] for slot in slots]

    return traced("the start", start, tables), [*streams]


def _judged(task: Task, symbol: Callable[[], Any], columns: int) -> tuple[Any, Any]:
    """Cost and failure of a step from one row of columns to another."""
    before, action, after = [symbol() for _ in range(columns)], symbol(), [symbol() for _ in range(columns)]
    price: Any = task.price
    return price(_Columns(before), action, _Columns(after))


Backend = Literal["python", "c"]


def cars_of(
    task: Task, cars: int, backend: Backend, mode: AutoresetMode, threads: int | None = None
) -> "Drives | Episodes":
    """The cars of a task, in Python or in C; with a warning in Python where a part of it cannot be compiled."""
    require(backend in ("python", "c"), "TrackSteering", f"backend {backend!r}; valid: python, c")
    if backend == "python":
        return Drives(task, cars, mode)
    try:
        return Episodes(task, cars, mode, threads)
    except native.NoCompilerError as error:
        raise native.NoCompilerError(f"{error}; or go without: backend='python'") from error
    except TraceError as error:
        cure = "to compile it, use steerkit.diagram.maths in place of numpy"
        gymnasium.logger.warn(f"TrackSteering: {error}; all is computed in Python; {cure}")
        return Drives(task, cars, mode)


class Drives:
    """N cars, each with its own start, noise and clock; `Episodes` is the same in C, and documents what is here."""

    def __init__(self, task: Task, cars: int, mode: AutoresetMode):
        self.task, self.n, self._mode, self._loop = task, cars, mode, task.loop
        self._signals = [*task.columns, *task.info]
        self._at = [self._loop.locate(name) for name in self._signals]
        self._agent = self._loop.names.index("controller")
        self._k = np.zeros(cars)
        self._x: list[Any] = []
        self._y: list[Any] = []
        self._values = np.full((len(self._signals), cars), np.nan)
        self._steps, self._cost = np.zeros(cars, dtype=int), np.zeros(cars)
        self._generators: Sequence[np.random.Generator] = ()
        self._last: tuple[NDArray[np.float32], dict[str, Array]] | None = None
        self.reward, self.over = np.zeros(cars), np.ones(cars, dtype=bool)
        self.terminated, self.truncated = np.zeros(cars, dtype=bool), np.zeros(cars, dtype=bool)

    @property
    def observation(self) -> NDArray[np.float32]:
        return self.task.observation(self._s)

    @property
    def _s(self) -> Array:
        return self._values[: len(self.task.columns)].T

    def draw_from(self, generators: Sequence[np.random.Generator]) -> None:
        self._generators = generators

    def start(self, cars: NDArray[np.intp], draws: Sequence[Draw]) -> None:
        start = self.task.starts(draws)
        self._put(cars, start)
        first = self._loop.sample(start)
        for row, name in enumerate(self._signals):
            self._values[row, cars] = first[name]
        self._steps[cars], self._cost[cars], self.over[cars] = 0, 0.0, False

    def step(self, actions: Array) -> None:
        if not self._x:
            raise gymnasium.error.ResetNeeded("step: no episode has begun; call reset()")
        before = self._s.copy()
        self._x[self._agent] = (float(actions[0]) if self.n == 1 else actions,)
        for phase in range(self._loop.period):
            self._loop.run_phase(phase, self._t(phase), self._x, self._y)
        self._k += self._loop.period
        self._values = self._look()
        self._steps += 1
        self._cost, failed = self.task.price(before, actions, self._s)
        require_finite(self._signals, np.vstack([self._values, self._cost]), self._steps)
        late = (self._steps >= self.task.longest) | (self._values[self._signals.index("path.s")] >= self.task.end)
        self.reward = np.where(failed, -self.task.failure, -self._cost)
        self.terminated, self.truncated = failed, late & ~failed
        anew = self.over
        if self._mode is AutoresetMode.NEXT_STEP and anew.any():  # they were driven on for nothing
            self.reward[anew], self.terminated[anew], self.truncated[anew] = 0.0, False, False
        self.over = self.terminated | self.truncated
        if self._mode is AutoresetMode.SAME_STEP:
            anew = self.over.copy()
            self._last = self.observation, self.infos()
        if self._mode is not AutoresetMode.DISABLED and anew.any():
            cars = np.flatnonzero(anew)
            self.start(cars, [self.task.draw(self._generators[car]) for car in cars.tolist()])

    def infos(self) -> dict[str, Array]:
        rows = self._values[len(self.task.columns) :].copy()
        named = dict(zip([name.split(".")[1] for name in self.task.info], rows))
        return named | {"t": self._steps * self.task.dt, "cost": self._cost.copy()}

    def last(self) -> tuple[NDArray[np.float32], dict[str, Array]]:
        assert self._last is not None
        return self._last

    def _put(self, cars: NDArray[np.intp], start: LoopState) -> None:
        self._k[cars] = 0.0

        def number(value: Any) -> Any:
            return float(np.ravel(value)[0]) if self.n == 1 else np.array(np.broadcast_to(value, self.n), float)

        def exchanged(old: Any, value: Any) -> Any:
            new = number(old)
            new[cars] = value
            return new

        if self.n == 1 or not self._x:  # the first time all cars start
            self._x, self._y = ([each(number, part) for part in parts] for parts in (start.x, start.y))
        else:
            self._x = [each(exchanged, *states) for states in zip(self._x, start.x)]
            self._y = [each(exchanged, *outputs) for outputs in zip(self._y, start.y)]

    def _look(self) -> Array:
        x, y = list(self._x), list(self._y)
        self._loop.run_phase(0, self._t(0), x, y)
        return np.array([np.broadcast_to(y[i][j], self.n) for i, j in self._at], dtype=float)

    def _t(self, phase: int) -> Any:
        k = self._k + phase
        return float(k[0]) * self._loop.dt if self.n == 1 else k * self._loop.dt
