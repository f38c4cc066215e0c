"""Pictures as matplotlib figures: a round on the map, cross-track error over time, a course."""

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of
from steerkit.plots.style import COLOURS, PALETTE, new_figure, style, styled
from steerkit.task import GOAL, TRIP

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from steerkit.paths.path import Path


@styled
def trace(log: Log, *, title: str, seconds: float = 100.0) -> Any:
    """Cross-track error and steering wheel over the first `seconds` (the paper's figures 3 and 4)."""
    figure, (top, low) = new_figure(rows=2, title=title)
    keep = log.t <= log.t[0] + seconds
    t = log.t[keep] - log.t[0]
    top.axhspan(-GOAL, GOAL, color=COLOURS["goal"], alpha=0.25, lw=0, label="|e| < 0.05 m")
    top.plot(t, log["path.e"][keep], color=COLOURS["learned"], lw=1.2)
    top.set_ylabel("e [m]")
    top.legend(loc="upper right")
    low.plot(t, degrees_of(log["car.delta_sw"][keep]), color=COLOURS["wheel"], lw=1.2)
    low.set_ylabel("steering wheel [deg]")
    low.set_xlabel("t [s]")
    return figure


@styled
def learning(log: Log, *, title: str, seconds: float | None = None) -> Any:
    """Cross-track error from the first second on, shaded where the recovery controller steers (figure 5).

    seconds: how much of the drive is shown; default: all of it.
    """
    figure, (axis,) = new_figure(rows=1, title=title)
    if seconds is None:
        seconds = float(log.t[-1])
    keep = log.t <= seconds
    t, e, learns = log.t[keep], log["path.e"][keep], log["supervisor.learning"][keep] > 0.5
    shade_recovery(axis, t, learns)
    for level in (-TRIP, TRIP):
        axis.axhline(level, color=COLOURS["limit"], lw=0.8, ls="--", label="|e| = 0.5 m" if level > 0 else None)
    axis.plot(t, e, color=COLOURS["learned"], lw=0.9)
    axis.set_ylim(-1.3, 1.3)
    axis.set_xlim(0.0, seconds)
    axis.set_ylabel("e [m]")
    axis.set_xlabel("driving time [s]")
    axis.legend(loc="upper right", ncols=2)
    return figure


def shade_recovery(axis: Any, t: Any, learns: Any) -> None:
    """Shade an axis where the recovery controller steers; learns: does the learner, at the times t (n,) [s]?"""
    look: dict[str, Any] = dict(color=COLOURS["recovery"], alpha=0.75, lw=0, step="post", label="recovery steers")
    axis.fill_between(t, 0, 1, where=~learns, transform=axis.get_xaxis_transform(), **look)


@styled
def first_round(log: Log, *, began: float | None, done: float | None, title: str) -> Any:
    """The learner's first complete round: where it drove, and its cross-track error (figure 6)."""
    if began is None or done is None:
        return learning(log, title=f"{title}: no complete round")
    keep = (log.t >= began) & (log.t <= done)
    part = Log(log.t[keep] - began, {name: values[keep] for name, values in log.items()}, log.units)
    return round_driven(part, title=f"{title}, begun {began:.0f} s after the start")


def _beside_a_map(drives: Mapping[str, tuple[Log, str]], title: str) -> tuple[Any, Any, Any]:
    """A figure of drives in colours: error, wheel and acceleration over distance, beside a map that is still empty.

    It is as high as the first drive's map needs to fill its place. Returns the figure, the map and the error's panel.
    """
    first = next(iter(drives.values()))[0]
    width, depth = float(np.ptp(first["car.x"])), float(np.ptp(first["car.y"]))
    height = float(np.clip(1.2 + 4.0 * depth / max(width, 1e-9), 4.8, 6.4))
    figure, (course, *panels) = new_figure(rows=3, title=title, map_beside=True, height=height)
    course.set_aspect("equal", adjustable="datalim")
    course.set(xlabel="x [m]", ylabel="y [m]")
    panels[0].axhspan(-GOAL, GOAL, color=COLOURS["goal"], alpha=0.25, lw=0)
    for name, (log, colour) in drives.items():
        at = log["path.progress"] - log["path.progress"][0]
        for panel, values in zip(panels, (log["path.e"], degrees_of(log["car.delta_sw"]), log["car.a_y"])):
            panel.plot(at, values, color=colour, lw=1.0, label=name)
    for panel, label in zip(panels, ("e [m]", "steering wheel [deg]", "a_y [m/s²]")):
        panel.set_ylabel(label)
    panels[-1].set_xlabel("distance driven [m]")
    return figure, course, panels[0]


@styled
def round_driven(log: Log, other: Log | None = None, *, title: str) -> Any:
    """The course coloured by |e|, with cross-track error, steering wheel and lateral acceleration beside it."""
    drives = {} if other is None else {"Stanley": (other, COLOURS["analytic"])}
    figure, course, error = _beside_a_map(drives | {"this drive": (log, COLOURS["learned"])}, title)
    dots = course.scatter(log["car.x"], log["car.y"], c=np.abs(log["path.e"]), s=6, cmap="viridis", vmin=0.0)
    figure.colorbar(dots, ax=course, label="|e| [m]", shrink=0.8, aspect=40)
    if other is not None:
        error.legend(loc="upper right", ncols=2)
    return figure


@styled
def rounds_driven(logs: Mapping[str, Log], *, title: str) -> Any:
    """Several drives over the same course in one picture: where they went, cross-track error, wheel, acceleration."""
    drives = {name: (log, colour) for (name, log), colour in zip(logs.items(), cycle(PALETTE))}
    figure, course, _ = _beside_a_map(drives, title)
    for name, (log, colour) in drives.items():
        course.plot(log["car.x"], log["car.y"], color=colour, lw=1.1, label=name)
    course.legend(loc="best", fontsize=8.0)
    return figure


def plot_course(path: "Path", *, title: str | None = None) -> "Figure":
    """A path seen from above, coloured by curvature, with start and direction; curvature over s beside it."""
    figure, (above, along) = new_figure(1, map_beside=True, height=4.2, title=repr(path) if title is None else title)
    line = path.samples
    bound = float(np.abs(line.kappa).max()) or 1.0
    dots = above.scatter(
        line.xy[:, 0], line.xy[:, 1], c=line.kappa, cmap="coolwarm_r", vmin=-bound, vmax=bound, s=9, lw=0, zorder=2
    )
    above.plot(line.xy[:, 0], line.xy[:, 1], color=COLOURS["muted"], lw=0.6, zorder=1)
    start, heading = line.xy[0], line.psi[0]
    reach = 0.08 * float(np.ptp(line.xy, axis=0).max())
    tip = start + reach * np.array([np.cos(heading), np.sin(heading)])
    above.annotate("", xy=tip, xytext=start, arrowprops={"arrowstyle": "-|>", "color": COLOURS["ink"], "lw": 1.4})
    above.plot(*start, "o", color=COLOURS["ink"], ms=5, zorder=3)
    above.annotate("start", start, xytext=(6, -11), textcoords="offset points", color=COLOURS["ink"], fontsize=8)
    above.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    with style():
        figure.colorbar(dots, ax=above, label="kappa [1/m], + = left", shrink=0.7)
    along.axhline(0.0, color=COLOURS["muted"], lw=0.7)
    along.plot(line.s, line.kappa, color=COLOURS["learned"])
    along.set(xlabel="s [m]", ylabel="kappa [1/m]")
    along.margins(x=0.0)
    return figure
