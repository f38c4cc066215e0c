"""Channels of different rates on one clock."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.logs.drive import aligned, in_metres


def test_channels_of_different_rates_come_to_the_clock_of_the_fastest() -> None:
    fast, slow = np.arange(0.0, 10.0, 0.01), np.arange(0.5, 9.0, 0.1)
    notes: list[str] = []
    even = aligned({"v": 2.0 * slow, "r": np.sin(fast)}, {"v": slow, "r": fast}, "test", notes)
    np.testing.assert_array_equal(even["t"], fast[(fast >= slow[0]) & (fast <= slow[-1])])
    np.testing.assert_allclose(even["v"], 2.0 * even["t"], atol=1e-12)
    np.testing.assert_array_equal(even["r"], np.sin(even["t"]))
    assert notes == ["one clock of 100 Hz for channels of v 10, r 100 Hz"]


def test_where_a_channel_pauses_nothing_is_made_up() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    there = (t < 4.0) | (t > 6.0)
    even = aligned({"v": t[there], "r": t}, {"v": t[there], "r": t}, "test", [])
    inside = (even["t"] > 4.001) & (even["t"] < 5.999)
    assert np.isnan(even["v"][inside]).all()
    assert np.isfinite(even["v"][~inside & (even["t"] < 3.99)]).all()


def test_where_the_car_was_may_be_unknown_without_a_row_lost() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    gps = np.arange(3.0, 5.0, 0.1)
    even = aligned({"v": t, "x": gps, "y": gps}, {"v": t, "x": gps, "y": gps}, "test", [])
    assert len(even["t"]) == len(t)
    known = np.isfinite(even["x"])
    np.testing.assert_allclose(even["x"][known], even["t"][known], atol=1e-9)
    assert known.sum() == pytest.approx(190, abs=2)


def test_clocks_that_do_not_overlap_teach() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    with pytest.raises(ValueError, match=r"clocks do not overlap: v 0 to 9.9, r 1000 to 1009.9 \[s\]"):
        aligned({"v": t, "r": t}, {"v": t, "r": t + 1000.0}, "test", [])


def test_positions_become_metres_and_a_receiver_without_a_fix_is_nowhere() -> None:
    t = np.arange(4.0)
    lat, lon = np.array([0.0, 48.0, 48.0, 48.001]), np.array([0.0, 9.0, 9.001, 9.0])
    notes: list[str] = []
    values, times = in_metres({"lat_deg": lat, "lon_deg": lon}, {"lat_deg": t, "lon_deg": t}, notes)
    assert np.isnan(values["x"][0])
    # WGS84: radii of curvature at 48 degrees are 6374 km along the meridian, 6390 km across
    np.testing.assert_allclose(
        values["x"][1:], [0.0, 6389.9e3 * np.cos(np.radians(48.0)) * np.radians(0.001), 0.0], rtol=1e-3, atol=1e-6
    )
    np.testing.assert_allclose(values["y"][3], 6374e3 * np.radians(0.001), rtol=1e-3)
    assert times["x"] is t
    assert "x, y: east and north of 48.000000, 9.000000" in notes[0]


def test_samples_that_came_out_of_order_are_put_in_order() -> None:
    t = np.arange(0.0, 10.0, 0.05)
    order = np.arange(len(t))
    order[[40, 41]] = [41, 40]
    slow, fast = np.arange(0.0, 10.0, 0.1), np.sin(t)
    found = aligned({"r": fast[order], "v": slow.copy()}, {"r": t[order], "v": slow}, "a log", [])
    np.testing.assert_array_equal(found["r"], fast[: len(found["t"])])
