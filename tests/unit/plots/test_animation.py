"""Films of a drive: frames, scale, mistakes."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from steerkit.diagram.simulation import Log
from steerkit.paths.courses import circle
from steerkit.plots.animation import Moments, Scene, animate
from steerkit.vehicles import VW_PASSAT, scaled
from tests.support.command_lines import run

PATH = circle()


def test_a_film_has_its_frames_and_the_car_moves(log: Log, tmp_path: Path) -> None:
    file = log.animate(PATH, tmp_path / "new" / "run.gif", fps=1.0)
    with Image.open(file) as film:
        assert film.n_frames == 4
        assert film.info["duration"] == 1000
        frames = []
        for k in (0, 3):
            film.seek(k)
            frames.append(np.asarray(film.convert("L"), dtype=float))
    assert np.abs(frames[0] - frames[1]).mean() > 1.0


def test_mistakes_teach(log: Log, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"fps = 0\.0"):
        animate(log, PATH, tmp_path / "run.gif", fps=0.0)
    assert not [*tmp_path.iterdir()]


def test_a_log_without_a_car_and_one_of_several_teach(log: Log, tmp_path: Path) -> None:
    bare = Log(log.t, {"car.x": log["car.x"]}, {"car.x": "m"})
    with pytest.raises(ValueError, match=r"the log lacks car\.y, car\.psi; recorded: car\.x"):
        animate(bare, PATH, tmp_path / "run.gif")
    two = Log(log.t, {name: np.stack([log[name]] * 2, axis=-1) for name in log}, log.units)
    with pytest.raises(ValueError, match=r"car\.x is \(\d+, 2\), a batch, expected a log of one car"):
        animate(two, PATH, tmp_path / "run.gif")


def test_the_car_that_is_given_is_drawn_where_the_log_knows_none(log: Log, tmp_path: Path) -> None:
    bare, long = Log(log.t, {name: log[name] for name in log}, log.units), scaled("long", m=1500.0, wheelbase=9.0)
    films = [
        animate(of, PATH, tmp_path / "run.gif", fps=1.0, vehicle=car).read_bytes()
        for of, car in ((log, long), (bare, long), (bare, VW_PASSAT))
    ]
    assert films[0] == films[2] != films[1], "the log knows its car"


def test_what_cannot_be_filmed_is_not_driven(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("matplotlib.animation.FFMpegWriter.isAvailable", classmethod(lambda cls: False))
    monkeypatch.setattr("steerkit.cli.drive.driven", lambda *_, **__: pytest.fail("it drove"))
    film, place = tmp_path / "run.mp4", tmp_path / "d"
    words = ("drive", "stanley", "--rounds", "0.04", "--out", str(place), "--animate", str(film))
    assert run(*words, monkeypatch=monkeypatch) == 2
    assert "needs ffmpeg, which is not there; install it, or write a .gif" in capsys.readouterr().err


def moments(**signals: list[float]) -> Moments:
    """Of a car over one second."""
    return Moments(np.array([0.0, 1.0]), {name: np.array(values) for name, values in signals.items()})


@pytest.mark.parametrize("psi", [0.0, 0.7, -2.0, 3.1])
def test_the_car_points_where_it_heads_and_its_front_wheels_where_they_are_turned(psi: float) -> None:
    car = moments(x=[1.0, 1.0], y=[2.0, 2.0], psi=[psi, psi], delta_sw=[7.8, 7.8])
    scene = Scene(car, None, 2.71, 1.2, 15.6, 18.0)
    scene.show(0.5, 1.0)

    def heading(corners: np.ndarray) -> float:
        """From the middle of the back edge to that of the front edge."""
        ahead = corners[2:4].mean(axis=0) - corners[[0, 5]].mean(axis=0)
        return float(np.arctan2(ahead[1], ahead[0]))

    *wheels, body = (shape.get_xy()[:6] for shape in scene.car.shapes)
    turned = [psi + 0.5, psi + 0.5, psi, psi]  # 7.8 rad of steering wheel are 0.5 rad of road wheel
    for corners, angle in zip([*wheels, body], [*turned, psi], strict=True):
        assert np.cos(heading(corners) - angle) == pytest.approx(1.0)


def test_a_heading_that_passes_180_degrees_is_no_spin() -> None:
    assert moments(x=[0.0, 1.0], y=[0.0, 0.0], psi=[3.1, 0.1 + 3.1 - 2.0 * np.pi]).at(0.5)["psi"] == pytest.approx(3.15)


def test_a_film_of_moments_says_how_fast_each_is(log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = list[tuple[float, float]]()
    show = Scene.show
    monkeypatch.setattr(Scene, "show", lambda self, t, speed: (shown.append((t, speed)), show(self, t, speed))[1])
    log.animate(PATH, tmp_path / "a.gif", fps=2.0, moments=[0.0, 0.5, 2.5])
    assert shown == [(0.0, 1.0), (0.5, 1.0), (2.5, 4.0)]
