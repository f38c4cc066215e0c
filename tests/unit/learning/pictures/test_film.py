"""The film of a run says what was: who drove, for how long, how far off, how often it failed."""

import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from PIL import Image

from steerkit.learning.pictures.film import FAR, NEAR, STILL, _Scene, film_of, moments_of
from steerkit.learning.pictures.run import Record
from steerkit.plots.style import COLOURS


def test_a_film_has_its_length_and_its_last_picture_stands(kept: Path, tmp_path: Path) -> None:
    file = film_of(kept, tmp_path / "new" / "run.gif", lasts=3.0, fps=2.0)
    durations, means = [], []
    with Image.open(file) as film:
        for k in range(film.n_frames):
            film.seek(k)
            means.append(np.asarray(film.convert("L"), dtype=float).mean())
            durations.append(film.info["duration"])
    assert durations == [500] * 5 + [round(1000 * STILL)]
    assert len(set(means)) == len(means)


def test_the_beginning_is_real_time_until_the_learner_has_the_wheel_again(record: Record) -> None:
    t = record.log.t
    first = float(t[record.failed_at[0]])
    again = float(t[record.learning & (t > first)][0])
    until = float(t[-1])
    found, speed = moments_of(record, until, lasts=4.0 * (again + 4.0), fps=10.0)
    slow = speed == 1.0
    assert found[slow][-1] == pytest.approx(again + 4.0, abs=0.11)
    np.testing.assert_allclose(np.diff(found[slow]), 0.1)
    if until > again + 4.0:
        steps = np.diff(found[~slow])
        np.testing.assert_allclose(steps, steps[0])
    assert found[-1] == until
    squeezed, speed = moments_of(record, until, lasts=0.5 * again, fps=10.0)  # no more than half of the film
    assert (squeezed < again + 4.0).sum() == pytest.approx(0.5 * len(squeezed), abs=2)
    assert speed[0] == pytest.approx((again + 4.0) / (0.25 * again))


def test_the_picture_says_what_the_log_says(record: Record) -> None:
    log, t = record.log, record.log.t
    done = float(t[-1]) - 0.01
    scene = _Scene(record, float(t[-1]), done)
    scene.picture(done, 1.0)
    assert scene.who.get_text() == "A whole round, learned"
    for k in (1, int(record.failed_at[0]) + 3, int(record.failed_at[1]) - 2, len(t) - 2):
        scene.picture(float(t[k]), 1.0)
        learns, failures = record.learning[k], int((record.failed_at <= k).sum())
        who = scene.who.get_text()
        assert ("learner" in who) == learns
        assert ("recovery" in who.lower()) == (not learns)
        what = scene.what.get_text()
        assert what.startswith(f"{t[k]:.1f} s driven")
        assert re.search(rf"  {failures} failures?$", what)
        told = re.search(r"= ([\d.]+) (c?m)", what)
        assert told
        e = abs(log["path.e"][k])
        assert float(told[1]) / (100.0 if told[2] == "cm" else 1.0) == pytest.approx(e, abs=0.006)
        x, y = log["car.x"][k], log["car.y"][k]
        assert scene.dot.get_xydata()[0] == pytest.approx((x, y))
        assert np.hypot(*(scene.car.shapes[-1].get_xy().mean(axis=0) - (x, y))) < 2.0
        drawn = [np.isfinite(line.get_ydata()[k]) for line in scene.lines]
        assert drawn[0 if learns else 1]
        colours = {scene.who.get_color(), scene.dot.get_color(), to_hex(scene.car.shapes[-1].get_facecolor())}
        assert colours == {COLOURS["learned" if learns else "analytic"]}


def test_the_car_points_where_it_drives(record: Record) -> None:
    log = record.log
    fast = np.flatnonzero(log["car.v"] > 3.0)[5:-5:40]
    course = np.arctan2(log["car.y"][fast + 1] - log["car.y"][fast], log["car.x"][fast + 1] - log["car.x"][fast])
    off = np.angle(np.exp(1j * (_Scene(record, 1.0, None).psi[fast] - course)))
    assert np.abs(off).max() < 0.25  # sideslip


def test_the_view_widens_when_it_goes_fast(record: Record) -> None:
    scene = _Scene(record, 20.0, None)
    widths = []
    for k in range(30):
        scene.picture(0.1 * k, 10.0 if k else 1.0)
        low, high = scene.view.get_xlim()
        widths.append(0.5 * (high - low))
    assert widths[0] == pytest.approx(NEAR)
    assert widths[-1] == pytest.approx(FAR)
    assert max(np.diff(widths)) <= 1.0 + 1e-9


def test_mistakes_teach(kept: Path, tmp_path: Path) -> None:
    for file, options, says in (
        ("run.mp4", {}, r"run.mp4: expected a name that ends in .gif"),
        ("run.gif", {"lasts": 1.0}, "lasts = 1.0 s, expected 2 to 120"),
        ("run.gif", {"fps": 60.0}, "fps = 60.0, expected 2 to 25"),
    ):
        with pytest.raises(ValueError, match=says):
            film_of(kept, tmp_path / file, **options)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="is no run directory"):
        film_of(tmp_path, tmp_path / "run.gif")
