"""A recorded drive on one clock: repairs are stated, confusion is refused."""

import contextlib
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit.diagram.units import degrees_of
from steerkit.identification import Drive, identify
from steerkit.logs import drive as drives
from steerkit.logs.drive import aligned, in_metres, odd_values, standing_off
from tests.support.recorded_cars import BASE, DT, by_rate, driven, noisy


def test_repairs_are_stated_and_harmless(clean: dict[str, Any]) -> None:
    rng = np.random.default_rng(0)
    rows = np.flatnonzero(~((clean["t"] > 20.0) & (clean["t"] < 23.0)))
    rows = np.concatenate((rows, rows[100:110]))
    order = np.arange(len(rows))
    order[1000:1050] = rng.permutation(order[1000:1050])
    broken = {key: value[rows[order]].copy() for key, value in noisy(clean, 0).items()}
    broken["v"][500] = np.nan
    drive, right = Drive.of(broken), Drive.of(noisy(clean, 0))
    said = "\n".join(drive.notes)
    for words in ("dropped 1 of", "sorted by time", "repeat the time", "1 gaps, 3.0 s in all"):
        assert words in said
    assert not drive.measured[round(21.0 / DT)]
    assert not drive.measured[round(23.5 / DT)]
    np.testing.assert_allclose(drive.delta_sw[drive.measured], right.delta_sw[drive.measured], atol=0.02)


def test_the_headings_zero_repairs_the_gyros(clean: dict[str, Any]) -> None:
    drive = Drive.of(clean | {"r": clean["r"] + 0.01})
    assert "yaw rate: -0.01" in drive.notes[0]
    assert drive.calibrated


def test_a_heading_that_contradicts_the_yaw_rate_and_a_crawl_teach(clean: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"has the other sign .* compass turns clockwise"):
        Drive.of(clean | {"psi": -clean["psi"]})
    with pytest.raises(ValueError, match="psi jumps by 360"):
        Drive.of(clean | {"psi": degrees_of(clean["psi"]) % 360.0})
    with pytest.raises(ValueError, match=r"only .* s at 3 m/s or faster"):
        Drive.of(by_rate(clean) | {"v": 0.1 * clean["v"]})


def test_columns_that_do_not_belong_together_teach(clean: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"go together by .* wrong columns or clocks"):
        Drive.of(by_rate(clean) | {"delta_sw": np.roll(clean["delta_sw"], 700)})
    with pytest.raises(ValueError, match="different lengths: t 4500, delta_sw 4499"):
        Drive.of(by_rate(clean) | {"delta_sw": clean["delta_sw"][1:]})
    two = {key: np.concatenate((value, value)) for key, value in by_rate(clean).items()}
    two["v"] = np.concatenate((clean["v"], clean["v"][::-1]))
    two["t"] = np.concatenate((clean["t"], clean["t"] + 0.01))
    with pytest.raises(ValueError, match=r"time runs back at row 4500 .* one after the other"):
        Drive.of(two)


def circling(t: Any = np.arange(3000) * DT, **changes: Any) -> dict[str, Any]:  # noqa: B008
    """A minute of weaving to the left, round and round: the heading passes 180 degrees many times."""
    r = 0.5 + 0.2 * np.sin(0.5 * t)
    psi = 0.5 * t + 0.4 * (1.0 - np.cos(0.5 * t))
    return {"t": t, "delta_sw": 45.0 * r / 6.0, "v": np.full_like(t, 6.0), "r": r, "psi": psi} | changes


def test_a_heading_that_passes_180_degrees_goes_on() -> None:
    whole = circling()
    wrapped = (whole["psi"] + np.pi) % (2.0 * np.pi) - np.pi
    assert (np.abs(np.diff(wrapped)) > 6.0).sum() >= 4
    for columns in (circling(psi=wrapped), circling(psi=wrapped, r=None)):
        drive = Drive.of(columns)
        inner = drive.measured & (drive.t < drive.t[-1] - 0.2)
        np.testing.assert_allclose(drive.r[inner], whole["r"][: len(drive.r)][inner], atol=2e-3)
    assert drive.notes == ("yaw rate: slope of the heading over 0.22 s",)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ({"delta_sw": [0.0, -17.5], "v": [100.0, -1.0], "r": [2.5, 0.0], "psi": [330.0, 0.0]}, ""),
        ({"v": [1.0], "psi": [0.0, 390.0]}, ""),
        ({"v": [1.0], "delta_sw": [17.51]}, r'delta_sw reaches .* is it in deg\? Say unit = "deg"'),
        ({"v": [100.1]}, "is it in km/h"),
        ({"v": [1.0], "r": [-2.51]}, ""),
        ({"v": [4.0], "r": [-4.9]}, ""),  # a small car's
        ({"v": [4.0], "r": [-5.1]}, r"is it in deg/s\?"),
        ({"v": [1.0], "r": [-12.1]}, r"is it in deg/s\?"),
        ({"v": [-1.01]}, "reversing is not modelled"),
        ({"v": [1.0], "psi": [0.0, 331.0]}, "psi jumps by 360"),
        ({"v": [1.0], "psi": [389.0, 0.0]}, "psi jumps by 360"),
    ],
)
def test_values_at_the_bounds_of_what_a_car_reaches(columns: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=f"a drive: .*{says}") if says else contextlib.nullcontext():
        drives._check_ranges({key: np.array(value) for key, value in columns.items()}, "a drive")


ADVICE = {5e-4: "", 0.5: "", 4.9e-4: "min", 0.51: "column", 1.9: "column", 2.0: "ms", 249.0: "ms", 251.0: "column"}
ADVICE |= {2e3: "us", 2.4e5: "us", 2e6: "ns", 2.4e8: "ns", 3e8: "column", 1e-6: "column"}


@pytest.mark.parametrize(("step", "advice"), ADVICE.items())
def test_the_step_says_what_unit_the_time_is_in(step: float, advice: str) -> None:
    t = step * np.arange(11.0)
    if not advice:
        assert drives._steps(t, "a drive", [])[0] == pytest.approx(step)
    else:
        with pytest.raises(ValueError, match="right column" if advice == "column" else f"is t in {advice}"):
            drives._steps(t, "a drive", [])


@pytest.mark.parametrize(("step", "pause", "gap"), [(0.01, 0.25, 0), (0.01, 0.26, 1), (0.1, 0.5, 0), (0.1, 0.51, 1)])
def test_a_gap_is_longer_than_five_steps_and_a_quarter_second(step: float, pause: float, gap: int) -> None:
    t, notes = np.cumsum([0.0] + [step] * 80 + [pause - 1e-9] + [step] * 80), list[str]()
    assert drives._steps(t, "a drive", notes)[1].tolist() == [80] * gap
    assert notes == [f"1 gaps, {pause:.1f} s in all (the longest {pause:.1f} s): bridged, not compared"] * gap
    assert drives._measured(t, np.array([80]), t[80] + np.array([0.0, 1e-6, pause + 0.999, pause + 1.0])).tolist() == [
        *(t[80] >= 1.0, False, False, True)
    ]


def test_half_of_a_drive_may_be_gaps() -> None:
    for pause, taken in ((1.0, True), (1.02, False)):
        t = np.cumsum([0.0] + [1 / 64] * 32 + [pause] + [1 / 64] * 32)
        with contextlib.nullcontext() if taken else pytest.raises(ValueError, match="1 s of 2 s are gaps"):
            drives._steps(t, "a drive", [])


def test_what_is_finer_than_the_clock_is_averaged_and_no_car_reverses() -> None:
    t = 0.005 * np.arange(400)
    even = drives._resampled(
        {"t": t + 7.0, "v": np.where(t < 1.0, -0.5, 5.0), "r": (-1.0) ** np.arange(400)}, 0.01, 0.005
    )
    assert even["t"] == pytest.approx(0.01 * np.arange(200))
    assert np.abs(even["r"][2:-2]).max() < 1e-12
    assert (even["v"][50], even["v"][150]) == (0.0, 5.0)


@pytest.mark.parametrize(
    ("metres", "says"),
    [
        (15.01, ""),
        (119.9, ""),
        (14.99, "perhaps v is in m/s and was read as km/h"),
        (120.1, r"perhaps v is in km/h .unit = .km/h.."),
        (45.0 * 57.3, "perhaps delta_sw is in degrees"),
        (45.0 / 57.3, "perhaps the yaw rate is in degrees"),
        (3.0, r"perhaps delta_sw is the road wheels' angle [^;]*\. To"),
        (-45.0, r"perhaps one of delta_sw and r has the wrong sign .scale = -1.\. To"),
        (-3.0, r"perhaps delta_sw is the road wheels' .*, and one of delta_sw and r"),
        (1e5, r"wheelbase.\. To"),
    ],
)
def test_wheel_over_curvature_is_that_of_a_road_car(metres: float, says: str) -> None:
    drive = Drive.of(circling())
    with pytest.raises(ValueError, match=says) if says else contextlib.nullcontext():
        drives._check_plausible(replace(drive, delta_sw=metres * drive.r / drive.v))


@pytest.mark.parametrize(("gain", "fits"), [(0.81, True), (1.24, True), (0.79, False), (1.26, False)])
def test_the_yaw_rate_may_differ_from_the_headings_by_a_quarter(gain: float, fits: bool) -> None:
    with contextlib.nullcontext() if fits else pytest.raises(ValueError, match=f"the yaw rate is {gain:.3g} times"):
        assert Drive.of(circling(r=gain * circling()["r"])).calibrated


@pytest.mark.parametrize(("recorded", "dt"), [(0.005, 0.01), (0.02, 0.02), (0.08, 0.05)])
def test_the_clock_is_the_recordings_within_bounds(recorded: float, dt: float) -> None:
    columns = {key: value[:: round(recorded / 0.005)] for key, value in circling(np.arange(12000) * 0.005).items()}
    assert Drive.of(columns).dt == dt
    for wrong in (0.00099, 0.101):
        with pytest.raises(ValueError, match=r"dt = .* expected 0.001 to 0\.1$"):
            Drive.of(columns, dt=wrong)
    assert [Drive.of(columns, dt=given).dt for given in (0.001, 0.1)] == [0.001, 0.1]


@pytest.mark.parametrize(("key", "jump"), [("delta_sw", 4.0), ("v", 8.0), ("r", 2.0)])
def test_a_lone_value_that_no_car_reaches_is_left_out(key: str, jump: float, clean: dict[str, Any]) -> None:
    spoilt = {name: value.copy() for name, value in by_rate(clean).items()}
    spoilt[key][1234] += jump
    drive, same = Drive.of(spoilt), Drive.of(by_rate(clean))
    assert any(f"dropped 1 rows of a lone {key} that no car reaches" in note for note in drive.notes)
    np.testing.assert_allclose(getattr(drive, key), getattr(same, key), atol=0.02)


@pytest.mark.parametrize("off", [-64.0, -3.0, 0.7, 32.0])
def test_a_row_whose_time_was_spoilt_is_left_out_not_sorted(off: float, clean: dict[str, Any]) -> None:
    spoilt = by_rate(clean) | {"t": clean["t"].copy()}
    spoilt["t"][2222] += off
    drive, same = Drive.of(spoilt), Drive.of(by_rate(clean))
    assert any("dropped 1 rows whose time is far" in note for note in drive.notes)
    assert len(drive.v) == len(same.v)
    np.testing.assert_allclose(drive.delta_sw, same.delta_sw, atol=0.02)
    later = by_rate(clean) | {"t": np.append(clean["t"][:-1], clean["t"][-1] + 9.0)}  # a pause before the last row
    assert not any("time is far" in note for note in Drive.of(later).notes)


def test_where_the_car_was_comes_along(clean: dict[str, Any]) -> None:
    place = {"x": 3.0 * clean["t"], "y": np.where(clean["t"] < 50.0, -clean["t"], np.nan)}
    drive = Drive.of(clean | place)
    assert drive.x is not None
    assert drive.y is not None
    assert drive.psi is not None
    np.testing.assert_allclose(drive.x, 3.0 * drive.t, atol=1e-9)
    assert np.isnan(drive.y[drive.t > 50.1]).all()
    np.testing.assert_allclose(drive.y[drive.t < 49.9], -drive.t[drive.t < 49.9], atol=1e-9)
    np.testing.assert_allclose(drive.psi, clean["psi"][: len(drive.psi)], atol=1e-9)
    assert Drive.of(by_rate(clean)).x is None


def test_a_drive_straight_on_is_one_but_nothing_is_identified_from_it(clean: dict[str, Any]) -> None:
    straight = Drive.of(by_rate(clean) | {"r": 0.0 * clean["r"]})
    assert "hardly turns" in straight.notes[-1]
    with pytest.raises(ValueError, match=r"hardly turns.*add bends"):
        identify(straight, BASE)


def test_where_a_channel_pauses_nothing_is_made_up() -> None:
    t = np.arange(0.0, 10.0, 0.01)
    there = (t < 4.0) | (t > 6.0)
    even = aligned({"v": t[there], "r": t}, {"v": t[there], "r": t}, "test", [])
    inside = (even["t"] > 4.001) & (even["t"] < 5.999)
    assert np.isnan(even["v"][inside]).all()
    assert np.isfinite(even["v"][~inside & (even["t"] < 3.99)]).all()


def test_the_clock_is_that_of_the_fastest_where_all_that_is_needed_was_recorded() -> None:
    fast, slow, late = 0.05 * np.arange(81.0), 1.5 + 0.1 * np.arange(36.0), np.array([2.0, 2.2])
    notes: list[str] = []
    values = {"x": late, "v": fast, "psi": (3.0 * slow) % 6.0 / 6.0 * 2.0 * np.pi}
    even = aligned(values, {"x": late, "v": fast, "psi": slow}, "test", notes)
    assert notes == ["one clock of 20 Hz for channels of x 5, v 20, psi 10 Hz"]
    assert even["t"] == pytest.approx(1.5 + 0.05 * np.arange(51.0))
    assert even["v"] == pytest.approx(even["t"])
    assert np.diff(even["psi"]) == pytest.approx(0.05 * np.pi)
    assert even["t"][np.isfinite(even["x"])] == pytest.approx(2.0 + 0.05 * np.arange(5.0))


def test_clocks_that_do_not_overlap_teach() -> None:
    t = np.arange(0.0, 10.0, 0.1)
    assert len(aligned({"v": t, "r": t}, {"v": t, "r": t + 8.8}, "test", [])["t"]) == 12
    with pytest.raises(ValueError, match="v has 1 samples that are numbers"):
        aligned({"v": t[:1], "r": t}, {"v": t[:1], "r": t}, "test", [])
    with pytest.raises(ValueError, match="clocks do not overlap"):
        aligned({"v": t[:11], "r": t}, {"v": t[:11], "r": t}, "test", [])
    with pytest.raises(ValueError, match=r"clocks do not overlap: v 0 to 9.9, r 1000 to 1009.9 \[s\]"):
        aligned({"v": t, "r": t}, {"v": t, "r": t + 1000.0}, "test", [])


def test_positions_become_metres_and_a_receiver_without_a_fix_is_nowhere() -> None:
    t = np.arange(4.0)
    lat, lon = np.array([0.0, 48.0, 48.0, 48.001]), np.array([0.0, 0.0, 0.001, 0.0])
    notes: list[str] = []
    values, times = {"lat_deg": lat, "lon_deg": lon}, {"lat_deg": t, "lon_deg": t}
    in_metres(values, times, notes)
    assert np.isnan(values["x"][0])
    # WGS84: radii of curvature at 48 degrees are 6374 km along the meridian, 6390 km across
    np.testing.assert_allclose(
        values["x"][1:], [0.0, 6389.9e3 * np.cos(np.radians(48.0)) * np.radians(0.001), 0.0], rtol=1e-3, atol=1e-6
    )
    np.testing.assert_allclose(values["y"][3], 6374e3 * np.radians(0.001), rtol=1e-3)
    assert times["x"] is t
    assert "x, y: east and north of 48.000000, 0.000000" in notes[0]


@pytest.mark.parametrize("held", [1, 4])
def test_a_first_fix_that_is_wrong_is_left_out_and_is_no_origin(held: int) -> None:
    """Each fix stands in one row, or is held over four."""
    t, fix = 0.25 * np.arange(80.0), np.arange(80) // held
    notes: list[str] = []
    lat, lon = 48.0 + 1e-5 * fix, 9.0 + 2e-5 * np.sin(fix / 5.0)
    lat[:held] -= 0.5
    values, times = {"lat_deg": lat, "lon_deg": lon}, {"lat_deg": t, "lon_deg": t}
    in_metres(values, times, notes)
    assert np.isnan(values["x"]).tolist() == [True] * held + [False] * (80 - held)
    assert (values["x"][held], values["y"][held]) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert np.abs(values["y"][held:]).max() < 100.0
    assert "left out the first fix: (47.5, 9) [degrees] lies 55501 m from the next position" in notes[0]


T = np.arange(0.0, 20.0, 0.02)
RNG = np.random.default_rng(1)


def test_a_value_that_stands_off_is_found_where_it_is() -> None:
    for noise in (0.0, 1e-3):
        values = np.sin(T) + noise * RNG.normal(size=len(T))
        assert odd_values({"v": values}, {"v": T}) == []
        values[437] += 0.1
        assert standing_off(values, 0.0).tolist() == [437]
        assert standing_off(np.repeat(values, 1 + (T[437] == T)), 0.0).tolist() == [], "two alike are a step"
        (told,) = odd_values({"v": values}, {"v": T})
        assert told == f"v stands off from all around in 1 samples, the first {T[437]:.6g} s from its start: spoilt?"


def test_noise_steps_and_a_kink_are_nothing_odd() -> None:
    rough = RNG.normal(size=5000)
    steps = np.round(np.sin(T), 2)
    flickering = np.where(np.arange(len(T)) == 500, 0.01, 0.0)
    kink = np.maximum(T - 10.0, 0.0)
    jump = np.where(T < 10.0, 0.0, 5.0)
    assert odd_values({"v": rough}, {"v": np.arange(5000.0)}) == []
    for values in (steps, flickering, kink, jump):
        assert odd_values({"v": values}, {"v": T}) == []


@pytest.mark.parametrize(("by", "told"), [(0.015, 1), (-0.015, 1), (0.004, 0)])
def test_a_time_that_is_not_that_of_its_sample_is_told_and_a_late_one_is_not(by: float, told: int) -> None:
    t = T.copy()
    t[300] += by
    found = odd_values({"r": np.sin(T)}, {"r": t})
    assert [one for one in found if one.startswith("the time of r stands off")] == found[:told]
    assert len([one for one in found if "time" in one]) == told


def test_a_lost_sample_and_a_pause_are_no_wrong_times() -> None:
    there = np.ones(len(T), dtype=bool)
    there[[100, *range(500, 560)]] = False
    assert odd_values({"r": np.sin(T[there])}, {"r": T[there]}) == []


@pytest.mark.parametrize(("quantity", "factor"), [("v", 3.6), ("v", 1 / 3.6), ("delta_sw", 57.2958), ("r", 57.2958)])
def test_a_unit_that_changes_in_the_middle_is_told(quantity: str, factor: float, clean: dict[str, Any]) -> None:
    mixed = by_rate(clean)
    size = np.abs(mixed[quantity])
    row = 2000 + int(np.argmax(size[2000:2500]))  # where it is not small
    mixed[quantity] = np.where(np.arange(len(size)) < row, 1.0, factor) * mixed[quantity]
    with pytest.raises(ValueError, match=rf"{quantity} goes from .* at row {row} .*: its unit changes there between"):
        Drive.of(mixed)


def stopping() -> dict[str, Any]:
    """Two drives of a minute and a half, from a stop to a stop, with noise of a gyro."""
    columns = noisy(driven(v_low=0.0, v_high=14.0, seconds=120.0), 0)
    return {key: columns[key] for key in ("t", "delta_sw", "v", "r")}


@pytest.mark.parametrize("factor", [1.0, 3.6, 1.0 / 3.6])
def test_a_unit_of_speed_that_changes_at_a_stop_is_told_with_its_row(factor: float) -> None:
    columns = stopping()
    stop = int(np.argmin(columns["v"] + (np.abs(columns["t"] - 60.0) > 20.0) * 99.0))
    columns["v"] = np.where(np.arange(len(columns["t"])) < stop, 1.0, factor) * columns["v"]
    if factor == 1.0:
        assert len(Drive.of(columns).v)
        return
    to = "km/h" if factor > 1.0 else "m/s"
    with pytest.raises(ValueError, match=rf"v goes with .* to {to} at a stop before row (\d+)") as told:
        Drive.of(columns)
    row = int(str(told.value).split("before row ")[1].split(" ")[0])
    assert 0 < columns["t"][row] - columns["t"][stop] < 25.0
    with pytest.raises(ValueError, match=rf"before row {row} "):
        Drive.of(columns | {"t": columns["t"] + 1000.0})  # a clock that does not begin at 0
    assert len(Drive.of(columns, trusted=True).v)


@pytest.mark.parametrize("ratio", [1.0, 15.0])
def test_a_small_car_of_a_tenth_is_read(ratio: float) -> None:
    """F1Tenth: wheelbase 0.33 m, at 4 m/s with up to 4.4 rad/s; the servo's angle, or as if it had a steering ratio."""
    t = 0.02 * np.arange(3000)
    angle = 0.35 * np.sin(0.9 * t)
    drive = Drive.of({"t": t, "v": np.full(3000, 4.0), "delta_sw": ratio * angle, "r": 4.0 * np.tan(angle) / 0.33})
    assert np.abs(drive.r).max() == pytest.approx(4.42, abs=0.02)
    with pytest.raises(ValueError, match=r"r reaches .* is it in deg/s"):
        Drive.of({"t": t, "v": np.full(3000, 9.0), "delta_sw": ratio * angle, "r": 4.0 * np.tan(angle) / 0.33})


def test_a_speed_sensor_that_wakes_up_is_no_change_of_unit(clean: dict[str, Any]) -> None:
    woken = by_rate(clean)
    woken["v"] = np.concatenate((np.full(50, 0.3), np.full(50, 1.08), woken["v"][100:]))
    assert len(Drive.of(woken).v) == len(Drive.of(by_rate(clean)).v)


@pytest.mark.parametrize("noise", [0.0, 0.005, 0.02, 0.05])
@pytest.mark.parametrize("scale", [0.94, 1.0])
def test_a_heading_with_noise_still_shows_the_gyros_scale(noise: float, scale: float) -> None:
    """Its slope over a short time would be mostly noise: with 0.02 rad that gave 0.71 for 0.94, and a refusal."""
    rng, t = np.random.default_rng(0), np.arange(0.0, 300.0, 0.01)
    kappa = 0.02 * np.sin(2.0 * np.pi * t / 25.0) + 0.01 * np.sin(2.0 * np.pi * t / 11.0)
    v, r = np.full(len(t), 8.0), 8.0 * kappa
    gyro = scale * r + 0.01 + 0.002 * rng.normal(size=len(t))
    psi = np.cumsum(r) * 0.01 + noise * rng.normal(size=len(t))
    drive = Drive.of({"t": t, "delta_sw": 15.6 * 2.8 * kappa, "v": v, "r": gyro, "psi": psi})
    gain, zero = np.polyfit(r, drive.r, 1)
    assert gain == pytest.approx(1.0, abs=0.02)
    assert zero == pytest.approx(0.0, abs=2e-4)
    assert any("gyro's scale" in note for note in drive.notes) == (scale != 1.0)


@pytest.mark.parametrize("late", [-1.0, -0.1, 0.0, 0.4, 0.9, 1.5])
def test_a_yaw_rate_of_another_clock_is_told(late: float, clean: dict[str, Any]) -> None:
    columns = by_rate(noisy(clean, 0))
    columns["r"] = np.interp(columns["t"] - late, columns["t"], columns["r"])
    told = [note for note in Drive.of(columns, trusted=True).notes if "comes" in note]
    if -0.3 <= late <= 0.6:
        assert not told
    else:
        (note,) = told
        found = float(note.split("comes ")[1].split(" s ")[0]) * (1.0 if " after " in note else -1.0)
        assert found == pytest.approx(late + 0.15, abs=0.2)  # the car's own delay and lag are in it
        assert "shift its times by" in note


def test_a_drive_whose_time_falls_is_turned_round_and_says_so(clean: dict[str, Any]) -> None:
    drive = Drive.of(clean)
    turned = Drive.of({key: value[::-1] for key, value in clean.items()})
    assert any("turned round, as its time falls from row to row" in note for note in turned.notes)
    np.testing.assert_array_equal(turned.r, drive.r)


@pytest.mark.parametrize("seed", range(4))
def test_the_scale_of_a_short_drive_rests_on_two_turns_that_are_independent(seed: int) -> None:
    """22 s are less than four times the 5 s over which gyro and heading are compared."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, 22.0, 0.05)
    r = 0.3 * np.sin(0.7 * t)
    gyro = r + 0.12 * np.sin(0.31 * t + seed) + 0.01 * rng.normal(size=len(t))
    psi = 0.3 / 0.7 * (1.0 - np.cos(0.7 * t))
    drive = Drive.of(
        {"t": t, "delta_sw": 45.0 * r / 6.0, "v": np.full_like(t, 6.0), "r": gyro, "psi": psi}, trusted=True
    )
    turned, shown = ((a[100:] - a[:-100])[20:] for a in (psi, np.cumsum(gyro) * 0.05 - 0.025 * gyro))
    correlation = np.corrcoef(turned, shown)[0, 1]
    assert drive.scale_deviation == pytest.approx(np.sqrt((1.0 - correlation**2) / 2.0) / correlation, rel=0.01)
