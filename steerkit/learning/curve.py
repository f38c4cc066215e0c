"""How well a learning run drives, over driving time: what its progress on a terminal and its live page draw."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from steerkit._support.errors import require
from steerkit.learning.counts import Counts
from steerkit.task import DT

Array = NDArray[np.float64]


class Stretches(NamedTuple):
    """What happened between edges in time: arrays, one number a stretch."""

    rms_e: Array
    """RMS of e while the learner steered [m]; NaN where it did not."""
    share: Array
    """Share of the driving time in which the learner steered; NaN where nothing was driven yet."""
    failures: Array
    """Failures in it."""


class Curve:
    """What a learner has done so far, as totals over driving time; any stretch of it is a difference of two.

    Add totals in the order of time, as often as the picture is to be fine. period: of the learner's samples [s].
    """

    def __init__(self, period: float = DT) -> None:
        self.period = period
        self._rows: list[tuple[float, float, float, float]] = [(0.0, 0.0, 0.0, 0.0)]

    @classmethod
    def of_drive(cls, t: Array, learns: NDArray[np.bool_], e: Array, failed: Array, *, period: float = DT) -> Curve:
        """Of a recorded drive, a total a second.

        t [s], does the learner steer, e [m]: (n,), one a sample. failed: the times at which it failed [s].
        """
        curve = cls(period)
        samples, sum_e2 = np.cumsum(learns), np.cumsum(np.where(learns, e**2, 0.0))
        seconds = np.arange(1.0, t[-1] + 1.0) if len(t) else np.array([])
        for k in np.unique(np.minimum(np.searchsorted(t, seconds), len(t) - 1)):
            if t[k] > curve.t:
                failures = float((failed <= t[k]).sum())
                curve.add(float(t[k]), samples=float(samples[k]), sum_e2=float(sum_e2[k]), failures=failures)
        return curve

    @property
    def t(self) -> float:
        """Driving time until which it goes [s]."""
        return self._rows[-1][0]

    def add(self, t: float, *, samples: float, sum_e2: float, failures: float) -> None:
        """The totals at driving time t [s]: the learner's samples, their sum of e^2 [m^2], and its failures.

        Raises ValueError for a time that is not later than the one before.
        """
        require(t > self.t, "Curve", f"t = {t:g} s, expected > {self.t:g} s, the one before")
        self._rows.append((t, samples, sum_e2, failures))

    def add_counts(self, t: float, counts: Counts) -> None:
        """The totals that a run has counted, at driving time t [s]."""
        samples = sum(episode.samples for episode in counts.episodes)
        self.add(t, samples=samples, sum_e2=sum(one.sum_e2 for one in counts.episodes), failures=counts.failures)

    def over(self, edges: ArrayLike) -> Stretches:
        """What happened between each edge [s] and the next."""
        edges = np.asarray(edges, dtype=float)
        return self.between(edges[:-1], edges[1:])

    def between(self, began: ArrayLike, ended: ArrayLike) -> Stretches:
        """What happened from each of `began` to each of `ended` [s]; between two totals, as much in every second."""
        edges = np.array([began, ended], dtype=float)
        t, *totals = np.array(self._rows).T
        samples, sum_e2 = (np.diff(np.interp(edges, t, total), axis=0)[0] for total in totals[:2])
        failures = np.diff(np.floor(np.interp(edges, t, totals[2]) + 1e-9), axis=0)[0]
        driven = np.diff(np.minimum(edges, self.t), axis=0)[0]
        some = samples > 0.5
        rms_e = np.sqrt(np.divide(sum_e2, samples, out=np.full(len(samples), np.nan), where=some))
        share = np.divide(self.period * samples, driven, out=np.full(len(samples), np.nan), where=driven > 0.0)
        return Stretches(rms_e, np.minimum(share, 1.0), failures)
