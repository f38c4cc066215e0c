"""The picture of what a run has recorded, with a drive in it, and how far from it that goes."""

from typing import TYPE_CHECKING

import numpy as np

from steerkit.controllers.policy import DOE, PSI_E, E, V
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of
from steerkit.learning.data.distance import REACH, Distance, states_of
from steerkit.learning.data.transitions import Transitions
from steerkit.plots.style import COLOURS, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PAIRS = (((V, "v [m/s]"), (DOE, "wheel [deg]")), ((E, "e [m]"), (PSI_E, "psi_e [deg]")))


@styled
def beside_the_data(record: Transitions, log: Log, apart: Distance, *, title: str) -> "Figure":
    """Recorded states (grey), a drive's by their distance from them, and that distance over time."""
    figure, (only,) = new_figure(title=title, width=10.5, height=3.6)
    figure.delaxes(only)
    left, middle, right = figure.subplots(1, 3)
    s = states_of(log, "beside_the_data")
    for axis, ((i, x_label), (j, y_label)) in zip((left, middle), _PAIRS):
        axis.plot(record.s[:, i], degrees_of(record.s[:, j]), ".", ms=2.0, mew=0, color=COLOURS["muted"], alpha=0.5)
        order = np.argsort(apart.d)
        dots = axis.scatter(
            s[order, i],
            degrees_of(s[order, j]),
            c=apart.d[order],
            s=3,
            lw=0,
            cmap="viridis",
            vmin=0.0,
            vmax=2.0 * REACH,
        )
        axis.set(xlabel=x_label, ylabel=y_label)
    figure.colorbar(dots, ax=middle, label="distance [1]")
    right.plot(log.t, apart.d, color=COLOURS["learned"], lw=0.9)
    right.axhline(REACH, color=COLOURS["limit"], lw=0.8, ls="--")
    right.set(xlabel="t [s]", ylabel=f"distance from the data [1]; {REACH:g}: as far as nets learned", ylim=(0.0, None))
    return figure
