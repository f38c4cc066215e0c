"""Metrics over one swept parameter, or maps of them over two."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit._support.errors import require
from steerkit.plots.style import PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def plot_sweep(values: Mapping[str, Any], columns: Mapping[str, Any], units: Mapping[str, str]) -> Figure:
    """A panel a metric over one parameter, or over two with the metric as colour; gaps where it is NaN.

    values: of each parameter (n,); columns: of the grid, the last parameter fastest, the metrics among them. Raises
    ValueError for more than two parameters. An axis is logarithmic where the values are evenly spaced in log.
    """
    names, metrics = list(values), [name for name in columns if name not in values]
    require(len(names) <= 2, "plot", f"{len(names)} parameters ({', '.join(names)}), expected one or two")
    figure, panels = new_figure(len(metrics), height=0.7 + 2.2 * len(metrics))
    for panel, metric, colour in zip(panels, metrics, [*PALETTE] * len(metrics)):
        label = f"{metric} [{units.get(metric, '1')}]".removesuffix(" [1]")
        scales = dict(zip(("xscale", "yscale"), map(_scale, values.values())))
        if len(names) == 1:
            panel.plot(values[names[0]], columns[metric], "." if len(columns[metric]) == 1 else "-", color=colour)
            panel.set(ylabel=label, **scales)
        else:
            table = np.reshape(columns[metric], [len(numbers) for numbers in values.values()]).T
            drawn = panel.pcolormesh(*values.values(), np.ma.masked_invalid(table), shading="nearest", cmap="viridis_r")
            figure.colorbar(drawn, ax=panel, label=label)
            panel.set(ylabel=names[1], **scales)
    panels[-1].set_xlabel(names[0])
    return figure


def _scale(values: Any) -> str:
    even = len(values) > 2 and min(values) > 0.0 and np.ptp(np.diff(np.log(values))) < 1e-6
    return "log" if even else "linear"
