"""Waypoints: read from the text of a CSV file, and checked before a path is laid along them."""

import math
import re
from array import array
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit._support.files import parted, text_table
from steerkit._support.quantities import QUANTITIES, SPELT, UNITS, ended_unit, place
from steerkit.diagram.maths import Array
from steerkit.diagram.units import FACTORS

_FEWEST_CLOSED = 6


_CALLED = {"x": "x", "y": "y", "lat_deg": "lat", "lon_deg": "lon", "t": "t", "v": "v"}
"""Quantities, and what their columns are called here."""
_READ = (*_CALLED.values(), "s", "psi", "kappa", "v_limit")
"""Columns that have to hold numbers."""
_SCALES = {unit: factor for units in FACTORS.values() for unit, factor in units.items()}


def read_columns(text: str, where: str, left_out: dict[int, str] | None = None) -> dict[str, Array]:
    """The columns of CSV text by their names, in SI units, degrees for lat and lon: see `text_table`.

    x, y, lat, lon, t and v may have any of the names that a log's may have, and units as `x [m]` or `speed_kmh`.
    left_out: is given the numbers of the lines that hold no point, and what they hold. Raises ValueError for an empty
    file; for a ragged row or a cell that is no number, with its line, without `left_out` or in more rows than a tenth.
    """
    what = "is XML, expected CSV; a file that holds GPX has to end in .gpx, and so on"
    require(not text.lstrip().startswith("<"), where, what)
    names, read_rows = text_table(_lines(text), where)
    columns = _named(names, where)
    places = next((two for two in (("x", "y"), ("lat", "lon")) if {*two} <= {one for one, _ in columns}), ())
    read, place = ([n for n, (one, _) in enumerate(columns) if one in some] for some in (_READ, places))
    bad: dict[int, str] = {} if left_out is None else left_out
    values, lines = array("d"), array("I")  # of a row of text at a time: all of it as text would take twenty times
    for k, line, numbers in read_rows:
        if None in numbers and len(numbers) == len(columns):  # a word that nothing here reads is none that is wrong
            numbers = [math.nan if one is None and n not in read else one for n, one in enumerate(numbers)]
        whole = None not in numbers and len(numbers) == len(columns)
        if whole and (left_out is None or all(math.isfinite(numbers[n] or 0.0) for n in place)):
            values.extend(numbers)  # type: ignore[arg-type]
            lines.append(k)
        else:
            bad[k] = f"line {k} is {line[:200]!r}, expected {len(columns)} numbers ({','.join(names)})"
            require(left_out is not None, where, bad[k])
    first = next(iter(bad.values()), "no rows, expected a header such as 'x,y' or 'lat,lon' and one point a line")
    require(lines, where, first)
    require(9 * len(bad) <= len(lines), where, f"{first}; and so are {len(bad)} of {len(bad) + len(lines)} rows")
    rows = np.frombuffer(values).reshape(-1, len(columns)).T
    made = {name: row if factor == 1.0 else factor * row for (name, factor), row in zip(columns, rows)}
    if left_out is not None and places:
        stray = stray_ends(made[places[0]], made[places[1]], made.get("t"), flat="x" in places)
        left_out |= {lines[k]: f"line {lines[k]}: {why}" for k, why in stray.items()}
        made = {name: row[0 in stray : len(row) - (-1 in stray)] for name, row in made.items()}
    return made


def _lines(text: str) -> Iterator[str]:
    return (found[0] for found in re.finditer(r"[^\r\n]*(?:\r\n?|\n|\Z)", text))


def mended(text: str, where: str) -> str:
    """CSV text whose bad rows are comments that say so; raises ValueError as `read_columns`."""
    bad: dict[int, str] = {}
    read_columns(text, where, bad)
    return "".join(f"# left out: {bad[k]}\n" if k in bad else line for k, line in enumerate(_lines(text), 1))


def said_of(left_out: Collection[str]) -> list[str]:
    """What to say of positions that are left out, in a line or none."""
    return [f"{len(left_out)} positions are left out, the first: {next(iter(left_out))}"] if left_out else []


def _named(names: list[str], where: str) -> list[tuple[str, float]]:
    """What each column is called here, and one of its unit in SI."""
    parts = [parted(name) for name in names]
    called = ["s" if bare.lower() == "s_m" else bare.lower() for bare, _ in parts]
    meant = [""] * len(names)
    for quantity, short in _CALLED.items():
        found = [
            (called[k] != short, at, k)
            for k, (bare, _) in enumerate(parts)
            if (at := place(quantity, bare)) is not None
        ]
        if found:
            *_, k = min(found)
            called[k], meant[k] = short, quantity
    require(len(set(called)) == len(called), where, f"two columns of one name: {', '.join(names)}")
    return [(name, _factor(meant[k], *parts[k], where)) for k, name in enumerate(called)]


def _factor(quantity: str, bare: str, unit: str, where: str) -> float:
    unit = SPELT.get(unit.lower(), unit) or ended_unit(quantity, bare)
    if not quantity or not unit:
        return _SCALES.get(unit, 1.0)
    units = UNITS[QUANTITIES[quantity]]
    require(unit in units, where, f"column {bare}: unit '{unit}'; valid: {', '.join(units)}")
    return units[unit]


def stated(text: str) -> tuple[bool, float] | None:
    """Whether a course is closed, and its length [m], as the first line of a file says that this package wrote."""
    said = re.search(r"^#.*: (closed|open) path, ([\d.]+) m", text, re.MULTILINE)
    return (said[1] == "closed", float(said[2])) if said else None


def check_stated(said: float, length: float, apart: float, where: str) -> None:
    """ValueError where a file's points make another length than its first line says, by more than `apart` [m]."""
    what = f"its first line says {said:g} m, its points make {length:.1f} m: cut short, or changed by hand"
    require(abs(length - said) <= apart, where, f"{what}; write it again, or delete that line")


def distances(points: Array) -> Array:
    """From each point to the next, (n - 1,)."""
    return np.hypot(*np.diff(points, axis=0).T)


def travelled(points: Array) -> Array:
    """From the first point to each, along the points between, (n,)."""
    return np.concatenate(([0.0], np.cumsum(distances(points))))


def _few(indices: NDArray[np.intp]) -> str:
    return ", ".join(map(str, indices[:5])) + (f" and {len(indices) - 5} more" if len(indices) > 5 else "")


def checked(points: Array, where: str) -> Array:
    """The waypoints (n, 2) [m]; ValueError, in the name of `where`, for such as no path leads along."""
    shaped = points.ndim == 2 and points.shape[1] == 2
    require(shaped, where, f"waypoints of shape {points.shape}, expected (n, 2): one row (x, y) [m] a point")
    few = f"{len(points)} waypoints, expected at least 2 (open) or {_FEWEST_CLOSED} (closed)"
    require(len(points) >= 2, where, few)
    broken = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if broken.size:
        at = tuple(points[broken[0]].tolist())
        raise ValueError(f"{where}: waypoint {_few(broken)} not finite (the first is {at}) [m], expected numbers")
    size = float(np.ptp(points, axis=0).max())
    cure = "for latitudes and longitudes in degrees use Path.from_gps"
    require(size >= 0.1, where, f"all waypoints within {size:.3g} m, expected metres; {cure}")
    same = np.flatnonzero(distances(points) < 1e-9) + 1
    what = f"waypoint {_few(same)} repeats the one before it (a car at rest?), expected distinct points"
    require(not same.size, where, f"{what}; keep xy[np.r_[True, np.hypot(*np.diff(xy, axis=0).T) > 0.05]]")
    return points


def ring(points: Array, where: str) -> Array:
    """The points with the first repeated at the end, once the ends are known to meet; else ValueError."""
    steps, gap = distances(points), math.dist(points[0], points[-1])
    if gap < 1e-3 * float(np.median(steps)):
        points, steps = points[:-1], steps[:-1]
        gap = math.dist(points[0], points[-1])
    few = f"{len(points)} distinct waypoints, expected at least {_FEWEST_CLOSED} when closed"
    require(len(points) >= _FEWEST_CLOSED, where, few)
    apart = f"closed, but its ends are {gap:.3g} m apart where neighbours are at most {steps.max():.3g} m"
    require(gap <= 3.0 * steps.max(), where, f"{apart}; use closed=False, or add waypoints that bridge the gap")
    back = points[0] - points[-1]
    ends = np.array([points[-1] - points[-2], points[1] - points[0]])
    if (ends @ back < -0.5 * np.hypot(*ends.T) * gap).all():
        near = len(points) // 2 + int(np.argmin(np.hypot(*(points[len(points) // 2 :] - points[0]).T)))
        cure = f"cut it to the first {near} waypoints, where it comes back to its start"
        raise ValueError(f"{where}: closed, but its end overlaps its start by {gap:.3g} m; {cure}")
    return np.vstack((points, points[:1]))


def check_gps(lat: Array, lon: Array, where: str) -> None:
    """ValueError, in the name of `where`, unless these are positions in degrees."""
    fits = lat.ndim == 1 and lat.shape == lon.shape and lat.size
    require(fits, where, f"lat of shape {lat.shape}, lon of shape {lon.shape}, expected both (n,)")
    broken = np.flatnonzero(~(np.isfinite(lat) & np.isfinite(lon)))
    require(not broken.size, where, f"position {_few(broken)} not finite [degrees], expected numbers")
    wrong = np.flatnonzero((np.abs(lat) > 90.0) | (np.abs(lon) > 180.0))
    if wrong.size:
        k = wrong[0]
        swapped = "; swapped?" if np.abs(lat).max() <= 180.0 and np.abs(lon).max() <= 90.0 else ""
        at = f"position {k}: lat {lat[k]:g}, lon {lon[k]:g} [degrees]"
        raise ValueError(f"{where}: {at}, expected -90..90 and -180..180{swapped}")
    degrees = np.abs(lat).max() > math.pi / 2.0 or np.abs(lon).max() > math.pi  # else they would be open sea
    require(degrees, where, f"lat {lat[0]:g}, lon {lon[0]:g} look like radians, expected degrees")


def east_north(lat_deg: NDArray[Any], lon_deg: NDArray[Any], origin_deg: tuple[float, float]) -> Array:
    """WGS84 positions (n,) [degrees] in metres east and north of an origin (n, 2), in its tangent plane (ENU)."""
    import pymap3d

    return np.column_stack(pymap3d.geodetic2enu(lat_deg, lon_deg, 0.0, *origin_deg, 0.0)[:2])


def placed(columns: Mapping[str, Array], where: str) -> tuple[Array, tuple[float, float] | None]:
    """Columns x, y [m] or lat, lon [degrees] as metres (n, 2), and where x = y = 0 is [degrees], if that is known."""
    if {"x", "y"} <= columns.keys():
        return np.column_stack((columns["x"], columns["y"])), None
    known = {"lat", "lon"} <= columns.keys()
    require(known, where, f"columns {', '.join(columns)}; valid: x, y [m] or lat, lon [degrees]")
    lat, lon = columns["lat"], columns["lon"]
    check_gps(lat, lon, where)
    origin = float(lat[0]), float(lon[0])
    return east_north(lat, lon, origin), origin


FASTEST = 100.0
"""[m/s]; what seems faster is a wrong position."""


def stray_ends(
    a: Array, b: Array, t: Array | None = None, *, flat: bool = False, drawn: bool = False
) -> dict[int, str]:
    """Is the first position (0) wrong, or the last (-1)? Why, in words, of ten positions or more.

    It lies off by more than ten times the longest of the other steps, and not straight on (drawn, where one step may
    be long: by ten times all of them); or by t [s] it is left faster than any car.

    a, b: x, y where `flat` [m], else latitude and longitude [degrees] (n,).
    """
    found = dict[int, str]()
    if len(a) < _MANY:
        return found
    metres = np.array([1.0, 1.0] if flat else [111e3, 111e3 * math.cos(math.radians(np.median(a)))])
    steps = np.hypot(metres[0] * np.diff(a), metres[1] * np.diff(b))
    if not np.isfinite(steps).all():
        return found
    most = 10.0 * float(steps[1:-1].sum() if drawn else steps[1:-1].max())
    for end, way in ((0, 1), (-1, -1)):
        first, second, third = metres * np.column_stack((a[::way][[0, 1, 5]], b[::way][[0, 1, 5]]))
        step, on = float(steps[end]), math.dist(second, third)
        ahead = (second - first) @ (third - second) > 0.88 * step * on > 0.0
        late = np.full(2, np.inf) if t is None else np.abs(np.diff(t[::way][:3]))
        left = steps[::way][:2] - 30.0 > FASTEST * late
        if (step > most and not ahead) or (left[0] and not left[1]):
            where = f"({a[end]:g}, {b[end]:g}) [{'m' if flat else 'degrees'}]"
            beside = "next" if way > 0 else "last"
            found[end] = f"{where} lies {step:.0f} m from the {beside} position, as no car drives"
    return found


_MANY, _FAR, _WIDE, _SMALL = 10, 100.0, 5000.0, 5.0
"""From so many points on they may lie so far apart [m] at most; a road that turns round has a bend tighter than this
radius [m]; a course is so large [m] at least."""


def check_metres(xy: Array, where: str) -> None:
    """ValueError, in the name of `where`, for a log whose numbers are millimetres or kilometres rather than metres."""
    if len(xy) < 2:
        return
    size = float(np.ptp(xy, axis=0).max())
    small = f"all of it within {size:.3g} m, expected metres; kilometres? multiply x, y by 1000"
    require(size >= _SMALL, where, small)
    steps = distances(xy)
    step = float(np.median(steps))
    apart = f"its points are {step:.0f} m apart (median), expected at most {_FAR:.0f} m"
    require(len(xy) < _MANY or step <= _FAR, where, f"{apart}; millimetres? divide x, y by 1000")
    bends = np.abs(np.diff(np.unwrap(np.arctan2(*np.diff(xy, axis=0).T[::-1]))))
    tightest = float((bends / (0.5 * (steps[1:] + steps[:-1]))).max(initial=0.0))
    wide = f"it turns by {bends.sum():.1f} rad without a bend tighter than {1.0 / max(tightest, 1e-9):.0f} m"
    fits = bends.sum() <= np.pi or tightest >= 1.0 / _WIDE
    require(fits, where, f"{wide}, expected metres; millimetres? divide x, y by 1000")
