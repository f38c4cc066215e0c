"""The recorded laps with their positions, and where the car is half a second later, by whom."""

from __future__ import annotations

import gzip
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit.diagram.units import radians_of
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.identification import identify, read_drive
from steerkit.metrics.signals import rms
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.task import DT
from steerkit.vehicles import vehicle

Array = NDArray[np.float64]
LAPS = {"genesis": ("genesis.csv.gz", "genesis-rfs"), "genesis-rfs": ("genesis_rfs.csv.gz", "genesis")}
"""File of each lap, and the drive from which the car is identified."""
AHEAD = 0.5
"""How far ahead [s]."""
BEGIN, SLOWEST = 10.0, 3.0
"""From which time [s] and speed [m/s] on is judged."""
UNIT: dict[str, Any] = {
    "position_noise": 0.005,
    "position_drift": 0.02,
    "psi_noise": radians_of(0.02),
    "psi_drift": radians_of(0.1),
    "drift_time": 60.0,
    "v_noise": 0.03,
    "r_noise": radians_of(0.3),
    "heading_drift": radians_of(1.0),
    "wheel_drift": radians_of(3.0),
}
"""A good inertial unit with RTK, mounted by hand, on a car whose wheel's zero nobody measured."""


def lap(name: str) -> dict[str, Array]:
    """The columns of a shipped lap in SI: t, delta_sw, v, psi (unwrapped), x, y, and r, NaN where none was recorded."""
    place = files("steerkit.logs") / "drives" / LAPS[name][0]
    rows = [row for row in gzip.decompress(place.read_bytes()).decode().splitlines() if not row.startswith("#")]
    columns = dict(zip(rows[0].split(","), np.loadtxt(rows[1:], delimiter=",").T))
    nothing = np.full(len(columns["t"]), np.nan)
    return {
        **{key: columns[key] for key in ("t", "v", "x", "y")},
        "psi": np.unwrap(columns["psi"]),
        "delta_sw": radians_of(1.0) * columns["delta_sw_deg"],
        "r": columns.get("wz", nothing),
    }


def half_second_ahead(seconds: float | None = None) -> dict[str, Any]:
    """RMS distance [m] of the foreseen positions from the recorded ones, by estimator and by dead reckoning.

    seconds: how much of each lap, all by default. `lap_half_second_x`: the one over the other, of the worse lap.
    """
    report: dict[str, Any] = {}
    for name, (_, other) in LAPS.items():
        columns = lap(name)
        car = identify(read_drive(other), base=vehicle("vw-passat")).vehicle
        block = VehicleState.of(NonlinearSingleTrack(vehicle=car), horizon=0.0, **UNIT)
        ours, theirs = _foreseen(block, columns, seconds or float(columns["t"][-1]))
        report[name] = {"estimator_m": ours, "dead_reckoning_m": theirs, "x": ours / theirs}
        print(
            f"{name}, {AHEAD:g} s ahead: estimator {ours:.4f} m, dead reckoning {theirs:.4f} m, x {ours / theirs:.3f}"
        )
    return {"laps": report, "lap_half_second_x": max(row["x"] for row in report.values())}


def _foreseen(block: VehicleState, columns: dict[str, Array], seconds: float) -> tuple[float, float]:
    """RMS distances of both from where the car was then."""
    t = np.arange(0.0, seconds, DT)
    now = np.searchsorted(columns["t"], t + 1e-6) - 1
    ages = t - columns["t"][now]
    recorded_r = columns["r"] if np.isfinite(columns["r"]).all() else np.gradient(columns["psi"], columns["t"])
    blind = block.U(*(float("nan"),) * len(block.U._fields))
    ours, theirs = [], []
    x: Any = None
    for i in range(len(t) - round(AHEAD / DT) - 1):
        k, age = now[i], float(ages[i])
        pose, motion = (columns[name][k].item() for name in ("x", "y", "psi")), columns["v"][k].item()
        u = block.U(*pose, age, motion, columns["r"][k].item(), age, columns["delta_sw"][k].item())
        if x is None:
            x = block.settle(0.0, block.init(), _direct(block, u))
        x = block.update(t[i], x, u, None)
        if t[i] < BEGIN or i % 10 or columns["v"][k] < SLOWEST:
            continue
        later = x
        for _ in range(round(AHEAD / DT) - 1):
            later = block.update(0.0, later, blind, None)
        y = block.output(0.0, later, _direct(block, blind))
        true = [float(np.interp(t[i] + AHEAD, columns["t"], columns[name])) for name in ("x", "y")]
        ours.append(np.hypot(y.x - true[0], y.y - true[1]))
        there = _dead_reckoned(columns, k, recorded_r[k], AHEAD + age)
        theirs.append(np.hypot(there[0] - true[0], there[1] - true[1]))
    return rms(ours), rms(theirs)


def _direct(block: VehicleState, u: Any) -> Any:
    return block.D(*[getattr(u, name) for name in block.D._fields])


def _dead_reckoned(columns: dict[str, Array], k: int, r: float, ahead: float) -> tuple[float, float]:
    """Where a car is after some seconds that goes on along a circle as it was measured last."""
    way, turn = columns["v"][k] * ahead, r * ahead
    course, chord = columns["psi"][k] + 0.5 * turn, way * np.sinc(0.5 * turn / np.pi)
    return columns["x"][k] + chord * np.cos(course), columns["y"][k] + chord * np.sin(course)
