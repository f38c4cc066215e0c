"""Channels of different rates on one clock, that of the one that was sampled most often."""

from __future__ import annotations

import numpy as np

from steerkit._support.errors import require
from steerkit.logs.channels import Array

PAUSE = 0.25
"""From this time on without a sample [s], or five of its usual steps, a channel pauses."""
PLACES = ("x", "y")
"""Quantities that a drive can be without: where they are not known they are NaN, and no row is lost for them."""


def aligned(values: dict[str, Array], times: dict[str, Array], where: str, notes: list[str]) -> dict[str, Array]:
    """The quantities (n,) over one `t` [s]; NaN where one was not sampled while others were.

    values, times: by quantity, each of its own length; taken out of the dictionaries. Linear between samples; a note
    says the rates. Raises ValueError for clocks that do not overlap.
    """
    first = next(iter(times.values()))
    if all(t is first for t in times.values()):
        times.clear()
        return {"t": first} | {quantity: values.pop(quantity) for quantity in list(values)}
    series = {quantity: _sorted(times.pop(quantity), values.pop(quantity)) for quantity in list(values)}
    for quantity, (t, _) in series.items():
        require(len(t) >= 2, where, f"{quantity} has {len(t)} samples that are numbers, expected more")
    spans = ", ".join(f"{quantity} {t[0]:.6g} to {t[-1]:.6g}" for quantity, (t, _) in series.items())
    needed = [q for q in series if q not in PLACES]
    begin, end = (max(series[q][0][0] for q in needed), min(series[q][0][-1] for q in needed))
    require(end - begin > 1.0, where, f"the clocks do not overlap: {spans} [s]; files of one drive, of one clock?")
    clock = series[max(needed, key=lambda q: len(series[q][0]))][0]
    clock = clock[np.searchsorted(clock, begin) : np.searchsorted(clock, end, side="right")]
    rates = ", ".join(f"{q} {_rate(t):.4g}" for q, (t, _) in series.items())
    notes.append(f"one clock of {_rate(clock):.4g} Hz for channels of {rates} Hz")
    return {"t": clock, **{quantity: _on(clock, *series.pop(quantity), quantity) for quantity in list(series)}}


def in_metres(
    values: dict[str, Array], times: dict[str, Array], notes: list[str]
) -> tuple[dict[str, Array], dict[str, Array]]:
    """Latitude and longitude as x (east) and y (north) of the first fix [m], unless there are x and y."""
    lat, lon = values.pop("lat_deg"), values.pop("lon_deg")
    at = times.pop("lat_deg")
    times.pop("lon_deg")
    known = np.isfinite(lat) & np.isfinite(lon) & (np.abs(lat) <= 90.0) & (np.abs(lon) <= 180.0)
    known &= (lat != 0.0) | (lon != 0.0)  # what a receiver without a fix says
    if "x" in values or not known.any():
        return values, times
    import pymap3d

    first = int(np.argmax(known))
    east, north, _ = pymap3d.geodetic2enu(lat, lon, 0.0, lat[first], lon[first], 0.0)
    notes.append(f"x, y: east and north of {lat[first]:.6f}, {lon[first]:.6f} [degrees]")
    values |= {"x": np.where(known, east, np.nan), "y": np.where(known, north, np.nan)}
    return values, times | {"x": at, "y": at}


def _sorted(t: Array, values: Array) -> tuple[Array, Array]:
    good = np.isfinite(t) & np.isfinite(values)
    if good.all() and (np.diff(t) > 0.0).all():
        return t, values  # as nearly always: no copies
    order = np.argsort(t[good], kind="stable")
    t, values = t[good][order], values[good][order]
    new = np.concatenate(([True], np.diff(t) > 0.0)) if len(t) else np.zeros(0, dtype=bool)
    return t[new], values[new]


def _rate(t: Array) -> float:
    return 1.0 / float(np.median(np.diff(t)))


def _on(clock: Array, t: Array, values: Array, quantity: str) -> Array:
    """Linear between samples; NaN outside of them and in pauses."""
    values = np.unwrap(values) if quantity == "psi" else values
    on = np.asarray(np.interp(clock, t, values), dtype=float)
    steps = np.diff(t)
    pause = max(PAUSE, 5.0 * float(np.median(steps)))
    if t[0] <= clock[0] and clock[-1] <= t[-1] and not (steps > pause).any():
        return on
    behind = np.clip(np.searchsorted(t, clock, side="left"), 1, len(t) - 1)
    lost = (t[behind] - t[behind - 1] > pause) & (clock > t[behind - 1]) & (clock < t[behind])
    return np.where(lost | (clock < t[0]) | (clock > t[-1]), np.nan, on)
