"""The picture of an identification: measured and predicted yaw rate, and what is left."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit.plots.style import COLOURS, PALETTE, new_figure, style

if TYPE_CHECKING:
    from steerkit.identification.estimate import Identified, Prediction

_PAUSE = 0.04  # share of the axis between the fitted and the held-out drive


def residuals(identified: Identified, held_out: Prediction | None = None) -> Any:
    """Yaw rate, residual and speed over time, the held-out drive after the fitted one; beside them a scatter plot."""
    fit = identified.fit
    parts = [(fit, "fitted", COLOURS["learned"]), *([(held_out, "held out", COLOURS["analytic"])] if held_out else [])]
    ends: list[float] = []
    with style():
        figure, (cloud, rate, left, speed) = new_figure(
            3, map_beside=True, title=f"{identified.vehicle.name}: yaw rate from steering wheel and speed alone"
        )
        start = 0.0
        for part, word, colour in parts:
            drive = part.drive
            t = start + drive.t
            hidden = ~drive.measured
            measured, error = np.where(hidden, np.nan, drive.r), np.where(hidden, np.nan, drive.r - part.r)
            rate.plot(t, measured, color=COLOURS["muted"], lw=2.2, alpha=0.7, label=None if ends else "measured")
            rate.plot(t, part.r, color=colour, lw=0.8, label=f"predicted, {word}")
            left.plot(t, 1e3 * error, color=colour, lw=0.6, label=f"{word}: RMS {1e3 * part.rms:.2f} mrad/s")
            speed.plot(t, drive.v, color=colour, lw=1.0)
            use = drive.driving
            cloud.plot(drive.r[use], part.r[use], ".", color=colour, ms=1.2, alpha=0.5, rasterized=True)
            ends.append(t[-1])
            start = t[-1] + _PAUSE * sum(p.drive.t[-1] for p, _, _ in parts)
        if held_out is not None:
            moved = f"zero of the wheel found anew: {1e3 * held_out.rms_rezeroed:.2f}"
            left.plot([], [], " ", label=f"{moved} mrad/s")
        reach = 1.05 * max(float(np.abs(part.drive.r).max()) for part, _, _ in parts)
        cloud.plot([-reach, reach], [-reach, reach], color=COLOURS["ink"], lw=0.6)
        cloud.set(
            aspect="equal",
            xlabel="measured yaw rate [rad/s]",
            ylabel="predicted yaw rate [rad/s]",
            xlim=(-reach, reach),
            ylim=(-reach, reach),
        )
        left.axhline(0.0, color=COLOURS["ink"], lw=0.6)
        rate.set_ylabel("yaw rate [rad/s]")
        left.set_ylabel("measured - predicted\n[mrad/s]")
        speed.set(ylabel="speed [m/s]", xlabel="t [s], one drive after the other" if held_out else "t [s]")
        speed.set_ylim(bottom=0.0)
        for axis in (rate, left):
            axis.legend(loc="lower right", ncols=3, fontsize=7, handlelength=1.2, columnspacing=1.2)
            low, high = axis.get_ylim()
            axis.set_ylim(low - 0.22 * (high - low), high)
        rate.margins(x=0.01)
        _intervals(figure, identified)
        return figure


def _intervals(figure: Any, identified: Identified) -> None:
    """The estimates in words under the cloud."""
    lines = []
    for name, label, factor, unit in (
        ("steer_ratio", "steering ratio", 1.0, ""),
        ("understeer_gradient", "understeer gradient", 1e3, "mrad s²/m"),
        ("delay_lag", "delay + lag", 1e3, "ms"),
        ("offset", "offset at the wheel", 180.0 / np.pi, "deg"),
    ):
        e = identified[name]
        numbers = f"{factor * e.value:.3g}  [{factor * e.low:.3g}, {factor * e.high:.3g}] {unit}"
        lines.append(f"{label}: {numbers}" + ("" if e.told_by == "log" else f"  ({e.told_by})"))
    figure.axes[-1].text(
        0.02,
        0.98,
        "\n".join(lines),
        transform=figure.axes[-1].transAxes,
        va="top",
        fontsize=7.5,
        color=COLOURS["ink"],
        bbox={"fc": COLOURS["paper"], "ec": PALETTE[5], "lw": 0.5, "boxstyle": "round,pad=0.4"},
        zorder=9,
    )
