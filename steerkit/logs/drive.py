"""A recorded drive on one clock: what is repaired is reported, what cannot be is refused."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # its parts load when they are first used
from numpy.typing import ArrayLike, NDArray

from steerkit._support.errors import require
from steerkit._support.quantities import QUANTITIES
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import RAD_PER_DEG
from steerkit.logs.channels import Array
from steerkit.paths.waypoints import east_north, stray_ends

PAUSE = 0.25
"""From this time on without a sample [s], or five of its usual steps, a channel pauses."""
PLACES = ("x", "y", "v_y")
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
    for quantity, t in times.items():
        steps = np.diff(t[np.isfinite(t) & np.isfinite(values[quantity])])
        for count, what in ((steps < 0.0, "came out of order"), (steps == 0.0, "repeat the time of the one before")):
            if count.any():
                notes.append(f"{count.sum()} samples of {quantity} {what}")
    series = {quantity: in_order(times.pop(quantity), values.pop(quantity)) for quantity in list(values)}
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


def in_metres(values: dict[str, Array], times: dict[str, Array], notes: list[str]) -> None:
    """Latitude and longitude become x (east) and y (north) of the first fix [m], unless there are x and y."""
    lat, lon, at, _ = (np.asarray(of.pop(key), dtype=float) for of in (values, times) for key in ("lat_deg", "lon_deg"))
    known = np.isfinite(lat) & np.isfinite(lon) & (np.abs(lat) <= 90.0) & (np.abs(lon) <= 180.0)
    known &= (lat != 0.0) | (lon != 0.0)  # what a receiver without a fix says
    if "x" in values or not known.any():
        return
    rows = np.flatnonzero(known)
    rows = rows[np.concatenate(([True], (np.diff(lat[rows]) != 0.0) | (np.diff(lon[rows]) != 0.0)))]  # one of each fix
    if why := stray_ends(lat[rows], lon[rows], at[rows]).get(0):
        known[: rows[1]] = False
        notes.append(f"left out the first fix: {why}")
    first = int(np.argmax(known))
    east, north = east_north(lat, lon, (lat[first], lon[first])).T
    notes.append(f"x, y: east and north of {lat[first]:.6f}, {lon[first]:.6f} [degrees]")
    values |= {"x": np.where(known, east, np.nan), "y": np.where(known, north, np.nan)}
    times |= {"x": at, "y": at}


def in_order(t: Array, values: Array) -> tuple[Array, Array]:
    """The samples that are numbers, rising in time; of repeated times the first."""
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
    behind = np.clip(np.searchsorted(t, clock, side="left"), 1, len(t) - 1)
    lost = (t[behind] - t[behind - 1] > pause) & (clock > t[behind - 1]) & (clock < t[behind])
    return np.where(lost | (clock < t[0]) | (clock > t[-1]), np.nan, on)


FASTEST = {"delta_sw": 35.0, "v": 30.0, "r": 30.0, "psi": 10.0}
"""What no car changes faster than: 2000 deg/s of wheel [rad/s], 3 g [m/s^2], yaw [rad/s^2], heading [rad/s]."""
ODD = ("delta_sw", "delta", "v", "r")
"""Quantities of which such values are reported; a heading and a place jump by themselves."""
_ODD, _NEAR = 10.0, [True] * 8 + [False] * 3 + [True] * 8
"""A value is odd that lies so many times further beside its neighbours' middle than any of those about it."""


def without_lone(columns: dict[str, Array], remarks: list[str]) -> None:
    """Takes out rows in which one value stands off from both neighbours by more than a car can change, and they agree.

    columns: (n,) each, `t` [s] among them, in SI.
    """
    t = columns["t"]
    bad = np.zeros(len(t), dtype=bool)
    span = np.minimum(np.diff(t)[:-1], np.diff(t)[1:])
    for key, fastest in FASTEST.items():
        if key in columns:
            rows = standing_off(np.unwrap(columns[key]) if key == "psi" else columns[key], fastest * span)
            if len(rows):
                bad[rows] = True
                remarks.append(f"dropped {len(rows)} rows of a lone {key} that no car reaches")
    if bad.any():
        _keep(columns, ~bad)


def odd_values(values: Mapping[str, Array], times: Mapping[str, Array]) -> list[str]:
    """Which samples of each quantity stand off from all around them, in value or in time, in words, if any do.

    values, times: by quantity, (n,) each, in SI [s], as they were read, before they are brought to one clock.
    """
    told, clocks = list[str](), list[Array]()
    for quantity, numbers in values.items():
        t = times[quantity]
        known = np.isfinite(t) & np.isfinite(numbers)
        t, numbers = t[known], numbers[known]
        if len(t) < len(_NEAR):
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


def standing_off(values: Array, least: float | Array) -> NDArray[np.intp]:
    """Rows whose value alone lies beside the middle of its neighbours, by more than `least` and ten times as far as any
    other near it: of a signal with noise or in steps, hardly any."""
    beside = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    # a spoilt value moves its neighbours' middles too, by half: those next to it count for less
    most = np.maximum(1.5 * scipy.ndimage.maximum_filter(beside, footprint=[True, False, True], mode="constant"), least)
    np.maximum(most, _ODD * scipy.ndimage.maximum_filter(beside, footprint=_NEAR, mode="constant"), out=most)
    return np.flatnonzero(beside > most) + 1


V_DRIVING = 3.0
"""From this speed on [m/s] a drive shows the car; below, the models roll kinematically."""

LEAST = 20.0
"""Least driving to identify from [s]."""
TURNING = 3e-4
"""Standard deviation of the curvature from which on a drive turns [1/m]."""
SETTLE = 1.0
"""After a gap, and at the start, the model has this long to forget what it does not know [s]."""
SCALE_WINDOW, SCALE_UNKNOWN = 5.0, 0.05
"""A gyro is compared with the heading over so long [s]; standard deviation of its scale where there is none [1]."""
HEADING_WINDOW = 0.2
"""Length of the parabola whose slope is the yaw rate, where only the heading was recorded [s]."""
_SPLIT = "split the file there, and read each part with its own unit"
_GO_ON = "To go on as it is: trusted=True (identify: --trust-units)"
_STRAIGHT = "it hardly turns: units and signs cannot be judged, and nothing can be identified; add bends"
PLAUSIBLE = (15.0, 120.0)
"""Steering-wheel angle over curvature, n (L + K v^2) [m], that a road car can have."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Drive:
    """Steering-wheel angle, speed and yaw rate of a drive, evenly sampled; `Drive.of` makes one from raw columns."""

    name: str
    """Where it came from, for messages and files."""
    dt: float
    """The common clock's step [s]."""
    delta_sw: Array
    """Steering-wheel angle, or its command, + = left (n,) [rad]."""
    v: Array
    """Speed (n,) [m/s]."""
    r: Array
    """Yaw rate (n,) [rad/s]."""
    measured: NDArray[np.bool_]
    """Where samples were recorded, that is not in a gap nor within 1 s after one (n,)."""
    calibrated: bool
    """Is the yaw rate's zero known, from the heading?"""
    scale_deviation: float = SCALE_UNKNOWN
    """Standard deviation of the yaw rate's scale, 0 where it is the heading's slope [1]."""
    psi: Array | None = None
    """Heading without jumps, + = counter-clockwise (n,) [rad]; None where the log has none."""
    x: Array | None = None
    """Where the car was, east or as the log has it (n,) [m]; NaN where not known, None where the log has none."""
    y: Array | None = None
    """The same, north."""
    v_y: Array | None = None
    """Lateral velocity of the centre of gravity, + = left (n,) [m/s]; None where the log has none."""
    commanded: bool = False
    """Is delta_sw what the steering was asked for, by its channel's name? Else it counts as what the wheel did."""
    notes: tuple[str, ...] = ()
    """What was read and what was repaired, in words."""
    digest: str = ""
    """SHA-256 of the file, for provenance."""

    @property
    def t(self) -> Array:
        """Time from the start (n,) [s]."""
        return np.arange(len(self.v)) * self.dt

    @property
    def driving(self) -> NDArray[np.bool_]:
        """The samples that a model is fitted to: recorded, and 3 m/s or faster (n,)."""
        return self.measured & (self.v >= V_DRIVING)

    @property
    def turns(self) -> bool:
        """Does it turn enough to identify the car? Else not even units and signs can be judged."""
        use = self.driving
        return bool(use.any()) and float(np.std(self.r[use] / self.v[use])) > TURNING

    def to_log(self) -> Log:
        """The drive as a Log: `save` writes it as .csv, .npz or .parquet, which `read_drive` reads again."""
        signals = {"delta_sw": self.delta_sw, "v": self.v, "r": self.r}
        signals |= {key: value for key, value in vars(self).items() if key in ("psi", *PLACES) and value is not None}
        return Log(self.t, signals, {key: QUANTITIES[key] for key in signals})

    @classmethod
    def of(
        cls,
        given: Mapping[str, ArrayLike | None],
        *,
        name: str = "drive",
        dt: float | None = None,
        trusted: bool = False,
        notes: Sequence[str] = (),
        digest: str = "",
        commanded: bool = False,
    ) -> "Drive":
        """A drive from columns in SI (n,): t, delta_sw, v, r or psi or both, x and y if known; on one clock.

        Repaired, with a note each: rows that are not finite, rows out of order, repeated times, lone values that no
        car reaches, gaps (bridged, and left out of every comparison), a yaw rate whose zero differs from the heading's
        rate. x, y may be unknown (NaN) in places. r from psi: slope of a
        parabola over 0.2 s. dt: the clock's step [s] (default: the recording's, within 0.01 to 0.05). trusted: do not
        judge whether units and signs are plausible. Raises ValueError for what cannot be repaired, with advice.
        """
        columns = {key: np.asarray(value, dtype=float).ravel() for key, value in given.items() if value is not None}
        del given  # a long drive is not in memory twice
        remarks = list(notes)
        without_lone(_whole_rows(columns, name, remarks), remarks)
        step, gaps = _steps(t := columns["t"], name, remarks)
        _check_units(columns, name)
        if not trusted:
            _check_ranges(columns, name)
        if dt is None:
            dt = float(np.clip(round(step, 3), 0.01, 0.05))
        require(1e-3 <= dt <= 0.1, name, f"dt = {dt} s, expected 0.001 to 0.1")
        even = _resampled(columns, dt, step)
        measured = _measured(t, gaps, even["t"])
        seconds = float(np.sum(measured & (even["v"] >= V_DRIVING))) * dt
        require(seconds >= LEAST, name, f"only {seconds:.1f} s at {V_DRIVING:g} m/s or faster, expected {LEAST:g} s")
        rate, calibrated, scale_deviation = _yaw_rate(even, measured, dt, name, remarks, trusted)
        drive = cls(
            name=name,
            dt=dt,
            r=rate,
            measured=measured,
            calibrated=calibrated,
            scale_deviation=scale_deviation,
            notes=tuple(remarks),
            digest=digest,
            commanded=commanded,
            **{key: even[key] for key in ("delta_sw", "v", "psi", *PLACES) if key in even},
        )
        if not trusted:
            _check_speeds_unit(drive, t)
            _check_plausible(drive)
        more = [_late(drive)] if drive.turns else [_STRAIGHT]
        return replace(drive, notes=(*drive.notes, *filter(None, more)))


def _keep(columns: dict[str, Array], rows: Any) -> None:
    """Of each column those rows."""
    for key in columns:
        columns[key] = columns[key][rows]


def _whole_rows(columns: dict[str, Array], name: str, remarks: list[str]) -> dict[str, Array]:
    """Finite rows, rising in t; the same dictionary."""
    lengths = {key: len(value) for key, value in columns.items()}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{name}: columns of different lengths: {', '.join(f'{k} {n}' for k, n in lengths.items())}")
    finite = np.ones(len(columns["t"]), dtype=bool)
    for key in columns.keys() - set(PLACES):
        finite &= np.isfinite(columns[key])
    lost = int(np.sum(~finite))
    require(finite.sum() >= 100, name, f"{int(finite.sum())} whole rows of {len(finite)}, expected 100 or more")
    if lost:
        remarks.append(f"dropped {lost} of {len(finite)} rows that hold no number")
        _keep(columns, finite)
    t = columns["t"]
    stray = standing_off(t, max(5.0 * float(np.median(np.abs(np.diff(t)))), 0.25))  # of a spoilt digit, say
    stray = stray[np.sign(t[stray] - t[stray - 1]) * np.sign(t[stray + 1] - t[stray]) < 0.0]  # not one at a gap
    if len(stray):
        remarks.append(f"dropped {len(stray)} rows whose time is far from that of the rows around them")
        _keep(columns, np.delete(np.arange(len(t)), stray))
    t = columns["t"]
    back = int(np.sum(np.diff(t) < 0.0))
    if back:
        order = np.argsort(t, kind="stable")
        rough, smooth = (float(np.abs(np.diff(columns["v"][rows])).sum()) for rows in (slice(None), order))
        if smooth > 1.5 * rough + 1.0:
            row = int(np.argmax(np.diff(t) < 0.0)) + 1
            what = f"time runs back at row {row} (from {t[row - 1]:.6g} to {t[row]:.6g} s)"
            cure = "they lie one after the other in this file; split it there"
            raise ValueError(f"{name}: {what}, and sorting would mix two recordings: {cure}")
        _keep(columns, order)
        reverse = back > 0.9 * (len(t) - 1)
        some = f"sorted by time: {back} times a row was earlier than the one before"
        remarks.append("turned round, as its time falls from row to row" if reverse else some)
    new = np.concatenate(([True], np.diff(columns["t"]) > 0.0))
    if not new.all():
        _keep(columns, new)
        remarks.append(f"dropped {int(np.sum(~new))} rows that repeat the time of the one before")
    return columns


def _steps(t: Array, name: str, remarks: list[str]) -> tuple[float, NDArray[np.intp]]:
    """The usual step [s], and the numbers of the rows before gaps."""
    steps = np.diff(t)
    step = float(np.median(steps))
    if not 5e-4 <= step <= 0.5:
        units = {1e-3: "ms", 1e-6: "us", 1e-9: "ns", 60.0: "min"}
        fits = [unit for factor, unit in units.items() if 2e-3 <= factor * step <= 0.25]
        advice = f'is t in {fits[0]}? Say unit = "{fits[0]}" in the column map' if fits else "is it the right column?"
        raise ValueError(f"{name}: t steps by {step:g} s, expected 0.0005 to 0.5 s; {advice}")
    gaps = np.flatnonzero(steps > max(5.0 * step, 0.25))
    if len(gaps):
        lost, share = float(steps[gaps].sum()), float(steps[gaps].sum() / (t[-1] - t[0]))
        few = f"{lost:.0f} s of {t[-1] - t[0]:.0f} s are gaps: too little is left"
        require(share <= 0.5, name, f"{few}; is t the right column, in seconds?")
        longest = f"(the longest {steps.max():.1f} s)"
        remarks.append(f"{len(gaps)} gaps, {lost:.1f} s in all {longest}: bridged, not compared")
    return step, gaps


_FASTEST_YAW, _FASTEST_SMALL = 2.5, 12.0
"""What a road car turns at most, and a small one, of a tenth its length [rad/s]."""


def _is_small(r: Array, v: Array) -> bool:
    """Does it turn faster than a road car, at a lateral acceleration r v that tyres allow, 20 m/s^2?"""
    return bool(_FASTEST_YAW < np.abs(r).max() <= _FASTEST_SMALL and np.abs(r * v).max() <= 20.0)


def _check_units(columns: dict[str, Array], name: str) -> None:
    """ValueError where a signal jumps by what lies between two of its units, and as its size goes on so."""
    for quantity, least, factor, what in (  # least: below, a sensor that wakes up may jump so
        ("v", 1.0, 3.6, "m/s and km/h"),
        ("delta_sw", 0.02, 1.0 / RAD_PER_DEG, "rad and deg"),
        ("r", 0.005, 1.0 / RAD_PER_DEG, "rad/s and deg/s"),
    ):
        size, t = np.abs(columns.get(quantity, np.zeros(2))), columns["t"]
        pair = np.sort(np.column_stack((size[:-1], size[1:])))
        jump = pair[:, 1] - pair[:, 0] > FASTEST[quantity] * np.maximum(np.diff(t), 1e-3)
        rows = np.flatnonzero(jump & (np.abs(pair[:, 1] / np.maximum(pair[:, 0], least) / factor - 1.0) < 0.1)) + 1
        for row in rows:
            near = (np.median(size[max(row - 8, 0) : row]), np.median(size[row : row + 8]))
            if abs(max(near) / max(min(near), 1e-9) / factor - 1.0) < 0.2:
                change = f"from {size[row - 1]:.4g} to {size[row]:.4g} at row {row} of numbers (t = {t[row]:.6g} s)"
                raise ValueError(f"{name}: {quantity} goes {change}: its unit changes there between {what}; {_SPLIT}")


def _check_ranges(columns: dict[str, Array], name: str) -> None:
    """Values that no car reaches are mostly a unit's fault."""
    small = _is_small(columns.get("r", np.zeros(1)), columns["v"])
    fastest = _FASTEST_SMALL if small else _FASTEST_YAW
    limits = {"delta_sw": (17.5, "rad", "deg"), "v": (100.0, "m/s", "km/h"), "r": (fastest, "rad/s", "deg/s")}
    for quantity, (high, unit, likely) in limits.items():
        largest = float(np.abs(columns.get(quantity, np.zeros(1))).max())
        cure = f'is it in {likely}? Say unit = "{likely}" in the column map'
        require(largest <= high, name, f"{quantity} reaches {largest:.4g} {unit}, expected {high:g} at most; {cure}")
    lowest = float(columns["v"].min())
    backwards = f"v falls to {lowest:.3g} m/s: reversing is not modelled; cut it out, or mind v's sign"
    require(lowest >= -1.0, name, backwards)
    jumps = np.abs(np.diff(columns.get("psi", np.zeros(2))))
    degrees = 'psi jumps by 360: it is in deg; say unit = "deg" in the column map'
    require((np.abs(jumps - 360.0) >= 30.0).all(), name, degrees)


def _resampled(columns: dict[str, Array], dt: float, step: float) -> dict[str, Array]:
    """All on t = 0, dt, 2 dt, ...: averaged first where the recording is finer, then linear. Empties `columns`."""
    t = columns.pop("t")
    t = t - t[0]
    clock = np.arange(int(t[-1] / dt + 1e-6) + 1) * dt
    width = round(dt / step)
    even: dict[str, Array] = {"t": clock}
    for key in list(columns):
        value = columns.pop(key)
        value = np.unwrap(value) if key == "psi" else value
        known = np.isfinite(value)
        if known.all():
            even[key] = np.interp(clock, t, scipy.ndimage.uniform_filter1d(value, width) if width >= 2 else value)
        elif known.any():
            even[key] = np.interp(clock, t[known], value[known])
            even[key][~np.interp(clock, t, known.astype(float)).astype(bool)] = np.nan
    np.maximum(even["v"], 0.0, out=even["v"])
    return even


def _measured(t: Array, gaps: NDArray[np.intp], clock: Array) -> NDArray[np.bool_]:
    kept: NDArray[np.bool_] = clock >= SETTLE
    for row in gaps:
        kept &= (clock <= t[row] - t[0]) | (clock >= t[row + 1] - t[0] + SETTLE)
    return kept


def _yaw_rate(
    even: dict[str, Array], measured: NDArray[np.bool_], dt: float, name: str, remarks: list[str], trusted: bool
) -> tuple[Array, bool, float]:
    """The yaw rate, with the heading's zero and scale; whether there is a heading; the scale's deviation.

    Zero and scale are the line of turns by the gyro over those of the heading, over 5 s each: the slope over a short
    time would have the heading's noise in it, and make the scale too small.
    """
    if "psi" not in even:
        return even["r"], False, SCALE_UNKNOWN
    if "r" not in even:
        window = 2 * round(0.5 * HEADING_WINDOW / dt) + 1
        remarks.append(f"yaw rate: slope of the heading over {window * dt:.2f} s")
        return scipy.signal.savgol_filter(even["psi"], window, 2, deriv=1, delta=dt), True, 0.0
    use = measured & (even["v"] >= V_DRIVING)
    n = round(SCALE_WINDOW / dt)
    through = np.convolve(use, np.ones(n + 1), mode="valid") > n + 0.5
    gyro = scipy.integrate.cumulative_trapezoid(even["r"], dx=dt, initial=0.0)
    turned, shown = ((a[n:] - a[:-n])[through] / SCALE_WINDOW for a in (even["psi"], gyro))
    if len(shown) < n or np.std(turned) < 1e-3:
        turned, shown = (a[use] for a in (np.gradient(even["psi"], dt), even["r"]))
    gain, correlation = _line(turned, shown)
    if not trusted and not 0.8 < gain < 1.25:
        fault = "has the other sign than" if gain < 0.0 else f"is {gain:.3g} times"
        cure = "mind unit and sign of r and psi in the column map (a compass turns clockwise: scale = -1)"
        raise ValueError(f"{name}: the yaw rate {fault} the heading's rate of change; {cure}")
    independent = max(2.0, len(shown) / n - 2.0)
    deviation = float(np.sqrt(max(0.0, 1.0 - correlation**2) / independent) / max(abs(correlation), 0.1))
    scale = gain if 3.0 * deviation < abs(gain - 1.0) < 0.25 and abs(gain - 1.0) > 0.01 else 1.0
    if scale != 1.0:
        remarks.append(f"yaw rate: over {scale:.3f}, as the turns of the heading are: the gyro's scale, or a bank")
    bias = float(np.mean(shown - scale * turned)) / scale
    if abs(bias) > 2e-4:
        remarks.append(f"yaw rate: {-bias:+.5f} rad/s, so that its mean is the heading's rate")
    return even["r"] / scale - bias, True, max(deviation, abs(gain / scale - 1.0))


def _check_speeds_unit(drive: Drive, t: Array) -> None:
    """ValueError where v changes between m/s and km/h while the car stands, or in a gap; t: of the rows [s].

    By delta_sw = a r/v + b v r + c, linear least squares over the drive: it leaves 0.35 at most of what it leaves
    with one unit, and a tenth of the wheel's variance, if v after one of the stops is taken in the other unit.
    """
    step = max(1, round(0.05 / drive.dt))
    at = np.flatnonzero(drive.driving[::step]) * step
    v, r, wheel = drive.v[at], drive.r[at], drive.delta_sw[at]
    begins, enough = np.flatnonzero(np.diff(at) > step) + 1, 5.0 / (drive.dt * step)
    begins = begins[(begins >= enough) & (len(at) - begins > enough)]
    if not len(begins) or not drive.turns:
        return

    def left(factor: float = 1.0, k: int = 0) -> float:
        """Squares that the line leaves [rad^2], with v times `factor` from sample k on."""
        w = np.concatenate((v[:k], factor * v[k:]))
        rows = np.column_stack((r / w, w * r, np.ones(len(w)), wheel))
        g = rows.T @ rows
        return float(g[3, 3] - g[3, :3] @ np.linalg.lstsq(g[:3, :3], g[:3, 3])[0])

    least = min(0.35 * left(), 0.1 * len(wheel) * float(np.var(wheel)))
    best, factor, k = min((left(factor, k), factor, k) for factor in (3.6, 1.0 / 3.6) for k in begins.tolist())
    if best < least:
        row = int(np.searchsorted(t - t[0], drive.t[at[k]]))
        now, then = ("m/s", "km/h") if factor > 1.0 else ("km/h", "m/s")
        change = f"from {then} to {now} at a stop before row {row} of numbers (t = {t[row]:.6g} s)"
        what = f"v goes with the wheel's angle and the yaw rate as if its unit changed {change}"
        raise ValueError(f"{drive.name}: {what}; {_SPLIT}. {_GO_ON}")


def _check_plausible(drive: Drive) -> None:
    """Does the wheel's angle over the curvature have the size of a car's?"""
    use = drive.driving
    if not drive.turns:
        return
    slope, correlation = _line(drive.r[use] / drive.v[use], drive.delta_sw[use])
    apart = f"steering and curvature r/v go together by {correlation:.2f} only (1: fully); wrong columns or clocks?"
    require(abs(correlation) > 0.7, drive.name, apart)
    small = _is_small(drive.r, drive.v)
    if (0.1 if small else PLAUSIBLE[0]) <= slope <= PLAUSIBLE[1]:
        return
    causes: dict[str, float] = {
        'delta_sw is in degrees (unit = "deg")': RAD_PER_DEG,
        'the yaw rate is in degrees (unit = "deg/s", "deg")': 1.0 / RAD_PER_DEG,
        'v is in km/h (unit = "km/h")': 1.0 / 3.6,
        "v is in m/s and was read as km/h": 3.6,
        "delta_sw is the road wheels' angle (scale = the steering ratio, about 15)": 15.0,
    }
    flip = -1.0 if slope < 0.0 else 1.0
    turned = "one of delta_sw and r has the wrong sign (scale = -1)"
    fits = [turned] if 20.0 <= -slope <= 90.0 else []
    fits += [
        cause + (f", and {turned}" if flip < 0.0 else "")
        for cause, factor in causes.items()
        if 20.0 <= flip * slope * factor <= 90.0
    ]
    likely = f"; perhaps {'; or '.join(fits)}" if fits else ""
    usual = f"a road car has {PLAUSIBLE[0]:g} to {PLAUSIBLE[1]:g} m (steering ratio times wheelbase)"
    raise ValueError(f"{drive.name}: delta_sw/curvature is {slope:.4g} m, {usual}{likely}. {_GO_ON}")


LATEST, EARLIEST = 0.7, -0.3
"""By how much a yaw rate may follow the steering [s]: more is of no car, but of its clock."""
_SOUGHT = 3.0
"""Lags up to this are looked for [s]."""


def _late(drive: Drive) -> str:
    """Whether the yaw rate is late against the steering, or early, by more than a car can be: what to do; else "".

    By the correlation of r with v delta_sw over the drive, shifted against each other.
    """
    some = slice(None, None, max(1, round(0.05 / drive.dt)))  # a long drive is not in memory several times
    use, dt = drive.driving[some], drive.dt * (some.step or 1)
    steered, turned = drive.v[some] * drive.delta_sw[some], drive.r[some]
    steered, turned = (np.where(use, a - a[use].mean(), 0.0) for a in (steered, turned))
    n = min(round(_SOUGHT / dt), len(use) // 4)
    together = scipy.signal.correlate(turned, steered, "full", "fft")[len(use) - 1 - n : len(use) + n]
    lag, most = (int(np.argmax(np.abs(together))) - n) * dt, float(np.abs(together).max())
    inside = EARLIEST <= lag <= LATEST or abs(abs(lag) - n * dt) < 1.5 * dt
    if inside or most < 1.02 * abs(float(together[n])):
        return ""
    word = f"{lag:.2f} s after" if lag > 0.0 else f"{-lag:.2f} s before"
    return (
        f"the yaw rate comes {word} the steering, as far as they are alike: of two clocks? shift its times by "
        f"{-lag:+.2f} s in the log, or leave it out where there is a heading"
    )


def _line(x: Array, y: Array) -> tuple[float, float]:
    """Slope of y over x by least squares, and their correlation; 0 where one of them is constant."""
    x, y = x - x.mean(), y - y.mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    return (xy / xx, xy / float(np.sqrt(xx * yy))) if min(xx, yy) > 0.0 else (0.0, 0.0)
