"""A course from above, with its curvature."""

from typing import TYPE_CHECKING

import numpy as np

from steerkit.plots.style import COLOURS, new_figure, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from steerkit.paths.path import Path


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
