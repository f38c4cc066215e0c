"""Run a loop and keep its signals: `simulate` and `Log`."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import atomic_write, read_npz, write_npz, write_rows
from steerkit.diagram.block import Port
from steerkit.diagram.diagnostics import explained
from steerkit.diagram.loop import Loop, LoopState, Sample

if TYPE_CHECKING:
    import pandas as pd

    from steerkit.paths.path import Path

Signal = str | Port


class NonFiniteError(ArithmeticError):
    """A signal became NaN or infinite; `log` holds all that was recorded."""

    def __init__(self, message: str, log: "Log"):
        super().__init__(message)
        self.log = log


class Log(Mapping[str, np.ndarray]):
    """Recorded signals by name: `log["car.v"]` (or `log[car.v]`) is an array over `log.t` [s].

    Shapes: (T,) for a scalar, (T, n) for a vector port, (T, N) or (T, n, N) for a batch of N cars. `log.units` maps
    names to units. `log.state` is the loop's state after the last tick, to go on from.
    """

    def __init__(
        self,
        t: np.ndarray,
        signals: dict[str, np.ndarray],
        units: dict[str, str],
        *,
        loop: Loop | None = None,
        state: LoopState | Callable[[], LoopState] | None = None,
    ):
        self.t, self.signals, self.units, self.loop, self._state = t, signals, units, loop, state

    @property
    def state(self) -> LoopState | None:
        """The loop's state after the last tick, to go on from; that of a compiled run is made when it is asked for."""
        if callable(self._state):
            self._state = self._state()
        return self._state

    def __getitem__(self, key: Signal) -> np.ndarray:
        if isinstance(key, Port):
            if self.loop is None:
                raise KeyError(f"{key!r}: this log was loaded from a file; ask by name, such as 'car.v'")
            key = self.loop.port_name(key)
        if key not in self.signals:
            raise KeyError(f"no signal '{key}' in the log; recorded: {', '.join(self.signals)}")
        return self.signals[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.signals)

    def __len__(self) -> int:
        return len(self.signals)

    def __repr__(self) -> str:
        span = f"t = {self.t[0]:g} to {self.t[-1]:g} s" if len(self.t) else "empty"
        return f"Log({len(self.t)} samples, {span}; {', '.join(self.signals)})"

    def columns(self) -> dict[str, np.ndarray]:
        """One flat column a number: `t`, `car.v`, and `car.v[0]`, `car.v[1]`, ... for vectors and batches."""
        columns = {"t": self.t}
        for name, values in self.signals.items():
            if values.ndim == 1:
                columns[name] = values
            else:
                n = math.prod(values.shape[1:])
                columns |= {f"{name}[{i}]": values.reshape(-1, n)[:, i] for i in range(n)}
        return columns

    def to_pandas(self) -> "pd.DataFrame":
        """A DataFrame indexed by t [s]; units in `frame.attrs["units"]`. Needs pandas (extra `bench`)."""
        import pandas as pd

        frame = pd.DataFrame(self.columns()).set_index("t")
        frame.attrs["units"] = dict(self.units)
        return frame

    def save(self, file: str | FilePath) -> None:
        """Write to a file of the kind that its name says, whole or not at all: .npz, which `load` reads again, .csv
        with units in the header, `t [s],car.v [m/s]`, or .parquet with units as field metadata (extra `bench`).

        Raises ValueError for another name.
        """
        kind, units = FilePath(file).suffix, {"t": "s", **self.units}
        require(kind in (".npz", ".csv", ".parquet"), "Log.save", f"{file}, expected .npz, .csv or .parquet at its end")
        if kind == ".npz":
            texts = np.array([f"{name}\t{self.units[name]}" for name in self.signals])
            return write_npz(file, {"t": self.t, "units": texts, **self.signals}, compressed=True)
        columns = {(name, units[name.split("[")[0]]): values for name, values in self.columns().items()}
        if kind == ".csv":
            return write_rows(file, [f"{name} [{unit}]" for name, unit in columns], list(columns.values()))
        import pyarrow as pa
        import pyarrow.parquet as pq

        fields = [
            pa.field(name, pa.from_numpy_dtype(values.dtype), metadata={"unit": unit})
            for (name, unit), values in columns.items()
        ]
        with atomic_write(file) as draft:
            return pq.write_table(pa.table(list(columns.values()), schema=pa.schema(fields)), draft)

    @classmethod
    def load(cls, file: str | FilePath) -> "Log":
        """Read what `save` wrote; raises ValueError for any other or a broken file."""
        arrays = read_npz(file, "Log.load")
        if not {"t", "units"} <= arrays.keys():
            raise ValueError(f"Log.load: {file} was not written by Log.save; it holds {', '.join(arrays) or 'nothing'}")
        t, units = arrays.pop("t"), dict(str(row).split("\t") for row in arrays.pop("units"))
        return cls(t, arrays, units)

    def plot(self, *signals: Signal) -> Any:
        """Plot signals over time, one panel a unit; returns the matplotlib figure."""
        from steerkit.plots.diagram import plot_log

        return plot_log(self, signals)

    def animate(self, path: "Path | None", file: str | FilePath, **options: Any) -> FilePath:
        """Write a film of the run, .gif or .mp4: `steerkit.plots.animation.animate` with its options."""
        from steerkit.plots.animation import animate

        return animate(self, path, file, **options)

    def _repr_png_(self) -> bytes | None:
        """Some signals over time, for a notebook."""
        from steerkit.plots.diagram import telling
        from steerkit.plots.style import png

        return png(self.plot(*telling(self))) if len(self.t) > 1 else None


class Recorder:
    """Collects chosen signals tick by tick; `log()` turns them into arrays."""

    def __init__(self, loop: Loop, signals: Sequence[Signal] | None = None):
        self.loop = loop
        names = (
            list(loop.units) if signals is None else [s if isinstance(s, str) else loop.port_name(s) for s in signals]
        )
        self._places = {name: loop.locate(name) for name in names}
        self._blocks = sorted({i for i, _ in self._places.values()})
        self._rows: list[tuple[Any, ...]] = []
        self._ticks: list[int] = []

    def add(self, k: int, y: Sequence[Any]) -> None:
        """Keep the outputs `y` of tick k."""
        self._ticks.append(k)
        self._rows.append(tuple([y[i] for i in self._blocks]))

    def clear(self) -> None:
        """Forget what was kept, to go on with an empty record."""
        self._ticks, self._rows = [], []

    def log(self, state: LoopState | None = None) -> Log:
        """All that was kept, as a Log."""
        at = {i: n for n, i in enumerate(self._blocks)}
        signals = {name: _stack([row[at[i]][j] for row in self._rows]) for name, (i, j) in self._places.items()}
        t = np.array(self._ticks, dtype=float) * self.loop.dt
        return Log(t, signals, {n: self.loop.units[n] for n in signals}, loop=self.loop, state=state)


def joined(logs: Sequence[Log]) -> Log:
    """Logs of the same signals, one after the other, as one."""
    logs = [log for log in logs if len(log.t)] or list(logs[:1])
    require(logs, "joined", "no logs to join")
    signals = {name: np.concatenate([log.signals[name] for log in logs]) for name in logs[0].signals}
    return Log(np.concatenate([log.t for log in logs]), signals, logs[0].units)


def simulate(
    loop: Loop,
    duration: float,
    *,
    state: LoopState | None = None,
    batch: int | None = None,
    record: Sequence[Signal] | None = None,
    every: int = 1,
    until: Callable[[Sample], bool] | None = None,
    allow_nonfinite: bool = False,
    progress: bool = False,
) -> Log:
    """Run a loop for `duration` seconds and return its signals.

    state: where to start (default: `loop.init()`); `log.state` of an earlier run goes on with it. batch: number of
    cars to run at once. record: signals to keep (default: all). every: keep one tick in `every`. until: called with
    each kept sample; the run ends after the first that it answers True. progress: show a bar on the terminal.

    Raises ValueError for a bad argument; NonFiniteError, with the log so far, when a recorded signal became NaN or
    infinite, unless `allow_nonfinite`. An exception inside a block is raised with a note saying which tick it was.
    """
    finite = np.isfinite(duration) and duration > 0.0
    require(finite, "simulate", f"duration = {duration} s, expected a finite number > 0")
    require(every >= 1, "simulate", f"every = {every}, expected a whole number >= 1")
    one = state is None or batch is None
    require(one, "simulate", "give state or batch, not both; the state knows its number of cars")
    other = f"{type(loop).__name__} is no Loop; expected steering_loop(...) or Loop(...)"
    require(isinstance(loop, Loop), "simulate", other)
    start = loop.init(batch=batch) if state is None else state
    recorder = Recorder(loop, record)
    x, y = list(start.x), list(start.y)
    ticks: Any = range(start.k, start.k + max(1, round(duration / loop.dt)))
    if progress:
        from steerkit._support.console import shown

        ticks = shown(ticks, "simulate")
    k = start.k
    try:
        for k in ticks:
            loop.advance(k, x, y)
            if k == start.k:
                loop.check(start.x, x)
            if k % every == 0:
                recorder.add(k, y)
                if until is not None and until(Sample(loop, k * loop.dt, y)):
                    break
    except Exception as error:
        error.add_note(f"in tick {k}, t = {k * loop.dt:g} s, of {loop!r}")
        if (teaching := explained(error, loop.blocks)) is not None:
            raise teaching from error
        raise
    log = recorder.log(LoopState(k + 1, tuple(x), tuple(y)))
    if not allow_nonfinite:
        check_finite(log)
    return log


def check_finite(log: Log) -> None:
    """Raise NonFiniteError, with the log, naming the signal that was first NaN or infinite, if one was."""
    first: tuple[int, str] | None = None
    for name, values in log.signals.items():
        bad = ~np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
        if bad.any() and (first is None or int(bad.argmax()) < first[0]):
            first = int(bad.argmax()), name
    if first is not None:
        i, name = first
        value = log[name][i]
        lost = np.argwhere(~np.isfinite(value))
        places = ", ".join("-".join(map(str, place)) for place in lost[:5].tolist()) + ", ..." * (len(lost) > 5)
        of = f" for {len(lost)} of {value.size} ({places})" if value.ndim else ""
        what = f"{name} [{log.units[name]}] is {value[tuple(lost[0])]}{of} at t = {log.t[i]:g} s, first of all signals"
        raise NonFiniteError(f"{what}; the error's .log holds the run (allow_nonfinite=True returns it)", log)


def _stack(values: list[Any]) -> np.ndarray:
    if not values or (values[0].__class__ is float and values[-1].__class__ is float):
        return np.array(values, dtype=float)
    shape = np.broadcast_shapes(np.shape(values[0]), np.shape(values[-1]))
    return np.array([np.broadcast_to(v, shape) for v in values], dtype=float)
