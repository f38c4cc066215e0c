"""The column map: wrong ones teach."""

from __future__ import annotations

from typing import Any

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
