"""Path: how it is made, what it refuses, what it gives; the built-in courses."""

import math

import numpy as np
import pytest

from steerkit.paths import courses
from steerkit.paths.importers import read_course
from steerkit.paths.path import Path

ANGLE = np.linspace(0.0, 2.0 * math.pi, 60, endpoint=False)
RING = 30.0 * np.column_stack((np.cos(ANGLE), np.sin(ANGLE)))
LINE = np.column_stack((np.arange(0.0, 50.0, 5.0), np.zeros(10)))
WIGGLY = np.column_stack((np.arange(0.0, 50.0, 0.25), 0.05 * (-1.0) ** np.arange(200)))


def made_of(xy, closed=False, **options):
    return Path.from_waypoints(xy, closed=closed, name="lap", **options)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: made_of(RING[::12], closed=True), r"5 distinct waypoints, expected at least 6 when closed"),
        (lambda: made_of(LINE, smoothing=-1.0), r"smoothing -1.0 \[m\]"),
        (lambda: made_of(LINE, spacing=0.0), r"spacing 0.0 \[m\]"),
        (lambda: made_of(RING[:40], closed=True), r"ends are 53.5 m apart where neighbours are at most 3.14 m"),
        (lambda: made_of(np.vstack((RING, RING[:4])), closed=True), r"overlaps its start .*the first 60 waypoints"),
        (lambda: made_of([(0, 0), (10, 0), (20, 0), (10, 0.01), (0, 0.01)]), r"folds back|too fine for spacing"),
        (lambda: made_of(WIGGLY), r"detail near .* too fine for spacing 0.997 .*smoothing > 0 for noisy points"),
    ],
)
def test_what_is_wrong_with_waypoints_is_said(make, message):
    with pytest.raises(ValueError, match=message) as error:
        make()
    assert "Path 'lap'" in str(error.value)


def test_a_closed_path_may_repeat_its_first_point():
    again = made_of(np.vstack((RING, RING[:1])), closed=True)
    assert np.array_equal(again.table.rows, made_of(RING, closed=True).table.rows)


@pytest.mark.parametrize("closed", [False, True])
def test_floats_arrays_and_lists_agree(closed):
    path = made_of(RING, closed=closed)
    s = [-3.0, 0.0, 1.7, path.length, path.length + 2.0]
    for function in (path.point, path.psi, path.kappa):
        assert np.array_equal(function(s), function(np.array(s)))
        assert np.allclose(function(s), [function(each) for each in s], atol=1e-13)
    assert type(path.kappa(1.0)) is float
    assert np.allclose(path.point(path.length + 2.0), path.point(2.0 if closed else path.length))


@pytest.mark.parametrize("closed", [False, True])
def test_back_is_inside_for_whoever_is_less_than_a_length_outside(closed):
    path = made_of(RING, closed=closed)
    n = path.length
    s = np.array([-n, -2.0, -1e-13, -1e-300, 0.0, 3.0, n - 1e-12, n, n + 1e-12, n + 2.0, 1.99 * n])
    back = path.back(s)
    assert ((back >= 0.0) & (back <= n)).all()
    assert [path.back(float(each)) for each in s] == back.tolist()
    apart = (back - path.inside(s)) / n
    assert np.abs(apart - (np.round(apart) if closed else 0.0)).max() < 1e-12
    assert np.isfinite(path.frame(back)).all()
    assert math.isnan(path.back(math.nan))


@pytest.mark.parametrize("name", ["paper", "genesis-rfs"])
def test_reversed_is_the_same_curve_the_other_way(name):
    path = courses.course(name)
    back, s = path.reversed(), np.linspace(1.0, path.length - 1.0, 777)
    assert np.allclose(back.point(path.length - s), path.point(s), atol=1e-9)
    assert np.allclose(back.kappa(path.length - s), -path.kappa(s), atol=1e-7)
    assert np.allclose(np.cos(back.psi(path.length - s) - path.psi(s)), -1.0, atol=1e-9)


@pytest.mark.parametrize(("name", "bend"), [("paper", 5e-5), ("circle", 1e-5), ("genesis-rfs", 1e-5)])
def test_a_csv_file_gives_the_path_back(name, bend, tmp_path):
    """Nearly to the last digit where its knots are a metre apart; the paper's are half a metre."""
    path = courses.course(name)
    path.to_csv(tmp_path / "course.csv")
    again = read_course(str(tmp_path / "course.csv")).path
    assert (again.name, again.length) == ("course", pytest.approx(path.length, abs=1e-5))
    s = np.linspace(0.0, path.length - 1e-3, 3000)
    assert np.allclose(again.point(s), path.point(s), atol=1e-5)
    assert np.allclose(again.kappa(s), path.kappa(s), atol=bend)


@pytest.mark.parametrize(("name", "seconds"), [("genesis", 361.15), ("genesis-rfs", 67.02)])
def test_the_recorded_speed_takes_as_long_as_the_recording(name, seconds):
    s, v = courses.recorded_speed(name)
    assert not courses.course(name).closed
    assert s[-1] == courses.course(name).length
    assert v.min() > 0.3
    assert seconds - 4.0 < np.trapezoid(1.0 / v, s) < seconds  # without the rest at its end


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: courses.circle(-1.0), r"radius -1.0 \[m\], expected > 0"),
        (lambda: courses.straight(0.0), r"length 0.0 \[m\]"),
        (lambda: courses.figure_eight(math.nan), r"size nan \[m\]"),
        (lambda: courses.random_course(1, length=50.0, max_kappa=0.1), r"expected length > 0 and a product >= 8"),
        (lambda: courses.lane_change(3), "valid: 1, 2"),
        (lambda: courses.lane_change(1, speed=0.0), "expected > 0"),
        (lambda: courses.bends([(10.0, 90.0, 9.0, 1.0)]), r"turns sum to 90 degrees"),
        (lambda: courses.bends([(9.0, 360.0, 2.0, 13.0)]), r"bend 0: ramp 13.0 \[m\], expected at most .* 12.6 m"),
    ],
)
def test_what_is_wrong_with_a_shape_is_said(make, message):
    with pytest.raises(ValueError, match=message):
        make()
