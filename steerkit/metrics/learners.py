"""What learning cost: driving time, episodes and transitions until it worked, over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from steerkit.metrics.statistics import Interval, interval, share

NEVER = float("inf")


@dataclass(frozen=True, kw_only=True)
class Learned:
    """What one seed came to; infinity where it never got there."""

    round_minutes: float = NEVER
    """Driving time until the first whole round was done [min], recovery and waiting included."""
    round_episodes: float = NEVER
    """Episodes until then [1]."""
    good_minutes: float = NEVER
    """Driving time until the first controller that drives a GOOD round took the wheel [min]."""
    good_episodes: float = NEVER
    """Episodes until then [1]."""
    transitions: int
    """Transitions recorded in the whole run [1]."""


def learned(seeds: Sequence[Learned]) -> dict[str, Interval]:
    """Medians over the seeds with bootstrap intervals, and the shares of seeds that succeeded with Wilson's.

    Keys: the fields of `Learned`, `round_share` and `good_share` [1]. A median is infinite if half the seeds or more
    never got there. Raises ValueError for no seeds. Source: Riedmiller, Montemerlo, Dahlkamp 2007, section IV (what is
    counted); Agarwal et al. 2021 (intervals over few seeds).
    """
    if not seeds:
        raise ValueError("learned: no seeds, expected at least one")
    figures = {
        name: interval([getattr(seed, name) for seed in seeds], np.median) for name in Learned.__dataclass_fields__
    }
    figures["round_share"] = share([np.isfinite(seed.round_minutes) for seed in seeds])
    figures["good_share"] = share([np.isfinite(seed.good_minutes) for seed in seeds])
    return figures
