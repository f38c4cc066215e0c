"""A small learned residual beside Pacejka tyres: accelerations by ridge regression, checked on held-out parts."""

import math
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.special import stdtrit

from steerkit._support.errors import require
from steerkit.identification.ahead import HORIZONS, MEMORY
from steerkit.identification.tyres import Scene, Tyres
from steerkit.logs.drive import Array, Drive

LASTS = 2.0
"""With this time constant what the last half second showed dies out [s]."""
BLOCKS, STARTS = 8, 1500
"""Parts of the log that are held out in turn; starts at most."""
_RIDGES = (math.inf, 1.0, 0.1, 0.01)  # of what depends on the state; first: nothing does
_PERSISTS = 1e-3  # ridge of the model's own error before
_QUANTILE, _NUDGE = 0.99, 1e-4


@dataclass(frozen=True, eq=False, kw_only=True)
class Residual:
    """The outcome of `learn_residual`."""

    tyres: Tyres
    weights: Array
    """(2, k), times `features`: v_y' [m/s^2] and r' [rad/s^2]."""
    share: float
    """Of the correction that is made, 0 to 1: the lower 95 % bound of the share that served held-out parts best."""
    weighed: NDArray[np.bool_]
    """Which features enter, and v_x (k + 1,)."""
    centre: Array
    spread: Array
    """Middle and inverse covariance of what it was trained on, features and v_x at the starts, left and right alike."""
    reach: float
    """Distance, in that covariance, within which 99 % of it was."""
    gain: dict[str, float]
    """RMS error half a second ahead over that of the tyres alone, by quantity, on parts of the log held out in turn."""

    def fade(self, scene: Scene, starts: NDArray[np.intp], before: Array) -> Array:
        """1 within its data, then by the square of the distance less, so that corrections shrink too (N,)."""
        distance = _distance(_at(scene, starts, before) * self.weighed, self.centre, self.spread)
        return np.asarray(np.minimum(1.0, self.reach / np.maximum(distance, 1e-9)) ** 2)

    def ahead(self, scene: Scene, starts: NDArray[np.intp], n: int) -> Array:
        """(v_y, r) (2, n + 1, N) as `Tyres.ahead`, with the residual; starts have `MEMORY` of driving before them."""
        before = missed(self.tyres, scene, starts)
        scale = self.share * self.fade(scene, starts, before)

        def slopes(t: float, v_x: Any, delta: Any, v_y: Any, r: Any) -> tuple[Any, Any]:
            more = scale * np.tensordot(self.weights, features(before * math.exp(-t / LASTS), v_x, delta, v_y, r), 1)
            own = self.tyres.slopes(t, v_x, delta, v_y, r)
            return own[0] + more[0], own[1] + more[1]

        return self.tyres.ahead(scene, starts, n, slopes)


def features(before: Array, v_x: Any, delta: Any, v_y: Any, r: Any) -> Array:
    """What the residual is linear in (k, ...): all change sign with the side, so it has no side of its own.

    before: the errors (2, ...) with which the last half second ended, v_y [m/s] and r [rad/s].
    """
    return np.stack(
        [before[0] + 0.0 * r, before[1] + 0.0 * r, v_y, r, delta, v_x * r, v_x * delta, abs(v_x * r) * delta]
    )


def missed(tyres: Tyres, scene: Scene, starts: NDArray[np.intp]) -> Array:
    """Measured less predicted (2, N) at the starts, predicted from half a second before; of a v_y not measured 0."""
    back = round(MEMORY / scene.dt)
    error = scene.motion[:, starts] - tyres.ahead(scene, starts - back, back)[:, -1]
    return error * np.array([[scene.seen], [True]])


def _at(scene: Scene, starts: NDArray[np.intp], before: Array) -> Array:
    now = features(before, scene.v_x[starts], scene.delta[starts], *scene.motion[:, starts])
    return np.vstack((now, scene.v_x[starts])).T


def _distance(at: Array, centre: Array, spread: Array) -> Array:
    return np.sqrt(np.einsum("ni,ij,nj->n", at - centre, spread, at - centre))


def learn_residual(tyres: Tyres, drive: Drive) -> Residual:
    """Accelerations beside those of the tyres, learned from the same drive in seconds; never more than is confirmed.

        (v_y', r') = tyres + share fade W features,

    W minimises the errors of v_y, r and lateral displacement 0.2, 0.5, 1 and 2 s ahead of many starts, linearised about
    the tyres' roll-out, by ridge regression. Two features are what the last half second showed; those of the state, and
    the share, are chosen on eighths of the drive held out in turn: the state enters where all three get better with
    95 % confidence, the share is the lower 95 % bound of the best one, and 0 where one of the three gets worse, half a
    second ahead or over all. White noise in v_y and r makes it a filter too: what was predicted corrects the start.

    Raises ValueError for a drive with less than eight seconds in a row of 1.5 s. Source: Hoerl, Kennard 1970.
    """
    scene, dt = tyres.scene(drive), drive.dt
    back, n = round(MEMORY / dt), round(HORIZONS[-1] / dt)
    usable = drive.driving & np.isfinite(scene.motion).all(axis=0)
    through = np.convolve(usable, np.ones(back + n + 1), mode="valid")
    starts = np.flatnonzero(through > back + n + 0.5) + back
    enough = len(starts) * dt
    require(enough >= BLOCKS, drive.name, f"{enough:.0f} s to learn a residual from, expected {BLOCKS} s or more")
    starts = starts[:: math.ceil(len(starts) / STARTS)]
    before, way = missed(tyres, scene, starts), tyres.ahead(scene, starts, n)
    error: Array = scene.motion[:, starts + np.arange(n + 1)[:, None]] - way  # (2, n + 1, N)
    effect, v_x = _effects(tyres, scene, starts, way, before), scene.v_x[starts]
    error, effect = _with_lateral(error, v_x, dt), _with_lateral(effect, v_x[:, None], dt)
    quantities = {"v_y": 0, "r": 1, "lateral": 2} if scene.seen else {"r": 1}
    ends = np.ix_(list(quantities.values()), [round(horizon / dt) for horizon in HORIZONS])
    error, effect = error[ends], effect[ends]
    size = np.sqrt(np.mean(error**2, axis=-1, keepdims=True)) + 1e-12
    error, effect = error / size, effect / size[..., None]
    parts = np.array_split(np.arange(len(starts)), BLOCKS)
    gap = math.ceil((back + n) / (starts[1] - starts[0]))
    k = effect.shape[-1] // 2
    scale = np.sqrt(np.mean(effect**2, axis=(0, 1, 2))) + 1e-12
    effect = effect / scale
    state = np.tile(np.arange(k) >= 2, 2)

    def solved(rows: NDArray[np.intp], ridge: float) -> Array:
        x, y = effect[:, :, rows].reshape(-1, 2 * k), error[:, :, rows].ravel()
        free = np.flatnonzero(~state | math.isfinite(ridge))
        penalty = len(y) * np.where(state, min(ridge, 1e9), _PERSISTS)[free]
        weights = np.zeros(2 * k)
        weights[free] = np.linalg.solve(x[:, free].T @ x[:, free] + np.diag(penalty), x[:, free].T @ y)
        return weights

    sure, chosen, left = float(stdtrit(BLOCKS - 1, 0.95)), math.inf, np.zeros(0)
    for ridge in _RIDGES:
        said = np.empty_like(error)
        for part in parts:
            others = np.concatenate((np.arange(max(0, part[0] - gap)), np.arange(part[-1] + gap, len(starts))))
            said[..., part] = effect[:, :, part] @ solved(others, ridge)
        costs = np.array([np.sum((error - said)[..., part] ** 2, axis=(1, 2)) for part in parts])  # (parts, quantities)
        better = left - costs if len(left) else costs
        if not len(left) or (better.mean(axis=0) > sure * better.std(axis=0, ddof=1) / math.sqrt(BLOCKS)).all():
            chosen, left, kept = ridge, costs, said
    along, square = (np.array([np.sum((a * kept)[..., part]) for part in parts]) for a in (error, kept))
    without = (along.sum() - along) / np.maximum(square.sum() - square, 1e-300)
    deviation = math.sqrt((BLOCKS - 1) * float(np.var(without)))
    share = float(np.clip(along.sum() / max(square.sum(), 1e-300) - sure * deviation, 0.0, 1.0))
    after = (error - share * kept) ** 2
    at = HORIZONS.index(0.5)
    ratio = np.sqrt(np.mean(after[:, at], axis=1) / np.mean(error[:, at] ** 2, axis=1))
    if (ratio > 1.0).any() or (np.sum(after, axis=(1, 2)) > np.sum(error**2, axis=(1, 2))).any():
        share, ratio = 0.0, np.ones(len(ratio))
    weighed = np.append(~state[:k] | math.isfinite(chosen), True)
    seen = _at(scene, starts, before) * weighed
    centre = np.append(np.zeros(k), seen[:, -1].mean())  # left and right are alike
    moments = (seen - centre).T @ (seen - centre) / len(seen)
    moments[:k, k] = moments[k, :k] = 0.0
    spread = np.linalg.pinv(moments, rcond=1e-8, hermitian=True)
    return Residual(
        tyres=tyres,
        weights=(solved(np.arange(len(starts)), chosen) / scale).reshape(2, k),
        share=share,
        weighed=weighed,
        centre=centre,
        spread=spread,
        reach=float(np.quantile(_distance(seen, centre, spread), _QUANTILE)),
        gain=dict(zip(quantities, map(float, ratio))),
    )


def _with_lateral(ways: Array, v_x: Array, dt: float) -> Array:
    """(3, n + 1, ...): of v_y and r (2, n + 1, ...) the lateral displacement too, to first order [m]."""
    turned = cumulative_trapezoid(ways[1], dx=dt, axis=0, initial=0.0)
    aside = cumulative_trapezoid(ways[0] + v_x * turned, dx=dt, axis=0, initial=0.0)
    return np.concatenate((ways, aside[None]))


def _effects(tyres: Tyres, scene: Scene, starts: NDArray[np.intp], way: Array, before: Array) -> Array:
    """By how much each weight moves v_y and r (2, n + 1, N, 2 k): implicit Euler steps, linearised about the way."""
    n = way.shape[1] - 1
    v_x, delta = scene.v_x[starts], scene.delta[starts + np.arange(n + 1)[:, None]]
    k = len(features(before, v_x, delta[0], *way[:, 0]))
    moved: list[Array] = [np.zeros((len(starts), 2, 2 * k))]
    for j in range(1, n + 1):
        t = j * scene.dt
        slopes = partial(tyres.slopes, t, v_x, delta[j])
        v_y, r = way[:, j]
        here = np.array(slopes(v_y, r))
        tangent = np.stack(
            (np.array(slopes(v_y + _NUDGE, r)) - here, np.array(slopes(v_y, r + _NUDGE)) - here), axis=-1
        )
        pushed = moved[-1].copy()
        rows = scene.dt * features(before * math.exp(-t / LASTS), v_x, delta[j], v_y, r).T
        pushed[:, 0, :k] += rows
        pushed[:, 1, k:] += rows
        moved.append(np.linalg.solve(np.eye(2) - scene.dt / _NUDGE * np.swapaxes(tangent, 0, 1), pushed))
    return np.moveaxis(np.array(moved), 2, 0)
