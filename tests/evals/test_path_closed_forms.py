"""Paths and their tracker against geometry that is known in closed form."""

import math

import numpy as np
import pymap3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from steerkit.paths import courses
from steerkit.paths.path import Path
from steerkit.paths.tracker import PathTracker

EXACT = 1e-8


def track(tracker, x=0.0, y=0.0, psi=0.0, v=5.0, beta=0.0, r=0.0):
    u = tracker.D(x, y, psi, v, beta, r)
    return tracker.output(0.0, tracker.settle(0.0, tracker.init(), u), u)


def drive(tracker, poses, v=5.0):
    """Outputs along poses (n, 3), one a sample, found once at the first."""
    state, outputs = tracker.init(), []
    for k, pose in enumerate(poses):
        u = tracker.D(*map(float, pose), v, 0.0, 0.0)
        if k == 0:
            state = tracker.settle(0.0, state, u)
        outputs.append(tracker.output(0.0, state, u))
        state = tracker.update(0.0, state, u, outputs[-1])
    return [np.array(column) for column in zip(*[y[:7] for y in outputs])]


def beside(path, s, offset):
    """Poses (n, 3) at `offset` to the left of c(s), along the path."""
    psi = path.psi(s)
    left = np.column_stack((-np.sin(psi), np.cos(psi)))
    return np.column_stack((path.point(s) + left * np.reshape(offset, (-1, 1)), psi))


def round_trip(path, s):
    """Distances along a closed path, whole rounds taken out."""
    return s - path.length * np.round(s / path.length)


CIRCLE = courses.circle(20.0)


@given(angle=st.floats(0.0, 6.28), e=st.floats(-30.0, 12.0), psi_e=st.floats(-3.0, 3.0), v=st.floats(0.0, 9.0))
def test_on_a_circle_every_output_has_its_closed_form(angle, e, psi_e, v):
    rho = 20.0 - e  # left of a left-hand circle is inside
    x, y = rho * math.sin(angle), 20.0 - rho * math.cos(angle)
    out = track(PathTracker(path=CIRCLE), x, y, angle + psi_e, v, 0.05, 0.2)
    assert math.remainder(out.s - 20.0 * angle, CIRCLE.length) == pytest.approx(0.0, abs=EXACT)
    assert out.e == pytest.approx(e, abs=EXACT)
    assert out.psi_e == pytest.approx(psi_e, abs=EXACT)
    assert out.kappa == pytest.approx(0.05, abs=1e-7)
    assert out.e_dot == pytest.approx(v * math.sin(psi_e + 0.05), abs=EXACT * 10)
    assert out.r_e == pytest.approx(0.2 - v * 0.05, abs=1e-6)


STRAIGHT = courses.straight(100.0)


@given(reference=st.floats(0.0, 3.0), psi=st.floats(-1.5, 1.5), x=st.floats(5.0, 90.0), y=st.floats(-5.0, 5.0))
def test_on_a_straight_the_reference_point_ahead_is_measured(reference, psi, x, y):
    out = track(PathTracker(path=STRAIGHT, reference=reference), x, y, psi, 6.0, -0.1, 0.3)
    assert out.s == pytest.approx(x + reference * math.cos(psi), abs=EXACT)
    assert out.e == pytest.approx(y + reference * math.sin(psi), abs=EXACT)
    assert out.e_dot == pytest.approx(6.0 * math.sin(psi - 0.1) + 0.3 * reference * math.cos(psi), abs=EXACT)
    assert (out.kappa, out.r_e) == (pytest.approx(0.0, abs=EXACT), pytest.approx(0.3, abs=EXACT))


def test_the_lemniscate_has_its_length_and_curvature():
    path, a = courses.figure_eight(60.0), 30.0
    assert path.length == pytest.approx(5.244115108584239 * a, rel=1e-7)  # 2*varpi*a
    rho = np.hypot(*path.samples.xy.T)
    assert np.allclose(np.abs(path.samples.kappa), 3.0 * rho / a**2, atol=1e-7)


@pytest.mark.parametrize("name", [name for name in courses.names() if name != "curvature-step"])
def test_s_is_arc_length_and_curvature_the_rate_of_heading(name):
    path = courses.course(name)
    s = np.linspace(0.0, path.length, 20_001)
    _, _, dx, dy, _, _ = path.frame(s)
    assert np.abs(np.hypot(dx, dy) - 1.0).max() < 1e-6
    psi = np.unwrap(path.psi(s[:-1]))
    middle = 0.5 * (s[1:-1] + s[:-2])
    assert np.abs(np.diff(psi) / np.diff(s[:-1]) - path.kappa(middle)).max() < 2e-4
    assert np.abs(np.diff(path.kappa(s))).max() < 0.1 * path.length / 20_000  # continuous: < 0.1 1/m a metre


def test_a_step_in_curvature_is_a_straight_an_arc_and_a_straight():
    """A spline cannot jump: within 3 m of each step it overshoots a little, elsewhere it is exact."""
    path = courses.course("curvature-step")
    s = np.linspace(0.0, path.length, 20_001)
    _, _, dx, dy, _, _ = path.frame(s)
    assert np.abs(np.hypot(dx, dy) - 1.0).max() < 2e-5
    ends = np.array([30.0, 30.0 + 27.0 * np.pi])
    far = np.abs(s[:, None] - ends).min(axis=1) > 3.0
    arc = (s > ends[0]) & (s < ends[1])
    assert np.abs(path.kappa(s) - np.where(arc, 1.0 / 27.0, 0.0))[far].max() < 1e-4


def eight() -> tuple[Path, np.ndarray, np.ndarray]:
    """A crossing, for three rounds."""
    path = courses.figure_eight(60.0)
    along = np.arange(0.0, 3.0 * path.length, 0.25)
    return path, along, 0.8 * np.sin(0.3 * along)


def narrow() -> tuple[Path, np.ndarray, np.ndarray]:
    """Stretches three metres apart, well past the middle between them, where the other one is nearer."""
    path = courses.bends([(30.0, 180.0, 1.45, 1.2), (60.0, 180.0, 1.45, 1.2), (30.0, 0.0, 1.0, 0.0)], spacing=0.1)
    assert 2.5 < np.ptp(path.samples.xy[:, 1]) < 3.5
    along = np.arange(-25.0, 25.0, 0.25)
    return path, along, 2.5 * np.cos(0.2 * along)


@pytest.mark.parametrize("drawn", [eight, narrow])
def test_where_a_course_meets_itself_it_is_followed_without_confusion(drawn):
    path, along, offset = drawn()
    s, progress, e, _, _, kappa, _ = drive(PathTracker(path=path), beside(path, along, offset))
    assert np.allclose(progress, along - along[0], atol=1e-6)
    assert np.allclose(round_trip(path, s - along), 0.0, atol=1e-6)
    assert np.allclose(e, offset, atol=1e-6)
    assert np.allclose(kappa, path.kappa(along), atol=1e-6)


def test_five_metres_inside_the_tightest_bend_the_place_is_still_found():
    path = courses.course("paper")
    tightest = path.samples.s[np.argmax(np.abs(path.samples.kappa))]
    along = np.arange(tightest - 30.0, tightest + 30.0, 0.05)
    s, _, e, *_ = drive(PathTracker(path=path, dt=0.05), beside(path, along, 5.0), v=1.0 - 5.0 / 5.9)
    assert np.abs(e - 5.0).max() < 1e-4
    assert np.abs(s - along).max() < 1e-2


def test_smoothing_recovers_a_circle_from_noisy_points():
    rng = np.random.default_rng(0)
    angle = np.linspace(0.0, 2.0 * math.pi, 600, endpoint=False)
    xy = 30.0 * np.column_stack((np.cos(angle), np.sin(angle))) + 0.05 * rng.standard_normal((600, 2))
    path = Path.from_waypoints(xy, closed=True, smoothing=0.07)  # RMS of two axes of 0.05 m
    assert np.abs(np.hypot(*path.samples.xy.T) - 30.0).max() < 0.04
    assert np.abs(path.samples.kappa - 1.0 / 30.0).max() < 0.01


WAYPOINTS = courses.random_course(3, length=120.0, max_kappa=0.15).samples.xy[:-1:3]


@settings(max_examples=20)
@given(
    turn=st.floats(-math.pi, math.pi),
    shift=st.tuples(st.floats(-1e3, 1e3), st.floats(-1e3, 1e3)),
    s=st.floats(0.0, 120.0),
    e=st.floats(-2.0, 2.0),
    psi_e=st.floats(-1.0, 1.0),
)
def test_errors_do_not_depend_on_where_the_map_lies_and_flip_in_a_mirror(turn, shift, s, e, psi_e):
    path = Path.from_waypoints(WAYPOINTS, closed=True)
    (x, y, psi), *_ = beside(path, np.array([s]), e)
    psi += psi_e
    here = track(PathTracker(path=path, reference=1.0), x, y, psi, 5.0, 0.02, 0.1)
    c, d = math.cos(turn), math.sin(turn)
    moved = Path.from_waypoints(WAYPOINTS @ [[c, d], [-d, c]] + shift, closed=True)
    at = c * x - d * y + shift[0], d * x + c * y + shift[1], psi + turn
    there = track(PathTracker(path=moved, reference=1.0), *at, 5.0, 0.02, 0.1)
    assert there[1:7] == pytest.approx(here[1:7], abs=1e-7)
    mirror = Path.from_waypoints(WAYPOINTS * [1.0, -1.0], closed=True)
    flipped = track(PathTracker(path=mirror, reference=1.0), x, -y, -psi, 5.0, -0.02, -0.1)
    assert flipped.s == pytest.approx(here.s, abs=1e-7)
    assert flipped[2:7] == pytest.approx([-a for a in here[2:7]], abs=1e-7)


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), length=st.floats(100.0, 1500.0), bendy=st.floats(8.01, 100.0))
def test_random_courses_keep_their_bounds(seed, length, bendy):
    path = courses.random_course(seed, length=length, max_kappa=bendy / length)
    assert path.length == pytest.approx(length, abs=1e-3)
    assert np.abs(path.kappa(np.linspace(0.0, length, 3000))).max() <= bendy / length
    polar = np.unwrap(np.arctan2(*path.samples.xy.T[::-1]))
    assert (np.diff(polar) > 0.0).all()  # star-shaped: never meets itself
    assert path.samples.psi[-1] - path.samples.psi[0] == pytest.approx(2.0 * math.pi, abs=1e-6)


def test_gps_positions_become_metres_east_and_north():
    angle = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    east, north = 80.0 * np.sin(angle), 80.0 * (1.0 - np.cos(angle))
    lat, lon, _ = pymap3d.enu2geodetic(east, north, 0.0, 52.3, 10.5, 0.0)
    path = Path.from_gps(lat, lon, closed=True, smoothing=0.0)
    assert path.length == pytest.approx(160.0 * math.pi, abs=1e-3)
    assert np.abs(np.hypot(path.samples.xy[:, 0], path.samples.xy[:, 1] - 80.0) - 80.0).max() < 1e-3
