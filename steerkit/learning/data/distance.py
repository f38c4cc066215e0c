"""How far from the data of a run a drive is: what a policy does there, nothing recorded tells."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit.controllers.policy import COLUMNS, StateDescription
from steerkit.diagram.maths import Array
from steerkit.diagram.simulation import Log
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.model import SPREAD

REACH = 2.0 * SPREAD
"""Distance up to which states are imagined about the recorded ones: see `steerkit.learning.nfq.model.imagine`."""
SIGNALS = dict(zip(COLUMNS, ("path.e", "path.e_dot", "car.v", "path.psi_e", "path.r_e", "doe.state"), strict=True))
"""Column -> signal of a drive's log."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Distance:
    """Distances of a drive's samples to the nearest recorded state, or its mirror image, and shares outside the ranges.

        d_k = min_i max_j |s_kj - s_ij|/half_j,   half: the half-ranges that a net sees as 1

    Source: Cover, Hart 1967 (nearest neighbour).
    """

    d: Array
    """Of each sample (n,) [1]."""
    by: Array
    """Number of the column that makes it (n,)."""
    outside: Mapping[str, float]
    """Share of the samples with that column beyond all recorded values [1]."""

    @classmethod
    def of(cls, s: Array, record: Transitions, description: StateDescription) -> "Distance":
        """That of states s (n, columns) to recorded ones. Raises ValueError for no record."""
        from scipy.spatial import cKDTree  # loads as slowly as all else that a drive needs

        require(len(record) > 0, "Distance", "no transitions were recorded, expected at least one")
        known, half = record.s[:, : len(COLUMNS)], description.half
        known = np.vstack((known, known * np.array(description.mirror_signs)))
        d, nearest = cKDTree(known / half).query(s / half, p=np.inf)
        by = (np.abs(s - known[nearest]) / half).argmax(axis=1)
        beyond = (s < known.min(axis=0)) | (s > known.max(axis=0))
        return cls(d=np.asarray(d), by=by, outside=dict(zip(COLUMNS, beyond.mean(axis=0).tolist(), strict=True)))

    @property
    def far(self) -> float:
        """Share of the samples further than REACH [1]."""
        return float(np.mean(self.d > REACH))

    def figures(self) -> dict[str, Any]:
        """For a program."""
        quantiles = {f"distance_{q}": float(np.percentile(self.d, q)) for q in (50, 95, 100)}
        return {"share_far": self.far, **quantiles, "share_outside": dict(self.outside)}

    def __str__(self) -> str:
        far = self.by[self.d > REACH]
        most = f", mostly by {COLUMNS[int(np.bincount(far).argmax())]}" if len(far) else ""
        return (
            f"distance from the data: median {np.median(self.d):.2f}, 95 % below {np.percentile(self.d, 95):.2f}; "
            f"{100.0 * self.far:.1f} % beyond {REACH:.2g}, which is as far as nets have learned{most}"
        )


def states_of(log: Log, where: str) -> Array:
    """The states (n, columns) of a drive's log; raises ValueError for a log without them."""
    lacks = [signal for signal in SIGNALS.values() if signal not in log]
    require(not lacks, where, f"has no {', '.join(lacks)}; expected the log of a policy's drive: steerkit drive RUN")
    return np.column_stack([log[signal] for signal in SIGNALS.values()])
