"""The film of a learning run, for a page's first screen: which controller steers, |e|, failures::

    film = film_of("runs/mine", "learning.gif")

The beginning, until the learner has the wheel again after its first failure, runs in real time; all after it, to the
first whole round or the run's end, is shown as fast as the film's length needs.
"""

from __future__ import annotations

import io
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.learning import rundir
from steerkit.learning.pictures.run import Record
from steerkit.plots.animation import CarShape, draw_path
from steerkit.plots.style import COLOURS, style
from steerkit.task import GOAL, TRIP

if TYPE_CHECKING:
    from PIL.Image import Image

SIZE = (6.0, 6.5)
"""Width and height at `DPI` dots an inch: with letters of 13 and more points it is read on a telephone, too."""
DPI = 100
NEAR, FAR = 11.0, 28.0
"""Half the width of what is seen around the car, slowly and fast [m]."""
STILL = 2.4
"""How long the last picture stands [s]."""
COLOURS_KEPT = 64
Array = NDArray[np.float64]


def film_of(place: str | FilePath, file: str | FilePath, *, lasts: float = 20.0, fps: float = 12.5) -> FilePath:
    """Write the film of a run directory to `file`, a .gif.

    lasts: how long it is, without the last picture's standing [s], 2 to 120. fps: pictures a second, 2 to 25.
    Returns the file. Raises ValueError for another ending, length or rate, and for what is no run directory.
    """
    file = FilePath(file)
    require(file.suffix == ".gif", "film", f"{file}: expected a name that ends in .gif")
    require(2.0 <= lasts <= 120.0, "film", f"lasts = {lasts} s, expected 2 to 120")
    require(2.0 <= fps <= 25.0, "film", f"fps = {fps}, expected 2 to 25")
    record = Record.read(place)
    done = rundir.document(FilePath(place))["counts"]["first_round_done"]
    require(len(record.log.t) >= 2, "film", f"{place}: nothing has been driven yet")
    until = float(record.log.t[-1]) if done is None else min(float(done), float(record.log.t[-1]))
    moments = zip(*moments_of(record, until, lasts, fps))
    with style():
        scene = _Scene(record, until, None if done is None else float(done))
        frames = [scene.picture(float(t), float(speed)) for t, speed in moments]
    file.parent.mkdir(parents=True, exist_ok=True)
    _write(frames, file, fps)
    return file


def moments_of(record: Record, until: float, lasts: float, fps: float) -> tuple[Array, Array]:
    """The driving time that each picture shows, and how many times faster than driven.

    The beginning in real time, if that takes no more than half of the film, the rest evenly.
    """
    learns, t = record.learning, record.log.t
    failed = float(t[record.failed_at[0]]) if len(record.failed_at) else None
    again = t[learns & (t > failed)] if failed is not None else t[:0]
    begin = min(until, (float(again[0]) if len(again) else 0.0) + 4.0)
    pictures = round(lasts * fps)
    slow = max(1.0, begin / (0.5 * lasts))
    first = np.arange(0.0, begin, slow / fps)
    rest = np.linspace(begin, until, max(2, pictures - len(first)))
    fast = max(1.0, (until - begin) / (lasts - begin / slow))
    return np.concatenate((first, rest)), np.repeat([slow, fast], [len(first), len(rest)])


class _Scene:
    """The picture, and what moves in it."""

    def __init__(self, record: Record, until: float, done: float | None):
        from matplotlib.figure import Figure

        self.record, self.until, self.done = record, until, done
        self.psi = np.unwrap(record.path.psi(record.log["path.s"]) + record.log["path.psi_e"])
        scenario = record.experiment.scenario
        car = scenario.nominal
        self.ratio = float(car.steer_ratio)
        self.figure = Figure(figsize=SIZE, dpi=DPI)
        self.view = self.figure.add_axes(
            (0.0, 0.24, 1.0, 0.6), xticks=[], yticks=[], aspect="equal", facecolor="#f6f7f8"
        )
        self.strip = self.figure.add_axes((0.13, 0.085, 0.84, 0.14))
        self.map = self.figure.add_axes((0.70, 0.59, 0.29, 0.24), xticks=[], yticks=[], aspect="equal")
        for side in self.map.spines.values():
            side.set_visible(True)
        self.view.grid(visible=False)
        self.map.grid(visible=False)
        draw_path(self.view, record.path)
        xy = record.path.samples.xy
        self.map.plot(*xy.T, color=COLOURS["muted"], lw=1.0)
        self.map.margins(0.08)
        self.trails = [axis.plot([], [], color=c, lw=2.4)[0] for axis in (self.view, self.map) for c in self.paint]
        (self.dot,) = self.map.plot([], [], "o", ms=8, mec="white")
        self.car = CarShape(self.view, float(car.wheelbase), float(car.l_f))
        self.who = self.figure.text(0.02, 0.975, "", fontsize=22, fontweight="bold", va="top")
        self.what = self.figure.text(0.02, 0.895, "", fontsize=14, va="top", color=COLOURS["ink"])
        self.fast = self.figure.text(0.02, 0.255, "", fontsize=13, color=COLOURS["ink"])
        self.window = NEAR
        self._draw_strip()

    paint = (COLOURS["learned"], COLOURS["analytic"])
    """Of the learner and of the recovery controller."""

    def _draw_strip(self) -> None:
        strip = self.strip
        strip.set(yscale="log", ylim=(0.002, 8.0), xlim=(0.0, max(self.until, 1.0)))
        strip.set_yticks([0.01, TRIP, 5.0], ["1 cm", "0.5 m", "5 m"], fontsize=12)
        strip.minorticks_off()
        strip.tick_params(axis="x", labelsize=12)
        strip.axhspan(0.002, GOAL, color=COLOURS["goal"], alpha=0.35, lw=0)
        strip.axhline(TRIP, color=COLOURS["limit"], lw=1.0, ls="--")
        words = "|e|; green: the goal, dashed: failure"
        strip.text(0.99, 0.95, words, transform=strip.transAxes, ha="right", va="top", fontsize=12)
        strip.set_xlabel("driving time [s]", fontsize=13, labelpad=1.0)
        self.lines = [strip.plot([], [], color=c, lw=1.6)[0] for c in self.paint]

    def picture(self, t: float, speed: float) -> Image:
        """What is seen at driving time t [s]."""
        from PIL import Image

        record, log = self.record, self.record.log
        k = max(0, int(np.searchsorted(log.t, t + 1e-9)) - 1)
        x, y, delta_sw = (float(np.interp(t, log.t, log[f"car.{key}"])) for key in ("x", "y", "delta_sw"))
        psi = float(np.interp(t, log.t, self.psi))
        learns = bool(record.learning[k])
        colour = self.paint[0 if learns else 1]
        failures = int((log.t[record.failed_at] <= t).sum())
        self.who.set(text=self._headline(t, learns, failures), color=colour)
        count = f"{failures} failure" + ("" if failures == 1 else "s")
        e = abs(float(log["path.e"][k]))
        error = f"{e:.2f} m" if e >= TRIP else f"{100.0 * e:.1f} cm"
        self.what.set_text(f"{t:.1f} s driven     |e| = {error}     {count}")
        self.fast.set_text("simulation, " + ("real time" if speed == 1.0 else f"{speed:.3g} times faster"))
        self._draw_past(k)
        self.dot.set_data([x], [y])
        self.dot.set_color(colour)
        self.car.place(x, y, psi, delta_sw / self.ratio)
        self.car.shapes[-1].set_facecolor(colour)
        self.window = NEAR if speed <= 2.0 else min(FAR, self.window + 1.0)  # widens while it becomes fast
        window = self.window
        tall = window * 0.6 * SIZE[1] / SIZE[0]
        self.view.set(xlim=(x - window, x + window), ylim=(y - tall, y + tall))
        buffer = io.BytesIO()
        self.figure.savefig(buffer, format="rgba", dpi=DPI)
        pixels = (round(SIZE[0] * DPI), round(SIZE[1] * DPI))
        return Image.frombytes("RGBA", pixels, buffer.getvalue()).convert("RGB")

    def _headline(self, t: float, learns: bool, failures: int) -> str:
        if self.done is not None and t >= self.done - 1e-6:
            return "A whole round, learned"
        if not learns:
            return "Failed: recovery drives" if failures else "Recovery drives"
        return "The learner drives" if failures else "The learner's first drive"

    def _draw_past(self, k: int) -> None:
        log, learns = self.record.log, self.record.learning[: k + 1]
        e = np.maximum(np.abs(log["path.e"][: k + 1]), 0.0025)
        x, y = log["car.x"][: k + 1], log["car.y"][: k + 1]
        for n, steers in enumerate((learns, ~learns)):
            joined = steers | np.append(False, steers[:-1])  # a line to where the other one begins
            self.lines[n].set_data(log.t[: k + 1], np.where(joined, e, np.nan))
            for trail in (self.trails[n], self.trails[n + 2]):
                trail.set_data(np.where(joined, x, np.nan), np.where(joined, y, np.nan))


def _write(frames: list[Image], file: FilePath, fps: float) -> None:
    """In one palette for all pictures, so that only what moves is stored."""
    from PIL import Image

    times: Any = [round(1000.0 / fps / 10.0) * 10] * (len(frames) - 1) + [round(1000.0 * STILL)]
    some = frames[:: max(1, len(frames) // 8)]
    sheet = Image.new("RGB", (frames[0].width, frames[0].height * len(some)))
    for n, frame in enumerate(some):
        sheet.paste(frame, (0, n * frame.height))
    palette = sheet.quantize(COLOURS_KEPT, dither=Image.Dither.NONE)
    flat = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    flat[0].save(file, save_all=True, append_images=flat[1:], duration=times, loop=0, optimize=True)
