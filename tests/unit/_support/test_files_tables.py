"""Tables in text: whatever parts their columns, wherever their names stand."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit._support.files import parted, text_table

ROWS = [[0.0, -1.5], [1.25, 2e-3]]


@pytest.mark.parametrize(
    "text",
    [
        "a,b\n0,-1.5\n1.25,2e-3\n",
        "a;b\r\n0;-1,5\r\n1,25;2e-3\r\n",
        "# made by hand\n# a\tb\n0\t-1,5\n\n1.25\t0.002\n# end",
        "a|b\n0|-1.5\n1.25|.002",
        "# a b\n0 -1.5\n1.25  0.002\n",
        '"a","b"\n"0","-1.5"\n"1.25","0.002"\n',
    ],
)
def test_a_table_is_read_however_it_is_written(text: str) -> None:
    names, rows = text_table(text.splitlines(), "t.csv")
    assert names == ["a", "b"]
    assert [numbers for _, _, numbers in rows] == ROWS


@pytest.mark.parametrize(
    ("cell", "number"),
    [("00:01:02", 62.0), ("12:00:00.25", 43200.25), ("1970-01-01T00:01:00Z", 60.0), ("1970-01-01 00:01:00", 60.0)],
)
def test_a_time_is_a_number_of_seconds(cell: str, number: float) -> None:
    assert [row[2] for row in text_table(["t,x", f"{cell},1"], "")[1]] == [[number, 1.0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "t.csv: no rows under a row of names"),
        ("# only\n", "t.csv: no rows under a row of names"),
        ("1;2\n3;4\n", r"line 1 holds numbers \(1;2\), no names; put a row of 2 names above them"),
        ("# 3,4\n# a,b,c\n1,2\n", r"line 3 holds numbers \(1,2\)"),
    ],
)
def test_a_table_without_names_is_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        text_table(text.splitlines(), "t.csv")


@settings(max_examples=50)
@given(st.lists(st.text(max_size=30), max_size=6))
def test_no_text_leads_to_anything_but_a_table_or_that(lines: list[str]) -> None:
    try:
        _, rows = text_table(lines, "t.csv")
    except ValueError:
        return
    assert all(isinstance(number, float | None) for _, _, row in rows for number in row)


def test_a_unit_is_parted_from_its_name() -> None:
    assert [parted(name) for name in ("v [m/s]", "speed (km/h)", "x", "a(b)c", "[m]")] == [
        ("v", "m/s"),
        ("speed", "km/h"),
        ("x", ""),
        ("a(b)c", ""),
        ("[m]", ""),
    ]
