"""Monotonic time for everything that runs in real time: the same clock in all processes of a machine."""

import math
import time
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Clock:
    """The machine's monotonic clock [s], `scale` times as fast (1 on a car; more to let a test be done sooner).

    All processes read the same clock, so that ages are comparable across them. With scale = 4 every limit, period and
    watchdog lasts a quarter as long, and the computer's own delays weigh four times as much.
    Raises ValueError unless scale is in (0, 100].
    """

    scale: float = 1.0

    def __post_init__(self) -> None:
        if not (math.isfinite(self.scale) and 0.0 < self.scale <= 100.0):
            raise ValueError(f"Clock: scale = {self.scale}, expected more than 0 and at most 100; 1 is real time")

    def now(self) -> float:
        """Time [s] since some moment of the machine's past."""
        return time.monotonic() * self.scale

    def wall(self, seconds: float) -> float:
        """How long `seconds` of this clock last for the machine [s]; never negative."""
        return max(0.0, seconds / self.scale)

    def sleep_until(self, t: float) -> None:
        """Return at time t [s], at once if it has passed."""
        delay = t - self.now()
        if delay > 0.0:
            time.sleep(delay / self.scale)
