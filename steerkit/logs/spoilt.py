"""Values that a spoilt digit or bit has made, in formats that have no check sum: what can be told of them is told."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

Array = NDArray[np.floating[Any]]

FASTEST = {"delta_sw": 35.0, "v": 30.0, "r": 30.0, "psi": 10.0}
"""What no car changes faster than: 2000 deg/s of wheel [rad/s], 3 g [m/s^2], yaw [rad/s^2], heading [rad/s]."""
ODD = ("delta_sw", "delta", "v", "r")
"""Quantities of which such values are told; a heading and a place jump by themselves."""
_ODD, _AROUND = 10.0, 8
"""A value is odd that lies so many times further beside its neighbours' middle than any of so many on both sides."""


def without_lone(columns: dict[str, Array], remarks: list[str]) -> None:
    """Takes out rows in which one value stands off from both neighbours by more than a car can change, and they agree.

    columns: (n,) each, `t` [s] among them, in SI.
    """
    t = columns["t"]
    bad = np.zeros(len(t), dtype=bool)
    span = np.minimum(np.diff(t)[:-1], np.diff(t)[1:])
    for key, fastest in FASTEST.items():
        if key in columns:
            rows = lone(np.unwrap(columns[key]) if key == "psi" else columns[key], fastest * span)
            if len(rows):
                bad[rows] = True
                remarks.append(f"dropped {len(rows)} rows of a lone {key} that no car reaches")
    if bad.any():
        for key in columns:
            columns[key] = columns[key][~bad]


def told_odd(values: Mapping[str, Array], times: Mapping[str, Array]) -> list[str]:
    """Which samples of each quantity stand off from all around them, in value or in time, in words, if any do.

    values, times: by quantity, (n,) each, in SI [s], as they were read, before they are brought to one clock.
    """
    told, clocks = list[str](), list[Array]()
    for quantity, numbers in values.items():
        t = times[quantity]
        known = np.isfinite(t) & np.isfinite(numbers)
        if not known.all():
            t, numbers = t[known], numbers[known]
        if len(t) <= 2 * _AROUND:
            continue
        steps = np.abs(np.diff(numbers))
        resolution = float(np.min(steps, initial=np.inf, where=steps > 0.0))
        found = [(quantity, standing_off(numbers, 4.0 * resolution))]
        if not any(times[quantity] is clock for clock in clocks):
            clocks.append(times[quantity])
            found.append((f"the time of {quantity}", standing_off(t, 0.5 * float(np.median(np.abs(np.diff(t)))))))
        for what, rows in found:
            if len(rows):
                at = f"{t[rows[0]] - t[0]:.6g} s from its start"
                told.append(f"{what} stands off from all around in {len(rows)} samples, the first {at}: spoilt?")
    return told


def lone(value: Array, reach: Array) -> NDArray[np.intp]:
    """Rows that stand off from both neighbours, which agree, by more than `reach` and 20 usual steps."""
    steps = np.diff(value)
    size = np.abs(steps)
    least = np.minimum(size[:-1], size[1:])
    far = np.flatnonzero(least > reach + 20.0 * float(np.median(size)))
    there, back = steps[far], steps[far + 1]
    return far[(there * back < 0.0) & (least[far] > 4.0 * np.abs(there + back))] + 1


def standing_off(values: Array, least: float) -> NDArray[np.intp]:
    """Rows whose value alone lies beside the middle of its neighbours, by more than `least` and ten times as far as any
    other near it: of a signal with noise or in steps, hardly any."""
    beside = values[:-2] + values[2:]
    beside *= -0.5
    beside += values[1:-1]
    np.abs(beside, out=beside)
    ahead = maximum_filter1d(beside, _AROUND, origin=-(_AROUND // 2), mode="constant")  # of a row and those after it
    # a spoilt value moves its neighbours' middles too, by half: those next to it do not count
    near = np.zeros_like(beside)
    near[:-2] = ahead[2:]
    np.maximum(near[_AROUND + 1 :], ahead[: -_AROUND - 1], out=near[_AROUND + 1 :])
    near *= _ODD
    np.maximum(near[1:], 1.5 * beside[:-1], out=near[1:])
    np.maximum(near[:-1], 1.5 * beside[1:], out=near[:-1])
    return np.flatnonzero(beside > np.maximum(near, least)) + 1
