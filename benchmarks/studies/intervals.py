"""Do the 95 % intervals of `identify` hold the truth, and those of parts of a log each other?

Parts: `made`, drives of 120 s at 5 to 25 m/s, each of another car, integrated here (nonlinear single track, tyres
saturate as tanh; no model of steerkit's) with bank (2 +- 2 %, changing over 30 s), wind (0.03 g, 4 s), a gyro whose
scale is 0.9 to 1.1, a yaw rate whose clock is early or late by up to 0.2 s, white and coloured noise (1 and 5 s); every
second one has a heading. Geometry, mass and inertia are known, ratio and tyres 20 % wrong. `shipped`: the two laps, cut
into thirds (of equal driving; a third too short for `identify` is left out), each pair of thirds compared. `online`:
the made drives again, 0.2 s later (no filter knows what comes), through `YawDelay` and `SingleTrackFilter`, after 60 s
and at their end.

`hold_pct`: of the told intervals (source neither `prior` nor `unsteady`; `online`: of all), how many hold the truth
(`shipped`: how many differences of two are within the interval of a difference); `told_pct`: how many are told
(`online`: valid); `width`: their median.

    python -m benchmarks study intervals [--drives 200] [--parts made shipped online] [--quick] [--json]
"""

import argparse
from dataclasses import replace
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from steerkit.diagram.maths import Array
from steerkit.estimators.estimate import NORMAL_95, estimated
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import YawDelay
from steerkit.identification import Drive, identify, shipped_drives
from steerkit.identification.fit import Identified
from steerkit.logs import read_drive
from steerkit.logs.drive import LEAST, SETTLE
from steerkit.task import DT as TASK_DT
from steerkit.vehicles import VW_PASSAT, Vehicle

PARTS = ("made", "shipped", "online")
NAMES = ("steer_ratio", "ratio_wheelbase", "understeer_gradient", "delay_lag", "offset")
G, DT, SECONDS, SHIFT = 9.81, 0.02, 120.0, 0.2


def coloured(rng: np.random.Generator, n: int, time: float) -> Array:
    """First-order noise of deviation 1 with this correlation time [s]."""
    keep, out = np.exp(-DT / time), np.zeros(n)
    out[0] = rng.normal()
    for k, one in enumerate(np.sqrt(1.0 - keep * keep) * rng.normal(size=n - 1)):
        out[k + 1] = keep * out[k] + one
    return out


def made(number: int, seconds: float = SECONDS) -> tuple[Drive, Vehicle, dict[str, float]]:
    """A drive that long [s], the car that is believed (geometry and mass true), and the truth."""
    rng = np.random.default_rng((39, number))
    n = round(seconds / DT)
    t = DT * np.arange(n)
    stiff_f, stiff_r, ratio_x, offset, zero = rng.uniform(
        [0.8, 0.8, 0.8, -0.05, -0.005], [1.25, 1.25, 1.2, 0.05, 0.005]
    )
    scale, clock, lag, delay = rng.uniform([0.9, -0.2, 0.03, 0.0], [1.1, 0.2, 0.12, 0.1])
    car = replace(VW_PASSAT, c_f=stiff_f * VW_PASSAT.c_f, c_r=stiff_r * VW_PASSAT.c_r)
    ratio = float(ratio_x * VW_PASSAT.steer_ratio)
    v = 15.0 - 10.0 * np.cos(2.0 * np.pi * t / rng.uniform(40.0, 70.0))
    wheel = (
        sum(
            a * np.sin(2.0 * np.pi * f * t + p)
            for f, a, p in zip(np.geomspace(0.03, 0.8, 12), np.geomspace(1.0, 0.2, 12), rng.uniform(0.0, 6.3, 12))
        )
        * 3.0
        / np.maximum(v, 4.0)
    )
    wheel *= np.minimum(1.0, 60.0 / v**2 / np.maximum(np.std(wheel * v), 0.1) * 4.0)
    bank = 0.02 + 0.02 * coloured(rng, n, 30.0)
    side = -G * bank + 0.03 * G * coloured(rng, n, 4.0)
    fine, steps = 5, 5 * n
    h = DT / fine
    late = np.interp(np.arange(steps) * h - delay, t, wheel)
    beta = r = psi = angle = 0.0
    rate, heading = np.zeros(n), np.zeros(n)
    peak_f, peak_r = (0.95 * car.m * G * x / car.wheelbase for x in (car.l_r, car.l_f))
    for k in range(steps):
        i = k // fine
        if k % fine == 0:
            rate[i], heading[i] = r, psi
        angle += h / lag * (late[k] - angle)
        delta = (angle + offset) / ratio
        force_f = peak_f * np.tanh(car.c_f * (delta - beta - car.l_f * r / v[i]) / peak_f)
        force_r = peak_r * np.tanh(car.c_r * (-beta + car.l_r * r / v[i]) / peak_r)
        beta += h * ((force_f + force_r) / (car.m * v[i]) + side[i] / v[i] - r)
        r += h * (car.l_f * force_f - car.l_r * force_r) / car.i_z
        psi += h * r
    colour = 0.003 * coloured(rng, n, 1.0) + 0.002 * coloured(rng, n, 5.0)
    gyro = scale * np.interp(t - clock, t, rate) + zero + colour + 0.004 * rng.normal(size=n)
    columns = {"t": t, "delta_sw": wheel, "v": v, "r": gyro}
    if number % 2:
        columns["psi"] = np.interp(t - clock, t, heading) + 0.003 * rng.normal(size=n)
    compliances = car.m / car.wheelbase * np.array([car.l_r / car.c_f, car.l_f / car.c_r])
    truth = {
        "steer_ratio": ratio,
        "ratio_wheelbase": ratio * car.wheelbase,
        "understeer_gradient": float(compliances[0] - compliances[1]),
        "delay_lag": delay + lag + clock,
        "offset": offset,
    }
    return Drive.of(columns, name=f"made {number}"), VW_PASSAT, {key: float(x) for key, x in truth.items()}


def thirds(name: str) -> list[Identified]:
    """What each third of a shipped drive says."""
    whole = read_drive(name)
    cuts = np.searchsorted(np.cumsum(whole.driving), np.linspace(0.0, whole.driving.sum(), 4))
    keys = [key for key in ("delta_sw", "v", "r", "psi") if getattr(whole, key) is not None]
    found = []
    for low, high in pairwise(cuts):
        columns = {key: getattr(whole, key)[low:high] for key in keys}
        if np.sum(whole.driving[low:high]) * whole.dt > LEAST + 2.0 * SETTLE:
            part = Drive.of({"t": whole.t[low:high], **columns}, name=f"{name} from {low * whole.dt:.0f} s")
            found.append(identify(part))
    return found


def online(
    drives: list[tuple[Drive, Vehicle, dict[str, float]]], seconds: float = SECONDS
) -> list[tuple[str, str, bool, bool, float, float]]:
    """What the estimators of a drive say after half and at the end of so long [s]; all drives as one batch."""
    at = np.arange(0.0, seconds - TASK_DT, TASK_DT)
    signals: dict[str, Array] = {}
    for name in ("delta_sw", "v", "r", "psi"):
        recorded = [getattr(drive, name) for drive, _, _ in drives]
        late = at - SHIFT if name in ("r", "psi") else at
        rows = [np.interp(late, d.t, x) if x is not None else np.nan * at for (d, _, _), x in zip(drives, recorded)]
        signals[name] = np.array(rows).T.copy()
    ways = YawDelay(vehicle=VW_PASSAT, earliest=-SHIFT), SingleTrackFilter(vehicle=VW_PASSAT, held=False)
    xs = [block.init((len(drives),)) for block in ways]
    found = []
    for k, t in enumerate(at):
        delay, told = ys = [block.output(t, x, ()) for block, x in zip(ways, xs)]
        if k in (round(0.5 * seconds / TASK_DT), len(at) - 1):
            for name, (y, port, scale, shift) in {
                "steer_ratio": (told, "ratio", VW_PASSAT.steer_ratio, 0.0),
                "understeer_gradient": (told, "understeer", 1.0, 0.0),
                # a held command is half a sample late
                "delay_lag": (delay, "delay_lag", 1.0, 0.5 * TASK_DT - SHIFT),
                "offset": (told, "offset", 1.0, 0.0),
            }.items():
                value, deviation, valid = (np.broadcast_to(part, (len(drives),)) for part in estimated(y, port))
                errors = scale * value + shift - np.array([truth[name] for _, _, truth in drives])
                widths = 2.0 * NORMAL_95 * scale * deviation
                part = f"online, {t:.0f} s"
                for ok, error, width in zip(valid, errors.tolist(), widths.tolist()):
                    found.append((part, name, bool(ok), abs(error) <= 0.5 * width, width, error))
        u = {name: values[k] for name, values in signals.items()} | {"active": np.ones(len(drives))}
        u |= {"delta_sw_cmd": u["delta_sw"], "delay": delay.delay + 0.5 * TASK_DT, "lag": delay.lag}
        u |= {"delay_deviation": delay.delay_lag_deviation}
        xs = [b.update(t, x, b.U(*[u[p.name] for p in b.inputs]), y) for b, x, y in zip(ways, xs, ys)]
    return found


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick is two drives of a third of the time, a tenth of it online, no log."""
    parser.add_argument("--drives", type=int, default=200, help="how many made drives (200)")
    parser.add_argument("--parts", nargs="+", choices=PARTS, default=list(PARTS), help="which (all)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """All parts, and their table."""
    rows = list[tuple[str, str, bool, bool, float, float]]()  # part, name, told, holds, width, error
    seconds = 0.3 * SECONDS if options.quick else SECONDS
    numbers = range(2 if options.quick else options.drives) if {"made", "online"} & {*options.parts} else range(0)
    drives = [made(number, seconds) for number in track(numbers, "drives", console=Console(stderr=True))]
    if "online" in options.parts:
        rows += online(drives, 0.1 * SECONDS if options.quick else SECONDS)
    if "made" in options.parts:
        for number, (drive, base, truth) in track(enumerate(drives), "fits", len(drives), console=Console(stderr=True)):
            found = identify(drive, base)
            part = "made, with heading" if number % 2 else "made, gyro alone"
            for name in NAMES:
                e = found[name]
                holds, width = e.low <= truth[name] <= e.high, e.high - e.low
                rows.append((part, name, e.source not in ("prior", "unsteady"), holds, width, e.value - truth[name]))
    if "shipped" in options.parts and not options.quick:
        for log in shipped_drives():
            for one, other in combinations(thirds(log), 2):
                for name in NAMES:
                    a, b = one[name], other[name]
                    apart, reach = abs(a.value - b.value), 0.5 * np.hypot(a.high - a.low, b.high - b.low)
                    told = not {"prior", "unsteady"} & {a.source, b.source}
                    rows.append(("shipped thirds", name, told, bool(apart <= reach), 2.0 * float(reach), apart))
    table = Table("part", "number", "told %", "held %", "median width", "median |error|", title="95 % intervals")
    answer: dict[str, Any] = {}
    for part, name in dict.fromkeys(row[:2] for row in rows):
        mine = [row for row in rows if row[:2] == (part, name)]
        known = [row for row in mine if row[2] or part.startswith("online")]
        hold = 100.0 * float(np.mean([row[3] for row in known])) if known else float("nan")
        width, error = (float(np.median([abs(float(row[k])) for row in known or mine])) for k in (4, 5))
        share = 100.0 * float(np.mean([row[2] for row in mine]))
        hold_or_none = None if np.isnan(hold) else hold
        answer[f"{part}: {name}"] = {"told_pct": share, "hold_pct": hold_or_none, "width": width, "error": error}
        table.add_row(part, name, f"{share:.0f}", f"{hold:.0f}", f"{width:.3g}", f"{error:.3g}")
    Console(width=120).print(table)
    return {"intervals": answer}
