"""A manoeuvre's runs: signals about the time at which the input began, in one sign; found in a log, or simulated."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import scipy  # its parts load when they are first used

from steerkit._support.errors import require
from steerkit.compiled import TraceError, compile
from steerkit.controllers.delay import delayed_stanley
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import Table
from steerkit.diagram.simulation import Log, simulate
from steerkit.logs.channels import Array
from steerkit.logs.drive import Drive
from steerkit.paths.courses import straight
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import Playback
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.proving.manoeuvre import SIDES, SPACING, Manoeuvre
from steerkit.scenario import Scenario, straightest
from steerkit.scenario.assembly import steering_loop
from steerkit.scenario.catalogue import make_controller
from steerkit.vehicles import FleetCar

NEEDED = ("delta_sw", "v", "r", "a_y")
SIGNED = ("delta_sw_cmd", "delta_sw", "r", "a_y", "beta", "e", "y", "psi")
"""Signals that change their sign where left and right are exchanged."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """One run of a manoeuvre: evenly sampled signals in SI. Raises ValueError for signals that do not fit."""

    t: Array
    """Time (n,) [s]; 0 where the input begins, or the drive does."""
    signals: Mapping[str, Array]
    """delta_sw [rad], v [m/s], r [rad/s], a_y [m/s^2], each (n,); and what else is known: delta_sw_cmd, psi [rad], beta
    [rad], e, x, y [m]."""
    side: str = "left"
    number: int = 1
    invalid: str = ""
    """Why it does not count; "" for a valid one."""
    whole: bool = False
    """Is it a drive of its own, of which the manoeuvre's conditions are not asked?"""

    def __post_init__(self) -> None:
        where = f"run {self.number}, {self.side}"
        missing = [name for name in NEEDED if name not in self.signals]
        require(not missing, where, f"no signal {', '.join(missing)}; expected {', '.join(NEEDED)}")
        for name, values in self.signals.items():
            require(len(values) == len(self.t), where, f"{name} has {len(values)} samples, t {len(self.t)}")
        steps = np.diff(self.t)
        even = len(steps) > 0 and steps.min() > 0.0 and np.ptp(steps) < 0.2 * steps.min()
        require(even, where, "t, expected two samples or more, evenly spaced [s]")

    def __getitem__(self, name: str) -> Array:
        return self.signals[name]

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return float(np.mean(np.diff(self.t)))

    def between(self, begin: float, end: float) -> Array:
        """The samples from begin to end [s] (n,)."""
        return np.asarray((self.t >= begin - 1e-9) & (self.t <= end + 1e-9))

    def about(self, name: str) -> Array:
        """A signal less its mean before the input (n,)."""
        before = self.between(-1.0, -self.dt)
        return self[name] - (self[name][before].mean() if before.any() else 0.0)


def prepared(run: Run, manoeuvre: Manoeuvre) -> Run:
    """A run as it is evaluated: to the left, filtered.

    Signals of a run to the right change their sign. Then all but positions go through a Butterworth low-pass of second
    order, forward and backward, which makes one of fourth order without lag; not where the sampling is too slow for it.
    """
    signals = {name: np.asarray(values, dtype=float) for name, values in run.signals.items()}
    signals = {name: SIDES[run.side] * values if name in SIGNED else values for name, values in signals.items()}
    if 0.0 < manoeuvre.cutoff < 0.45 / run.dt and len(run.t) > 30:
        sos = scipy.signal.butter(2, manoeuvre.cutoff, fs=1.0 / run.dt, output="sos")
        for name in ("delta_sw_cmd", "delta_sw", "r", "a_y", "beta"):
            if name in signals:
                signals[name] = scipy.signal.sosfiltfilt(sos, signals[name])
    return replace(run, signals=signals)


def checked(run: Run, manoeuvre: Manoeuvre) -> Run:
    """The run, invalid with a reason where the manoeuvre's conditions or limits did not hold."""
    if run.invalid:
        return run
    conditions, abort, seconds = manoeuvre.conditions, manoeuvre.abort, run.t[-1]
    before = run.between(-conditions.settle, 0.0)
    found = ""
    if not all(np.isfinite(run[name]).all() for name in NEEDED):
        found = "signals are not finite"
    elif run.whole:
        return run
    elif (off := float(np.abs(run["v"] - conditions.v).max())) > min(conditions.v_tolerance, abort.v):
        found = f"speed {off:.2f} m/s off, {min(conditions.v_tolerance, abort.v):g} allowed"
    elif manoeuvre.input and run.t[0] < -0.5 * conditions.settle and abs(run["r"][before].mean()) > conditions.r_max:
        found = f"not straight ahead before: r = {run['r'][before].mean():.4f} rad/s, {conditions.r_max:g} allowed"
    elif manoeuvre.input and seconds < manoeuvre.seconds - 0.5:
        found = f"ends after {seconds:.1f} of {manoeuvre.seconds:.1f} s"
    else:
        for name, limit, unit in (("a_y", abort.a_y, "m/s^2"), ("r", abort.r, "rad/s")):
            if not found and (most := float(np.abs(run[name]).max())) > limit:
                found = f"|{name}| = {most:.2f} {unit}, {limit:g} allowed"
    return replace(run, invalid=found)


LIKE = {"delta_sw": 0.95, "r": 0.85}
"""From which correlation with the form on a stretch counts: of the wheel, and of the yaw rate on a course."""
SMALLEST = {"delta_sw": 0.02, "r": 0.02}
"""Size of the form that is not noise [rad], [rad/s]."""
PACES = (0.7, 0.8, 0.9, 1.0, 1.15, 1.3, 1.5)
"""Lengths of a course that are looked for, over that of the manoeuvre's speed: drivers take it in their own way."""


def found(manoeuvre: Manoeuvre, drive: Drive) -> tuple[Manoeuvre, list[Run], list[str]]:
    """The manoeuvre as it was driven in a log, at the speed that it was; its runs; and what is to be known of them.

    A form that has a beginning and an end, straight driving before it included, is looked for by its normalised
    correlation with the angle of the wheel, or with the yaw rate for a lane change. Steady driving, random steering and
    lane keeping have none: there the whole drive is the run, and evaluations take of it what they can use.
    a_y = v r: a log tells no rate of the sideslip, which is in the a_y of a car only while that changes.
    Source: Lewis 1995 (normalised correlation).
    """
    notes = ["a_y = v r: the log has no lateral acceleration of its own"]
    signals: dict[str, Array] = {"delta_sw": drive.delta_sw, "v": drive.v, "r": drive.r, "a_y": drive.v * drive.r}
    signals |= {key: value for key, value in vars(drive).items() if key in ("x", "y", "psi") and value is not None}
    lane_change = manoeuvre.course.startswith("iso3888")
    if manoeuvre.evaluation in ("steady", "course") and not lane_change:
        notes.append("the whole drive is evaluated; the conditions of the manoeuvre are not asked of it")
        return manoeuvre, [Run(t=drive.t, signals=signals, whole=True)], notes
    if manoeuvre.input is not None and manoeuvre.input.form == "random":
        notes.append("stretches of even speed are evaluated; the conditions of the manoeuvre are not asked of them")
        return manoeuvre, _even(drive, signals, 3.0 * manoeuvre.input.period), notes
    form, name, places = _looked_for(manoeuvre, drive)
    if not places:
        notes.append(f"not in this log: no stretch whose {name} is like {form} (correlation {LIKE[name]:g})")
        return manoeuvre, [], notes
    v = float(np.median([drive.v[begin:end].mean() for begin, end, _ in places]))
    driven = manoeuvre.at(v=v)
    if abs(v - manoeuvre.conditions.v) > manoeuvre.conditions.v_tolerance:
        notes.append(f"driven at {v:.1f} m/s, not at {manoeuvre.conditions.v:g}: figures are of that speed")
    runs, count = list[Run](), {"left": 0, "right": 0}
    settle = round(manoeuvre.conditions.settle / drive.dt)
    for begin, end, sign in sorted(places):
        side = "left" if sign > 0.0 else "right"
        count[side] += 1
        part = slice(max(begin - settle, 0), end)
        gap = "" if drive.measured[part].all() else "samples are missing"
        t, cut = drive.t[part] - drive.t[begin], {key: value[part] for key, value in signals.items()}
        runs.append(Run(t=t, signals=cut, side=side, number=count[side], invalid=gap))
    return driven, runs, notes


def _even(drive: Drive, signals: dict[str, Array], least: float) -> list[Run]:
    """Stretches of `least` [s] and more in which the speed stays within 1.5 m/s of its mean so far."""
    runs, edges = list[Run](), np.flatnonzero(np.diff(drive.driving.astype(int), prepend=0, append=0))
    for begin, end in edges.reshape(-1, 2).tolist():
        while begin < end:
            mean = np.cumsum(drive.v[begin:end]) / np.arange(1, end - begin + 1)
            off = np.abs(drive.v[begin:end] - mean) > 1.5
            length = int(np.argmax(off)) if off.any() else end - begin
            if length * drive.dt >= least:
                cut = {key: value[begin : begin + length] for key, value in signals.items()}
                runs.append(Run(t=np.arange(length) * drive.dt, signals=cut, number=len(runs) + 1, whole=True))
            begin += length
    return runs


def _looked_for(manoeuvre: Manoeuvre, drive: Drive) -> tuple[str, str, list[tuple[int, int, float]]]:
    """What the form is called, the signal, and (begin, end, sign) of each stretch like it, none over another."""
    straight = np.zeros(round(min(manoeuvre.conditions.settle, 1.0) / drive.dt))
    if manoeuvre.input is not None:
        at = np.arange(0.0, manoeuvre.seconds, drive.dt)
        wave = manoeuvre.required.wave
        forms = [np.interp(at, np.arange(len(wave)) * SPACING, wave)]
        what, name = f"the input of {manoeuvre.name}", "delta_sw"
    else:
        v = float(np.median(drive.v[drive.driving]))
        path = manoeuvre.at(v=v).path()
        turned = np.flatnonzero(np.abs(path.samples.kappa) > 1e-4)
        begin, end = (path.samples.s[k] for k in (turned[0], turned[-1]))
        forms = [v * path.kappa(np.arange(begin, end, v * drive.dt / pace)) for pace in PACES]
        what, name = f"the course of {manoeuvre.name}", "r"
    signal = getattr(drive, name)
    candidates: list[tuple[float, int, int, float]] = []
    for form in forms:
        whole = np.concatenate((straight, form))
        if len(whole) >= len(signal):
            continue
        correlation, size = correlated(signal, whole)
        size = size * np.abs(form).max()
        for sign in (1.0, -1.0):
            like = np.where(sign * size >= SMALLEST[name], sign * correlation, 0.0)
            for k in scipy.signal.find_peaks(like, height=LIKE[name], distance=len(form))[0]:
                candidates.append((float(like[k]), int(k) + len(straight), int(k) + len(whole), sign))
    kept: list[tuple[int, int, float]] = []
    for _, first, last, sign in sorted(candidates, reverse=True):
        if all(last <= a or first >= b for a, b, _ in kept):
            kept.append((first, last, sign))
    return what, name, kept


def correlated(signal: Array, form: Array) -> tuple[Array, Any]:
    """Normalised correlation of a form (m,) with each stretch of a signal (n,), and its size there, each (n - m + 1,).

    rho_k = sum (x_{k+i} - mean) (f_i - mean f)/(sqrt(sum (x - mean)^2) sqrt(sum (f - mean f)^2))
    """
    m, centred = len(form), form - form.mean()
    norm = float(np.sqrt(centred @ centred))
    product = scipy.signal.fftconvolve(signal, centred[::-1], mode="valid")
    total = np.concatenate(([0.0], np.cumsum(signal)))
    square = np.concatenate(([0.0], np.cumsum(signal**2)))
    variance = (square[m:] - square[:-m]) - (total[m:] - total[:-m]) ** 2 / m
    spread = np.sqrt(np.maximum(variance, 1e-12))
    return product / (spread * norm), product / norm**2


DT = 0.01
"""Sample time of an open-loop run [s]."""
_MARGIN = 5.0  # m: so far before the end of an open course a run ends
_straight = lru_cache(maxsize=8)(straight)  # runs of a manoeuvre have equal ones
_LAG = 0.12  # s: of the steering of a fleet's cars
_OPEN = ("m", "i_z", "l_f", "l_r", "c_f", "c_r", "steer_ratio")


def simulated(manoeuvre: Manoeuvre, scenario: Scenario, *, controller: str = "stanley", seed: int = 0) -> list[Run]:
    """The runs of a manoeuvre by a scenario's car and steering; its course and speeds are the manoeuvre's.

    Open loop: `controller` drives straight on until the input begins. A manoeuvre on a course it drives alone.
    A run is of what the car does, in samples of 0.01 s (the plant's own, if those are longer); the wheel's angle
    is the one held in the sample before, so that dead times read half a sample too short. Repeats have another
    seed each, and where nothing is drawn by lot they are the same. Raises ValueError for a car that does not take the
    speed, and what the scenario's parts do.
    """
    scenario = _at(scenario, manoeuvre.conditions.v)
    runs = []
    repeats = manoeuvre.repeats if scenario.random else 1
    for side in manoeuvre.sides:
        for number in range(1, repeats + 1):
            draw = 1000 * seed + number
            if manoeuvre.input is None:
                runs.append(_driven(manoeuvre, scenario, controller, side, number, draw))
            else:
                loop = open_loop(manoeuvre, scenario, side, draw, controller)
                runs.append(run_of(_log(loop, _seconds(manoeuvre)), manoeuvre, side, number, -_wait(manoeuvre)))
    return runs


def _log(loop: Loop, seconds: float) -> Log:
    """What `simulate` gives, bit for bit: of generated Python, in a third of the time, where all blocks allow that."""
    try:
        return compile(loop, backend="python").run(seconds, allow_nonfinite=True)
    except TraceError:
        return simulate(loop, seconds, allow_nonfinite=True)


def _wait(manoeuvre: Manoeuvre) -> float:
    return manoeuvre.conditions.settle + 1.0


def _seconds(manoeuvre: Manoeuvre, late: float = 0.0) -> float:
    return _wait(manoeuvre) + manoeuvre.seconds + late + DT


def open_loop(manoeuvre: Manoeuvre, scenario: Scenario, side: str, seed: int = 0, controller: str = "stanley") -> Loop:
    """The loop of a run: straight on, then the input, on a straight course that is long enough.

    `stanley` is one that knows the steering's delay, and it and the wave steer every 0.01 s; others at their own pace.
    """
    v, car = manoeuvre.conditions.v, scenario.nominal
    path = _straight(2.0 * v * _seconds(manoeuvre) + 200.0)
    blocks: dict[str, Any] = dict(scenario.blocks(path, 50.0, seed))
    blocks["sensors"] = blocks["estimator"] = None  # a test driver holds the wheel, who needs neither
    known = replace(scenario.design_model(), path=path)
    steering: Any = {name: getattr(known, name) for name in ("delay", "lag", "rate_limit", "slew", "a_y_limit")}
    base = make_controller(controller, known) if controller != "stanley" else delayed_stanley(car, dt=DT, **steering)
    steering = manoeuvre.open_loop(base, car, side, wait=_wait(manoeuvre))
    return steering_loop(path=path, controller=steering, reference=float(car.l_f), **blocks)


def on_course(manoeuvre: Manoeuvre, scenario: Scenario, controller: str, seed: int = 0) -> tuple[Loop, float]:
    """The loop of a run on the manoeuvre's course, and how far it goes [m]: of a closed one half a round."""
    v = manoeuvre.conditions.v
    path = manoeuvre.path()
    scenario = _at(scenario, v)
    law = make_controller(controller, replace(scenario.design_model(), path=path))
    blocks: dict[str, Any] = dict(scenario.blocks(path, straightest(path) if path.closed else 0.0, seed))
    loop = steering_loop(path=path, controller=law, reference=scenario.ahead, **blocks)
    return loop, 0.5 * path.length if path.closed else path.length - _MARGIN


def _at(scenario: Scenario, v: float) -> Scenario:
    """The scenario at that speed, on no course of its own."""
    driver = {"speed": "wander", "v_min": v, "v_max": v}
    return scenario.with_(course={"name": "straight", "start": 0.0}, driver=driver)


def _driven(manoeuvre: Manoeuvre, scenario: Scenario, controller: str, side: str, number: int, seed: int) -> Run:
    """A run on the manoeuvre's course."""
    loop, length = on_course(manoeuvre, scenario, controller, seed)
    seconds = 1.5 * length / manoeuvre.conditions.v
    log = simulate(loop, seconds, until=lambda sample: sample["path.progress"] >= length, allow_nonfinite=True)
    run = run_of(log, manoeuvre, side, number, 0.0)
    short = "" if log["path.progress"][-1] >= length else "the end of the course was not reached"
    return replace(run, invalid=short)


def run_of(log: Log, manoeuvre: Manoeuvre, side: str, number: int, start: float, car: int | None = None) -> Run:
    """A run from the log of a steering loop, which begins at `start` [s]; of a batch, that car's."""
    names = {key: f"car.{key}" for key in ("delta_sw", "v", "r", "a_y", "beta", "x", "y", "psi") if f"car.{key}" in log}
    names |= {"e": "path.e", "delta_sw_cmd": "controller.delta_sw"}
    if "column.delta_sw_meas" in log:
        names["delta_sw"] = "column.delta_sw_meas"
    signals = {key: log[name] if car is None else log[name][:, car] for key, name in names.items() if name in log}
    return Run(t=log.t + start, signals=signals, side=side, number=number)


def of_fleet(manoeuvre: Manoeuvre, cars: Sequence[FleetCar]) -> Iterator[tuple[FleetCar, list[Run]]]:
    """The runs of many production cars, in batches of a compiled program.

    Each has its own dead time and is steered by the angle that its data ask, or on a course by `stanley-delay`, which
    knows it; all have a lag of 0.12 s. The cars are linear single tracks, as of stiffness is all that is known of
    their tyres. A run to the left alone: to the right it is the same, mirrored.
    """
    if manoeuvre.input is None:
        yield from _on_course(manoeuvre, cars)
        return
    wait, v = _wait(manoeuvre), manoeuvre.conditions.v
    sizes = np.array([manoeuvre.required.angle(car.vehicle, v) for car in cars])
    late = np.array([car.steer_delay for car in cars])
    wave = np.concatenate((np.zeros(round(wait / DT)), np.median(sizes) * manoeuvre.required.wave))
    play = Playback(angles=tuple(wave.tolist()), speeds=(v,) * len(wave), dt=DT)
    actuator = SteeringActuator(lag=_LAG, limit=30.0, rate_limit=200.0, dt=DT)
    car = LinearSingleTrack(vehicle=cars[0].vehicle, v0=v, dt=DT)
    loop = Loop(
        blocks={"controller": play, "actuator": actuator, "car": car},
        wires=[(play.delta_sw, actuator.delta_sw_cmd), (actuator.delta_sw, car.delta_sw_cmd), (play.v, car.v_cmd)],
    )
    values = {f"car.vehicle.{key}": np.array([float(getattr(each.vehicle, key)) for each in cars]) for key in _OPEN}
    values |= {"controller.delay": late, "actuator.gain": sizes / np.median(sizes)}
    record = [f"car.{key}" for key in ("delta_sw", "v", "r", "a_y", "beta", "x", "y", "psi")]
    program = compile(loop, record=record, parameters=list(values))
    log = program.run(_seconds(manoeuvre, float(late.max())), parameters=values, allow_nonfinite=True)
    for k, each in enumerate(cars):
        yield each, [run_of(log, manoeuvre, "left", 1, -wait, k)]


def _on_course(manoeuvre: Manoeuvre, cars: Sequence[FleetCar]) -> Iterator[tuple[FleetCar, list[Run]]]:
    """The runs of a manoeuvre on a course: cars of one dead time are a batch."""
    for delay in sorted({round(car.steer_delay, 2) for car in cars}):
        group = [car for car in cars if round(car.steer_delay, 2) == delay]
        steering = {"delay": delay, "lag": _LAG}
        scenarios = [
            Scenario(vehicle={"name": car.vehicle.name, "plant": "linear"}, steering=steering) for car in group
        ]
        loops, lengths = zip(*(on_course(manoeuvre, scenario, "stanley-delay") for scenario in scenarios))
        values = differing(loops)
        record = [*(f"car.{key}" for key in ("delta_sw", "v", "r", "a_y")), "path.e"]
        program = compile(loops[0], record=record, parameters=list(values))
        log = program.run(
            lengths[0] / manoeuvre.conditions.v, parameters=values, batch=len(group), allow_nonfinite=True
        )
        yield from ((car, [run_of(log, manoeuvre, "left", 1, 0.0, k)]) for k, car in enumerate(group))


def differing(loops: Sequence[Loop]) -> dict[str, Array]:
    """The block fields in which loops of one structure differ, each with its value a loop (N,).

    Raises ValueError for loops that differ in what is no number, such as a table of gains.
    """
    each = [{f"{name}.{k}": v for name, block in loop.blocks.items() for k, v in _numbers(block)} for loop in loops]
    named = [key for key, value in each[0].items() if any(one.get(key) != value for one in each)]
    for key in named:
        require(isinstance(each[0][key], float), "batch", f"{key} differs from car to car and is no number")
    return {key: np.array([one[key] for one in each]) for key in named}


def _numbers(owner: Any, within: str = "") -> Iterator[tuple[str, Any]]:
    """Every field, those of dataclasses in it too; of what is no number whatever tells two of it apart."""
    for field in fields(owner):
        value, name = getattr(owner, field.name), f"{within}{field.name}"
        if is_dataclass(value):
            yield from _numbers(value, f"{name}.")
        elif isinstance(value, int | float):
            yield name, float(value)
        elif isinstance(value, Table):
            yield name, value.rows.tobytes()
        elif not isinstance(value, str):
            yield name, value
