"""The picture and the film of a drive that was driven again."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit.diagram.units import degrees_of
from steerkit.plots.style import COLOURS, new_figure, style
from steerkit.task import A_Y_MAX

if TYPE_CHECKING:
    from steerkit.logs.resimulate import Resimulated


def compared(again: Resimulated) -> Any:
    """Both angles over time, their difference with the places where it is largest, and a_y within its limit."""
    t = again.t
    with style():
        title = f"{again.name}: {again.controller} on the same way"
        figure, (wheel, differs, a_y) = new_figure(3, title=title)
        wheel.plot(t, degrees_of(again.driven), color=COLOURS["muted"], lw=2.0, alpha=0.7, label="as driven")
        wheel.plot(t, degrees_of(again.again), color=COLOURS["analytic"], lw=0.8, label=again.controller)
        wheel.set_ylabel("wheel [deg]")
        wheel.legend(loc="upper right")
        differs.plot(t, degrees_of(again.differs), color=COLOURS["analytic"], lw=0.8)
        for place in again.places():
            differs.plot(place["t"], place["differs_deg"], "o", color=COLOURS["learned"], ms=4)
        differs.set_ylabel("differs by [deg], + = left")
        for values, colour in ((again.a_y_driven, COLOURS["muted"]), (again.a_y, COLOURS["analytic"])):
            a_y.plot(t, np.asarray(values), color=colour, lw=0.8)
        for limit in (-A_Y_MAX, A_Y_MAX):
            a_y.axhline(limit, color=COLOURS["limit"], lw=0.8, ls="--")
        a_y.set_ylabel("a_y [m/s^2]")
        a_y.set_xlabel("t [s]")
    return figure


def film(again: Resimulated, file: str | Path, *, lasts: float = 10.0, progress: bool = False) -> Path:
    """The controller's car on the way that was driven, with e beside it, as .gif or .mp4; see `Log.animate`.

    lasts [s]: the film, or less where the drive took less.
    """
    car, speed = again.car.vehicle, max(1.0, float(again.t[-1]) / lasts)
    size = {"wheelbase": float(car.wheelbase), "l_f": float(car.l_f), "steer_ratio": float(car.steer_ratio)}
    return again.log.animate(again.path, file, **size, speed=speed, fps=8.0, progress=progress)
