"""The rough map of land: nothing on land is at sea, and the open sea is."""

from __future__ import annotations

import pytest

from steerkit.land import near_land

LAND = {
    "Osnabrueck": (52.28, 8.02),
    "Munich": (48.14, 11.58),
    "Sylt": (54.91, 8.31),
    "Key West": (24.56, -81.78),
    "Berkeley": (37.87, -122.26),
    "Honolulu": (21.31, -157.86),
    "Sydney": (-33.87, 151.21),
    "Ushuaia": (-54.80, -68.30),
    "Malta": (35.90, 14.51),
    "Taveuni, on the date line": (-16.8, 179.99),
    "the South Pole": (-90.0, 180.0),
    "Alert": (82.50, -62.35),
}
SEA = {
    "Osnabrueck, swapped": (8.02, 52.28),
    "Amsterdam, swapped": (4.90, 52.37),
    "the Atlantic": (40.0, -40.0),
    "the Pacific": (0.0, -150.0),
    "zero": (0.0, 0.0),
    "the North Pole": (90.0, 0.0),
}


@pytest.mark.parametrize("name", LAND)
def test_land_is_land(name: str) -> None:
    assert near_land(*LAND[name])


@pytest.mark.parametrize("name", SEA)
def test_sea_is_sea(name: str) -> None:
    assert not near_land(*SEA[name])
