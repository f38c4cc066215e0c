"""Do two channels tell the same? How late, how large, how far off the one is against the other."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from steerkit._support.errors import require
from steerkit.logs.channels import Array, Channel
from steerkit.logs.columns import Column, ColumnMap
from steerkit.logs.names import candidates, told_unit

LONGEST = 0.5
"""Largest lag that is looked for [s]."""
FINE = 0.01
"""Clock on which two channels are compared [s]."""
AGREE = 0.7
"""From this correlation on two channels tell the same."""
_MOST = 4
"""Other channels of a quantity that are compared."""
_LEAST = 5.0
"""Shortest time that both have to have been recorded [s]."""


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """other(t + lag) = scale * reference(t) + offset, as well as `correlation` says."""

    lag: float
    """How late the other one is [s]; negative where it is early."""
    scale: float
    """The other's size over the reference's."""
    offset: float
    """What the other says where the reference is zero, in its unit."""
    correlation: float
    """1: fully; 0: not at all."""

    def __str__(self) -> str:
        when = "late" if self.lag >= 0.0 else "early"
        return (
            f"{abs(self.lag):.3f} s {when}, {self.scale:.3f} times, offset {self.offset:+.4f}, "
            f"correlation {self.correlation:.3f}"
        )


def yaw_axis(used: ColumnMap, channels: Mapping[str, Channel], notes: list[str]) -> ColumnMap:
    """The map with that axis of a gyro, and that sign, which goes with speed times steering angle.

    A telephone or a logger lies in the car as it likes. Nothing is changed where no axis goes with it clearly.
    """
    part = re.fullmatch(r"(.*(?:gyro_|gyr_|angular_velocity[._]))[xyz](.*)", used.columns["r"].name)
    axes = [f"{part[1]}{axis}{part[2]}" for axis in "xyz"] if part else []
    axes = [axis for axis in axes if axis in channels]
    if len(axes) < 2:
        return used
    steered, t = _steered(used, channels)
    try:
        found = {axis: agreement(t, steered, channels[axis].t, channels[axis].values) for axis in axes}
    except ValueError:
        return used
    best = max(axes, key=lambda axis: abs(found[axis].correlation))
    if abs(found[best].correlation) < AGREE:
        return used
    scale = 1.0 if found[best].correlation > 0.0 else -1.0
    told = ", ".join(f"{axis} {found[axis].correlation:.2f}" for axis in axes)
    notes.append(f"r is the axis of the gyro that goes with speed times steering angle, + = left; correlations: {told}")
    column = replace(used.columns["r"], name=best, scale=scale, unit=told_unit("r", channels[best]))
    return ColumnMap({**used.columns, "r": column})


def _steered(used: ColumnMap, channels: Mapping[str, Channel]) -> tuple[Array, Array]:
    angle, speed = (used.columns.get("delta_sw") or used.columns["delta"], used.columns["v"])
    wheel, v = channels[angle.name], channels[speed.name]
    t, values = _known(v.t, v.values)
    sign = 1.0 if angle.scale > 0.0 else -1.0
    return sign * wheel.values * np.interp(wheel.t, t, values), wheel.t


def told_again(used: ColumnMap, channels: Mapping[str, Channel], where: str) -> list[str]:
    """What other channels say of the quantities of a drive, in words: the same, or how late and how large."""
    notes = []
    for quantity in ("delta_sw", "v", "r"):
        if quantity not in used.columns:
            continue
        column = used.columns[quantity]
        others = [name for name in candidates(quantity, channels) if name != column.name]
        mine = channels[column.name]
        for name in others[:_MOST]:
            other = channels[name]
            there = Column(name, told_unit(quantity, other))
            pair = ColumnMap({quantity: column}), ColumnMap({quantity: there})
            si = [m.in_si({n: c.values for n, c in channels.items()}, where=where)[quantity] for m in pair]
            if np.array_equal(mine.t, other.t) and np.array_equal(*si):
                notes.append(f"{quantity} is in {name} too, the same to the last bit")
                continue
            try:
                found = agreement(mine.t, si[0], other.t, si[1])
            except ValueError:
                continue
            alike = (
                str(found) if abs(found.correlation) >= AGREE else f"another one, correlation {found.correlation:.2f}"
            )
            notes.append(f"{quantity} is in {name} too: {alike}")
    return notes


def agreement(t: Array, reference: Array, t_other: Array, other: Array) -> Agreement:
    """How `other` follows `reference`, both over their own times [s]; NaN and gaps are left out.

    The lag is that of the largest correlation within 0.5 s, to a fraction of 0.01 s by a parabola through the three
    largest. The scale is the ratio of the spreads (reduced major axis), so that noise on the reference does not make
    the other look smaller. Raises ValueError for less than 5 s in common.
    """
    (t, reference), (t_other, other) = (_known(*pair) for pair in ((t, reference), (t_other, other)))
    begin = max(t[0], t_other[0]) + LONGEST if len(t) and len(t_other) else 0.0
    end = min(t[-1], t_other[-1]) - LONGEST if len(t) and len(t_other) else 0.0
    require(end - begin >= _LEAST, "agreement", f"{max(end - begin, 0.0):.1f} s in common, expected {_LEAST:g} or more")
    clock = np.arange(begin, end, FINE)
    base = _smooth(np.interp(clock, t, reference))
    steps = np.arange(-round(LONGEST / FINE), round(LONGEST / FINE) + 1)
    alike = np.array([_correlation(base, _smooth(np.interp(clock + k * FINE, t_other, other))) for k in steps])
    best = int(np.argmax(np.abs(alike)))
    lag = float(FINE * (steps[best] + _between(np.abs(alike), best)))
    late = _smooth(np.interp(clock + lag, t_other, other))
    scale = _slope(base, late)
    offset = float(np.mean(late) - scale * np.mean(base))
    return Agreement(lag=lag, scale=scale, offset=offset, correlation=_correlation(base, late))


def _known(t: Array, values: Array) -> tuple[Array, Array]:
    good = np.isfinite(t) & np.isfinite(values)
    order = np.argsort(t[good], kind="stable")
    return t[good][order], values[good][order]


def _smooth(values: Array) -> Array:
    """The mean over 0.2 s: two sensors of one motion have other noise and other resolution."""
    width = round(0.2 / FINE)
    sums = np.cumsum(np.concatenate(([0.0], values)))
    return (sums[width:] - sums[:-width]) / width


def _correlation(a: Array, b: Array) -> float:
    a, b = a - a.mean(), b - b.mean()
    size = float(np.sqrt(np.sum(a * a) * np.sum(b * b)))
    return float(np.sum(a * b)) / size if size > 0.0 else 0.0


def _between(values: Array, best: int) -> float:
    """Where between samples the top of a parabola through the largest and its neighbours is, -0.5 to 0.5."""
    if not 0 < best < len(values) - 1:
        return 0.0
    before, at, after = values[best - 1 : best + 2]
    bend = before - 2.0 * at + after
    return float(0.5 * (before - after) / bend) if bend < 0.0 else 0.0


def _slope(a: Array, b: Array) -> float:
    """b's spread over a's, with the sign of their correlation."""
    spread = float(np.std(a))
    return float(np.sign(_correlation(a, b)) * np.std(b) / spread) if spread > 0.0 else 0.0
