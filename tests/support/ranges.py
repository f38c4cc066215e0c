"""The ends of a parameter's range: what lies at an end is accepted, what lies just beyond is refused."""

import math
from collections.abc import Callable
from typing import Any

import pytest


def keeps_range(make: Callable[..., Any], name: str, interval: str) -> None:
    """`make(name=value)` accepts all of an interval such as "(0.0, 2.0]", or "[1, inf)" of whole numbers, and no more.

    Just beyond an end is the next number; ValueError has to name the parameter.
    """
    whole = "." not in interval
    ends = zip(map(float, interval[1:-1].split(",")), (-math.inf, math.inf), (interval[0] == "[", interval[-1] == "]"))
    for end, beyond, closed in ends:
        if math.isfinite(end):
            after = end + math.copysign(1.0, beyond) if whole else math.nextafter(end, beyond)
            before = math.nextafter(end, -beyond)
            good, bad = (end, after) if closed else (before, end)
            number = int if whole else float
            make(**{name: number(good)})
            with pytest.raises(ValueError, match=name):
                make(**{name: number(bad)})
