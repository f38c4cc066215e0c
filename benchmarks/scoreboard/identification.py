"""Identification on track: tyres from 30 s under noise against nonlinear least squares, and what a residual adds.

`sysid_x_nls`: cars are driven here for 90 s near their limits: two of 1:10, tyres by Pacejka; a road car by Pacejka;
cars of the fleet drawn by the seed, tyres by Fiala; CommonRoad's multi-body cars (extra `peers`). v_x, v_y and r get
white noise, 0.02, 0.05 and 0.1 in m/s and rad/s (those of the paper could not be had). The first 30 s are identified,
geometry, mass and inertia given; errors are those of the model, from true states under the true wheel, on the last
60 s: one step of 0.02 s ahead, as the paper has it, and 1 s. Ratios to nonlinear least squares are of the RMS error,
geometric means over v_y, r, cars, seeds and noise. Nonlinear least squares is Pacejka's D, C, B, E of each axle through
the forces that measured states and their differences give; `filtered`: those states by the low-pass of the paper's
code, a Butterworth filter of third order at 0.1 of the Nyquist frequency, there and back.

`residual_x_model`: RMS error 0.5 s ahead with the residual over that of the same tyres without, geometric mean over
v_y, r and lateral displacement and over the held-out parts of the laps that ship: the last 30 %, the first 30 %, either
half of each, of its rest; and each of the other. Of these the last 30 % and the other lap are what the residual's
design was chosen by. `residual_worst`: of any held-out log, those 60 s under noise included, their geometric mean.

    python -m benchmarks study scoreboard --parts identification [--drives 3] [--quick] [--json]

Source: Dikici et al. 2024, "Learning-Based On-Track System Identification for Scaled Autonomous Racing in Under a
Minute" (a network's corrections; 3.3 times below nonlinear least squares, one step ahead).
"""

import argparse
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from scipy.optimize import least_squares
from scipy.signal import butter, filtfilt

from benchmarks.tables import show, show_figures
from steerkit.diagram.maths import Array
from steerkit.identification import Drive, shipped_drives
from steerkit.identification.ahead import HORIZONS, look_ahead
from steerkit.identification.tyres import Residual, Tyres, accelerations, identify_tyres, learn_residual, pacejka
from steerkit.logs import read_drive
from steerkit.plants.single_track import fiala
from steerkit.vehicles import VW_PASSAT, G, Vehicle, drawn_car, scaled

NOISE = (0.02, 0.05, 0.1)
DT, TRAIN, REST, FINE = 0.02, 30.0, 60.0, 10
KNOWN = ("c_f", "c_r", "mu_f", "mu_r")
JUDGED = ("v_y", "r", "lateral")


@dataclass(frozen=True, eq=False)
class Kind:
    """A car, told but for its tyres, how fast it is driven, and its tyres' force at slip angles, by axle."""

    vehicle: Vehicle
    speeds: tuple[float, float]
    tyres: Callable[[str, Any], Any] | None
    """None: CommonRoad's multi-body car."""
    theta: dict[str, float] | None = None
    """Its parameters, if Pacejka's."""


def _loads(car: Vehicle) -> dict[str, float]:
    return {axle: float(car.m * G * arm / car.wheelbase) for axle, arm in (("f", car.l_r), ("r", car.l_f))}


def _pacejka(name: str, car: Vehicle, speeds: tuple[float, float], front: Any, rear: Any) -> Kind:
    """A car with tyres (B, C, D over the load, E)."""
    loads = _loads(car)
    theta: dict[str, float] = {}
    for axle, (b, c, d, e) in (("f", front), ("r", rear)):
        theta |= {f"c_{axle}": b * c * d * loads[axle], f"mu_{axle}": d, f"C_{axle}": c, f"E_{axle}": e}

    def force(axle: str, alpha: Any) -> Any:
        peak = theta[f"mu_{axle}"] * loads[axle]
        return pacejka(alpha, theta[f"c_{axle}"], peak, theta[f"C_{axle}"], theta[f"E_{axle}"])

    return Kind(replace(car, name=name), speeds, force, theta)


def _small() -> Vehicle:
    """The 1:10 car of the paper's code, its tyres not known."""
    per = 10.0 * 3.54 * G / 0.307
    return Vehicle(
        name="1:10",
        m=3.54,
        i_z=0.05797,
        l_f=0.162,
        l_r=0.145,
        c_f=per * 0.145,
        c_r=per * 0.162,
        steer_ratio=1.0,
        mu=0.8,
    )


def kinds(seed: int) -> Iterator[Kind]:
    """The cars of a seed."""
    yield _pacejka("1:10, paper", _small(), (3.2, 6.0), (7.364, 2.066, 0.533, 0.478), (7.791, 2.916, 0.540, 0.658))
    yield _pacejka("1:10, other", _small(), (3.2, 6.0), (5.0, 1.6, 0.65, 0.0), (6.0, 1.6, 0.68, 0.0))
    road = replace(VW_PASSAT, steer_ratio=1.0)
    yield _pacejka("road", road, (8.0, 25.0), (10.0, 1.5, 0.9, -0.5), (13.0, 1.4, 0.95, -0.8))
    rng = np.random.default_rng((41, seed))
    car = replace(drawn_car(4100 + seed).vehicle, steer_ratio=1.0)
    true = replace(car, c_f=rng.uniform(0.6, 1.2) * car.c_f, c_r=rng.uniform(0.8, 1.3) * car.c_r)
    grip = float(rng.uniform(0.6, 1.1))
    loads = _loads(car)
    stiffness = {"f": true.c_f, "r": true.c_r}
    yield Kind(car, (8.0, 25.0), lambda axle, alpha: fiala(np.tan(alpha), stiffness[axle], grip * loads[axle]))
    try:
        from benchmarks.peers.commonroad import CARS
    except ImportError:
        return
    yield Kind(CARS[seed % len(CARS)], (8.0, 20.0), None)


@dataclass(frozen=True, eq=False)
class Driven:
    """What a car did, without noise, (n,) each."""

    v_x: Array
    v_y: Array
    r: Array
    delta: Array

    def part(self, begin: float, end: float) -> "Driven":
        """From one time to the other [s]."""
        rows = slice(round(begin / DT), round(end / DT))
        return Driven(*(a[rows] for a in (self.v_x, self.v_y, self.r, self.delta)))


def driven(kind: Kind, seed: int, seconds: float) -> Driven:
    """A wander from side to side up to 0.9 of the grip (multi-body: 0.7), its yaw rate by feed-forward and feedback."""
    rng = np.random.default_rng((42, seed))
    car, n = kind.vehicle, round(seconds / DT)
    t = np.arange(n) * DT
    waves = zip(np.geomspace(0.05, 0.5, 8), np.geomspace(1.0, 0.5, 8), rng.uniform(0.0, 6.3, 8))
    swing = np.sum([a * np.sin(2.0 * np.pi * f * t + p) for f, a, p in waves], axis=0)
    low, high = kind.speeds
    v = 0.5 * (low + high) + 0.5 * (high - low) * np.sin(
        2.0 * np.pi * t / rng.uniform(8.0, 15.0) + rng.uniform(0.0, 6.0)
    )
    if kind.tyres is None:
        return _multi_body(kind, np.tanh(1.2 * swing / np.std(swing)) * 0.7 * G, 0.5 * (low + high) + 0.0 * v)
    loads, peak = _loads(car), np.linspace(0.0, 0.5, 500)
    grip = min(float(np.max(kind.tyres(axle, peak))) / loads[axle] for axle in "fr")
    wanted = np.tanh(1.2 * swing / np.std(swing)) * 0.9 * grip * G / v
    v_y = r = 0.0
    states, h = np.zeros((n, 3)), DT / FINE

    def slopes(u: float, delta: float, v_y: float, r: float) -> tuple[float, float]:
        front = kind.tyres("f", delta - np.arctan2(v_y + car.l_f * r, u)) * np.cos(delta)  # type: ignore[misc]
        rear = kind.tyres("r", -np.arctan2(v_y - car.l_r * r, u))  # type: ignore[misc]
        return (front + rear) / car.m - u * r, (car.l_f * front - car.l_r * rear) / car.i_z

    for k, (u, rate) in enumerate(zip(v, wanted)):
        delta = float(np.clip(car.wheelbase * (2.0 * rate - r) / u, -0.4, 0.4))
        states[k] = v_y, r, delta
        for _ in range(FINE):
            a, b = slopes(u, delta, v_y, r)
            a, b = slopes(u, delta, v_y + 0.5 * h * a, r + 0.5 * h * b)
            v_y, r = v_y + h * a, r + h * b
    return Driven(v, *states.T)


def _multi_body(kind: Kind, a_y: Array, v: Array) -> Driven:
    from benchmarks.peers.commonroad import CommonRoadMultiBody

    car = kind.vehicle
    plant = CommonRoadMultiBody(vehicle=car, v0=float(v[0]), dt=DT / 2)
    x, states = plant.init(), np.zeros((len(v), 4))
    for k, (u, side) in enumerate(zip(v, a_y)):
        delta = float(np.clip(car.wheelbase * (2.0 * side / u - x[5]) / u, -0.3, 0.3))
        states[k] = x[3], x[10], x[5], delta
        for _ in range(2):
            x = plant.update(0.0, x, plant.U(delta * float(car.steer_ratio), u), None)
    return Driven(*states.T)


def recorded(true: Driven, noise: float, seed: int, ratio: float) -> Drive:
    """The log of it: v, v_y and r with white noise."""
    rng = np.random.default_rng((43, seed))
    v_x, v_y, r = (a + noise * rng.normal(size=len(a)) for a in (true.v_x, true.v_y, true.r))
    measured, v = np.ones(len(v_x), dtype=bool), np.hypot(v_x, v_y)
    return Drive(name="made", dt=DT, delta_sw=ratio * true.delta, v=v, r=r, measured=measured, calibrated=True, v_y=v_y)


def least_squares_tyres(car: Vehicle, log: Drive, *, filtered: bool) -> dict[str, float]:
    """Nonlinear least squares of Pacejka's curves, from the same log; see the module."""
    v_y = log.v_y if log.v_y is not None else np.zeros(len(log.v))
    signals = [np.sqrt(np.maximum(log.v**2 - v_y**2, 0.0)), v_y, log.r, log.delta_sw / float(car.steer_ratio)]
    if filtered:
        b, a = butter(3, 0.1)
        signals = [filtfilt(b, a, signal) for signal in signals]
    v_x, v_y, r, delta = signals
    side, turn = car.m * (np.gradient(v_y, DT) + v_x * r), car.i_z * np.gradient(r, DT)
    forces = {
        "f": (car.l_r * side + turn) / (car.wheelbase * np.cos(delta)),
        "r": (car.l_f * side - turn) / car.wheelbase,
    }
    alpha = {"f": delta - np.arctan2(v_y + car.l_f * r, v_x), "r": -np.arctan2(v_y - car.l_r * r, v_x)}
    found: dict[str, float] = {}
    for axle, load in _loads(car).items():

        def misses(p: Any, axle: str = axle, load: float = load) -> Any:
            return pacejka(alpha[axle], p[0] * p[1] * p[2], p[2], p[1], p[3]) - forces[axle] / load

        b, c, d, e = least_squares(
            misses, [5.0, 1.5, 0.8, 0.0], bounds=([0.5, 0.5, 0.05, -5.0], [50.0, 3.0, 3.0, 1.0])
        ).x
        found |= {f"c_{axle}": b * c * d * load, f"mu_{axle}": d, f"C_{axle}": c, f"E_{axle}": e}
    return found


def held_out(car: Vehicle, theta: dict[str, float], true: Driven) -> tuple[Array, Array]:
    """RMS errors of v_y and r one step and 1 s ahead from true states, (2,) each."""
    n, parts = round(1.0 / DT), 2
    starts = np.arange(0, len(true.r) - n - 1, 5)
    x, h, steps = np.stack((true.v_y[starts], true.r[starts])), DT / parts, []
    for k in range(n):
        slopes = partial(accelerations, car, theta, true.v_x[starts + k], true.delta[starts + k])
        for _ in range(parts):
            k1 = np.array(slopes(*x))
            k2 = np.array(slopes(*(x + 0.5 * h * k1)))
            k3 = np.array(slopes(*(x + 0.5 * h * k2)))
            x = x + h / 6.0 * (k1 + 2.0 * (k2 + k3) + np.array(slopes(*(x + h * k3))))
        steps.append(x - np.stack((true.v_y[starts + k + 1], true.r[starts + k + 1])))
    one, second = (np.sqrt(np.mean(steps[k] ** 2, axis=1)) for k in (0, n - 1))
    return one, second


def with_residual(car: Vehicle, tyres: Tyres, residual: Residual, rest: Drive) -> dict[str, float]:
    """RMS error 0.5 s ahead over that without it, by quantity, and `all`, the geometric mean.

    car: of the data sheet, for the linear model that `look_ahead` judges beside them.
    """
    steering = {name: tyres.theta[name] for name in ("steer_ratio", "offset", "delay", "rate_zero")} | {"lag": 0.0}
    per = car.m / car.wheelbase
    theta = steering | {"d_f": per * car.l_r / car.c_f, "d_r": per * car.l_f / car.c_r}
    found: Any = SimpleNamespace(vehicle=car, base=car, theta=theta)
    errors = look_ahead(found, rest, tyres, residual).errors
    at = HORIZONS.index(0.5)
    ratios = {q: errors[q]["pacejka + residual"][at] / errors[q]["pacejka"][at] for q in JUDGED if q in errors}
    return ratios | {"all": _mean(list(ratios.values()))}


def _mean(values: Any) -> float:
    return float(np.exp(np.mean(np.log(values)))) if len(values) else float("nan")


def cut(drive: Drive, begin: float, end: float) -> Drive:
    """A part of a drive, of 0 to 1."""
    rows = slice(round(begin * len(drive.v)), round(end * len(drive.v)))
    signals: Any = {key: value[rows] for key, value in vars(drive).items() if isinstance(value, np.ndarray)}
    return replace(drive, **signals)


def laps() -> Iterator[tuple[str, Drive, Drive]]:
    """Name, what is learned from and what is held out, of the laps that ship."""
    drives = {name: read_drive(name) for name in shipped_drives()}
    for name, drive in drives.items():
        yield f"{name}, its last 30 %", cut(drive, 0.0, 0.7), cut(drive, 0.7, 1.0)
        yield f"{name}, its first 30 %", cut(drive, 0.3, 1.0), cut(drive, 0.0, 0.3)
        yield f"{name}, its first half", cut(drive, 0.5, 1.0), cut(drive, 0.0, 0.5)
        yield f"{name}, its last half", cut(drive, 0.0, 0.5), cut(drive, 0.5, 1.0)
        for other in drives.keys() - {name}:
            yield f"{other}, of {name}", drive, drives[other]


def add_options(parser: Any) -> None:
    """Options of this part."""
    parser.add_argument("--drives", type=int, default=3, help="of each car under noise")
    parser.add_argument("--first-drive", type=int, default=0, help="seed of the first of them")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """The figures: see the module."""
    seeds, noises = (1, NOISE[1:2]) if options.quick else (options.drives, NOISE)
    rows, seconds, covered = list[dict[str, Any]](), list[float](), list[bool]()
    held: dict[str, dict[str, float]] = {}
    those = range(options.first_drive, options.first_drive + seeds)
    jobs = [(kind, seed) for seed in those for kind in kinds(seed) if not options.quick or kind.tyres]
    jobs = jobs[-2:-1] if options.quick else jobs
    for kind, seed in track(jobs, "identifying", console=Console(stderr=True)):
        true, ratio = driven(kind, seed, TRAIN + REST), float(kind.vehicle.steer_ratio)
        for noise in noises:
            log = recorded(true, noise, seed, ratio)
            share = TRAIN / (TRAIN + REST)
            first, rest = cut(log, 0.0, share), cut(log, share, 1.0)
            began = time.process_time()
            tyres = identify_tyres(first, kind.vehicle, fixed={"steer_ratio": ratio})
            residual = learn_residual(tyres, first)
            seconds.append(time.process_time() - began)
            for name in KNOWN if kind.theta else ():
                low, high = tyres[name].low, tyres[name].high
                if np.isfinite(low):
                    covered.append(low <= kind.theta[name] <= high)  # type: ignore[index]
            unseen = true.part(TRAIN, TRAIN + REST)
            ours = held_out(kind.vehicle, tyres.theta, unseen)
            row: dict[str, Any] = {"car": kind.vehicle.name, "noise": noise, "seed": seed}
            for word in ("", "_filtered"):
                theirs = held_out(kind.vehicle, least_squares_tyres(kind.vehicle, first, filtered=bool(word)), unseen)
                row |= {f"{when}{word}": _mean(a / b) for when, a, b in zip(("step", "second"), ours, theirs)}
            rows.append(row)
            held[f"{kind.vehicle.name}, noise {noise}, seed {seed}"] = with_residual(
                kind.vehicle, tyres, residual, rest
            )
    base, on_laps = scaled("hyundai-genesis", m=2000.0, wheelbase=3.01), {}
    lap_seconds = []
    for name, seen, rest in [] if options.quick else laps():
        began = time.process_time()
        tyres = identify_tyres(seen, base)
        residual = learn_residual(tyres, seen)
        lap_seconds.append(time.process_time() - began)
        on_laps[name] = with_residual(base, tyres, residual, rest)
    held |= on_laps
    worst = max(held, key=lambda name: held[name]["all"])
    figures = {
        "sysid_x_nls": _mean([row["step"] for row in rows]),
        "sysid_x_nls_1s": _mean([row["second"] for row in rows]),
        "sysid_x_nls_filtered": _mean([row["step_filtered"] for row in rows]),
        "sysid_x_nls_filtered_1s": _mean([row["second_filtered"] for row in rows]),
        "sysid_x_nls_worst": max(row["step"] for row in rows),
        "residual_x_model": _mean([ratios["all"] for ratios in on_laps.values()]),
        "residual_laps": on_laps,
        "residual_worst": held[worst]["all"],
        "residual_worst_log": worst,
        "residual_worst_quantity": max(ratio for ratios in held.values() for ratio in ratios.values()),
        "sysid_coverage_pct": 100.0 * float(np.mean(covered)),
        "sysid_seconds": max(seconds),
        "sysid_seconds_lap": max(lap_seconds, default=float("nan")),
        "sysid_drives": rows,
    }
    show("over nonlinear least squares", rows)
    if on_laps:
        show(
            "with the residual over without, 0.5 s ahead",
            [{"held out": name} | found for name, found in on_laps.items()],
        )
    show_figures(figures)
    return figures
