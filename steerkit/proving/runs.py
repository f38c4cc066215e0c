"""A manoeuvre's runs: signals about the time at which the input began, in one sign, filtered as it asks."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import scipy  # its parts load when they are first used

from steerkit._support.errors import require
from steerkit.logs.channels import Array
from steerkit.proving.manoeuvre import SIDES, Manoeuvre

NEEDED = ("delta_sw", "v", "r", "a_y")
SIGNED = ("delta_sw_cmd", "delta_sw", "r", "a_y", "beta", "e", "y", "psi")
"""Signals that change their sign where left and right are exchanged."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """One run of a manoeuvre: evenly sampled signals in SI. Raises ValueError for signals that do not fit."""

    t: Array
    """Time (n,) [s]; 0 where the input begins, or the drive does."""
    signals: Mapping[str, Array]
    """delta_sw [rad], v [m/s], r [rad/s], a_y [m/s^2], each (n,); and what else is known: delta_sw_cmd, psi [rad], beta
    [rad], e, x, y [m]."""
    side: str = "left"
    number: int = 1
    invalid: str = ""
    """Why it does not count; "" for a valid one."""
    whole: bool = False
    """Is it a drive of its own, of which the manoeuvre's conditions are not asked?"""

    def __post_init__(self) -> None:
        where = f"run {self.number}, {self.side}"
        missing = [name for name in NEEDED if name not in self.signals]
        require(not missing, where, f"no signal {', '.join(missing)}; expected {', '.join(NEEDED)}")
        for name, values in self.signals.items():
            require(len(values) == len(self.t), where, f"{name} has {len(values)} samples, t {len(self.t)}")
        steps = np.diff(self.t)
        even = len(steps) > 0 and steps.min() > 0.0 and np.ptp(steps) < 0.2 * steps.min()
        require(even, where, "t, expected two samples or more, evenly spaced [s]")

    def __getitem__(self, name: str) -> Array:
        return self.signals[name]

    @property
    def dt(self) -> float:
        """Sample time [s]."""
        return float(np.mean(np.diff(self.t)))

    def between(self, begin: float, end: float) -> Array:
        """The samples from begin to end [s] (n,)."""
        return np.asarray((self.t >= begin - 1e-9) & (self.t <= end + 1e-9))

    def about(self, name: str) -> Array:
        """A signal less its mean before the input (n,)."""
        before = self.between(-1.0, -self.dt)
        return self[name] - (self[name][before].mean() if before.any() else 0.0)


def prepared(run: Run, manoeuvre: Manoeuvre) -> Run:
    """A run as it is evaluated: to the left, filtered.

    Signals of a run to the right change their sign. Then all but positions go through a Butterworth low-pass of second
    order, forward and backward, which makes one of fourth order without lag; not where the sampling is too slow for it.
    """
    signals = {name: np.asarray(values, dtype=float) for name, values in run.signals.items()}
    signals = {name: SIDES[run.side] * values if name in SIGNED else values for name, values in signals.items()}
    if 0.0 < manoeuvre.cutoff < 0.45 / run.dt and len(run.t) > 30:
        sos = scipy.signal.butter(2, manoeuvre.cutoff, fs=1.0 / run.dt, output="sos")
        for name in ("delta_sw_cmd", "delta_sw", "r", "a_y", "beta"):
            if name in signals:
                signals[name] = scipy.signal.sosfiltfilt(sos, signals[name])
    return replace(run, signals=signals)


def checked(run: Run, manoeuvre: Manoeuvre) -> Run:
    """The run, invalid with a reason where the manoeuvre's conditions or limits did not hold."""
    if run.invalid:
        return run
    conditions, abort, seconds = manoeuvre.conditions, manoeuvre.abort, run.t[-1]
    before = run.between(-conditions.settle, 0.0)
    found = ""
    if not all(np.isfinite(run[name]).all() for name in NEEDED):
        found = "signals are not finite"
    elif run.whole:
        return run
    elif (off := float(np.abs(run["v"] - conditions.v).max())) > min(conditions.v_tolerance, abort.v):
        found = f"speed {off:.2f} m/s off, {min(conditions.v_tolerance, abort.v):g} allowed"
    elif manoeuvre.input and run.t[0] < -0.5 * conditions.settle and abs(run["r"][before].mean()) > conditions.r_max:
        found = f"not straight ahead before: r = {run['r'][before].mean():.4f} rad/s, {conditions.r_max:g} allowed"
    elif manoeuvre.input and seconds < manoeuvre.seconds - 0.5:
        found = f"ends after {seconds:.1f} of {manoeuvre.seconds:.1f} s"
    else:
        for name, limit, unit in (("a_y", abort.a_y, "m/s^2"), ("r", abort.r, "rad/s")):
            if not found and (most := float(np.abs(run[name]).max())) > limit:
                found = f"|{name}| = {most:.2f} {unit}, {limit:g} allowed"
    return replace(run, invalid=found)
