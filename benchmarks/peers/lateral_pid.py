"""A PID with feed-forward as one file for comma's controls challenge: `benchmarks.peers.lateral_pid:Controller`.

Written here after the baselines that the challenge describes, none of whose code is used.
"""

from typing import Any


class Controller:
    """steer = ff (target some samples ahead - roll) + p e + i sum e dt + d de/dt, held within +-2."""

    def __init__(self, ff: float = 0.55, p: float = 0.1, i: float = 0.1, d: float = 0.0, ahead: int = 6):
        self.ff, self.p, self.i, self.d, self.ahead = ff, p, i, d, ahead
        self.sum = self.before = 0.0

    def update(self, target_lataccel: float, current_lataccel: float, state: Any, future_plan: Any) -> float:
        """The steer of this sample, 0.1 s after the one before."""
        plan = [target_lataccel, *future_plan.lataccel]
        error = target_lataccel - current_lataccel
        forward = self.ff * (plan[min(self.ahead, len(plan) - 1)] - state.roll_lataccel)
        steer = forward + self.p * error + self.i * self.sum + self.d * (error - self.before) / 0.1
        if abs(steer) < 2.0:
            self.sum += 0.1 * error
        self.before = error
        return min(max(steer, -2.0), 2.0)
