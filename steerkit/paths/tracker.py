"""Where is the car along the path, and how far off: the block between a plant's pose and a controller's errors."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from steerkit._support.errors import number, require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.paths.path import Path
from steerkit.task import DT

_LEAST_SLOPE = 0.2  # floor of 1 - kappa*e: keeps a step downhill even beyond the centre of a bend
_STEPS_OF_SYMBOLS = 6  # three do within a metre or two of the given place
_CARS_AT_ONCE = 256  # of a batch, when looking over the whole path


@dataclass(frozen=True, eq=False, kw_only=True)
class PathTracker(Block):
    """Path coordinates of a reference point on the car, by Newton steps from where it was expected.

    With p = (x, y) + reference*(cos psi, sin psi), the foot point c(s) solves (p - c(s)) . c'(s) = 0:

        s <- s + (p - c).c' / max(1 - kappa*e, 0.2)           twice a sample, each step within +-window
        e = cross(c', p - c),  psi_e = wrap(psi - psi_path(s)),  r_e = r - v*kappa
        e_dot = v sin(psi_e + beta) + r*reference*cos(psi_e)  velocity of p along the path's left normal
        s(t + dt) ~ s + dt*(v cos(psi_e + beta) - r*reference*sin(psi_e))/(1 - kappa*e)   where the next search starts

    so that it follows its own stretch where others run close by. On the built-in courses, at |e| <= 2 m, the error in
    s after the two steps is below 1e-10 m for a start 5 cm off and 1e-5 m for 1 m. Beyond the ends of an open path, s
    stays there and e is measured from the tangent, as if it went on straight; kappa stays the end's.

    inputs: x, y [m], psi [rad] (any turn), v [m/s] speed of the centre of gravity, beta [rad], r [rad/s].
    outputs: s [m] in [0, length]; progress [m] since the start, not wrapped; e [m], + = left; e_dot [m/s];
    psi_e [rad] in [-pi, pi]; kappa [1/m] at s; r_e [rad/s]; preview [1/m], `preview_points` curvatures at
    s + j*v*preview_dt, j = 0, 1, ... state: s, progress [m] expected at the next sample.
    valid: e up to the centre of the bend (kappa*e < 1), a sample's unforeseen motion below 2*window, its motion below
    a round (the search then starts where it was). A NaN in the pose gives NaN in e, while s stays a place on the path.
    errors: ValueError for bad parameters and, in `settle`, for a pose that is not finite.
    source: Hoffmann et al. 2007 (e and psi_e of Stanley); Wang, Kearney, Atkinson 2002 (Newton on the foot point).

    path: the path. reference [m]: how far ahead of the centre of gravity e is measured (l_f: front axle). window [m]:
    longest step of the search, a round at most. preview_points, preview_dt [s]: the preview. dt [s]: sample time.
    """

    x = In("m")
    y = In("m")
    psi = In("rad")
    v = In("m/s")
    beta = In("rad")
    r = In("rad/s")

    s = Out("m", direct=(x, y, psi))
    progress = Out("m", direct=(x, y, psi))
    e = Out("m", direct=(x, y, psi))
    e_dot = Out("m/s")
    psi_e = Out("rad", direct=(x, y, psi))
    kappa = Out("1/m", direct=(x, y, psi))
    r_e = Out("rad/s", direct=(x, y, psi, v, r))
    preview = Out("1/m", size="preview_points", direct=(x, y, psi, v))

    path: Path
    reference: Scalar = number(0.0, "m", low=-1e3, high=1e3)
    window: float = number(1.0, "m", above=0.0)
    preview_points: int = number(0, low=0)
    preview_dt: float = number(DT, "s", above=0.0, high=3600.0)

    class X(NamedTuple):
        s: Scalar
        progress: Scalar

    def __post_init__(self) -> None:
        super().__post_init__()
        where = "PathTracker"
        require(isinstance(self.path, Path), where, f"path is a {type(self.path).__name__}, expected a steerkit Path")
        fits = not self.path.closed or self.window <= self.path.length
        require(fits, where, f"window {self.window} [m], expected at most a round of {self.path!r}")

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return self.X(np.zeros(batch), np.zeros(batch)) if batch else self.X(0.0, 0.0)

    def settle(self, t: float, x: Any, u: Any) -> State:
        """The nearest place of the whole path; a heading against it counts as up to sqrt(2) m of distance. For symbols,
        which cannot be compared with all of it, the place near x.s."""
        px, py = u.x + self.reference * m.cos(u.psi), u.y + self.reference * m.sin(u.psi)
        if m.is_symbol(px):
            s = x.s
            for _ in range(_STEPS_OF_SYMBOLS):
                s = self.path.inside(s + self._step(s, px, py, self.path.frame(s)))
            return self.X(s, 0.0)
        pose = np.broadcast_arrays(*(np.atleast_1d(np.asarray(a, dtype=float)) for a in (px, py, u.psi)))
        lost = np.flatnonzero(~np.isfinite(pose).all(axis=0))
        whose = f"pose x, y [m], psi [rad] of car {', '.join(map(str, lost[:5]))} at the start"
        require(not lost.size, "PathTracker", f"{whose}, expected finite numbers; check what drives x, y and psi")
        cars = len(pose[0])
        groups = [slice(k, k + _CARS_AT_ONCE) for k in range(0, cars, _CARS_AT_ONCE)]
        s = np.concatenate([self._nearest(*(a[group] for a in pose)) for group in groups])
        for _ in range(20):  # four or five do, unless the car is near the centre of a bend
            before, s = s, self.path.inside(s + self._step(s, pose[0], pose[1], self.path.frame(s)))
            if (s == before).all():  # and would stay there
                break
        return self.X(s, np.zeros(cars)) if any(map(np.ndim, (px, py, u.psi))) else self.X(float(s[0]), 0.0)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        path, reference, v = self.path, self.reference, u.v
        cos_psi, sin_psi = m.cos(u.psi), m.sin(u.psi)
        px, py = u.x + reference * cos_psi, u.y + reference * sin_psi
        first = self._step(x.s, px, py, path.frame(x.s))
        s = path.back(x.s + first)
        frame = path.frame(s)
        second = self._step(s, px, py, frame)
        cx, cy, tx, ty, ddx, ddy = frame
        kappa = tx * ddy - ty * ddx
        # the second step is tiny: move the foot point by its Taylor series and save a table look-up
        half = 0.5 * second
        ex = px - cx - second * (tx + half * ddx)
        ey = py - cy - second * (ty + half * ddy)
        tx = tx + second * ddx
        ty = ty + second * ddy
        s = path.back(s + second)
        cos_e = tx * cos_psi + ty * sin_psi
        psi_e = m.atan2(tx * sin_psi - ty * cos_psi, cos_e)
        return self.Y(
            s,
            x.progress + (first + second),
            tx * ey - ty * ex,
            v * m.sin(psi_e + u.beta) + u.r * reference * cos_e,
            psi_e,
            kappa,
            u.r - v * kappa,
            self._ahead(s, v) if self.preview_points else (),
        )

    def update(self, t: Any, x: Any, u: Any, y: Any) -> State:
        along = u.v * m.cos(y.psi_e + u.beta) - u.r * self.reference * m.sin(y.psi_e)
        ahead = self.dt * along / m.maximum(_LEAST_SLOPE, 1.0 - y.kappa * y.e)
        ahead = self._on_path(y.s, m.where(m.absolute(ahead) <= self.path.length, ahead, 0.0))
        return self.X(self.path.back(y.s + ahead), y.progress + ahead)

    def _ahead(self, s: Scalar, v: Scalar) -> tuple[Scalar, ...]:
        stride = self.preview_dt * m.where(m.is_finite(v), v, 0.0)  # a broken speed shows in e_dot
        return tuple([self.path.kappa(s + j * stride) for j in range(self.preview_points)])

    def _step(self, s: Scalar, px: Scalar, py: Scalar, frame: tuple[Scalar, ...]) -> Scalar:
        """One Newton step towards the foot point [m]; in this order of arguments a NaN becomes -window."""
        cx, cy, tx, ty, ddx, ddy = frame
        ex, ey = px - cx, py - cy
        step = (ex * tx + ey * ty) / m.maximum(_LEAST_SLOPE, 1.0 - ex * ddx - ey * ddy)
        step = m.minimum(self.window, m.maximum(-self.window, step))
        return step if self.path.closed else self._on_path(s, step)

    def _on_path(self, s: Scalar, step: Scalar) -> Scalar:
        return step if self.path.closed else m.clip(s + step, 0.0, self.path.length) - s

    def _nearest(self, px: Any, py: Any, psi: Any) -> Any:
        """The best knot of the path for each car [m]."""
        knots = self.path.samples
        distance = (px[:, None] - knots.xy[:, 0]) ** 2 + (py[:, None] - knots.xy[:, 1]) ** 2
        return knots.s[np.argmin(distance + 1.0 - np.cos(psi[:, None] - knots.psi), axis=1)]
