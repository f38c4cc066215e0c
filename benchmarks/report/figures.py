"""The report's pictures: matplotlib figures as SVG that takes its colours and letters from the page around it."""

import io
import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from steerkit.plots.style import COLOURS, PALETTE, new_figure, style
from steerkit.task import GOAL, TRIP

WIDTH = 4.6
"""Width of a picture [in]: it fits a phone, and two or three stand side by side on a desk."""
MOST_DOTS = 150
"""No controller gets more dots than these in one plot."""
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


def new(height: float, *, width: float = WIDTH, square: bool = False) -> tuple[Figure, Axes]:
    """A figure with one panel [in]."""
    figure, (axes,) = new_figure(1, width=width, height=height)
    if square:
        axes.set_aspect("equal", adjustable="datalim")
    return figure, axes


def dots(
    values: Mapping[str, np.ndarray],
    middle: Mapping[str, tuple[float, float, float]],
    look: Mapping[str, Look],
    *,
    limit: float | None,
) -> Figure:
    """One metric: a dot a case, a bar for the median's interval and a tick for the median, one row a controller.

    values: by controller, of which the finite ones are drawn. middle: (median, low, high), infinite ones left out.
    """
    with style():
        height, left = 0.42 + 0.24 * len(values), 0.16 + 0.073 * max(map(len, values))
        figure, axes = new(height)
        figure.set_layout_engine(None)  # known margins: solving for them takes as long as drawing
        axes.set_position((left / WIDTH, 0.3 / height, 1.0 - (left + 0.16) / WIDTH, 1.0 - 0.36 / height))
        rng = np.random.default_rng(0)
        finite = np.concatenate([v[np.isfinite(v)] for v in values.values()] or [np.zeros(0)])
        positive = finite[finite > 0.0]
        if len(positive) and len(positive) == len(finite) and positive.max() > 25.0 * positive.min():
            axes.set_xscale("log")
            _plain_numbers(axes.xaxis, positive.max() / positive.min())
        for row, (name, numbers) in enumerate(values.items()):
            shown = numbers[np.isfinite(numbers)]
            if len(shown) > MOST_DOTS:  # as many of their quantiles, or the page grows with every case
                shown = np.quantile(shown, np.linspace(0.0, 1.0, MOST_DOTS))
            shift = rng.uniform(-0.22, 0.22, len(shown))
            axes.plot(shown, row + shift, "o", ms=3.2, mew=0, alpha=0.45, color=look[name].colour)
            centre, low, high = middle[name]
            if math.isfinite(low) and math.isfinite(high):
                axes.plot([low, high], [row, row], color=look[name].colour, lw=2.4, solid_capstyle="butt")
            if math.isfinite(centre):
                axes.plot([centre], [row], "|", ms=11, mew=2.0, color=look[name].colour)
        if limit is not None and len(finite) and finite.max() > 0.4 * limit:
            axes.axvline(limit, color=COLOURS["limit"], lw=0.9, ls="--")
        axes.set_yticks(range(len(values)), list(values))
        axes.set_ylim(len(values) - 0.5, -0.5)
        axes.grid(axis="y", visible=False)
        if axes.get_xscale() == "linear":
            axes.ticklabel_format(axis="x", useOffset=False)
            axes.locator_params(axis="x", nbins=6)
            low, high = axes.get_xlim()
            if high - low < 1e-3 * max(abs(low), abs(high), 1e-6) or not len(finite) or np.ptp(finite) == 0.0:
                at = float(np.mean(finite)) if len(finite) else 0.0
                axes.set_xlim(at - max(0.5 * abs(at), 0.1), at + max(0.5 * abs(at), 0.1))
        return figure


def _plain_numbers(axis: Axis, span: float = 1.0) -> None:
    """On a logarithmic axis: 0.1, 0.2, 0.5 instead of powers of ten; the fewer, the larger the ratio `span`."""
    subs = (1.0, 2.0, 5.0) if span < 40.0 else (1.0, 3.0) if span < 500.0 else (1.0,)
    axis.set_major_locator(LogLocator(subs=subs, numticks=10))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter(NullFormatter())


def course_map(drives: Mapping[str, Mapping[str, np.ndarray]], look: Mapping[str, Look], magnified: float) -> Figure:
    """Where each controller drove, its distance from the path drawn `magnified` times; grey is the path itself."""
    with style():
        figure, axes = new(3.9, width=5.4, square=True)
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
        figure, axes = new(3.9, width=5.4)
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
        figure, axes = new(2.9)
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
            _plain_numbers(axes.yaxis)
            if highest:
                axes.set_ylim(top=2.0 * highest)
        elif highest:
            axes.set_ylim(0.0, 1.15 * highest)
        if len(x) > 1:
            axes.set_xlim(x[0] - 0.02 * np.ptp(x), x[-1] + 0.02 * np.ptp(x))
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        return figure
