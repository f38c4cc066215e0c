"""Addresses of courses."""

from __future__ import annotations

import pytest

from steerkit.paths.importers import Address, is_road


def test_an_address_names_a_file_and_what_of_it() -> None:
    one = Address.parsed("maps/town.xodr#road=1,lane=-1,noise=0.05,closed=no,reverse=yes")
    assert (one.file, dict(one.choice)) == ("maps/town.xodr", {"road": "1", "lane": "-1"})
    assert (one.noise, one.closed, one.reverse) == (0.05, False, True)
    assert one.name == "town-road1-lane-1-reversed"
    plain = Address.parsed("lap.gpx")
    assert (plain.noise, plain.closed, plain.reverse, plain.name) == (None, None, False, "lap")


def test_names_hold_nothing_that_parts_names_or_folders() -> None:
    assert "--" not in Address.parsed("a--b.xodr#road=-1,lane=-1").name
    assert "/" not in Address.parsed("x.gpx#track=a/b c").name


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("lap.kml", r"ending '.kml' is not known.*valid: .csv, .gpx, .geojson, .json, .xodr, .xml, .osm"),
        ("lap", "ending 'none' is not known"),
        ("lap.gpx#noise", "'noise', expected KEY=VALUE"),
        ("lap.gpx#noise=", "expected KEY=VALUE"),
        ("lap.gpx#noise=-1", r"noise = -1 \[m\], expected 0 to 10"),
        ("lap.gpx#noise=nan", r"noise = nan \[m\], expected 0 to 10"),
        ("lap.gpx#noise=1,noise=2", "noise stands twice"),
        ("lap.gpx#closed=maybe", "closed 'maybe' is not known.*valid: yes, no"),
        ("lap.gpx#road=1", "GPX key 'road' is not known.*valid: track, lap, noise, closed, reverse"),
    ],
)
def test_other_addresses_are_refused(text: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Address.parsed(text)


def test_a_plain_csv_is_read_as_ever() -> None:
    assert not is_road("yard.csv")
    assert not is_road("paper")
    assert is_road("yard.csv#noise=0.5")
    assert is_road("LAP.GPX")
