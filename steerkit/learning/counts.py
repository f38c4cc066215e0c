"""What has happened in a learning run: episodes, distance, rounds and trainings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field


@dataclass(kw_only=True)
class Episode:
    """One time at the wheel of the learner, from take-over to failure (or to the end of the run)."""

    began: float
    """Driving time at the take-over [s]."""
    progress: float
    """Path progress there [m]."""
    net: int
    """Number of the net that took over."""
    ended: float | None = None
    """Driving time at its end [s]; None while it lasts."""
    failed: bool = False
    """Did it end because the recovery controller had to take the wheel?"""
    distance: float = 0.0
    """Path distance covered [m]."""
    sum_e2: float = 0.0
    samples: int = 0
    rounds: int = 0
    """Complete rounds within it."""

    @property
    def rms_e(self) -> float:
        """Root mean square cross-track error [m]."""
        return math.sqrt(self.sum_e2 / max(1, self.samples))


@dataclass(kw_only=True)
class Counts:
    """What has happened so far: the part of a run that is not loop state, nets or transitions."""

    k: int = 0
    """Base tick of the loop; driving time is k*dt."""
    updates: int = 0
    """Trainings so far; net number n is the product of the n-th."""
    train_seconds: float = 0.0
    """Computing time really spent in training [s]; driving time is charged `setting.fit_seconds` an update."""
    trained_at: float = 0.0
    """Distance driven at the last training [m]."""
    driven: float = 0.0
    """Distance driven by the learner [m]."""
    first_round_begun: float | None = None
    """Driving time at which the first complete round began [s]."""
    first_round_done: float | None = None
    """Driving time at which it was complete [s]."""
    failures_to_round: int | None = None
    """Failures before the first complete round."""
    episodes: list[Episode] = field(default_factory=list)

    @property
    def failures(self) -> int:
        """How often the recovery controller had to take the wheel."""
        return sum(episode.failed for episode in self.episodes)

    @property
    def rounds(self) -> int:
        """Complete rounds, each driven within one episode."""
        return sum(episode.rounds for episode in self.episodes)

    @property
    def episode(self) -> Episode | None:
        """The one that lasts, if one does."""
        return self.episodes[-1] if self.episodes and self.episodes[-1].ended is None else None

    def steered(self, t: float, *, progress: float, e: float, round_length: float = math.inf) -> bool:
        """One sample with the learner at the wheel, at driving time t [s]; was a round of that length complete in it?

        progress: along the path [m]; e: cross-track error [m]. An episode begins with its first sample.
        """
        episode = self.episode
        if episode is None:
            episode = Episode(began=t, progress=progress, net=self.updates)
            self.episodes.append(episode)
        distance = progress - episode.progress
        self.driven += max(0.0, distance - episode.distance)
        episode.distance = distance
        episode.sum_e2 += e**2
        episode.samples += 1
        if distance < (episode.rounds + 1) * round_length:
            return False
        episode.rounds += 1
        if self.first_round_done is None:
            self.first_round_begun, self.first_round_done = episode.began, t
            self.failures_to_round = self.failures
        return True

    def ended(self, t: float, *, failed: bool) -> Episode | None:
        """The learner does not steer at driving time t [s]: the episode that ends with that, if one lasted."""
        episode = self.episode
        if episode is not None:
            episode.ended, episode.failed = t, failed
        return episode
