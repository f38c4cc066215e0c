"""N cars of a task in compiled C, episode after episode: one call a step, arrays in place, no Python a car."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from steerkit._support import native
from steerkit._support.errors import require
from steerkit._support.random import OpenSeed, RandomState
from steerkit.compiled.c_code import function_source, lanes_source
from steerkit.compiled.trace import Tick, Trace, trace, traced
from steerkit.controllers.network_policy import BOUND
from steerkit.diagram.maths import Table
from steerkit.gym.starts import Draw, reseeded
from steerkit.gym.task import Array, Task, not_finite

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
        task.require_period()
        self.task, self.n, self._how = task, cars, ctypes.c_int(_HOW[mode])
        self._names = [name.split(".")[1] for name in task.info]
        self._signals = [*task.columns, *task.info]
        code = episode_code(task, self._signals, "path.s")
        self._library = native.load(code.source, vector_maths=True)
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
            "state": np.zeros((groups, code.carried, lanes)),
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
            far=task.starts.last,
            start_e=task.start_e,
            start_psi_e=task.start_psi_e,
            cars=cars,
            padded=padded,
            groups=groups,
            **{name: array.ctypes.data for name, array in self._arrays.items()},
        )
        seen = self._arrays["observation"]
        fits = seen.shape == (cars, columns) and seen.dtype == np.float32 and seen.flags.c_contiguous
        require(
            fits, "Episodes", f"observation {seen.dtype} {seen.shape}, expected float32 {(cars, columns)}, contiguous"
        )
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
            self._explain()

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

    def _explain(self) -> None:
        signals = self._arrays["signals"].transpose(1, 0, 2).reshape(len(self._signals), -1)[:, : self.n]
        wrong = np.argwhere(~np.isfinite(signals))
        if len(wrong):
            row, car = wrong[0]
            raise not_finite(self._signals[row], car, signals[row, car], self._arrays["steps"][car])


# ---- the C ---------------------------------------------------------------------------------------------------

_AT = ctypes.c_void_p
_NUMBER = ctypes.c_double


class Fleet(ctypes.Structure):
    """The struct `fleet` of the C below: where the arrays are, and the task's numbers."""

    _fields_ = [
        *((name, _AT) for name in ("mid", "half", "action", "state", "signals", "observation", "last_observation")),
        *((name, _AT) for name in ("info", "last_info", "reward", "cost", "steps", "terminated", "truncated", "over")),
        *((name, _AT) for name in ("seed", "start", "generator", "next_uint32", "next_double")),
        *((name, _NUMBER) for name in ("failure", "longest", "end", "far", "start_e", "start_psi_e")),
        *((name, ctypes.c_longlong) for name in ("cars", "padded", "groups")),
    ]


_CODE = """\
#include <pthread.h>
#include <stdint.h>
typedef struct {{
  const double *mid, *half;       /* [{columns}] */
  const double *action;           /* [cars]; rad */
  double *state, *signals;        /* [groups][{carried}][LANES], [groups][{rows}][LANES] */
  float *observation, *last_observation;  /* [cars][{columns}] */
  double *info, *last_info;       /* [{infos}][padded] */
  double *reward, *cost;          /* [padded] */
  long long *steps;
  unsigned char *terminated, *truncated, *over;
  uint64_t *seed;                 /* of the starts that are given, with s, e, psi_e in `start` [padded][3] */
  double *start;
  void *const *generator;         /* [cars]: NumPy's bit generators */
  uint32_t (*next_uint32)(void *);
  double (*next_double)(void *);
  double failure, longest, end;   /* a failure's cost; the longest episode [steps]; where the course ends [m] */
  double far, start_e, start_psi_e;  /* largest s [m], |e| [m] and |psi_e| [rad] of a start */
  long long cars, padded, groups;
}} fleet;
typedef struct {{ const fleet *f; long long first, last; int how; }} part;
enum {{ NEXT_STEP, SAME_STEP, DISABLED }};
static real load(const double *a) {{ real r; __builtin_memcpy(&r, a, sizeof r); return r; }}
static void store(double *a, real r) {{ __builtin_memcpy(a, &r, sizeof r); }}
static uint64_t mixed(uint64_t z)
{{
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9u;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBu;
  return z ^ (z >> 31);
}}
/* one of `streams` of a seed, as steerkit._support.random.seed_state */
static void seeded(uint64_t seed, uint64_t stream, real *states, int lane)
{{
  uint64_t z = mixed(seed) ^ mixed(stream + 0x5EED);
  for (int i = 0; i < 6; i++) {{
    z += 0x9E3779B97F4A7C15u;
    states[i][lane] = (double)(1 + mixed(z) % (i < 3 ? 4294967086u : 4294944442u));
  }}
}}
static const uint64_t streams[] = {{ {streams} }};
/* draws a start as Task.draw does: the seed, the place, its e, its turn */
static void draw(const fleet *f, long long car)
{{
  void *g = f->generator[car];
  f->seed[car] = f->next_uint32(g) >> 1;
  double *to = f->start + 3 * car;
  const double s = f->next_double(g) * f->far;
  to[0] = {beginning} ? 0.0 : s;
  to[1] = -f->start_e + 2.0 * f->start_e * f->next_double(g);
  to[2] = f->start_psi_e * (-1.0 + 2.0 * f->next_double(g));
}}
static void observed(float *to, const fleet *f, const real *v, int lane)
{{
  for (int c = 0; c < {columns}; c++) {{
    const double scaled = (v[c][lane] - f->mid[c]) / f->half[c];
    to[c] = (float)(scaled < -{bound} ? -{bound} : scaled > {bound} ? {bound} : scaled);
  }}
}}
/* puts the lanes of `which` where `start` says */
static void begun(const fleet *f, long long group, mask which, real *s, real *v)
{{
  real given[3 + {random}], new_s[{carried}], new_v[{rows}];
  for (int l = 0; l < LANES; l++) {{
    const long long car = group * LANES + l;
    for (int i = 0; i < 3; i++) given[i][l] = f->start[3 * car + i];
    for (int i = 0; i < {random} / 6; i++) seeded(f->seed[car], streams[i], given + 3 + 6 * i, l);
  }}
  begin(given, new_s, new_v);
  for (int i = 0; i < {carried}; i++) s[i] = SELECT(which, new_s[i], s[i]);
  for (int i = 0; i < {rows}; i++) v[i] = SELECT(which, new_v[i], v[i]);
  for (int l = 0; l < LANES; l++)
    if (which[l]) f->steps[group * LANES + l] = 0, f->cost[group * LANES + l] = 0.0;
}}
static void kept(const fleet *f, long long group, const real *s, const real *v)
{{
  for (int i = 0; i < {carried}; i++) store(f->state + (group * {carried} + i) * LANES, s[i]);
  for (int i = 0; i < {rows}; i++) store(f->signals + (group * {rows} + i) * LANES, v[i]);
  for (int i = 0; i < {infos}; i++) store(f->info + i * f->padded + group * LANES, v[{columns} + i]);
  for (int l = 0; l < LANES; l++)
    if (group * LANES + l < f->cars) observed(f->observation + (group * LANES + l) * {columns}, f, v, l);
}}
static void stepped(const fleet *f, long long group, int how)
{{
  real s[{carried}], v[{rows}], before[{rows}], cost, failed;
  mask anew;
  const long long car0 = group * LANES;
  for (int i = 0; i < {carried}; i++) s[i] = load(f->state + (group * {carried} + i) * LANES);
  for (int i = 0; i < {rows}; i++) before[i] = load(f->signals + (group * {rows} + i) * LANES);
  const real action = load(f->action + car0);
  s[{agent}] = action;
  {ticks}
  look(s, v);
  judge(before, action, v, &cost, &failed);
  store(f->cost + car0, cost);
  for (int l = 0; l < LANES; l++) {{
    const long long car = car0 + l;
    const unsigned char out = failed[l] != 0, was = f->over[car];
    const unsigned char late = ++f->steps[car] >= f->longest || v[{place}][l] >= f->end;
    const unsigned char end = (out || late) && !(how == NEXT_STEP && was);
    anew[l] = (how == NEXT_STEP ? was : how == SAME_STEP && end) ? -1 : 0;
    f->reward[car] = how == NEXT_STEP && was ? 0.0 : out ? -f->failure : -cost[l];
    f->terminated[car] = out && end;
    f->truncated[car] = !out && end;
    f->over[car] = end && how != SAME_STEP;
    if (anew[l] && car < f->cars) {{
      if (how == SAME_STEP) {{
        observed(f->last_observation + car * {columns}, f, v, l);
        for (int i = 0; i < {infos}; i++) f->last_info[i * f->padded + car] = v[{columns} + i][l];
        f->last_info[{infos} * f->padded + car] = (double)f->steps[car];
        f->last_info[({infos} + 1) * f->padded + car] = cost[l];
      }}
      draw(f, car);
    }}
  }}
  int any = 0;
  for (int l = 0; l < LANES; l++) any |= anew[l] != 0;
  if (any) begun(f, group, anew, s, v);
  kept(f, group, s, v);
}}
static void *work(void *given)
{{
  const part *p = given;
  for (long long group = p->first; group < p->last; group++) stepped(p->f, group, p->how);
  return 0;
}}
void step(const fleet *f, int how, int threads)
{{
  part parts[64];
  pthread_t ids[64];
  int running[64];
  for (int i = threads - 1; i >= 0; i--) {{
    parts[i] = (part){{ f, f->groups * i / threads, f->groups * (i + 1) / threads, how }};
    running[i] = i > 0 && pthread_create(ids + i, 0, work, parts + i) == 0;
    if (!running[i]) work(parts + i);
  }}
  for (int i = 1; i < threads; i++) if (running[i]) pthread_join(ids[i], 0);
}}
/* begins the episodes of the cars of `which`, where `start` says */
void place(const fleet *f, const unsigned char *which)
{{
  for (long long group = 0; group < f->groups; group++) {{
    real s[{carried}], v[{rows}];
    mask anew;
    for (int i = 0; i < {carried}; i++) s[i] = load(f->state + (group * {carried} + i) * LANES);
    for (int i = 0; i < {rows}; i++) v[i] = load(f->signals + (group * {rows} + i) * LANES);
    for (int l = 0; l < LANES; l++) anew[l] = which[group * LANES + l] ? -1 : 0;
    begun(f, group, anew, s, v);
    kept(f, group, s, v);
    for (int l = 0; l < LANES; l++) if (anew[l]) f->over[group * LANES + l] = 0;
  }}
}}
int lanes(void) {{ return LANES; }}
"""


class EpisodeCode(NamedTuple):
    """The C of a task's episodes."""

    source: str
    carried: int
    """How many numbers of state a car has."""


class _Columns:
    """Stands for a batch of states in a cost: column i of it is a symbol."""

    def __init__(self, symbols: Sequence[Any]):
        self.symbols = symbols

    def __getitem__(self, place: tuple[slice, int]) -> Any:
        return self.symbols[place[1]]


def episode_code(task: Task, signals: Sequence[str], place: str) -> EpisodeCode:
    """The C of the task's episodes. signals: the observation's columns, then those of `info`; place: the true s.

    Raises TraceError for a loop, a cost or a start that cannot be run on symbols, naming which, and ValueError for a
    block that depends on t.
    """
    graphs = trace(task.loop)
    graphs.require_timeless("TrackSteering")
    tables = {id(table): (i, table) for i, table in enumerate(graphs.tables)}
    carried, columns = graphs.persistent, len(task.columns)
    rows = [graphs.layout.slots_of(name)[0] for name in signals]
    begin, streams = _begin(task, graphs, [*carried, *rows], tables)
    judge = traced("the cost", lambda symbol: _judged(task, symbol, columns), tables)
    known = [table for _, table in tables.values()]
    state, seen = [f"s[{i}]" for i in range(len(carried))], [f"v[{i}]" for i in range(len(rows))]

    def slot(number: int) -> str:
        return state[carried.index(number - 1)]

    def function(head: str, tick: Tick, names: Sequence[str], source: Callable[[int], str]) -> str:
        return function_source(head, tick, names, source, known)

    ticks = [Tick(tick.graph, tuple([tick.roots[i] for i in carried])) for tick in graphs.ticks]
    look = Tick(graphs.ticks[0].graph, tuple([graphs.ticks[0].roots[row] for row in rows]))
    arguments = [*(f"b[{i}]" for i in range(columns)), "a", *seen[:columns]]
    agent = sum(len(x) for x in graphs.layout.template.x[: task.loop.names.index("controller")])
    parts = [
        lanes_source(known),
        *(function(f"tick{phase}(real *s)", tick, state, slot) for phase, tick in enumerate(ticks)),
        function("look(const real *s, real *v)", look, seen, slot),
        function("begin(const real *d, real *s, real *v)", begin, [*state, *seen], "d[{}]".format),
        function(
            "judge(const real *b, real a, const real *v, real *cost, real *failed)",
            judge,
            ["*cost", "*failed"],
            arguments.__getitem__,
        ),
        _CODE.format(
            columns=columns,
            carried=len(carried),
            rows=len(rows),
            infos=len(rows) - columns,
            agent=carried.index(agent),
            random=6 * len(streams),
            streams=", ".join(map(str, streams or [0])),
            bound=BOUND,
            place=list(signals).index(place, columns),
            beginning=int(task.start == "beginning"),
            ticks=" ".join(f"tick{phase}(s);" for phase in range(len(ticks))),
        ),
    ]
    return EpisodeCode("\n".join(parts), len(carried))


def _begin(
    task: Task, graphs: Trace, slots: Sequence[int], tables: dict[int, tuple[int, Table]]
) -> tuple[Tick, list[int]]:
    """These slots at a start, of s, e, psi_e and six numbers for each of the streams of random numbers; the streams."""
    streams: dict[int, RandomState] = {}

    def start(symbol: Callable[[], Any]) -> list[Any]:
        s, e, psi_e = symbol(), symbol(), symbol()

        def states(stream: int) -> RandomState:
            if stream not in streams:
                streams[stream] = tuple([symbol() for _ in range(6)])
            return streams[stream]

        drawn = [reseeded(block, OpenSeed(states)).init() for block in task.loop.blocks.values()]
        first = task.starts.state(s, e, psi_e, drawn)
        values = graphs.layout.pack(first.x, first.y)
        return [values[slot] for slot in slots]

    return traced("the start", start, tables), [*streams]


def _judged(task: Task, symbol: Callable[[], Any], columns: int) -> tuple[Any, Any]:
    """Cost and failure of a step from one row of columns to another."""
    before, action, after = [symbol() for _ in range(columns)], symbol(), [symbol() for _ in range(columns)]
    price: Any = task.price
    return price(_Columns(before), action, _Columns(after))
