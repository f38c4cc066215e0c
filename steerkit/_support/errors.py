"""What is wrong, said so that it teaches: where, what, the unit, what was expected, the valid choices."""

import dataclasses
import difflib
import importlib
import math
from collections.abc import Iterable, Mapping
from numbers import Integral
from typing import Any

import numpy as np

_PLAIN = (float, int)


class WiringError(ValueError):
    """A loop that cannot run as it is wired; raised when the loop is built."""


def require(ok: Any, where: str, what: str) -> None:
    """Raise ValueError `where: what` unless `ok` (for all cars, if an array); blocks check their parameters with it."""
    if not (ok.all() if hasattr(ok, "all") else ok):
        raise ValueError(f"{where}: {what}")


def optional(module: str, where: str, extra: str) -> Any:
    """A module of an optional package; raises ValueError, naming the extra that brings it, where it is not installed.

    where: what needs it, such as `a.parquet: Parquet`.
    """
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise ValueError(f"{where} needs {package}: pip install 'steerkit-control[{extra}]'") from None


def nearest(name: str, names: Iterable[str]) -> str:
    """` (did you mean 'car'?)`, or nothing, for an error."""
    near = difflib.get_close_matches(name, list(names), n=1, cutoff=0.4)
    return f" (did you mean '{near[0]}'?)" if near else ""


def known(name: str, names: Iterable[str], where: str, *, also: str = "") -> str:
    """`name` itself, if it is one of `names`; else a ValueError with the nearest and with all that are valid.

    where: what kind of name it is, such as `course`. also: what is valid besides, such as `FILE.csv`.
    """
    valid = list(names)
    if name in valid:
        return name
    expected = f"{', '.join(valid)}{', ' if also else ''}{also}"
    raise ValueError(f"{where} '{name}' is not known{nearest(name, valid)}; valid: {expected}")


def require_within(
    where: str, name: str, value: Any, unit: str, low: Any, high: Any, hint: str = "", *, above: bool = False
) -> None:
    """Raise a teaching ValueError unless low <= value <= high, for a number or for every entry of an array.

    above: `low` itself is not valid.
    """
    if type(value) in _PLAIN and type(low) in _PLAIN and type(high) in _PLAIN:
        if low <= value <= high and not (above and value == low):
            return
    else:
        numbers = np.asarray(value)
        if numbers.dtype.kind not in "iuf":
            raise ValueError(f"{where}: {name} = {value!r}, expected a number [{unit}]")
        if ((low <= numbers) & (numbers <= high)).all() and not (above and (numbers == low).any()):
            return
    least, most = f"{np.min(low):.6g}", f"{np.max(high):.6g}"
    expected = f"{least} to {most}"
    if above or "inf" in expected:
        bounds = [f"{'>' if above else '>='} {least}"] * (least != "-inf") + [f"<= {most}"] * (most != "inf")
        expected = " and ".join(bounds) or "a number"
    raise ValueError(f"{where}: {name} = {value} [{unit}], expected {expected}{'; ' if hint else ''}{hint}")


def number(
    default: Any = dataclasses.MISSING,
    unit: str = "1",
    *,
    low: float = -math.inf,
    high: float = math.inf,
    above: float | None = None,
) -> Any:
    """A dataclass field for a number [unit] from `low` (or above `above`) to `high`, or for one number per car.

    `check_numbers` checks it; every block does so when it is made. A field of type int takes whole numbers only.
    NaN is never valid; with a default of None, None is.
    """
    bounds = (unit, low if above is None else above, high, above is not None)
    return dataclasses.field(default=default, metadata={"number": bounds})


def check_numbers(of: Any, where: str) -> None:
    """Raise ValueError for a field of the dataclass object `of`, made by `number`, that is not in its range."""
    for f in dataclasses.fields(of):
        value = getattr(of, f.name)
        if "number" in f.metadata and not (value is None and f.default is None):
            unit, low, high, above = f.metadata["number"]
            whole = f.type not in ("int", int) or isinstance(value, Integral)
            require(whole, where, f"{f.name} = {value!r}, expected a whole number")
            require_within(where, f.name, value, unit, low, high, above=above)


_HELD = {float: "a number", int: "a whole number", str: "a text", bool: "true or false", tuple[float, ...]: "numbers"}
"""What a field of that annotation holds, as an error calls it."""


def made_of(kind: Any, table: Any, where: str) -> Any:
    """The dataclass object whose fields stand in a table of a file; what is left out takes its default.

    Raises ValueError, in the name of `where`, for what is no table, an unknown key, a value of another type than its
    field's, a key that is lacking, and what the class refuses.
    """
    require(isinstance(table, Mapping), where, f"{table!r:.60}, expected a table")
    valid = {f.name: f for f in dataclasses.fields(kind)}
    values = {key: tuple(value) if isinstance(value, list) else value for key, value in table.items()}
    for key, value in values.items():
        require(key in valid, where, f"no key '{key}'{nearest(key, valid)}; valid: {', '.join(valid)}")
        wanted: Any = valid[key].type
        if wanted in _HELD:
            require(_holds(wanted, value), where, f"{key} = {value!r:.60}, expected {_HELD[wanted]}")
    try:
        return kind(**values)
    except TypeError as error:
        lacking = [key for key, f in valid.items() if key not in table and f.default is f.default_factory]
        raise ValueError(f"{where}: lacks {', '.join(lacking) or error}") from error
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from error


def _holds(wanted: Any, value: Any) -> bool:
    if wanted == tuple[float, ...]:
        return isinstance(value, tuple) and all(_holds(float, one) for one in value)
    return isinstance(value, _PLAIN if wanted is float else wanted) and (wanted is bool or not isinstance(value, bool))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Checked:
    """A dataclass whose fields made by `number` are in their ranges: ValueError, in the name of its class, else."""

    def __post_init__(self) -> None:
        check_numbers(self, type(self).__name__)


def whole_samples(where: str, name: str, value: Any, dt: float) -> int:
    """How many samples of dt [s] a pure delay lasts; raises ValueError unless it is a whole number of them, 0 to 1000.

    One number for all cars of a batch: it decides how many values the state holds.
    """
    require(np.ndim(value) == 0, where, f"{name} [s] has shape {np.shape(value)}, expected one number for all cars")
    require_within(where, name, value, "s", 0.0, 1000.0 * dt)
    n = round(value / dt)
    nearest = f"{n * dt:g} or {(n + 1 if value > n * dt else max(n - 1, 0)) * dt:g}"
    ok = abs(value - n * dt) <= 1e-9
    require(ok, where, f"{name} = {value} [s], expected a multiple of dt = {dt:g} s; valid: {nearest}, or a finer dt")
    return n


def in_one_line(error: BaseException, *, foreign: bool = False) -> str:
    """An error in one line: what, where, the notes that it was given on its way; of `foreign` code, its kind too."""
    text = str(error.args[0] if isinstance(error, KeyError) and error.args else error)
    if isinstance(error, OSError) and error.strerror:
        name = f"{error.filename}: " if error.filename is not None else ""
        text = f"{name}{error.strerror}"
    kind = f"{type(error).__name__}: " if foreign and not isinstance(error, WiringError) else ""
    notes = getattr(error, "__notes__", ()) if foreign or isinstance(error, OSError) else ()
    line = " ".join("; ".join([f"{kind}{text}", *notes]).split("\n"))
    return "".join(sign if sign.isprintable() else f"{sign!r}"[1:-1] for sign in line)  # a terminal obeys some of these
