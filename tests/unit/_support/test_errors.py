"""Errors teach: a hint for a mistyped name, what is valid, and bounds that hold for every car of a batch."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steerkit._support.errors import check_numbers, made_of, number, optional, require, whole_samples


def test_a_package_that_is_not_installed_is_named_with_the_extra_that_brings_it() -> None:
    assert optional("math", "a", "b") is math
    with pytest.raises(ValueError, match=r"^a\.x: X needs no_such: pip install 'steerkit-control\[logs\]'$"):
        optional("no_such.thing", "a.x: X", "logs")


def test_what_does_not_hold_for_one_car_is_an_error() -> None:
    require(np.array([True, True]), "Block", "never said")
    for wrong in (False, np.array([True, False])):
        with pytest.raises(ValueError, match=r"^Block: k = 0 \[1\], expected > 0$"):
            require(wrong, "Block", "k = 0 [1], expected > 0")


@dataclass
class Numbers:
    """A field of each kind of range."""

    share: Any = number(1.0, "1", above=0.0, high=1.0)
    mass: Any = number(1.0, "kg", low=0.0)
    offset: Any = number(0.0, "rad", high=2.0)
    free: Any = number(0.0, "m")
    lag: Any = number(None, "s", low=0.1, high=2.0)
    count: int = number(1, "1", low=1)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"share": 0.0}, r"^Table: share = 0\.0 \[1\], expected > 0 and <= 1$"),
        ({"share": np.array([0.5, 0.0])}, "expected > 0 and <= 1"),
        ({"share": 1.01}, "expected > 0 and <= 1"),
        ({"mass": -0.1}, r"^Table: mass = -0\.1 \[kg\], expected >= 0$"),
        ({"offset": 2.1}, r"^Table: offset = 2\.1 \[rad\], expected <= 2$"),
        ({"free": math.nan}, r"^Table: free = nan \[m\], expected a number$"),
        ({"free": None}, r"^Table: free = None, expected a number \[m\]$"),
        ({"free": True}, r"free = True, expected a number \[m\]$"),
        ({"free": "1.5"}, r"free = '1\.5', expected a number \[m\]$"),
        ({"lag": 0.0}, "expected 0.1 to 2$"),
        ({"lag": np.array([1.0, 3.0])}, r"lag = \[1\. 3\.\] \[s\], expected 0.1 to 2$"),
        ({"count": 1.5}, r"^Table: count = 1\.5, expected a whole number$"),
    ],
)
def test_a_field_has_its_range_beside_it(given: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        check_numbers(Numbers(**given), "Table")


def test_bounds_beside_a_field_are_inside_unless_above() -> None:
    check_numbers(Numbers(share=1.0, mass=0.0, offset=-math.inf, lag=None), "Table")
    check_numbers(Numbers(share=np.array([0.5, 1e-9]), lag=0.1, offset=2.0), "Table")


@pytest.mark.parametrize(
    ("delay", "message"),
    [
        (0.024, r"delay = 0\.024 \[s\], expected a multiple of dt = 0\.01 s; valid: 0\.02 or 0\.03, or a finer dt"),
        (0.026, r"valid: 0\.03 or 0\.02, or a finer dt"),
        (0.004, r"valid: 0 or 0\.01"),
        (-0.01, "expected 0 to 10"),
        (10.01, "expected 0 to 10"),
        (np.array([0.01, 0.02]), r"delay \[s\] has shape \(2,\), expected one number for all cars"),
    ],
)
def test_a_delay_between_two_samples_is_an_error(delay: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        whole_samples("Block", "delay", delay, 0.01)


@dataclass(frozen=True)
class Row:
    """A field of each type that a file may hold."""

    name: str
    size: float = 1.0
    count: int = 1
    on: bool = False
    levels: tuple[float, ...] = ()
    rest: Any = None

    def __post_init__(self) -> None:
        require(self.size > 0.0, "row", f"size = {self.size}")


def test_a_table_of_a_file_becomes_an_object() -> None:
    table = {"name": "a", "size": 2, "on": True, "levels": [1, 0.5], "rest": [1]}
    assert made_of(Row, table, "f.toml") == Row("a", 2.0, 1, True, (1, 0.5), (1,))


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ([], r"^f\.toml: \[\], expected a table$"),
        ({"name": "a", "sizes": 1.0}, r"^f\.toml: no key 'sizes' \(did you mean 'size'\?\); valid: name, size, count"),
        ({"name": 1}, "^f.toml: name = 1, expected a text$"),
        ({"name": "a", "size": True}, "size = True, expected a number$"),
        ({"name": "a", "count": 1.0}, "count = 1.0, expected a whole number$"),
        ({"name": "a", "count": True}, "count = True, expected a whole number$"),
        ({"name": "a", "on": 1}, "on = 1, expected true or false$"),
        ({"name": "a", "levels": 1.0}, "levels = 1.0, expected numbers$"),
        ({"name": "a", "levels": [1.0, "b"]}, r"levels = \(1\.0, 'b'\), expected numbers$"),
        ({"size": 1.0}, "^f.toml: lacks name$"),
        ({"name": "a", "size": -1.0}, r"^f\.toml: row: size = -1\.0$"),
    ],
)
def test_a_mistake_in_a_table_is_named(table: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        made_of(Row, table, "f.toml")
