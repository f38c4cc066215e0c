"""Frames of a drive: the car and its path from above, a map, and the cross-track error of the last seconds."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from steerkit.gym.task import Task
from steerkit.task import GOAL

WIDTH, HEIGHT = 720, 480
_FINE = 2  # drawn so many times larger, then smoothed
_STRIP = 120  # height of the strip of e
_SCALE = 30.0  # pixels a metre
_SECONDS = 10.0
_INK, _MUTED, _PAPER, _ROAD = "#24303c", "#8794a2", "#ffffff", "#eef1f4"
_GOAL, _LIMIT, _CAR, _GLASS = "#8fc3a0", "#b5382c", "#1f6fa8", "#dce8f1"


class Painter:
    """Paints one car of a task; keeps the last ten seconds of e."""

    def __init__(self, task: Task):
        self._task, self._path = task, task.path
        car: Any = task.loop.blocks["car"]
        vehicle = getattr(car, "vehicle", None)
        self._l_f = float(np.max(getattr(vehicle, "l_f", 1.2)))
        self._l_r = float(np.max(getattr(vehicle, "l_r", 1.5)))
        self._ratio = float(np.max(getattr(vehicle, "steer_ratio", 16.0)))
        self._limit = float(getattr(task.price, "trip", task.limit))
        self._goal = float(getattr(task.price, "goal", GOAL))
        self._history: deque[float] = deque(maxlen=round(_SECONDS / task.dt))
        self._now: Mapping[str, Any] = {}
        self._fonts = {size: ImageFont.load_default(size * _FINE) for size in (11, 13)}
        self._map = self._course()

    def begin(self, info: Mapping[str, Any]) -> None:
        """A new episode."""
        self._history.clear()
        self.add(info)

    def add(self, info: Mapping[str, Any]) -> None:
        """One sample: what an environment's `info` holds."""
        self._now = info
        self._history.append(float(info["e"]))

    def frame(self) -> NDArray[np.uint8]:
        """The picture of the last sample, (HEIGHT, WIDTH, 3)."""
        image = Image.new("RGB", (WIDTH * _FINE, HEIGHT * _FINE), _PAPER)
        draw = ImageDraw.Draw(image)
        if self._now:
            self._scene(draw)
            self._strip(draw)
            self._labels(draw, image)
        return np.asarray(image.reduce(_FINE))

    # ---- seen from above, the path's direction upwards -------------------------------------------------------

    def _scene(self, draw: ImageDraw.ImageDraw) -> None:
        now = self._now
        up = float(self._path.psi(now["s"]))
        s = np.round(4.0 * float(now["s"])) / 4.0 + np.arange(-14.0, 20.0, 0.25)
        if not self._path.closed:
            s = s[(s >= 0.0) & (s <= self._path.length)]
        xy, psi = self._path.point(s), self._path.psi(s)
        left = np.column_stack((-np.sin(psi), np.cos(psi)))
        at = np.array([now["x"], now["y"]])

        def seen(points: Any) -> list[tuple[float, float]]:
            """Pixels of points [m]: x to the right, y down."""
            d = np.atleast_2d(points) - at
            along, across = d @ (math.cos(up), math.sin(up)), d @ (-math.sin(up), math.cos(up))
            middle, bottom = 0.5 * WIDTH, 0.62 * (HEIGHT - _STRIP)
            pixels = np.column_stack((middle - _SCALE * across, bottom - _SCALE * along)) * _FINE
            return [(float(x), float(y)) for x, y in pixels]

        for width, colour in ((self._limit, _ROAD), (self._goal, "#cfe6d6")):
            draw.polygon([*seen(xy + width * left), *seen(xy - width * left)[::-1]], fill=colour)
        for side in (self._limit, -self._limit):
            draw.line(seen(xy + side * left), fill=_LIMIT, width=_FINE)
        draw.line(seen(xy), fill=_INK, width=_FINE)
        posts = np.abs(s / 5.0 - np.round(s / 5.0)) < 0.025 + 1e-9  # every five metres, so that speed shows
        for side in (-1.0, 1.0):
            for a, b in zip(
                seen((xy + side * (self._limit + 0.25) * left)[posts]),
                seen((xy + side * (self._limit + 0.6) * left)[posts]),
            ):
                draw.line([a, b], fill=_MUTED, width=2 * _FINE)
        psi_car = float(now["psi"])
        wheel = psi_car + float(now["delta_sw"]) / self._ratio if "delta_sw" in now else psi_car
        nose, tail = self._l_f + 0.85, -self._l_r - 0.95
        body = [(tail, -0.7), (tail + 0.2, -0.86), (nose - 0.5, -0.86), (nose, -0.55)]
        outline = np.array([*body, *[(x, -y) for x, y in body[::-1]]])
        draw.polygon(seen(at + _turned(outline, psi_car)), fill=_CAR, outline=_INK, width=_FINE)
        glass = [(0.55, -0.62), (1.15, -0.7), (1.15, 0.7), (0.55, 0.62)]
        draw.polygon(seen(at + _turned(np.array(glass), psi_car)), fill=_GLASS)
        for along, turn in ((self._l_f, wheel), (-self._l_r, psi_car)):
            for across in (-0.83, 0.83):
                hub = at + _turned(np.array([[along, across]]), psi_car)
                draw.polygon(seen(hub + _turned(_box(0.66, 0.24), turn)), fill=_INK)
        draw.line(seen(xy), fill=_GOAL, width=_FINE)
        spot = seen(at + _turned(np.array([[float(self._task.place.ahead), 0.0]]), psi_car))[0]
        _dot(draw, spot, 3.5 * _FINE, "#ffffff")

    # ---- e over the last seconds -----------------------------------------------------------------------------

    def _strip(self, draw: ImageDraw.ImageDraw) -> None:
        top, left, right = HEIGHT - _STRIP, 52, WIDTH - 14
        draw.rectangle([0, top * _FINE, WIDTH * _FINE, HEIGHT * _FINE], fill=_PAPER)
        draw.line([(0, top * _FINE), (WIDTH * _FINE, top * _FINE)], fill="#d5dbe1", width=_FINE)
        middle, half = top + 0.5 * _STRIP, 0.5 * _STRIP - 12

        def height(e: float) -> float:
            return (middle - half * max(-1.05, min(1.05, e / self._limit))) * _FINE

        draw.rectangle([left * _FINE, height(self._goal), right * _FINE, height(-self._goal)], fill="#e3f1e7")
        for e, colour in ((self._limit, _LIMIT), (0.0, "#c3cbd3"), (-self._limit, _LIMIT)):
            draw.line([(left * _FINE, height(e)), (right * _FINE, height(e))], fill=colour, width=_FINE)
            draw.text(((left - 6) * _FINE, height(e)), f"{e:+.1f}" if e else "0", _MUTED, self._fonts[11], anchor="rm")
        draw.text(((left + 6) * _FINE, (top + 21) * _FINE), "e [m], last 10 s", _MUTED, self._fonts[11], anchor="lm")
        step = (right - left) / (self._history.maxlen or 1)
        line = [((left + i * step) * _FINE, height(e)) for i, e in enumerate(self._history)]
        if len(line) > 1:
            draw.line(line, fill=_CAR, width=2 * _FINE, joint="curve")
        _dot(draw, line[-1], 3.0 * _FINE, _CAR)

    def _labels(self, draw: ImageDraw.ImageDraw, image: Image.Image) -> None:
        now, font = self._now, self._fonts[13]
        lines = [f"t = {now['t']:.2f} s", f"e = {now['e']:+.3f} m"]
        lines += [f"v = {now['v']:.1f} m/s"] if "v" in now else []
        lines += [f"wheel {math.degrees(now['delta_sw']):+.0f} deg"] if "delta_sw" in now else []
        for row, text in enumerate(lines):
            draw.text((14 * _FINE, (18 + 19 * row) * _FINE), text, _INK, font, anchor="lm")
        picture, dots = self._map
        corner = ((WIDTH - 14) * _FINE - picture.width, 12 * _FINE)
        image.paste(picture, corner)
        x, y = dots(float(now["x"]), float(now["y"]))
        _dot(draw, (corner[0] + x, corner[1] + y), 4.0 * _FINE, _LIMIT)

    def _course(self) -> tuple[Image.Image, Any]:
        """The course as a small map, and the function that finds a place on it."""
        xy = self._path.samples.xy
        low, size = xy.min(axis=0), np.maximum(np.ptp(xy, axis=0), 1.0)
        scale = min(150.0 / size[0], 110.0 / size[1]) * _FINE
        edge = 7 * _FINE
        width, height = (int(v) + 2 * edge for v in size * scale)
        picture = Image.new("RGB", (width, height), _PAPER)

        def spot(x: float, y: float) -> tuple[float, float]:
            return edge + (x - low[0]) * scale, height - edge - (y - low[1]) * scale

        ImageDraw.Draw(picture).line([spot(x, y) for x, y in xy.tolist()], fill=_MUTED, width=2 * _FINE, joint="curve")
        return picture, spot


def _turned(points: NDArray[np.float64], psi: float) -> NDArray[np.float64]:
    """Points (n, 2) of a frame turned by psi [rad]."""
    c, s = math.cos(psi), math.sin(psi)
    return points @ np.array([[c, s], [-s, c]])


def _box(length: float, width: float) -> NDArray[np.float64]:
    return 0.5 * np.array([(-length, -width), (length, -width), (length, width), (-length, width)])


def _dot(draw: ImageDraw.ImageDraw, at: tuple[float, float], radius: float, colour: str) -> None:
    draw.ellipse([at[0] - radius, at[1] - radius, at[0] + radius, at[1] + radius], fill=colour, outline=_INK)
