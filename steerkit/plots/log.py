"""Signals of a log over time."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from steerkit.plots.style import PALETTE, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from steerkit.diagram.simulation import Log, Signal


_SHOWN = ("e", "delta_sw", "v", "a_y", "psi_e", "r")  # outputs worth a panel, best first
_PANELS = 4


def plot_log(log: "Log", signals: "Sequence[Signal] | None" = None) -> "Figure":
    """Signals of a log over t, one panel a unit, all panels over the same t; returns the figure.

    signals: names or ports (default: all). A vector gives a line an entry, a batch a thin line a car. Raises KeyError
    for a signal that was not recorded.
    """
    names = [_name(log, signal) for signal in (signals or [name for name in log if log[name].size])]
    by_unit: dict[str, list[str]] = {}
    for name in names:
        by_unit.setdefault(log.units[name], []).append(name)
    figure, panels = new_figure(len(by_unit))
    for panel, (unit, group) in zip(panels, by_unit.items()):
        for number, name in enumerate(group):
            values = log[name]
            lines = values.reshape(len(log.t), math.prod(values.shape[1:]))
            many = lines.shape[1] > 1
            look = {"lw": 0.7, "alpha": max(0.15, 0.9 / lines.shape[1] ** 0.5)} if many else {"lw": 1.2}
            drawn = panel.plot(log.t, lines, color=PALETTE[number % len(PALETTE)], **look)
            drawn[0].set_label(f"{name} ({lines.shape[1]})" if many else name)
        brackets = "" if unit == "1" else f"[{unit}]"
        if len(group) == 1:
            panel.set_ylabel(f"{group[0]} {brackets}".strip())
        else:
            panel.set_ylabel(brackets)
            legend = panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.02), frameon=False, fontsize=8.0)
            for handle in legend.get_lines():
                handle.set(alpha=1.0, linewidth=1.6)
        panel.margins(x=0.0)
    panels[-1].set_xlabel("t [s]")
    return figure


def telling(log: "Log") -> list[str]:
    """Up to four signals, of different names, that tell most about a drive; else the first ones."""
    chosen = []
    for name in _SHOWN:
        chosen += [signal for signal in log if signal.rpartition(".")[2] == name and log[signal].size][:1]
    return chosen[:_PANELS] or [signal for signal in log if log[signal].size][:_PANELS]


def _name(log: "Log", signal: "Signal") -> str:
    """The signal's name, checked to be recorded."""
    log[signal]
    return signal if isinstance(signal, str) else log.loop.port_name(signal)  # type: ignore[union-attr]
