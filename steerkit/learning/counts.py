"""What has happened in a learning run: episodes, distance, rounds and trainings."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from steerkit.task import RELEASE

PATIENCE = 20.0
"""For how long the recovery controller may steer before the run says that it does not get to hand over [s]."""


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
class Recovery:
    """The time for which the recovery controller has been steering without a break."""

    began: float
    """Driving time at its begin, or when it was last said that it lasts [s]."""
    nearest: float = math.inf
    """Least |e| since then [m]."""
    slowest: float = math.inf
    """Least |e_dot| since then with |e| < RELEASE [m/s]."""
    said: str = ""
    """The newest line of `Counts.stuck` about it."""


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
    corrected: int = 0
    """Samples in which the policy at the wheel had to be corrected by the safety filter, since it got it."""
    episodes: list[Episode] = field(default_factory=list)
    recovery: Recovery | None = None
    """That of the recovery controller now; None: it does not steer."""
    stuck: list[str] = field(default_factory=list)
    """Why the recovery controller could not hand over for PATIENCE, a line for each time."""

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
        self.recovery, episode = None, self.episode
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

    def recovering(self, t: float, *, e: float, e_dot: float, calm: float, busy: bool) -> str | None:
        """The recovery controller steers at driving time t [s]: why it does not hand over, once after each PATIENCE.

        e [m], e_dot [m/s]: as the learner sees them. calm: |e_dot| below which it would [m/s]. busy: is the training
        of the policy that is to take over still going on?
        """
        recovery = self.recovery = self.recovery or Recovery(began=t)
        recovery.nearest = min(recovery.nearest, abs(e))
        if abs(e) < RELEASE:
            recovery.slowest = min(recovery.slowest, abs(e_dot))
        if t - recovery.began < PATIENCE:
            return None
        if recovery.nearest >= RELEASE:
            why = f"it came no nearer to the path than {recovery.nearest:.2f} m, and hands over below {RELEASE:g} m"
        elif recovery.slowest >= calm:
            why = f"it crosses the path at {recovery.slowest:.2f} m/s at least, and hands over below {calm:g} m/s"
        else:
            why = "the training of the next policy is not done" if busy else "no policy is ready to take over"
        line = f"at {t:.0f} s: recovery has steered for {PATIENCE:g} s and cannot hand over: {why}"
        self.stuck.append(line)
        self.recovery = Recovery(began=t, said=line)
        return line
