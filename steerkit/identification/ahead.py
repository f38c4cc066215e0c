"""How far ahead an identified car is right: velocities and displacement, beside what is said without its tyres."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from steerkit.identification.fit import SLOW_ENOUGH, Identified, Simulator
from steerkit.logs.drive import HEADING_WINDOW, Array, Drive
from steerkit.metrics import rms
from steerkit.plants.single_track import LinearSingleTrack, SingleTrackState
from steerkit.vehicles import Vehicle
from steerkit.vehicles.rollout import Rollout

if TYPE_CHECKING:
    from steerkit.identification.tyres import Tyres

HORIZONS = (0.2, 0.5, 1.0, 2.0)
"""How far ahead is judged [s]."""
QUANTITIES = {"v_x": "m/s", "v_y": "m/s", "r": "rad/s", "longitudinal": "m", "lateral": "m"}
"""What is judged, in this order, and its unit."""
_NUMBERS = 400_000  # that one signal may have over all starts: they are thinned out so that a long drive fits in memory
_STRAIGHT, _LONG = 1e-3, 2.0  # curvature up to which it is driven straight on [1/m], and for how long at least [s]


@dataclass(frozen=True, kw_only=True)
class Ahead:
    """The outcome of `look_ahead`."""

    drive: str
    starts: int
    errors: dict[str, dict[str, tuple[float, ...]]]
    """RMS error by quantity and predictor, one for each of `HORIZONS`; empty without a start."""
    note: str
    """Where the log's displacement and v_y come from."""


def look_ahead(found: Identified, drive: Drive, tyres: "Tyres | None" = None) -> Ahead:
    """Errors of v_x, v_y, r and displacement up to 2 s ahead, from many starts in a drive of the identified car.

    Of three that start from the measured v_x, v_y and r, the speed staying what it is:

    model: `LinearSingleTrack` under the wheel as it will be turned, late and with its zero corrected as identified;
    persistence: v_x, v_y and r stay constant;
    kinematics: the same wheel as the model, r = v_x tan(delta)/L, v_y = l_r r.

    With tyres also pacejka: their single track, v_x constant.

    Displacement is in the vehicle's frame at the start, longitudinal and lateral [m]; see `measured_way` for the
    measured one, whose v_y is a mean over 0.2 s. Where on the car its position is measured no log says: model and
    kinematics each take the place, metres ahead of the centre of gravity, with which their steady v_y/r is right on
    average. Starts are spread over all of the drive that goes on at 3 m/s or faster for 2 s.
    """
    car, dt = found.vehicle, drive.dt
    rate = drive.r - (0.0 if drive.calibrated else found.theta["rate_zero"])
    place, heading, slip, note = measured_way(drive, rate)
    known, v_y = slip is not None, np.zeros(len(rate)) if slip is None else slip
    n = round(HORIZONS[-1] / dt)
    through = np.convolve(drive.driving & np.isfinite(place + v_y), np.ones(n + 1), mode="valid")
    starts = np.flatnonzero(through > n + 0.5)
    starts = starts[:: math.ceil(len(starts) * (n + 1) / _NUMBERS) or 1]
    if not len(starts):
        return Ahead(drive=drive.name, starts=0, errors={}, note=f"nothing is judged: no {HORIZONS[-1]:g} s in one go")
    at = starts + np.arange(n + 1)[:, None]
    wheel = Simulator(drive, found.base).wheel(found.theta)
    slides = car.l_r - Rollout.of(car).rear_slip * drive.v**2  # v_y over r in a steady bend
    arms = [arm_of(drive, rate, v_y - lever * rate) if known and drive.turns else 0.0 for lever in (slides, car.l_r)]
    side, r = v_y[starts] if known else (slides * rate)[starts], rate[starts]
    rolled = _rolled(car, dt, drive.v[starts], side - arms[0] * r, r, wheel[at])
    v_x = np.sqrt(np.maximum(drive.v**2 - v_y**2, 0.0))
    still = np.ones((n + 1, 1))
    rolling = v_x[starts] * np.tan(0.5 * (wheel[at] + wheel[at - 1]) / car.steer_ratio) / car.wheelbase
    predicted = {
        "model": (rolled[0], rolled[1] + arms[0] * rolled[2], rolled[2]),
        "persistence": (v_x[starts] * still, side * still, r * still),
        "kinematics": (v_x[starts] * still, (car.l_r + arms[1]) * rolling, rolling),
    }
    if tyres:
        scene = tyres.scene(drive)
        aside, turning = tyres.ahead(scene, starts, n)
        predicted["pacejka"] = (scene.v_x[starts] * still, aside + scene.arm * turning, turning)
    ends = [round(horizon / dt) for horizon in HORIZONS]
    gone = ((place[at] - place[starts]) * np.exp(-1j * heading[starts]))[ends]
    measured = {
        "v_x": v_x[at[ends]],
        "v_y": v_y[at[ends]],
        "r": rate[at[ends]],
        "longitudinal": gone.real,
        "lateral": gone.imag,
    }
    errors: dict[str, dict[str, tuple[float, ...]]] = {q: {} for q in QUANTITIES if known or q != "v_y"}
    for who, (ahead, aside, turning) in predicted.items():
        velocity = ahead + 1j * aside if known else np.hypot(ahead, aside)
        turned = np.exp(1j * cumulative_trapezoid(turning, dx=dt, axis=0, initial=0.0))
        way = cumulative_trapezoid(velocity * turned, dx=dt, axis=0, initial=0.0)[ends]
        said = {
            "v_x": velocity.real[ends],
            "v_y": aside[ends],
            "r": turning[ends],
            "longitudinal": way.real,
            "lateral": way.imag,
        }
        for quantity, by_predictor in errors.items():
            by_predictor[who] = tuple(map(rms, said[quantity] - measured[quantity]))
    note += "; none foresees v"
    if known:
        note += f"; measured {arms[0]:+.2f} m ahead of the centre of gravity (kinematics: {arms[1]:+.2f} m)"
    return Ahead(drive=drive.name, starts=len(starts), errors=errors, note=note)


def arm_of(drive: Drive, rate: Array, rest: Array) -> float:
    """How far ahead of the centre of gravity a point with that much more v_y is, by least squares of rest = arm r."""
    use = drive.driving & np.isfinite(rest)
    return float(rate[use] @ rest[use] / (rate[use] @ rate[use]))


def _rolled(car: Vehicle, dt: float, v: Array, v_y: Array, r: Array, wheel: Array) -> tuple[Array, Array, Array]:
    """(v_x, v_y, r) of the model, each (n + 1, N), for N starts and the wheel (n + 1, N)."""
    plant = LinearSingleTrack(vehicle=car, dt=dt, substeps=math.ceil(dt / SLOW_ENOUGH - 1e-9))
    states = [SingleTrackState(0.0, 0.0, 0.0, np.arcsin(np.clip(v_y / v, -1.0, 1.0)), r, v, wheel[0])]
    for held in wheel[:-1]:
        states.append(plant.update(0.0, states[-1], plant.U(held, v), None))
    beta = np.array([state.sway for state in states])
    return v * np.cos(beta), v * np.sin(beta), np.array([state.r for state in states])


def measured_way(drive: Drive, rate: Array) -> tuple[NDArray[np.complexfloating], Array, Array | None, str]:
    """Measured place x + i y [m], heading [rad], v_y [m/s], each (n,), and a note on where they come from.

    By the log's v_y, if it has one. Else by position, where there is a heading beside it: v_y is its slope over 0.2 s
    across the heading, which is turned until straight driving, on curvatures up to 0.001 1/m, has none; NaN where the
    position goes otherwise than v, by 1 m/s and 30 %: it jumps, or is held. Else, or where position and heading do not
    fit each other: by v along the heading, and v_y is None.
    """
    heading = drive.psi if drive.psi is not None else cumulative_trapezoid(rate, dx=drive.dt, initial=0.0)
    if drive.v_y is not None:
        velocity = np.sqrt(np.maximum(drive.v**2 - drive.v_y**2, 0.0)) + 1j * drive.v_y
        rolled = cumulative_trapezoid(velocity * np.exp(1j * heading), dx=drive.dt, initial=0.0)
        return rolled, heading, drive.v_y, "by v, heading and v_y of the log"
    why = "the log has no position with a heading"
    if drive.psi is not None and drive.x is not None and drive.y is not None:
        place = drive.x + 1j * drive.y
        half = max(1, round(0.5 * HEADING_WINDOW / drive.dt))
        velocity = np.full(len(place), np.nan + 0j)
        velocity[half:-half] = (place[2 * half :] - place[: -2 * half]) / (2 * half * drive.dt)
        velocity *= np.exp(-1j * heading)
        jumps = np.abs(np.abs(velocity) - drive.v) > 1.0 + 0.3 * drive.v
        velocity[jumps] = np.nan
        straight = drive.driving & np.isfinite(velocity) & (np.abs(rate) <= _STRAIGHT * drive.v)
        along = velocity[straight].sum() / max(drive.v[straight].sum(), 1e-9)
        if straight.sum() * drive.dt >= _LONG and abs(abs(along) - 1.0) < 0.05:
            turn = float(np.angle(along))
            note = f"by position; the heading turned by {turn:+.4f} rad, so that it has no v_y on straights"
            note += f"; left out {jumps.sum() * drive.dt:.1f} s in which it goes otherwise than v" * bool(jumps.any())
            return place, heading + turn, (velocity * np.exp(-1j * turn)).imag, note
        why = "position and heading do not fit each other, or it is never driven straight on"
    rolled = cumulative_trapezoid(drive.v * np.exp(1j * heading), dx=drive.dt, initial=0.0)
    return rolled, heading, None, f"by v and heading, v_y is not in the log: {why}"
