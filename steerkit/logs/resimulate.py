"""The loop that drives a recorded drive again, what is different then, and its picture and film."""

import math
from dataclasses import dataclass
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from steerkit._support.errors import require
from steerkit.compiled import NoCompilerError, TraceError, compile
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from steerkit.diagram.units import degrees_of
from steerkit.logs import Drive
from steerkit.logs.channels import Array
from steerkit.logs.drive import V_DRIVING
from steerkit.metrics import largest, rms
from steerkit.paths.path import Path
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.plants.speed_driver import Playback
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.plots.style import COLOURS, PALETTE, new_figure, style
from steerkit.scenario.assembly import bare, steering_loop
from steerkit.scenario.catalogue import DesignModel, make_controller
from steerkit.task import A_Y_MAX, DT, JERK_MAX
from steerkit.vehicles import Vehicle

_SPACING = 2.0
"""The driven way has a point so often [m]."""
_SMOOTH = 0.5
"""Yaw rate is averaged over so long, without delay, before a way is made of it [s]."""
_APART = 10.0
"""Places where the two differ most lie so far apart [s]."""
_KEPT = ("path.e", "actuator.delta_sw", *(f"car.{name}" for name in ("x", "y", "psi", "v", "a_y", "delta_sw")))


@dataclass(frozen=True, eq=False, kw_only=True)
class Resimulated:
    """A recorded drive beside its simulation with another controller, at the same times (n,)."""

    name: str
    controller: str
    vehicle: Vehicle
    v: Array
    """Speed, as recorded [m/s]."""
    driven: Array
    """Steering-wheel angle as recorded, its zero corrected [rad]."""
    a_y_driven: Array
    """The recorded lateral acceleration: v times the yaw rate [m/s^2]."""
    compared: NDArray[np.bool_]
    """Recorded, and 3 m/s or faster."""
    log: Log
    """The simulation's signals; `path.e` is how far the car is beside the way that was driven."""
    path: Path
    """The way that was driven."""

    @property
    def differs(self) -> Array:
        """By how much the controller steers further to the left [rad]; NaN where it is not compared."""
        return np.where(self.compared, self.log["actuator.delta_sw"] - self.driven, np.nan)

    def places(self, count: int = 5) -> list[dict[str, float]]:
        """Where the two differ most: time, speed, both angles [deg], their difference; the largest first."""
        left, t = np.abs(self.differs), self.log.t
        found = list[dict[str, float]]()
        while len(found) < count and np.isfinite(left).any():
            k = int(np.nanargmax(left))
            found.append(
                {
                    "t": float(t[k]),
                    "v": float(self.v[k]),
                    "driven_deg": degrees_of(float(self.driven[k])),
                    "again_deg": degrees_of(float(self.log["actuator.delta_sw"][k])),
                    "differs_deg": degrees_of(float(self.differs[k])),
                    "e": float(self.log["path.e"][k]),
                }
            )
            left[np.abs(t - t[k]) < _APART] = np.nan
        return found

    def figures(self) -> dict[str, Any]:
        """What a table shows: wheel speed, a_y and jerk of both, how long beyond their limits; and the difference."""
        use, log = self.compared, self.log
        differs, e = self.differs[use], log["path.e"][use]
        dt = float(log.t[1] - log.t[0])
        answer: dict[str, Any] = {
            "drive": self.name,
            "controller": self.controller,
            "seconds": len(log.t) * dt,
            "compared_seconds": float(use.sum()) * dt,
            "rms_differs_deg": degrees_of(rms(differs)),
            "max_differs_deg": degrees_of(largest(differs)),
            "mean_differs_deg": degrees_of(float(differs.mean())),
            "rms_e": rms(e),
            "max_e": largest(e),
            "places": self.places(),
        }
        again = (log["actuator.delta_sw"], log["car.a_y"])
        for who, (wheel, a_y) in {"driven": (self.driven, self.a_y_driven), "again": again}.items():
            answer[who] = _within(wheel, a_y, use, dt, float(self.vehicle.delta_sw_max))
        return answer

    def verdict(self) -> str:
        """What a person would say of it, in a sentence."""
        found = self.figures()
        driven, again = found["driven"], found["again"]
        speed = again["rms_wheel_speed_deg_s"] / max(driven["rms_wheel_speed_deg_s"], 1e-9)
        beyond = again["seconds_beyond_a_y"] + again["seconds_beyond_jerk"]
        limits = f"beyond the limits of a_y or jerk for {beyond:.1f} s" if beyond else "always within a_y and jerk"
        return (
            f"{self.controller} stays within {found['max_e']:.2f} m of the driven way, turns the wheel {speed:.2f} "
            f"times as fast (RMS) as was driven, and is {limits}; it steers otherwise by "
            f"{found['rms_differs_deg']:.1f} degrees RMS, {found['max_differs_deg']:.1f} at most."
        )


def _within(wheel: Array, a_y: Array, use: NDArray[np.bool_], dt: float, stop: float) -> dict[str, float]:
    """Of one who steers: how fast, how hard, and how long beyond the limits."""
    half = max(1, round(0.5 / dt))
    mean = np.convolve(a_y, np.ones(half) / half, mode="same")  # ISO 11270: over 0.5 s
    jerk = np.gradient(mean, dt)
    return {
        "rms_wheel_speed_deg_s": degrees_of(rms(np.gradient(wheel, dt)[use])),
        "max_wheel_deg": degrees_of(largest(wheel[use])),
        "max_a_y": largest(a_y[use]),
        "max_jerk": largest(jerk[use]),
        "seconds_beyond_a_y": float((np.abs(a_y[use]) > A_Y_MAX).sum()) * dt,
        "seconds_beyond_jerk": float((np.abs(jerk[use]) > JERK_MAX).sum()) * dt,
        "seconds_at_stop": float((np.abs(wheel[use]) > 0.99 * stop).sum()) * dt,
    }


def resimulate(
    drive: Drive, controller: str, *, vehicle: Vehicle, steering: SteeringActuator | None = None, progress: bool = False
) -> Resimulated:
    """Drive a recorded drive again: the same way at the same speed, steered by a controller of the catalogue.

    The way is that of the point of the car where the controller looks at e, by dead reckoning from speed and heading
    (or yaw rate, averaged over 0.5 s), so that e = 0 is what was driven. The car is `NonlinearSingleTrack` behind
    `SteeringActuator`; the controller knows both. The same drive, car and controller give the same bits.

    controller: as for `steerkit.scenario.catalogue.make_controller`. vehicle, steering (default: that of
    `SteeringActuator`): of the car that drives again; the offset is what must be added to a recorded angle, and
    delays are multiples of 0.01 s. progress: print it. Raises ValueError for a
    drive without enough of a way in it and for an unknown controller.
    """
    metres = float(np.sum(drive.v) * drive.dt)
    require(metres >= 20.0, drive.name, f"goes {metres:.1f} m, expected 20 m or more to drive again")
    straight = Path.from_waypoints([(0.0, 0.0), (100.0, 0.0)], closed=False)
    motor = steering or SteeringActuator()
    delay, lag = float(motor.delay), float(motor.lag)

    def designed(on: Path) -> Any:
        model = DesignModel(vehicle=vehicle, path=on, delay=delay, lag=lag, hold=SteeringActuator.dt)
        return make_controller(controller, model)

    law = bare(designed(straight))
    ahead = float(getattr(law, "reference", float(vehicle.l_f)))  # where the controller looks at e
    path = way(drive, ahead=float(vehicle.l_r) + ahead)
    speeds = np.interp(np.arange(0.0, drive.t[-1] + DT, DT), drive.t, drive.v)
    plant = NonlinearSingleTrack(vehicle=vehicle, v0=max(float(speeds[0]), 0.1), x0=float(vehicle.l_r))
    actuator = SteeringActuator(delay=delay, lag=lag, rate_limit=DesignModel.rate_limit, limit=vehicle.delta_sw_max)
    loop = steering_loop(
        car=plant,
        path=path,
        driver=Playback(angles=(0.0,) * len(speeds), speeds=tuple(speeds.tolist()), dt=DT),
        controller=designed(path),
        actuator=actuator,
        reference=ahead,
    )
    log = _run(loop, float(drive.t[-1]), progress)
    t = log.t
    driven = np.interp(t, drive.t, drive.delta_sw) + float(motor.offset)
    r, v = np.interp(t, drive.t, drive.r), np.interp(t, drive.t, drive.v)
    measured = np.interp(t, drive.t, drive.measured.astype(float)) > 0.99
    return Resimulated(
        name=drive.name,
        controller=controller,
        vehicle=vehicle,
        v=v,
        driven=driven,
        a_y_driven=v * r,
        compared=measured & (v >= V_DRIVING) & (t >= 2.0),
        log=log,
        path=path,
    )


def way(drive: Drive, *, ahead: float = 0.0) -> Path:
    """The way of the point `ahead` [m] of a drive's rear axle, by dead reckoning from the origin along +x.

    It begins and ends with a straight: of 10 m, for a car whose centre is behind that point, and of 50 m to look at.
    """
    dt = drive.dt
    width = 2 * round(0.5 * _SMOOTH / dt) + 1
    rate = np.convolve(np.pad(drive.r, width // 2, mode="edge"), np.ones(width) / width, mode="valid")
    psi = cumulative_trapezoid(rate, dx=dt, initial=0.0)
    v = 0.5 * (drive.v[1:] + drive.v[:-1])
    middle = 0.5 * (psi[1:] + psi[:-1])
    x = np.concatenate(([0.0], np.cumsum(v * np.cos(middle) * dt))) + ahead * np.cos(psi)
    y = np.concatenate(([0.0], np.cumsum(v * np.sin(middle) * dt))) + ahead * np.sin(psi)
    s = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    moved = np.concatenate(([True], np.diff(s) > 1e-6))
    at = np.linspace(0.0, s[-1], max(4, math.ceil(s[-1] / _SPACING)) + 1)
    xy = np.column_stack([np.interp(at, s[moved], column[moved]) for column in (x, y)])
    on = (xy[-1] - xy[-2]) / math.dist(xy[-1], xy[-2])  # a controller looks ahead of the last sample
    more = xy[-1] + np.outer(np.arange(1, 26) * _SPACING, on)
    before = xy[0] - np.outer(np.arange(5, 0, -1) * _SPACING, (1.0, 0.0))
    return Path.from_waypoints(np.vstack((before, xy, more)), closed=False, spacing=_SPACING, name=drive.name)


def _run(loop: Loop, seconds: float, progress: bool) -> Log:
    """Twenty samples a second; compiled where the controller can be."""
    kept, ticks = list(_KEPT), round(DT / loop.dt)
    try:
        return compile(loop, record=kept, every=ticks).run(seconds)
    except (TraceError, NoCompilerError):  # a block or a machine without C
        return simulate(loop, seconds, record=kept, every=ticks, progress=progress)


def compared(*driven: Resimulated) -> Any:
    """The angles over time, their differences with the places where they are largest, and a_y within its limit."""
    first, t = driven[0], driven[0].log.t
    names = ", ".join(again.controller for again in driven)
    with style():
        figure, (wheel, differs, a_y) = new_figure(3, title=f"{first.name}: {names} on the same way")
        wheel.plot(t, degrees_of(first.driven), color=COLOURS["muted"], lw=2.0, alpha=0.7, label="as driven")
        a_y.plot(t, np.asarray(first.a_y_driven), color=COLOURS["muted"], lw=0.8)
        for again, colour in zip(driven, cycle((COLOURS["analytic"], COLOURS["learned"], *PALETTE[2:]))):
            wheel.plot(t, degrees_of(again.log["actuator.delta_sw"]), color=colour, lw=0.8, label=again.controller)
            differs.plot(t, degrees_of(again.differs), color=colour, lw=0.8)
            for place in again.places():
                differs.plot(place["t"], place["differs_deg"], "o", color=colour, ms=4)
            a_y.plot(t, again.log["car.a_y"], color=colour, lw=0.8)
        wheel.set_ylabel("wheel [deg]")
        wheel.legend(loc="upper right")
        differs.set_ylabel("differs by [deg], + = left")
        for limit in (-A_Y_MAX, A_Y_MAX):
            a_y.axhline(limit, color=COLOURS["limit"], lw=0.8, ls="--")
        a_y.set_ylabel("a_y [m/s^2]")
        a_y.set_xlabel("t [s]")
    return figure
