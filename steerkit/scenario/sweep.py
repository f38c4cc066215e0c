"""A loop driven with every combination of parameter values, each a car of one compiled batch."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit._support.console import shown
from steerkit._support.errors import known, require
from steerkit.compiled import Backend, compile
from steerkit.compiled.trace import parameter, replaced, with_parameters
from steerkit.diagram.block import state_like
from steerkit.diagram.loop import Loop, LoopState
from steerkit.diagram.simulation import Log
from steerkit.metrics import TABLE, measures_of_log, of_log
from steerkit.metrics.drive import Summary
from steerkit.plots.style import PALETTE, new_figure, styled
from steerkit.task import DT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

METRICS = {metric.name: metric for metric in TABLE if metric.group in ("tracking", "steering", "comfort")}
"""The metrics that a sweep knows by name."""
USUAL = ("rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y")
_SIGNALS = ("path.e", "path.psi_e", "car.delta_sw", "car.a_y")
_SAMPLES = 1e6
"""Samples of a batch: as many of each signal are in memory at once."""


@dataclass(frozen=True)
class Sweep:
    """What a sweep found; made by `sweep`. `found["rms_e"]` is a column, a number a drive."""

    values: dict[str, np.ndarray]
    """The values of each parameter."""
    columns: dict[str, np.ndarray]
    """One number a drive: the parameters, then the metrics; the last parameter varies fastest."""

    def __getitem__(self, name: str) -> np.ndarray:
        return self.columns[known(name, self.columns, "column of the sweep")]

    def best(self, metric: str) -> dict[str, float]:
        """The drive with the best value of a metric (the smallest, where less is better or nothing is known of it).

        Raises ValueError where every drive's is NaN.
        """
        column = self[metric]
        require(np.isfinite(column).any(), "Sweep.best", f"{metric} is NaN for all {len(column)} drives")
        less = metric not in METRICS or METRICS[metric].lower_is_better
        row = int(np.nanargmin(column) if less else np.nanargmax(column))
        return {name: float(values[row]) for name, values in self.columns.items()}

    @styled
    def plot(self) -> "Figure":
        """A panel a metric over one parameter, or over two with the metric as colour; gaps where it is NaN.

        An axis is logarithmic where its values are evenly spaced in log. Raises ValueError for more parameters.
        """
        names, metrics = list(self.values), [name for name in self.columns if name not in self.values]
        require(len(names) <= 2, "Sweep.plot", f"{len(names)} parameters ({', '.join(names)}), expected one or two")
        figure, panels = new_figure(len(metrics), height=0.7 + 2.2 * len(metrics))
        for panel, metric, colour in zip(panels, metrics, [*PALETTE] * len(metrics)):
            unit = METRICS[metric].unit if metric in METRICS else "1"
            label = f"{metric} [{unit}]".removesuffix(" [1]")
            in_log = [len(v) > 2 and min(v) > 0.0 and np.ptp(np.diff(np.log(v))) < 1e-6 for v in self.values.values()]
            scales = {name: "log" if log else "linear" for name, log in zip(("xscale", "yscale"), in_log)}
            if len(names) == 1:
                panel.plot(self.values[names[0]], self[metric], "." if len(self[metric]) == 1 else "-", color=colour)
                panel.set(ylabel=label, **scales)
            else:
                table = np.ma.masked_invalid(np.reshape(self[metric], [len(v) for v in self.values.values()]).T)
                drawn = panel.pcolormesh(*self.values.values(), table, shading="nearest", cmap="viridis_r")
                figure.colorbar(drawn, ax=panel, label=label)
                panel.set(ylabel=names[1], **scales)
        panels[-1].set_xlabel(names[0])
        return figure


def sweep(
    loop: Loop,
    values: Mapping[str, Any],
    seconds: float,
    metrics: Sequence[str | Callable[[Log], float]] = USUAL,
    *,
    distance: float = math.inf,
    record: Sequence[str] = (),
    backend: Backend = "auto",
    progress: bool = False,
) -> Sweep:
    """Drive a loop for `seconds` with every combination of parameter values, and measure each drive.

    values: `{"controller.k": [0.5, 1.0, 2.0], ...}`, fields as for `compile(parameters=...)`, of each the values (n,).
    metrics: names of `steerkit.metrics.TABLE`, for which the loop has the signal names of `steering_loop`; or functions
    of one car's log, which then holds the signals of `record` too. All drives draw the same random numbers. Logs have
    20 samples a second. A metric is NaN where the car was lost.
    distance: what `path.progress` is when a drive is over [m], if that is before `seconds`; for an open course.
    backend: as for `compile`. progress: show a bar on the terminal.

    Raises ValueError for values refused or without effect, an unknown metric, a bad duration, and what `compile` does.
    """
    require(values, "sweep", "no parameters; expected such as {'controller.k': [0.5, 1.0, 2.0]}")
    points = {name: np.atleast_1d(np.asarray(given, dtype=float)) for name, given in values.items()}
    for name, given in points.items():
        good = given.ndim == 1 and given.size > 0 and np.isfinite(given).all()
        require(good, "sweep", f"{name} = {given}, expected finite numbers (n,) with n >= 1")
        present = parameter(loop, name)
        single = isinstance(present, float | int) and not isinstance(present, bool)
        require(single, "sweep", f"{name} = {present!r:.60}, expected the name of a field that holds one number")
    named = [known(metric, METRICS, "metric") for metric in metrics if isinstance(metric, str)]
    names = [metric if isinstance(metric, str) else getattr(metric, "__name__", repr(metric)) for metric in metrics]
    require(
        names and len({*names, *points}) == len(names) + len(points), "sweep", f"metrics {names}, expected other names"
    )
    quick = {*named} <= {*Summary.__dataclass_fields__}
    signals = dict.fromkeys([*_SIGNALS * bool(named), *["path.progress"] * math.isfinite(distance), *record])
    grid = {name: a.ravel() for name, a in zip(points, np.meshgrid(*points.values(), indexing="ij"))}
    ready = compile(loop, backend=backend, record=[*signals], every=max(1, round(DT / loop.dt)), parameters=[*points])
    for name in ready.trace.unread:
        starts = [with_parameters(loop, {name: v}).init() for v in np.unique(points[name])[[0, -1]].tolist()]
        low, high = (np.array(ready.trace.layout.pack(start.x, start.y), dtype=float) for start in starts)
        what = "no equation of the loop reads it: it was used when the loop was made; make a loop for each value"
        same = np.ptp(points[name]) > 0.0 and np.array_equal(low, high, equal_nan=True)
        require(not same, "sweep", f"{name}: {what}")
    rows = []
    size = max(8, int(_SAMPLES * DT / seconds)) if seconds > 0.0 else 8
    for first in shown(range(0, len(next(iter(grid.values()))), size), "sweep" * progress):
        cars = {name: column[first : first + size] for name, column in grid.items()}
        log = ready.run(seconds, state=_start(loop, cars), parameters=cars, allow_nonfinite=True)
        for one in _apart(log, distance):
            measured: dict[str, float] = {}
            if named:
                measured = vars(of_log(one)) if quick else measures_of_log(one)
            rows.append([measured[metric] if isinstance(metric, str) else metric(one) for metric in metrics])
    return Sweep(points, grid | dict(zip(names, np.array(rows, dtype=float).T)))


def _start(loop: Loop, cars: Mapping[str, np.ndarray]) -> LoopState:
    """Where the cars start: all with the random numbers of one car, which in a batch differ from car to car."""
    states = []
    for name, block in loop.blocks.items():
        own = {field: numbers.tolist() for field, numbers in cars.items() if field.partition(".")[0] == name}
        each = [block.init()] if not own else []
        for row in zip(*own.values()):
            one = block
            for field, value in zip(own, row):
                one = replaced(one, field.split(".")[1:], value, field)
            each.append(one.init())
            size = f"{', '.join(own)}: the state of {name} has {len(each[0])} or {len(each[-1])} numbers by its value"
            require(len(each[0]) == len(each[-1]), "sweep", f"{size}; make a loop for each value")
        states.append(state_like(each[0], map(np.array, zip(*each))) if own else each[0])
    return with_parameters(loop, dict(cars)).init(x=states)


def _apart(log: Log, distance: float) -> Iterator[Log]:
    """The logs of the cars of a batch, each up to the sample in which it has gone that far."""
    by_car = {name: np.ascontiguousarray(np.moveaxis(values, -1, 0)) for name, values in log.items()}
    for car in range(len(next(iter(by_car.values()), ()))):
        there = by_car["path.progress"][car] >= distance if math.isfinite(distance) else np.zeros(1)
        end = int(there.argmax()) + 1 if there.any() else None
        yield Log(log.t[:end], {name: values[car, :end] for name, values in by_car.items()}, log.units)
