"""A run as a film: the car, to scale, on its path, with the cross-track error running beside it. GIF or MP4."""

from collections.abc import Sequence
from pathlib import Path as File
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit._support.console import shown
from steerkit._support.errors import require
from steerkit.diagram.units import degrees_of
from steerkit.plots.style import COLOURS, style
from steerkit.task import GOAL, TRIP
from steerkit.vehicles import VW_PASSAT, Vehicle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from steerkit.diagram.simulation import Log
    from steerkit.paths.path import Path

LENGTH, WIDTH = 1.75, 0.66
"""Length and width of a car, in wheelbases: a VW Passat has 4.77 m and 1.82 m at 2.71 m."""
_WHEEL = (0.24, 0.085)
_WHO = ("learned", "analytic")  # colours of the learner, or of whoever drives alone, and of the recovery controller
_TALL = 0.56  # height of what is seen over its width
_LASTS = 15.0  # [s] the film


def film_writer(file: str | File) -> Any:
    """Matplotlib's writer for a film of that name: ask before a long drive whether its film can be written.

    Raises ValueError for another ending than .gif and .mp4, and for an MP4 without ffmpeg.
    """
    from matplotlib.animation import FFMpegWriter, PillowWriter

    kinds: dict[str, Any] = {".gif": PillowWriter, ".mp4": FFMpegWriter}
    ending = File(file).suffix
    require(ending in kinds, "animate", f"{file}: a film ends in {' or '.join(kinds)}")
    without = f"{file}: needs ffmpeg, which is not there; install it, or write a .gif"
    require(kinds[ending].isAvailable(), "animate", without)
    return kinds[ending]


def animate(
    log: "Log",
    path: "Path | None",
    file: str | File,
    *,
    vehicle: Vehicle = VW_PASSAT,
    fps: float = 12.0,
    moments: Sequence[float] | np.ndarray | None = None,
    progress: bool = False,
) -> File:
    """Write a film of a run to `file`: .gif (through Pillow) or .mp4 (through ffmpeg).

    log: with car.x, car.y, car.psi, and, if they are there, car.v, car.delta_sw, a tracker's e and whether a learner
    steers (supervisor.learning). path: what the car should follow, or None. vehicle: the car, where the log does not
    know its own. fps: pictures a second. moments: the time of each picture [s], two at least; default: even steps in
    real time, or faster for the film to last 15 s. Returns the file. Raises ValueError for another kind of file, a log
    without a car or of several, or an MP4 without ffmpeg.
    """
    film_file = File(file)
    film = film_writer(film_file)
    require(1.0 <= fps <= 60.0, "animate", f"fps = {fps}, expected 1 to 60")
    run = Moments.of_log(log)
    speed = max(1.0, (log.t[-1] - log.t[0]) / _LASTS)
    if moments is None:
        moments = np.arange(log.t[0], log.t[-1] + 1e-9, speed / fps)
    speeds = fps * np.diff(moments, prepend=2.0 * moments[0] - moments[1]) if len(moments) > 1 else [speed]
    plant = log.loop.blocks.get("car") if log.loop is not None else None
    vehicle = getattr(plant, "vehicle", vehicle)
    film_file.parent.mkdir(parents=True, exist_ok=True)
    with style():
        size = float(vehicle.wheelbase), float(vehicle.l_f), float(vehicle.steer_ratio)
        scene = Scene(run, path, *size, 18.0)
        writer = film(fps=fps)
        with writer.saving(scene.figure, str(film_file), dpi=80):
            for t, faster in shown([*zip(moments, speeds)], "film" if progress else ""):
                scene.show(float(t), float(faster))
                writer.grab_frame()
    return film_file


class Moments:
    """Signals of one car over time t (T,) [s], at any moment: x, y, psi; e, v, delta_sw and who steers, if known."""

    def __init__(self, t: np.ndarray, signals: dict[str, np.ndarray]):
        self.t, self.signals = t, {**signals, "psi": np.unwrap(signals["psi"])}

    @classmethod
    def of_log(cls, log: "Log") -> "Moments":
        """Those of a log of one car."""
        names = {key: f"car.{key}" for key in ("x", "y", "psi", "v", "delta_sw")}
        errors = [name for name in ("path.e", *log) if name.rpartition(".")[2] == "e" and name in log]
        names |= {"e": errors[0]} if errors else {}
        names |= {"learning": "supervisor.learning"}
        missing = [names[key] for key in ("x", "y", "psi") if names[key] not in log]
        require(not missing, "animate", f"the log lacks {', '.join(missing)}; recorded: {', '.join(log)}")
        require(len(log.t) >= 2, "animate", f"{len(log.t)} samples, expected two at least")
        signals = {key: log[name] for key, name in names.items() if name in log}
        require(signals["x"].ndim == 1, "animate", f"car.x is {signals['x'].shape}, a batch, expected a log of one car")
        return cls(log.t, signals)

    def at(self, t: float) -> dict[str, float]:
        """All signals at t [s], linear between samples."""
        return {key: float(np.interp(t, self.t, values)) for key, values in self.signals.items()}


class Scene:
    """The picture, and what moves in it."""

    def __init__(
        self, run: Moments, path: "Path | None", wheelbase: float, l_f: float, steer_ratio: float, window: float
    ):
        from matplotlib.figure import Figure

        self.run, self.window, self.ratio = run, window, steer_ratio
        self.figure = Figure(figsize=(7.2, 5.2), layout="constrained")
        view, strip = self.figure.subplots(2, height_ratios=(3.4, 1.0))
        self.view, self.strip = view, strip
        view.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
        self._look(run.at(run.t[0]))
        if path is not None:
            draw_path(view, path)
        self.trails = {who: view.plot([], [], color=COLOURS[who], lw=1.6, alpha=0.8)[0] for who in _WHO}
        self.car = CarShape(view, wheelbase, l_f)
        self.words = view.text(0.01, 0.98, "", transform=view.transAxes, va="top", color=COLOURS["ink"], zorder=9)
        self._draw_strip()
        self.figure.draw_without_rendering()
        self.figure.set_layout_engine(None)  # laid out once: the picture must not jump, and "none" would draw it twice

    def _look(self, now: dict[str, float]) -> None:
        self.view.set_xlim(now["x"] - self.window, now["x"] + self.window)
        self.view.set_ylim(now["y"] - _TALL * self.window, now["y"] + _TALL * self.window)

    def _draw_strip(self) -> None:
        run, strip = self.run, self.strip
        if "e" in run.signals:
            e = run.signals["e"]
            strip.axhspan(-GOAL, GOAL, color=COLOURS["goal"], alpha=0.35, lw=0)
            strip.plot(run.t, e, color=COLOURS["muted"], lw=0.7)
            self.lines = {who: strip.plot([], [], color=COLOURS[who], lw=1.3)[0] for who in _WHO}
            strip.set_ylim(*(np.array([-1.15, 1.15]) * max(0.06, float(np.nanmax(np.abs(e))))))
            if np.nanmax(np.abs(e)) > TRIP:
                strip.set_yscale("symlog", linthresh=0.1)  # failures beside centimetres
            strip.set_ylabel("e [m]")
        else:
            strip.set_yticks([])
        self.now = strip.axvline(run.t[0], color=COLOURS["ink"], lw=0.8)
        strip.set(xlim=(run.t[0], run.t[-1]), xlabel="t [s]")

    def show(self, t: float, speed: float) -> None:
        """Move everything to time t [s]."""
        run, now = self.run, self.run.at(t)
        x, y, psi = now["x"], now["y"], now["psi"]
        past = run.t <= t
        learns = run.signals["learning"][past] > 0.5 if "learning" in run.signals else np.ones(past.sum(), bool)
        for who, steers in zip(_WHO, (learns, ~learns)):
            drawn = steers | np.append(False, steers[:-1])  # a line to where the other one begins
            xy = [np.append(np.where(drawn, run.signals[key][past], np.nan), now[key]) for key in ("x", "y")]
            self.trails[who].set_data(*(xy if steers[-1] else [values[:-1] for values in xy]))
            if "e" in run.signals:
                self.lines[who].set_data(run.t[past], np.where(drawn, run.signals["e"][past], np.nan))
        self.car.place(x, y, psi, now.get("delta_sw", 0.0) / self.ratio)
        self._look(now)
        words = self._steering(learns) if "learning" in run.signals else []
        words += [f"t = {t:.1f} s" + ("" if abs(speed - 1.0) < 1e-6 else f"   (shown {speed:.3g} x)")]
        words += [f"v = {now['v']:.1f} m/s"] if "v" in now else []
        words += [f"wheel {degrees_of(now['delta_sw']):+.0f} deg"] if "delta_sw" in now else []
        words += [f"e = {now['e']:+.3f} m"] if "e" in now else []
        self.words.set_text("\n".join(words))
        self.now.set_xdata([t, t])

    def _steering(self, learns: np.ndarray) -> list[str]:
        """Who steers, and how often the learner has failed."""
        self.car.shapes[-1].set_facecolor(COLOURS[_WHO[0 if learns[-1] else 1]])
        failures = int((learns[:-1] & ~learns[1:]).sum())
        who = "the learner" if learns[-1] else "the recovery controller"
        return [f"{who} steers; {failures} failure" + ("" if failures == 1 else "s")]

    def pixels(self) -> np.ndarray:
        """The picture as it is now, (height, width, 3) uint8."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        canvas = FigureCanvasAgg(self.figure)
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()


def draw_path(axis: "Axes", path: "Path") -> None:
    """The path, and the limits of |e| beside it."""
    line = path.samples
    ends = [0] if path.closed else []
    xy = np.concatenate((line.xy, line.xy[ends]))
    left = np.column_stack((-np.sin(line.psi), np.cos(line.psi)))
    for side in (-TRIP, TRIP):
        edge = line.xy + side * left
        edge = np.concatenate((edge, edge[ends]))
        axis.plot(edge[:, 0], edge[:, 1], color=COLOURS["limit"], lw=0.7, ls="--", alpha=0.6)
    axis.plot(xy[:, 0], xy[:, 1], color=COLOURS["muted"], lw=1.0)


class CarShape:
    """A car to scale, seen from above, its front wheels turned as they are."""

    def __init__(self, axis: "Axes", wheelbase: float, l_f: float):
        from matplotlib.patches import Polygon

        rear = l_f - wheelbase
        middle, half, side = l_f - 0.5 * wheelbase, 0.5 * LENGTH * wheelbase, 0.5 * WIDTH * wheelbase
        self.body = _box(middle, half, side, nose=0.12 * wheelbase)
        self.wheels = [(x, s * 0.82 * side, front) for x, front in ((l_f, True), (rear, False)) for s in (-1.0, 1.0)]
        self.tyre = _box(0.0, 0.5 * _WHEEL[0] * wheelbase, 0.5 * _WHEEL[1] * wheelbase)
        ink, body = COLOURS["ink"], COLOURS["learned"]
        self.shapes = [Polygon(self.tyre, fc=ink, lw=0, zorder=6.5) for _ in self.wheels]
        self.shapes.append(Polygon(self.body, fc=body, ec=ink, lw=0.8, alpha=0.7, zorder=6))
        for shape in self.shapes:
            axis.add_patch(shape)

    def place(self, x: float, y: float, psi: float, delta: float) -> None:
        """Move it: centre of gravity x, y [m], yaw psi [rad], road-wheel angle delta [rad]."""
        from matplotlib.transforms import Affine2D

        car = Affine2D().rotate(psi).translate(x, y)
        for shape, (along, across, front) in zip(self.shapes, self.wheels):
            wheel = Affine2D().rotate(delta if front else 0.0).translate(along, across) + car
            shape.set_xy(wheel.transform(self.tyre))
        self.shapes[-1].set_xy(car.transform(self.body))


def _box(middle: float, half: float, side: float, nose: float = 0.0) -> np.ndarray:
    """Corners of a box along x, its front corners cut by `nose`."""
    front, back, cut = middle + half, middle - half, side - 0.6 * nose
    left = np.array([(front, cut), (front - nose, side), (back, side)])
    return np.vstack((left[::-1] * (1.0, -1.0), left))
