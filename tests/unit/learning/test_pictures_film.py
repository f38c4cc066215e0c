"""The film of a run says what was: who drove, for how long, how far off, how often it failed."""

from pathlib import Path

import numpy as np
import pytest
from matplotlib.colors import to_hex
from PIL import Image

from steerkit.learning.pictures import Record, film_of, moments_of, with_heading
from steerkit.plots.animation import Moments, Scene
from steerkit.plots.style import COLOURS

pytestmark = pytest.mark.usefixtures("without_layout")  # many pictures are drawn


def test_a_film_has_its_length_and_every_picture_differs(kept: Path, tmp_path: Path) -> None:
    file = film_of(kept, tmp_path / "new" / "run.gif", lasts=3.0, fps=2.0)
    durations, means = [], []
    with Image.open(file) as film:
        for k in range(film.n_frames):
            film.seek(k)
            means.append(np.asarray(film.convert("L"), dtype=float).mean())
            durations.append(film.info["duration"])
    assert durations == [500] * 6
    assert len(set(means)) == len(means)


def test_the_beginning_is_real_time_until_the_learner_has_the_wheel_again(record: Record) -> None:
    t = record.log.t
    first = float(t[record.failed_at[0]])
    again = float(t[record.learning & (t > first)][0])
    until = float(t[-1])
    found = moments_of(record, until, lasts=4.0 * (again + 4.0), fps=10.0)
    slow = found < again + 4.0
    assert found[slow][-1] == pytest.approx(again + 4.0, abs=0.11)
    np.testing.assert_allclose(np.diff(found[slow]), 0.1)
    if until > again + 4.0:
        steps = np.diff(found[~slow])
        np.testing.assert_allclose(steps, steps[0])
    assert found[-1] == until
    squeezed = moments_of(record, until, lasts=0.5 * again, fps=10.0)  # no more than half of the film
    assert (squeezed < again + 4.0).sum() == pytest.approx(0.5 * len(squeezed), abs=2)


def test_the_picture_says_what_the_log_says(record: Record) -> None:
    log, t = record.log, record.log.t
    scene = Scene(Moments.of_log(with_heading(record)), record.path, 2.7, 1.2, 15.6, 18.0)
    for k in (1, int(record.failed_at[0]) + 3, int(record.failed_at[1]) - 2, len(t) - 2):
        scene.show(float(t[k]), 1.0)
        learns, failures = record.learning[k], int((record.failed_at <= k).sum())
        who, when, *_, error = scene.words.get_text().split("\n")
        assert who == f"the {'learner' if learns else 'recovery controller'} steers; {failures} failure" + "s" * (
            failures != 1
        )
        assert when == f"t = {t[k]:.1f} s"
        assert float(error.removeprefix("e = ").removesuffix(" m")) == pytest.approx(log["path.e"][k], abs=6e-4)
        role = "learned" if learns else "analytic"
        assert scene.trails[role].get_xydata()[-1] == pytest.approx((log["car.x"][k], log["car.y"][k]))
        assert scene.lines[role].get_ydata()[-1] == log["path.e"][k]
        assert to_hex(scene.car.shapes[-1].get_facecolor()) == COLOURS[role]


def test_mistakes_teach(kept: Path, tmp_path: Path) -> None:
    for file, options, says in (
        ("run.gif", {"lasts": 1.0}, "lasts = 1.0 s, expected 2 to 120"),
        ("run.gif", {"fps": 90.0}, "fps = 90.0, expected 1 to 60"),
    ):
        with pytest.raises(ValueError, match=says):
            film_of(kept, tmp_path / file, **options)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="is no run directory"):
        film_of(tmp_path, tmp_path / "run.gif")


def test_the_car_points_where_it_drives(record: Record) -> None:
    log = with_heading(record)
    fast = np.flatnonzero(log["car.v"] > 3.0)[5:-5:40]
    course = np.arctan2(log["car.y"][fast + 1] - log["car.y"][fast], log["car.x"][fast + 1] - log["car.x"][fast])
    off = np.angle(np.exp(1j * (log["car.psi"][fast] - course)))
    assert np.abs(off).max() < 0.25  # sideslip
