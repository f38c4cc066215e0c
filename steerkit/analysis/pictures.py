"""Pictures of linear analysis: Bode plots with their margins, margins over a speed, step responses."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit.analysis.linear import Point, UnstableError, margins, step_response
from steerkit.diagram.units import degrees_of
from steerkit.plots.style import COLOURS, PALETTE, new_figure, styled

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@styled
def plot_bode(loops: Mapping[str, Any], *, title: str = "") -> "Figure":
    """Gain and phase of open loops over frequency, by name; dots where |L| = 1, margins in the legend.

    loops: single-input, single-output systems, as `break_at` gives them. Raises ValueError as `margins` does, but for
    an unstable closed loop, which the legend names.
    """
    figure, (gain, phase) = new_figure(2, title=title, height=5.4)
    for colour, (name, system) in zip(PALETTE, loops.items()):
        top = math.pi / system.dt if system.isdtime(strict=True) else 1e3
        w = np.geomspace(3e-3 * top, top * (1.0 - 1e-6), 1000)
        answer = np.asarray(system(np.exp(1j * w * system.dt) if system.isdtime(strict=True) else 1j * w))
        angle = np.unwrap(np.angle(answer))
        angle -= 2.0 * math.pi * math.ceil((angle[0] - 0.1) / (2.0 * math.pi))  # starts in (-360, 0] degrees
        try:
            margin = margins(system)
            label = f"{name}: {_legend(margin.gain, margin.phase, margin.delay)}"
            at = margin.gain_crossing
        except UnstableError:
            label, at = f"{name}: closed loop unstable", math.nan
        gain.plot(w, 20.0 * np.log10(np.maximum(np.abs(answer), 1e-9)), color=colour, label=label)
        phase.plot(w, degrees_of(angle), color=colour)
        if math.isfinite(at):
            gain.plot(at, 0.0, "o", ms=5, color=colour)
            phase.plot(at, degrees_of(float(np.interp(at, w, angle))), "o", ms=5, color=colour)
    gain.axhline(0.0, color=COLOURS["muted"], lw=0.8)
    phase.axhline(-180.0, color=COLOURS["muted"], lw=0.8)
    gain.set(xscale="log", ylabel="|L| [dB]", ylim=(-40.0, None))
    phase.set(ylabel="arg L [deg]", xlabel="frequency [rad/s]", ylim=(-720.0, 20.0))
    phase.set_yticks(range(-720, 1, 180))
    gain.legend(loc="upper right")
    phase.margins(x=0.0)
    return figure


@styled
def plot_over(points: Mapping[str, Sequence[Point]], *, xlabel: str = "v [m/s]", title: str = "") -> "Figure":
    """Phase margin, delay margin and the largest closed-loop pole over what was varied: a line a name.

    points: as `over` gives them. Where the closed loop is unstable the margins have a gap and the pole is above 1.
    """
    figure, (phase, delay, pole) = new_figure(3, title=title)
    for colour, (name, varied) in zip(PALETTE, points.items()):
        x = [point.value for point in varied]
        margins_of = [point.margins for point in varied]
        phases = [math.nan if t is None else degrees_of(t.phase) for t in margins_of]
        delays = [math.nan if t is None else t.delay for t in margins_of]
        largest = [abs(point.poles[0]) if len(point.poles) else 0.0 for point in varied]
        for panel, values in ((phase, phases), (delay, delays), (pole, largest)):
            panel.plot(x, values, "o-", ms=3, color=colour, label=name)
    pole.axhline(1.0, color=COLOURS["limit"], lw=0.9)
    phase.set(ylabel="phase margin [deg]", ylim=(0.0, 90.0))
    delay.set(ylabel="delay margin [s]", ylim=(0.0, None))
    pole.set(ylabel="largest |pole|", xlabel=xlabel)
    phase.legend(loc="upper right", ncols=2)
    return figure


@styled
def plot_steps(systems: Mapping[str, Any], seconds: float, *, ylabel: str = "", title: str = "") -> "Figure":
    """Step responses of single-input, single-output systems over t, by name, such as those of several speeds."""
    figure, (panel,) = new_figure(1, title=title)
    for colour, (name, system) in zip(PALETTE, systems.items()):
        panel.plot(*step_response(system, seconds), color=colour, label=name)
    panel.axhline(0.0, color=COLOURS["muted"], lw=0.8)
    panel.set(xlabel="t [s]", ylabel=ylabel)
    panel.margins(x=0.0)
    panel.legend(loc="best")
    return figure


def _legend(gain: float, phase: float, delay: float) -> str:
    """Margins for a legend."""
    parts = [("gain", f"{gain:.2f}", gain), ("phase", f"{degrees_of(phase):.0f}°", phase)]
    parts.append(("delay", f"{delay:.2f} s", delay))
    return ", ".join(f"{name} {text if math.isfinite(value) else '∞'}" for name, text, value in parts)
