"""Notebook looks and films: the right contents, escaped, made without loading matplotlib before they are shown."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from steerkit import Stanley, placed, simulate, steering_loop, vehicle
from steerkit.block import Block
from steerkit.courses import circle
from steerkit.doe import Integrator
from steerkit.plants.human_driver import ConstantSpeed, RecordedDriver
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plots.animation import LENGTH, _moved, _Run, _Scene, animate
from steerkit.simulation import Log

PATH, PASSAT = circle(), vehicle("vw-passat")
PNG = b"\x89PNG"


@pytest.fixture(scope="module")
def log() -> Log:
    car = placed(LinearSingleTrack(vehicle=PASSAT, v0=5.0), PATH)
    loop = steering_loop(car=car, path=PATH, driver=ConstantSpeed(speed=5.0), controller=Stanley.of(PASSAT))
    return simulate(loop, 4.0)


def test_a_block_shows_its_parameters_and_ports() -> None:
    html = Integrator()._repr_html_()
    for words in ("<b>Integrator</b>", "limit", "9.07571", "applied", "rad", "seen by update only", "of the state"):
        assert words in html
    assert html.count("<table>") == html.count("</table>") == 2
    assert "&lt;" not in html.split("<table>")[0]


def test_long_and_odd_parameters_are_cut_and_escaped() -> None:
    driver = RecordedDriver(speeds=tuple(np.linspace(1.0, 2.0, 500).tolist()), spacing=0.1)
    assert "500 entries" in driver._repr_html_()
    html = LinearSingleTrack(vehicle=vehicle("vw-passat"))._repr_html_()
    assert "..." in html  # the vehicle
    named = LinearSingleTrack(vehicle=type(PASSAT)(**{**vars(PASSAT), "name": "<script>"}))._repr_html_()
    assert "<script>" not in named


def test_every_shipped_block_can_be_shown(log: Log) -> None:
    assert log.loop is not None
    for block in log.loop.blocks.values():
        assert isinstance(block, Block)
        assert type(block).__name__ in block._repr_html_()


def test_a_log_shows_ranges_and_a_picture(log: Log) -> None:
    html = log._repr_html_()
    for words in ("<b>Log</b>", "path.e", "rad/s", "data:image/png;base64,iVBOR"):
        assert words in html
    assert f"{log['car.x'].max():.4g}" in html
    assert log._repr_png_()[:4] == PNG
    one = Log(np.zeros(1), {"a.b": np.zeros(1)}, {"a.b": "1"})
    assert "<img" not in one._repr_html_()
    assert "no time" in Log(np.zeros(0), {}, {})._repr_html_()


def test_a_batch_is_shown(log: Log) -> None:
    assert log.loop is not None
    many = simulate(log.loop, 0.5, batch=3)
    assert "<td style='text-align:left'>3</td>" in many._repr_html_()


def test_a_loop_shows_its_diagram(log: Log) -> None:
    assert log.loop is not None
    assert log.loop._repr_png_()[:4] == PNG


def test_matplotlib_is_loaded_when_a_log_is_shown_and_not_before() -> None:
    code = """
import sys
import steerkit.plots.notebook, steerkit.plots.animation
from steerkit import Integrator
Integrator()._repr_html_()
assert "matplotlib" not in sys.modules
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


# ---- films ------------------------------------------------------------------------------------------------------


def test_a_film_has_its_frames_and_the_car_moves(log: Log, tmp_path: Path) -> None:
    file = log.animate(PATH, tmp_path / "new" / "run.gif", fps=2.0, speed=1.0)
    with Image.open(file) as film:
        assert film.n_frames == 8
        assert film.info["duration"] == 500
        frames = []
        for k in (0, 7):
            film.seek(k)
            frames.append(np.asarray(film.convert("L"), dtype=float))
    assert np.abs(frames[0] - frames[1]).mean() > 1.0


def test_the_car_is_to_scale_and_in_its_place(log: Log) -> None:
    scene = _Scene(_Run(log, 0), PATH, 2.71, PASSAT.l_f, 15.6, 18.0)
    scene.show(2.0, 1.0)
    body = scene.shapes[-1].get_xy()
    x, y, psi = (np.interp(2.0, log.t, log[f"car.{key}"]) for key in ("x", "y", "psi"))
    local = _moved(body - (x, y), -psi, 0.0, 0.0)
    assert np.ptp(local[:, 0]) == pytest.approx(LENGTH * 2.71)
    assert local[:, 0].max() > 0.5 * 2.71
    assert abs(local[:, 1].max() + local[:, 1].min()) < 1e-9
    front, rear = (
        np.mean([_moved(s.get_xy() - (x, y), -psi, 0.0, 0.0).mean(axis=0) for s in pair], axis=0)
        for pair in (scene.shapes[:2], scene.shapes[2:4])
    )
    assert front[0] - rear[0] == pytest.approx(2.71, abs=0.1)
    assert scene.view.get_xlim() == pytest.approx((x - 18.0, x + 18.0))
    assert "t = 2.0 s" in scene.words.get_text()
    assert f"{np.interp(2.0, log.t, log['path.e']):+.3f}" in scene.words.get_text()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"file": "run.avi"}, r"a film ends in \.gif or \.mp4"),
        ({"window": 1.0}, "window = 1.0 m"),
        ({"fps": 0.0}, "fps = 0.0"),
        ({"speed": -1.0}, "speed = -1.0"),
    ],
)
def test_mistakes_teach(options: dict[str, Any], says: str, log: Log, tmp_path: Path) -> None:
    file = tmp_path / options.pop("file", "run.gif")
    with pytest.raises(ValueError, match=says):
        animate(log, PATH, file, **options)
    assert not file.exists()


def test_a_log_without_a_car_teaches(log: Log, tmp_path: Path) -> None:
    bare = Log(log.t, {"car.x": log["car.x"]}, {"car.x": "m"})
    with pytest.raises(ValueError, match=r"the log lacks car\.y, car\.psi; recorded: car\.x"):
        animate(bare, PATH, tmp_path / "run.gif")


def test_mp4_without_ffmpeg_teaches(log: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("matplotlib.animation.FFMpegWriter.isAvailable", classmethod(lambda cls: False))
    with pytest.raises(ValueError, match=r"needs ffmpeg, which is not there; install it, or write a \.gif"):
        animate(log, PATH, tmp_path / "run.mp4")


def test_drive_animates(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from steerkit.cli import app as cli

    words = ["drive", "stanley", "--course", "circle", "--rounds", "0.04", "--out", str(tmp_path / "d"), "-q"]
    monkeypatch.setattr("sys.argv", ["steerkit", *words, "--animate", str(tmp_path / "run.gif")])
    with pytest.raises(SystemExit, match="0"):
        cli.main()
    with Image.open(tmp_path / "run.gif") as film:
        assert film.n_frames >= 5
