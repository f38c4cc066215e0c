"""The column map: wrong ones teach."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from steerkit.identification import ColumnMap


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"deltasw": "x"}, r"'deltasw' is no quantity \(did you mean 'delta_sw'\?\); valid: t, delta_sw"),
        ({"v": {"column": "x", "unit": "knots"}}, "unit 'knots' is not known; valid: m/s, km/h"),
        ({"v": {"column": "x", "units": "m/s"}}, "v.units is not known; valid: column, unit, scale, offset"),
        ({"v": {"unit": "m/s"}}, "give a name or"),
        ({"v": {"column": "x", "scale": 0}}, "scale = 0"),
    ],
)
def test_a_wrong_map_teaches(table: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        ColumnMap.of(table)


def test_column_words() -> None:
    words = ColumnMap.parsed(["delta_sw=df:rad:15.87", "v=speed:km/h", "r=wz"]).columns
    assert (words["delta_sw"].scale, words["v"].unit, words["r"].name) == (15.87, "km/h", "wz")
    with pytest.raises(ValueError, match="expected QUANTITY=COLUMN"):
        ColumnMap.parsed(["delta_sw"])
    with pytest.raises(ValueError, match="scale 'x' is no number"):
        ColumnMap.parsed(["delta_sw=a:rad:x"])


@pytest.mark.parametrize(
    ("quantity", "unit", "si"),
    [
        ("v", "mph", 1760.0 * 0.9144 / 3600.0),  # a mile is 1760 yards of 0.9144 m
        ("v", "kn", 1852.0 / 3600.0),
        ("v", "km/h", 1000.0 / 3600.0),
        ("t", "ms", 1.0 / 1000.0),
        ("t", "us", 1.0 / 1000.0**2),
        ("t", "ns", 1.0 / 1000.0**3),
        ("t", "min", 60.0),
        ("delta_sw", "deg", math.pi / 180.0),
        ("r", "deg/s", math.pi / 180.0),
        ("r", "mrad/s", 1.0 / 1000.0),
    ],
)
def test_units_are_what_their_definitions_say(quantity: str, unit: str, si: float) -> None:
    column = ColumnMap.of({quantity: {"column": "c", "unit": unit, "scale": -2.0, "offset": 0.5}})
    values = column.in_si({"c": np.array([0.0, 3.0])}, where="test")[quantity]
    np.testing.assert_allclose(values, [0.5, 0.5 - 6.0 * si], rtol=1e-14)  # the offset is in SI
