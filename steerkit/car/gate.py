"""The gate: the last thing a command passes before the bus. One pure function, total over all floats."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from steerkit.vehicles.rollout import GateLimits


class Verdict(NamedTuple):
    """What the gate answers."""

    send: bool
    """May a frame go out?"""
    delta_sw: float
    """The angle to send [rad], a whole number of quanta; meaningless unless `send`."""
    why: str
    """Why it was refused, or which limit changed it; empty: passed as it is."""


def gate(limits: GateLimits, request: float, last: float, speeds: Sequence[float], dt: float) -> Verdict:
    """The command that may be sent, given the request, the command before it, and what is known of the speed.

    v      = max |speeds|, at least v_floor; v_max if one of them is no number, or none is known
    target = sat(request) to |delta_sw| <= delta_sw_max and |kappa| <= a_y_max/v^2, kappa = tan(delta)/(L + K v^2)
    out    = sat(target) to last +- rate(v)*dt and kappa(last) +- jerk_max/v^2*dt,  dt at most dt_max,
             and, where |kappa| grows, to |v^2 kappa + v arm dkappa/dt| <= a_y_max, a_y of the centre of gravity, or
             by one quantum
    sent   = out, rounded towards `last` to a whole number of quanta

    Where the bounds on kappa and on its change contradict each other (the speed has jumped), the change is bounded
    and goes towards the bound on kappa. Refuses when the request, `last` or dt is no finite number, `last` is out of
    range, or dt is below dt_min.

    request, last [rad]; speeds [m/s]; dt [s] since the last frame. Any floats are valid. Raises nothing.
    Source: ISO 11270:2014 (3 m/s^2, 5 m/s^3); the curvature-speed bounds of production lane keeping.
    """
    if not math.isfinite(request):
        return Verdict(False, 0.0, "request is no finite number")
    if not (math.isfinite(last) and abs(last) <= limits.delta_sw_max + limits.quantum):
        return Verdict(False, 0.0, "last command is out of range")
    if not (math.isfinite(dt) and dt >= limits.dt_min):
        return Verdict(False, 0.0, "too soon after the last frame")
    q, ratio = limits.quantum, limits.steer_ratio
    n_max = math.floor(limits.delta_sw_max / q + 1e-9)
    n_last = max(-n_max, min(n_max, round(last / q)))
    last = n_last * q
    v = pessimistic(limits, speeds)
    length = limits.length(v)
    dt = min(dt, limits.dt_max)

    bound = min(limits.delta_sw_max, ratio * math.atan(length * limits.a_y_max / (v * v)))
    target = max(-bound, min(bound, request))
    kappa, turn = math.tan(last / ratio) / length, limits.jerk_max / (v * v) * dt
    step = limits.rate(v) * dt
    sway, kappa_max = limits.arm / (v * dt), limits.a_y_max / (v * v)
    right, left = (sway * kappa - kappa_max) / (1.0 + sway), (sway * kappa + kappa_max) / (1.0 + sway)
    low = max(last - step, ratio * math.atan(length * (kappa - turn)))
    high = min(last + step, ratio * math.atan(length * (kappa + turn)))
    low = max(low, min(last - q, ratio * math.atan(length * right)))
    high = min(high, max(last + q, ratio * math.atan(length * left)))
    out = max(low, min(high, target))

    z = (out - last) / q
    n = max(-n_max, min(n_max, n_last + math.trunc(z + math.copysign(1e-6, z))))
    size = abs(request)
    why = "delta_sw limit" if size > limits.delta_sw_max else "a_y limit" if size > bound else ""
    if out != target:
        why = f"{why}, rate limit" if why else "rate limit"
    return Verdict(True, n * q, why)


def pessimistic(limits: GateLimits, speeds: Sequence[float]) -> float:
    """The speed that the bounds are taken at [m/s]: the fastest that may be true."""
    if not speeds or not all(map(math.isfinite, speeds)):
        return max([limits.v_max, *(abs(v) for v in speeds if math.isfinite(v))])
    return max(limits.v_floor, *map(abs, speeds))
