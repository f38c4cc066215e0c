"""From a line to a course: what is smoothed, what cannot be driven, and the file that keeps it."""

from itertools import pairwise
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import pytest

from steerkit.paths.courses import course
from steerkit.paths.importers import Line, course_of, read_course
from steerkit.paths.importers.course import laid, smoothed

BENT = np.array([(0.0, 0.0), (40.0, 0.0), (60.0, 20.0), (60.0, 60.0)])


def made(xy: Any, **changes: Any) -> Any:
    given = dict(name="yard", noise=0.1, closed=False, drawn=True)
    return laid(Line(xy=np.asarray(xy, dtype=float), **changes.pop("speeds", {})), **(given | changes))


def test_a_drawn_line_is_followed_between_its_points() -> None:
    one = made(BENT, noise=0.5)
    k = one.path.samples
    off = [min(_off(p, a, b) for a, b in pairwise(BENT)) for p in k.xy]
    assert max(off) < 2.0
    assert 0.3 < np.sqrt(np.mean(np.square(off))) < 0.6
    assert np.abs(k.kappa).max() < 1.0 / 6.0
    assert any("smoothed by noise = 0.5 m" in note for note in one.notes)


def test_a_way_that_winds_up_between_its_points_is_refused_at_once() -> None:
    """A row that stands a second time, 40 m further on: the smoothed curve would be 19 km long, and take minutes."""
    s = np.arange(0.0, 300.0, 5.0)
    xy = np.column_stack((s, 20.0 * np.sin(s / 75.0)))
    twice = np.insert(xy, 44, xy[36], axis=0)
    with pytest.raises(ValueError, match=r"noise = 0.1 m it is \d+ m long, but from point to point 373 m: points"):
        made(twice, drawn=False)
    assert made(xy, drawn=False).path.length == pytest.approx(300.8, abs=0.5)  # 295 m and 20^2/75^2/4 of it


def _off(p: np.ndarray, a: np.ndarray, b: np.ndarray) -> float:
    share = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
    return float(np.hypot(*(p - a - share * (b - a))))


@pytest.mark.parametrize(
    ("xy", "changes", "message"),
    [
        (
            [(0, 0), (50, 0), (50, 30)],
            dict(noise=0.2),
            r"bends to a radius of .* m at s = .*; the car's wheel does 4.1",
        ),
        ([(0, 0), (50, 0), (5, 1)], {}, r"turns by 3.1 rad at one point, \(50.0, 0.0\) \[m\]: a kink"),
        ([(0, 0), (3, 0)], {}, "is 3.0 m long, expected 10 to 200000"),
        ([(0, 0), (np.nan, 0), (50, 0)], {}, r"point 1 is at \(nan, 0.0\) \[m\]"),
        ([(0, 0), (1e12, 0), (50, 0)], {}, "expected numbers below 1e8"),
        ([(0, 0), (0, 0.001)], {}, "1 distinct points, expected 2 or more"),
        ([(0, 0), (20, 0), (20, 1), (0, 1), (0, 2), (20, 2)], dict(noise=0.0), "yard: cannot be driven|radius of"),
    ],
)
def test_what_cannot_be_driven_is_refused_with_the_reason(xy: Any, changes: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        made(xy, **changes)


def test_a_wheel_that_does_more_drives_more() -> None:
    k = np.abs(made(BENT, noise=0.5, tightest=1.0).path.samples.kappa).max()
    with pytest.raises(ValueError, match="the car's wheel does"):
        made(BENT, noise=0.5, tightest=1.01 / k)
    made(BENT, noise=0.5, tightest=0.99 / k)


def test_speeds_stay_where_they_were() -> None:
    limit = np.array([10.0, 10.0, 5.0, 5.0])
    one = made(BENT, noise=0.5, speeds=dict(v_limit=limit))
    s = one.path.samples.s
    assert one.v is None
    assert (one.v_limit[s < 66.0] == 10.0).all()
    assert (one.v_limit[s > 69.0] == 5.0).all()
    some = made(BENT, noise=0.5, speeds=dict(v_limit=limit * [1.0, np.nan, 1.0, 1.0])).v_limit
    assert [np.unique(some[part]).tolist() for part in (s < 39.0, s > 69.0)] == [[10.0], [5.0]]
    assert np.isnan(some[(s > 41.0) & (s < 66.0)]).all()


def test_a_course_comes_back_from_its_file(tmp_path: FilePath) -> None:
    built_in = course("paper")
    xy = built_in.point(np.arange(0.0, built_in.length, 1.0))
    v = np.linspace(4.0, 6.0, len(xy))
    one = laid(
        Line(xy=xy, v=v), name="p", noise=0.02, closed=True, drawn=False, origin_deg=(52.28, 8.02), notes=("a\nb",)
    )
    assert one.path.closed
    again = course_of(one.text(), "p.csv")
    assert (again.closed, again.origin_deg) == (True, (52.28, 8.02))
    assert again.length == pytest.approx(one.path.length, abs=1e-4)
    at = np.linspace(0.0, one.path.length, 500)
    assert np.hypot(*(again.point(at) - one.path.point(at)).T).max() < 1e-3
    assert np.abs(again.kappa(at) - one.path.kappa(at)).max() < 2e-3
    with pytest.raises(ValueError, match=r"y.csv: its first line says .* m, its points make .*: cut short"):
        course_of("\n".join(made(BENT, noise=0.5).text().splitlines()[:-3]), "y.csv")
    one.to_csv(str(tmp_path / "p.csv"))
    third = read_course(str(tmp_path / "p.csv") + "#noise=0")
    assert third.path.length == pytest.approx(one.path.length, abs=1e-3)


def ring(radius: float, step: float, noise: float, seed: int) -> np.ndarray:
    angle = np.arange(0.0, 2.0 * np.pi, step / radius)
    xy = radius * np.column_stack((np.cos(angle), np.sin(angle))) + 1e4
    return xy + noise * np.random.default_rng(seed).normal(size=xy.shape)


@pytest.mark.parametrize("noise", [0.05, 0.3, 1.0])
def test_a_noisy_circle_is_one_again(noise: float) -> None:
    """Within the noise of a few points' mean, and with the noise that was stated left over."""
    points = ring(60.0, 1.0, noise, 3)
    curve, end, u, shown = smoothed(points, noise, closed=True)
    there = curve(np.linspace(0.0, end, 400))
    radii = np.hypot(*(there - 1e4).T)
    assert np.sqrt(np.mean((radii - 60.0) ** 2)) < 0.5 * noise
    assert shown == pytest.approx(noise * (1.0 + 2.0 * (2.0 / len(points)) ** 0.5) ** 0.5, rel=0.01)
    beside = np.hypot(*(points - 1e4).T) - np.hypot(*(curve(u) - 1e4).T)
    assert np.sqrt(np.mean(beside**2)) == pytest.approx(shown, rel=0.05), "less by what the curve takes"


def test_an_exact_straight_stays_one_however_stiff_the_curve() -> None:
    x = np.linspace(0.0, 2000.0, 4001)
    points = np.column_stack((x, 0.3 * x + 1000.0))
    curve, end, _, shown = smoothed(points, 1.0, closed=False)
    there = curve(np.linspace(0.0, end, 500))
    assert np.abs(there[:, 1] - 0.3 * there[:, 0] - 1000.0).max() < 1e-6
    assert shown < 1e-6


def test_a_closed_curve_closes_with_its_derivatives() -> None:
    curve, end, _, _ = smoothed(ring(30.0, 3.0, 0.2, 1), 0.2, closed=True)
    for order in range(4):
        assert curve(0.0, order) == pytest.approx(curve(end * (1.0 - 1e-13), order), abs=1e-6)
