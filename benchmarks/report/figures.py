"""The report's pictures: matplotlib figures as SVG that takes its colours and letters from the page around it."""

import io
import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from steerkit.plots.style import COLOURS, PALETTE, new_figure, style
from steerkit.task import GOAL, TRIP

WIDTH = 4.6
"""Width of a picture [in]: it fits a phone, and two or three stand side by side on a desk."""
LINES = ("-", (0, (5, 1.5)), (0, (1.2, 1.2)), (0, (6, 1.5, 1.2, 1.5)))
"""Dashes take over where twelve colours are used up, and tell lines apart without colour."""
_SERIAL = itertools.count()
_INK = {
    COLOURS["ink"]: "--ink",
    COLOURS["muted"]: "--muted",
    COLOURS["grid"]: "--grid",
    COLOURS["limit"]: "--limit",
    COLOURS["goal"]: "--goal",
    COLOURS["paper"]: "--card",
}


@dataclass(frozen=True)
class Look:
    """How one controller is drawn, everywhere the same."""

    colour: str
    dashes: Any
    css: str
    """The colour as the page knows it."""

    @property
    def line(self) -> dict[str, Any]:
        """Keyword arguments of a line."""
        return {"color": self.colour, "ls": self.dashes}


def looks(controllers: Sequence[str]) -> dict[str, Look]:
    """A look for each controller, by its place in the list."""
    n = len(PALETTE)
    return {
        name: Look(PALETTE[i % n], LINES[i // n % len(LINES)], f"var(--c{i % n})") for i, name in enumerate(controllers)
    }


def svg(figure: Figure, words: str) -> str:
    """The figure as an <svg> element: colours and typeface of the page, letters as letters, ids of its own.

    Coordinates have two decimals, a hundredth of a pixel: a page of a whole suite has some hundred figures, and this
    halves it. words: what it shows, for those who do not see it.
    """
    serial = f"f{next(_SERIAL)}"
    buffer = io.StringIO()
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "steerkit"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{serial}-\1"', text)
    text = re.sub(r'(xlink:href|href)="#([^"]+)"', rf'href="#{serial}-\2"', text)
    text = re.sub(r"url\(#([^)]+)\)", rf"url(#{serial}-\1)", text)
    text = re.sub(r' xmlns:xlink="[^"]*"', "", text)
    text = re.sub(r"font: ([^;\"]*?)(\d[\d.]*px) [^;\"]*", r"font: \1\2 inherit; font-family: inherit", text)
    text = re.sub(r"font-family: '[^;\"]*", "font-family: inherit", text)
    text = re.sub(r" transform=\"rotate\(-?0 [^)]*\)\"", "", text)
    text = re.sub(r"<[^>]*>", lambda tag: re.sub(r"(\.\d\d)\d+", r"\1", tag[0]), text)  # labels keep their digits
    text = re.sub(r"\s*\n\s*", "\n", text)
    for colour, variable in (*_INK.items(), *((c, f"--c{i}") for i, c in enumerate(PALETTE))):
        text = re.sub(re.escape(colour), f"var({variable})", text, flags=re.I)
    text = re.sub(r"(<text[^>]*style=\")", r"\1fill: var(--ink); ", text)
    safe = words.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;")
    return re.sub(
        r'<svg[^>]*?viewBox="([^"]*)"[^>]*>', rf'<svg viewBox="\1" role="img" aria-label="{safe}">', text, count=1
    )


def course_map(drives: Mapping[str, Mapping[str, np.ndarray]], look: Mapping[str, Look], magnified: float) -> Figure:
    """Where each controller drove, its distance from the path drawn `magnified` times; grey is the path itself."""
    with style():
        figure, (axes,) = new_figure(width=5.4, height=3.9)
        axes.set_aspect("equal", adjustable="datalim")
        longest = max(drives.values(), key=lambda d: float(d["s"].max() - d["s"].min()))
        centre, _ = _frame(longest)
        axes.plot(*centre.T, color=COLOURS["muted"], lw=3.0, alpha=0.35, solid_capstyle="round")
        for name, drive in drives.items():
            foot, normal = _frame(drive)
            drawn = foot + magnified * np.clip(drive["e"], -TRIP, TRIP)[:, None] * normal
            axes.plot(*drawn.T, lw=1.0, label=name, **look[name].line)
        axes.plot(*centre[0], "o", ms=5, color=COLOURS["ink"])
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        return figure


def error_along(drives: Mapping[str, Mapping[str, np.ndarray]], look: Mapping[str, Look]) -> Figure:
    """e [m] over the driven distance, one line a controller."""
    with style():
        figure, (axes,) = new_figure(width=5.4, height=3.9)
        for name, drive in drives.items():
            dt = float(np.mean(np.diff(drive["t"]))) if len(drive["t"]) > 1 else 0.0
            axes.plot(np.cumsum(drive["v"]) * dt, drive["e"], lw=0.9, label=name, **look[name].line)
        axes.axhspan(-GOAL, GOAL, color=COLOURS["goal"], alpha=0.3, lw=0)
        largest = max(float(np.nanmax(np.abs(d["e"]))) for d in drives.values())
        if largest > 0.6 * TRIP:
            for level in (-TRIP, TRIP):
                axes.axhline(level, color=COLOURS["limit"], lw=0.9, ls="--")
        bound = min(1.15 * max(largest, 0.06), 1.5)
        axes.set_ylim(-bound, bound)
        axes.margins(x=0.0)
        axes.set_xlabel("driven [m]")
        axes.set_ylabel("e [m]")
        return figure


def magnification(drives: Mapping[str, Mapping[str, np.ndarray]]) -> float:
    """A round factor by which e [m] is enlarged on a map so that the widest excursion is a thirtieth of the map."""
    span = max(float(np.ptp(d["x"])) + float(np.ptp(d["y"])) for d in drives.values()) / 2.0
    widest = max(float(np.nanmax(np.abs(np.clip(d["e"], -TRIP, TRIP)))) for d in drives.values())
    exact = span / 30.0 / max(widest, 1e-3)
    steps = [f * 10.0**k for k in range(4) for f in (1.0, 2.0, 5.0)]
    return max((s for s in steps if s <= exact), default=1.0)


def _frame(drive: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The path's points beside the car (T, 2) [m] and its left normals there (T, 2); the car's own psi is not kept."""
    p = np.column_stack([drive["x"], drive["y"]])
    way = np.gradient(p, axis=0)
    psi = np.arctan2(way[:, 1], way[:, 0]) - drive["psi_e"]
    normal = np.column_stack([-np.sin(psi), np.cos(psi)])
    return p - drive["e"][:, None] * normal, normal


def bands(
    x: np.ndarray,
    curves: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray]],
    look: Mapping[str, Look],
    *,
    x_label: str,
    y_label: str,
    log: bool = False,
    share: bool = False,
) -> Figure:
    """One line a controller with its interval: curves are (middle, low, high), each (len(x),); infinite is a gap."""
    with style():
        figure, (axes,) = new_figure(width=WIDTH, height=2.9)
        highest = max([float(np.max(m[np.isfinite(m)], initial=0.0)) for m, *_ in curves.values()] or [0.0])
        for name, (middle, low, high) in curves.items():
            top = np.where(np.isfinite(high), high, 10.0 * highest if highest else 1.0)
            seen = np.isfinite(middle)
            axes.fill_between(x, low, top, where=seen, color=look[name].colour, alpha=0.14, lw=0, step="post")
            drawn = np.where(seen, middle, np.nan)
            axes.plot(x, drawn, lw=1.5, label=name, drawstyle="steps-post", **look[name].line)
        if share:
            axes.set_ylim(-0.03, 1.03)
        elif log:
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0), numticks=10))  # not powers of ten alone
            axes.yaxis.set_major_formatter("{x:g}")
            axes.yaxis.set_minor_formatter(NullFormatter())
            if highest:
                axes.set_ylim(top=2.0 * highest)
        elif highest:
            axes.set_ylim(0.0, 1.15 * highest)
        if len(x) > 1:
            axes.set_xlim(x[0] - 0.02 * np.ptp(x), x[-1] + 0.02 * np.ptp(x))
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        return figure
