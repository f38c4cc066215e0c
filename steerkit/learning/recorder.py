"""What of a drive becomes a transition: fed sample by sample while a learner drives, in simulation or on a car."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

State = tuple[float, ...]
Keep = Callable[[State, float, State, int], object]
"""Takes a transition: s, a, s_next, number of the episode."""


class Before(NamedTuple):
    """The first half of a transition, waiting for the sample that follows it."""

    number: int
    """Of its sample; the next one's is one larger."""
    s: State
    """State of the learner (SI)."""
    action: float
    """What the learner did there [rad]."""


class TransitionRecorder:
    """Makes transitions (s, a, s_next) of the samples of a drive, and hands each to `keep`.

    A transition is two samples that follow each other without a gap, in the first of which the learner steered. So the
    sample in which the learner loses the wheel is the end of a transition and never the beginning of one; nothing is
    recorded while another steers, across a sample that was left out, or from a car that was carried elsewhere
    (`forget`). Samples that are not finite are left out.
    """

    def __init__(self, keep: Keep):
        self.keep = keep
        self.before: Before | None = None
        """What the next sample would complete."""

    def sample(self, number: int, s: State, action: float, *, learning: bool, episode: int) -> None:
        """Sample `number`: the learner's state, its action [rad], whether it steers, and the number of its episode."""
        before, sound = self.before, all(map(math.isfinite, s))
        if before is not None and before.number == number - 1 and sound:
            self.keep(before.s, before.action, s, episode)
        self.before = Before(number, s, action) if learning and sound and math.isfinite(action) else None

    def forget(self) -> None:
        """The next sample does not follow from the last one: the car was carried elsewhere, or time has passed."""
        self.before = None
