"""The loop of a drive, assembled in one place; test drives over whole rounds, and their table."""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from rich.markup import escape
from rich.table import Table

from steerkit._support.console import shown
from steerkit._support.errors import known, require
from steerkit.compiled import compile
from steerkit.compiled.trace import parameter, replaced, with_parameters
from steerkit.controllers.supervisor import Supervisor
from steerkit.diagram.block import Block, state_like
from steerkit.diagram.loop import Loop, LoopState
from steerkit.diagram.simulation import Log, Sample, simulate
from steerkit.estimators.steering_sign import SteeringSigns
from steerkit.metrics import TABLE, measures_of_log, of_log, r79_acceleration, r79_jerk
from steerkit.metrics.drive import Summary
from steerkit.metrics.signals import largest
from steerkit.plots.style import PALETTE, new_figure, styled
from steerkit.scenario import Scenario
from steerkit.scenario.assembly import bare, steering_loop
from steerkit.scenario.catalogue import make_controller
from steerkit.task import DT, TRIP
from steerkit.vehicles.rollout import Rollout

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def assembled(
    scenario: Scenario,
    controller: Block,
    *,
    doe: Block | None = None,
    recovery: Block | None = None,
    safety: Block | None = None,
    seed: int = 0,
) -> Loop:
    """The loop of a drive in simulation, whoever drives: learner, test drive, suite or environment.

    controller, doe, recovery, safety: as for `steering_loop`. seed: of driver, sensors, gusts and the link's delays.
    Raises what `steering_loop` raises.
    """
    path, law = scenario.path(), cast(Any, bare(controller))
    own = scenario.reference == "own" and hasattr(law, "reference")
    blocks: dict[str, Any] = dict(scenario.blocks(path, scenario.course.start, seed))
    return steering_loop(
        path=path,
        controller=controller,
        doe=doe,
        recovery=recovery,
        supervisor=None if recovery is None else Supervisor(limit=scenario.nominal.delta_sw_max, dt=controller.dt),
        reference=law.reference if own else scenario.ahead,
        safety=safety,
        **blocks,
    )


_STEADY = 0.05
"""A wheel that is so near its command follows it [rad]."""


class SignCheck:
    """Does the car of a loop turn where it is steered? `look` at its samples: see `SteeringSigns`."""

    def __init__(self, scenario: Scenario, loop: Loop, dt: float):
        self._plant, self._signs = scenario.vehicle.plant, SteeringSigns(Rollout.of(scenario.nominal), dt)
        self._steady = False
        chain = [name for name in ("link", "actuator", "column", "car") if name in loop.blocks]
        into = loop.inputs_of(chain[0])
        self._command = next(into[name] for name in ("delta_sw_cmd", "delta_sw_in") if name in into)
        last = chain[-2] if len(chain) > 1 else "car"
        outputs = [port.name for port in loop.blocks[last].outputs]
        self._wheel = f"{last}.{'delta_sw_meas' if 'delta_sw_meas' in outputs else 'delta_sw'}"

    def look(self, sample: Sample) -> None:
        """At a sample; raises ValueError where the steering is wired the wrong way round."""
        signs = self._signs
        v, r, psi = (sample[f"car.{name}"] for name in ("v", "r", "psi"))
        command, wheel = sample[self._command], sample[self._wheel]
        # where a run goes on, commands from before are on their way: their answer would be taken for that to the next
        self._steady |= sample.t < 1.0 or abs(command - wheel) < _STEADY
        if not self._steady:
            return
        signs.add(sample.t, command=command, wheel=wheel, v=v, r=r, psi=psi)
        if wrong := signs.wrong():
            plant = f"plant '{self._plant}': at {sample.t:.1f} s it is steered the wrong way round"
            raise ValueError(f"{plant} (+ is left, ISO 8855): {wrong}")


def controller(name: str, scenario: Scenario) -> Block:
    """The controller of that name for that scenario, or your own: `steerkit.scenario.catalogue.make_controller`.

    Raises ValueError with the valid names.
    """
    return make_controller(name, scenario.design_model(clock=time.perf_counter))


def drive_loop(scenario: Scenario, steering: Block, *, doe: Block | None = None, seed: int = 0) -> Loop:
    """The loop of a test drive: a policy (with its doe) has the scenario's recovery controller behind it."""
    if "ready" not in [port.name for port in steering.outputs]:
        return assembled(scenario, steering, doe=doe, seed=seed)
    if "ready_from" in {field.name for field in fields(steering)}:
        steering = replace(steering, ready_from=0.0)  # type: ignore[call-arg]
    return assembled(scenario, steering, doe=doe, recovery=scenario.recovery_controller(), seed=seed)


def drive(
    scenario: Scenario,
    steering: Block,
    *,
    doe: Block | None = None,
    seed: int = 0,
    rounds: float | None = None,
    progress: bool = False,
    only_while_held: bool = False,
    each: Callable[[Sample], None] | None = None,
) -> Log:
    """Drive the scenario's rounds of its course (or `rounds`) and return the log, 20 samples a second.

    only_while_held: end at the first sample in which the recovery controller has the wheel. each: called with every
    sample of the log as it is driven, such as a live stream's. The run also ends after the time that the slowest
    driver would need; then the last `path.progress` is short of `rounds` times the course. Raises ValueError where the
    car turns the other way than it is steered: `SignCheck`.
    """
    if rounds is not None:
        scenario = scenario.with_(course={"rounds": rounds})
    loop = drive_loop(scenario, steering, doe=doe, seed=seed)
    length, signs = scenario.length, SignCheck(scenario, loop, steering.dt)

    def over(sample: Sample) -> bool:
        signs.look(sample)
        if each is not None:
            each(sample)
        lost = only_while_held and sample["supervisor.learning"] < 0.5
        return lost or sample["path.progress"] >= length

    every = round(steering.dt / loop.dt)
    return simulate(loop, scenario.seconds, every=every, until=over, allow_nonfinite=True, progress=progress)


def held_all_along(log: Log, *, limit: float = TRIP) -> bool:
    """Did the controller stay within |e| <= limit [m] and, if learned, keep the wheel from the first sample on?"""
    on_course = bool((abs(log["path.e"]) <= limit).all())
    return on_course and ("supervisor.learning" not in log or bool((log["supervisor.learning"] > 0.5).all()))


_JUDGES = {"iso_11270": ("max_a_y", "max_jerk"), "un_r79": ("max_a_y_r79", "max_jerk_r79")}
"""The norms that a drive is judged by, and the metrics whose limits they set: lateral acceleration and jerk."""


def row_of(name: str, log: Log) -> dict[str, Any]:
    """A drive's figures, for a program: its controller, was it held, `steerkit.metrics.Summary`, and for ISO 11270 and
    UN R79 whether it keeps their limits."""
    a_y, found = log["car.a_y"], asdict(of_log(log))
    r79 = {"max_a_y_r79": largest(r79_acceleration(log.t, a_y)), "max_jerk_r79": largest(r79_jerk(log.t, a_y))}
    limits = {metric.name: metric.limit or 0.0 for metric in TABLE}
    judged = {norm: all((found | r79)[of] <= limits[of] for of in metrics) for norm, metrics in _JUDGES.items()}
    return {"controller": name, "held": held_all_along(log), **found, **judged}


_COLUMNS = {
    "RMS e\n[m]": "{rms_e:.3f}",
    "max e\n[m]": "{max_e:.3f}",
    "RMS wheel\nrate\n[deg/s]": "{rms_wheel_rate_deg:.0f}",
    "max a_y\n[m/s²]": "{max_a_y:.2f}",
    "|e| <\n0.05 m\n[%]": "{percent_within_5cm:.1f}",
    "max jerk\n[m/s³]": "{max_jerk:.1f}",
    "ISO\n11270": "{iso_11270}",
    "UN\nR79": "{un_r79}",
}


def comparison(title: str, logs: Mapping[str, Log]) -> Table:
    """A table with one row a drive."""
    table = Table(*map(escape, ("controller", "held", *_COLUMNS)), title=title)
    table.columns[0].overflow = "fold"
    for name, log in logs.items():
        row = row_of(name, log)
        row["percent_within_5cm"] = 100.0 * row["share_within_5cm"]
        row |= {norm: "kept" if row[norm] else "not" for norm in _JUDGES}
        table.add_row(escape(name), "yes" if row["held"] else "no", *(text.format(**row) for text in _COLUMNS.values()))
    return table


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
    metrics: Sequence[str] = USUAL,
    *,
    distance: float = math.inf,
    progress: bool = False,
) -> Sweep:
    """Drive a loop for `seconds` with every combination of parameter values, and measure each drive.

    values: `{"controller.k": [0.5, 1.0, 2.0], ...}`, fields as for `compile(parameters=...)`, of each the values (n,).
    metrics: names of `steerkit.metrics.TABLE`, for which the loop has the signal names of `steering_loop`. All drives
    draw the same random numbers. Logs have 20 samples a second. A metric is NaN where the car was lost.
    distance: what `path.progress` is when a drive is over [m], if that is before `seconds`; for an open course.
    progress: show a bar on the terminal.

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
    for metric in metrics:
        known(metric, METRICS, "metric")
    require(metrics, "sweep", "no metrics, expected one or more")
    quick = {*metrics} <= {*Summary.__dataclass_fields__}
    signals = [*_SIGNALS, *["path.progress"] * math.isfinite(distance)]
    grid = {name: a.ravel() for name, a in zip(points, np.meshgrid(*points.values(), indexing="ij"))}
    ready = compile(loop, record=signals, every=max(1, round(DT / loop.dt)), parameters=[*points])
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
            measured = vars(of_log(one)) if quick else measures_of_log(one)
            rows.append([measured[metric] for metric in metrics])
    return Sweep(points, grid | dict(zip(metrics, np.array(rows, dtype=float).T)))


def _start(loop: Loop, cars: Mapping[str, np.ndarray]) -> LoopState:
    """Where the cars start: all with the random numbers of one car, which in a batch differ from car to car."""
    states = []
    for name, block in loop.blocks.items():
        own = {field: numbers.tolist() for field, numbers in cars.items() if field.partition(".")[0] == name}
        fields = [field.partition(".")[2] for field in own]
        each = [block.init()] if not own else []
        for row in zip(*own.values()):
            each.append(replaced(block, dict(zip(fields, row)), name).init())
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
