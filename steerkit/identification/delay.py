"""Dead time and lag of a steering from a log of its commands and the measured wheel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from steerkit._support.errors import require
from steerkit.logs.drive import Array


class SteeringResponse(NamedTuple):
    """What `fit_delay_lag` found: delay [s], lag [s], and the RMS of what they leave unexplained [rad]."""

    delay: float
    lag: float
    rms: float


def fit_delay_lag(t: Array, command: Array, wheel: Array, *, longest: float = 0.5) -> SteeringResponse:
    """Delay and lag of the steering from a log of commands and measured wheel angles.

    Least squares over wheel(t + dt) = wheel(t) + f (g command(t - delay) + o - wheel(t)) for delays 0, dt, ..., and
    between them (the command is held: a share of a sample is the mean of two); lag = -dt/log(1 - f). A ratio g and an
    offset o of their own take nothing from the delay. The delay is that of the least residual.

    t (T,) [s], even; command, wheel (T,) [rad]. longest [s]: largest delay tried. Valid where neither stops nor rate
    limit act, and the wheel is moved over the record. Raises ValueError for a record that is uneven, too short, not
    finite, or without movement. Source: Ljung 1999, section 4.2 (ARX).
    """
    t, command, wheel = (np.asarray(a, dtype=float) for a in (t, command, wheel))
    where = "fit_delay_lag"
    require(t.ndim == 1 and t.shape == command.shape == wheel.shape, where, "t, command, wheel of different shapes")
    require(np.isfinite([t, command, wheel]).all(), where, "the record holds a NaN or an infinity")
    dt = float(t[1] - t[0]) if len(t) > 1 else 0.0
    require(dt > 0.0 and np.allclose(np.diff(t), dt, rtol=1e-3), where, "t must rise in even steps")
    count = int(longest / dt + 1e-9) + 1
    require(len(t) > 3 * count + 10, where, f"{len(t)} samples, expected more than {3 * count + 10} for {longest} s")
    require(np.ptp(command) > 1e-3 and np.ptp(wheel) > 1e-3, where, "the wheel was not moved in this record")
    now, after = wheel[count:-1], wheel[count + 1 :]
    best: tuple[float, float, float] = (np.inf, 0.0, 0.0)
    for n in range(count):
        recent, older = (command[count - i : len(t) - 1 - i] for i in (n, n + 1))
        columns = np.column_stack((now, recent, older, np.ones_like(now)))
        coefficients, *_ = np.linalg.lstsq(columns, after, rcond=None)
        keep, a, b, _ = coefficients
        if not (0.0 <= keep < 1.0 and a + b > 0.0 and min(a, b) >= -0.2 * max(a, b)):
            continue  # no delay between n and n + 1 samples explains it, nor would it but for noise
        error = float(np.sqrt(np.mean((columns @ coefficients - after) ** 2)))
        lag = -dt / np.log(keep) if keep > 1e-9 else 0.0
        # the older command acts first, for `early`: its share is exp(-(dt - early)/lag) - exp(-dt/lag) of the whole
        share = min(max(0.0, b / (a + b)), 1.0)
        early = dt * share if lag < 1e-6 else dt + lag * np.log(share * (1.0 - keep) + keep)
        if error < best[0] - 1e-12:
            best = (error, n * dt + early, float(lag))
    require(np.isfinite(best[0]), where, f"no delay up to {longest} s explains the wheel; is it the right command?")
    return SteeringResponse(float(best[1]), best[2], best[0])
