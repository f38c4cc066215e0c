"""A small model of how the car answers the wheel, learned from the recorded transitions, and transitions it imagines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit.block import Block, require
from steerkit.learning.state import StateDescription
from steerkit.learning.transitions import Transitions

Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class CarModel:
    now: float
    before: float
    drift: float
    yaw: float
    dt: float
    residuals: Array
    last: Array

    @classmethod
    def fit(cls, tr: Transitions, dt: float = 0.05, element: Any = None, limit: float = 9.07) -> CarModel:
        s, a, n = tr.s, tr.a, tr.s_next
        v = np.maximum(s[:, 2], 1.0)
        way = s[:, 1] / v - s[:, 3]
        turn = (n[:, 1] / np.maximum(n[:, 2], 1.0) - s[:, 1] / v) - dt * 0.5 * (s[:, 4] + n[:, 4])
        follows = np.zeros(len(s), dtype=bool)
        follows[1:] = tr.episode[1:] == tr.episode[:-1]
        last = s[:, 5].copy()
        last[1:][follows[1:]] = s[:-1, 5][follows[1:]]
        x = np.column_stack((n[:, 5], s[:, 5], last, way))
        k = follows if follows.sum() > 10 else slice(None)
        w = np.linalg.solve(x[k].T @ x[k] + 1e-3 * np.eye(4), x[k].T @ turn[k])
        p = x @ w
        dr = n[:, 4] - s[:, 4]
        vp = v * p
        yaw = float(vp @ dr / (vp @ vp + 1e-9))
        self = cls(now=w[:1], before=w[1:3], drift=float(w[3]), yaw=yaw, dt=dt, residuals=None, last=last)
        object.__setattr__(self, "residuals", n[:, :5] - self.step(s, n[:, 5], last))
        return self

    def step(self, s: Array, doe1: Array, last: Array) -> Array:
        """Next e, e_dot, v, psi_e, r_e."""
        e, e_dot, v, psi_e, r_e, doe = s.T
        v1 = np.maximum(v, 1.0)
        course = e_dot / v1
        p = self.now[0] * doe1 + self.before[0] * doe + self.before[1] * last + self.drift * (course - psi_e)
        r1 = r_e + self.yaw * v * p
        mean = 0.5 * (r_e + r1)
        c1 = course + p + self.dt * mean
        return np.column_stack((e + self.dt * v * 0.5 * (course + c1), v * c1, v, psi_e + self.dt * mean, r1))

    @property
    def shift(self) -> float:
        """d psi_e / d doe from one steady bend to another."""
        return (self.now[0] + self.before.sum()) / self.drift


def imagine(
    model: CarModel,
    tr: Transitions,
    actions: Any,
    d: StateDescription,
    doe: Block,
    count: int,
    rng: np.random.Generator,
    sig=(0.15, 0.08, 0.08, 1.0),
) -> Transitions:
    i = rng.integers(len(tr), size=count)
    s, sign = tr.s[i].copy(), rng.choice([-1.0, 1.0], count)
    res = model.residuals[i]
    signs = np.where(np.array(d.mirror_signs)[None, :] < 0, sign[:, None], 1.0)
    s *= signs
    res = res * signs[:, :5]
    # other speeds
    v0, v1 = tr.s[:, 2].min(), tr.s[:, 2].max()
    v = s[:, 2].copy()
    new_v = rng.uniform(min(4.0, v0), max(7.5, v1), count)
    s[:, 1] *= new_v / np.maximum(v, 1.0)
    s[:, 2] = new_v
    s[:, 0] += sig[0] * rng.standard_normal(count)
    s[:, 0] = np.clip(s[:, 0], -0.5, 0.5)
    turn = sig[1] * rng.standard_normal(count)
    s[:, 3] += turn
    s[:, 1] += s[:, 2] * turn
    s[:, 4] += sig[2] * rng.standard_normal(count)
    s[:, 5] += sig[3] * rng.standard_normal(count)
    limit = d.high[5]
    to = rng.uniform(-limit, limit, count) - s[:, 5]
    s[:, 5] += to
    s[:, 3] += model.shift * to
    a = rng.choice(np.array(actions), count)
    n = np.empty_like(s)
    n[:, :5] = model.step(s, a) + res
    n[:, 5] = doe.output(0.0, doe.init((count,))._replace(delta_sw=s[:, 5]), type("U", (), {"action": a})()).delta_sw
    out = Transitions(tr.names)
    out.extend(s, a, n, -1 - np.arange(count))
    return out
