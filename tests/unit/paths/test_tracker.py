"""PathTracker: one formula for floats, batches and symbols; finding the place, keeping it, losing it."""

import math

import numpy as np
import pytest

from steerkit.paths import courses
from steerkit.paths.tracker import PathTracker

PAPER = courses.course("paper")


def pose_beside(path, s, e, psi_e):
    (x, y), psi = path.point(s), path.psi(s)
    return x - e * math.sin(psi), y + e * math.cos(psi), psi + psi_e


def inputs(tracker, pose, v=5.0, beta=0.02, r=0.1):
    return tracker.D(*(float(a) for a in pose), v, beta, r)


def test_each_of_many_cars_is_found_wherever_it_starts():
    """More than are searched for at once."""
    tracker, s = PathTracker(path=PAPER), np.linspace(0.0, 795.0, 300)
    e, psi_e = 3.0 * np.sin(s), np.cos(7.0 * s)
    u = tracker.D(*np.transpose([pose_beside(PAPER, *row) for row in zip(s, e, psi_e)]), *np.zeros((3, 300)))
    y = tracker.output(0.0, tracker.settle(0.0, tracker.init((300,)), u), u)
    assert PAPER.length * np.sin(np.pi * (y.s - s) / PAPER.length) == pytest.approx(0.0 * s, abs=1e-5)
    assert y.e == pytest.approx(e, abs=1e-6)
    assert y.psi_e == pytest.approx(psi_e, abs=1e-6)
    assert y.progress == pytest.approx(0.0 * s, abs=1e-9)


@pytest.mark.parametrize("along", [-0.6, -0.2, 0.0, 0.3, 0.7])
@pytest.mark.parametrize("e", [-0.5, 0.0, 0.5])
@pytest.mark.parametrize("s", [2.622 * 60.0 / 4.0, 2.622 * 60.0 * 3.0 / 4.0])
def test_about_a_crossing_the_strand_that_the_car_follows_is_found_even_if_the_other_is_nearer(s, e, along):
    path = courses.course("figure-eight")
    tracker = PathTracker(path=path)
    u = inputs(tracker, pose_beside(path, s + along, e, 0.0))
    y = tracker.output(0.0, tracker.settle(0.0, tracker.init(), u), u)
    assert (y.s, y.e, y.psi_e) == pytest.approx((s + along, e, 0.0), abs=0.01)


@pytest.mark.parametrize("e", [-4.0, 0.0, 8.0])
def test_beside_a_bend_the_next_place_is_foreseen_by_the_angle_about_its_centre(e):
    """On a circle of 20 m a car e inside drives v dt/(20 - e) of an angle, and so 20 times that along the path."""
    path = courses.circle(20.0)
    tracker = PathTracker(path=path, dt=0.05)
    x, y, psi = pose_beside(path, 30.0, e, 0.0)
    u = tracker.U(float(x), float(y), float(psi), 6.0, 0.0, 6.0 / (20.0 - e))
    state = tracker.settle(0.0, tracker.init(), tracker.D(*u))
    after = tracker.update(0.0, state, u, tracker.output(0.0, state, tracker.D(*u)))
    assert after.s - 30.0 == pytest.approx(20.0 * 6.0 * 0.05 / (20.0 - e), rel=1e-3)
    assert after.progress == pytest.approx(after.s - 30.0, abs=1e-6)


@pytest.mark.parametrize("off", [-0.9, -0.3, 0.6])
@pytest.mark.parametrize("e", [-3.0, 5.0])
def test_progress_is_all_of_the_way_that_s_has_made(e, off):
    """Also where the place was expected elsewhere, so that both steps of the search have to go some way."""
    path = courses.circle(20.0)
    tracker = PathTracker(path=path)
    u = inputs(tracker, pose_beside(path, 30.0, e, 0.0))
    y = tracker.output(0.0, tracker.X(30.0 + off, 7.0), u)
    assert y.progress - 7.0 == pytest.approx(y.s - (30.0 + off), abs=1e-12)
    assert y.s == pytest.approx(30.0, abs=0.02)


def test_beyond_the_end_of_an_open_path_neither_s_nor_progress_goes_on():
    path = courses.straight(50.0)
    tracker = PathTracker(path=path, dt=0.05)
    before = tracker.output(0.0, tracker.settle(0.0, tracker.init(), at := inputs(tracker, (-7.0, 0.4, 0.1))), at)
    assert (before.s, before.e, before.psi_e) == pytest.approx((0.0, 0.4, 0.1), abs=1e-8)
    u = inputs(tracker, (45.0, 0.3, 0.0), beta=0.0, r=0.0)
    state = tracker.settle(0.0, tracker.init(), u)
    for k in range(60):
        now = tracker.U(45.0 + 0.25 * k, 0.3, 0.0, 5.0, 0.0, 0.0)
        y = tracker.output(0.0, state, tracker.D(*now))
        assert y.s == pytest.approx(min(50.0, now.x), abs=1e-9)
        assert y.progress == pytest.approx(min(5.0, now.x - 45.0), abs=1e-9)
        assert y.e == pytest.approx(0.3)
        state = tracker.update(0.0, state, now, y)


def test_after_a_jump_of_the_measured_position_the_place_is_found_again():
    tracker = PathTracker(path=PAPER)
    state = tracker.settle(0.0, tracker.init(), inputs(tracker, pose_beside(PAPER, 80.0, 0.0, 0.0)))
    u = inputs(tracker, pose_beside(PAPER, 84.0, 0.7, 0.0), v=0.0, r=0.0)
    for k in range(4):
        y = tracker.output(k * 0.05, state, u)
        state = tracker.update(k * 0.05, state, u, y)
        assert abs(y.progress) <= 2.0 * (k + 1) + 1e-9  # two steps of a window a sample
    assert (y.s, y.e) == (pytest.approx(84.0, abs=1e-6), pytest.approx(0.7, abs=1e-6))


def test_the_preview_is_the_curvature_ahead_at_the_present_speed():
    tracker = PathTracker(path=PAPER, preview_points=4, preview_dt=0.5)
    u = inputs(tracker, pose_beside(PAPER, 60.0, 0.2, 0.0), v=8.0)
    y = tracker.output(0.0, tracker.settle(0.0, tracker.init(), u), u)
    assert y.preview == pytest.approx([PAPER.kappa(60.0 + 4.0 * j) for j in range(4)], abs=1e-8)
    assert y.preview[0] == pytest.approx(y.kappa, abs=1e-9)
    assert tracker.preview.size == 4
    assert PathTracker(path=PAPER).output(0.0, PathTracker.X(60.0, 0.0), u).preview == ()


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_broken_pose_is_refused_at_the_start_and_shows_in_e_later(bad):
    tracker = PathTracker(path=PAPER, preview_points=2)
    good, broken = inputs(tracker, (1.0, 0.2, 0.0)), inputs(tracker, (1.0, bad, 0.0), v=bad)
    with pytest.raises(ValueError, match=r"PathTracker: pose .* of car 0 at the start, expected finite numbers"):
        tracker.settle(0.0, tracker.init(), broken)
    with pytest.raises(ValueError, match=r"of car 1, 2 at the start"):
        tracker.settle(0.0, tracker.init((3,)), tracker.D(np.zeros(3), np.array([0.0, bad, bad]), *[np.zeros(3)] * 4))
    state = tracker.settle(0.0, tracker.init(), good)
    y = tracker.output(0.0, state, broken)
    assert not math.isfinite(y.e)
    assert math.isfinite(y.s)
    assert all(map(math.isfinite, tracker.update(0.0, state, broken, y)))


def test_more_than_a_round_in_a_sample_leaves_the_search_where_it_was():
    """On a circle of 126 m, at kappa*e = 1, where the foot point runs away: 30 m/s count five times, 150 m/s too."""
    circle = courses.circle(20.0)
    tracker = PathTracker(path=circle, dt=1.0)
    for v, moved in ((20.0, 100.0), (30.0, 0.0), (1e9, 0.0)):
        u = inputs(tracker, pose_beside(circle, 3.0, 19.99, 0.0), v=v, beta=0.0, r=0.0)
        y = tracker.output(0.0, tracker.X(3.0, 0.0), u)
        after = tracker.update(0.0, tracker.X(3.0, 0.0), u, y)
        assert 0.0 <= after.s <= circle.length
        assert after.progress - y.progress == pytest.approx(moved, abs=1e-6)


def test_a_window_longer_than_a_round_is_refused():
    with pytest.raises(ValueError, match=r"window 900.0 \[m\], expected at most a round of Path\('paper', closed, 79"):
        PathTracker(path=PAPER, window=900.0)
