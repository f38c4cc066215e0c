"""`steerkit resimulate`: a table, a picture, JSON."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from steerkit.cli.app import app


def test_a_recorded_drive_is_driven_again(tmp_path: Path) -> None:
    picture = tmp_path / "again.png"
    words = ["resimulate", "genesis-rfs", "--controller", "stanley", "--vehicle", "vw-passat", "--plot", str(picture)]
    done = CliRunner().invoke(app, [*words, "--json"])
    assert done.exit_code == 0, done.output
    (figures,) = json.loads(done.stdout.strip().splitlines()[0])["resimulated"]
    assert figures["controller"] == "stanley"
    assert figures["compared_seconds"] == pytest.approx(62.6, abs=1.0)
    assert figures["max_e"] < 0.1
    assert 3 <= len(figures["places"]) <= 5
    assert picture.stat().st_size > 10_000


def test_one_picture_shows_one_controller() -> None:
    for option, file in (("--plot", "a.png"), ("--film", "a.gif")):
        words = ["resimulate", "genesis", "--controller", "mpc", "--controller", "lqr", option, file]
        done = CliRunner().invoke(app, words)
        assert isinstance(done.exception, ValueError)
        assert f"{option} {file}: shows one controller, not mpc, lqr" in str(done.exception)


def test_a_film_of_another_kind_is_refused_before_the_drive() -> None:
    done = CliRunner().invoke(app, ["resimulate", "no-such-file.csv", "--film", "a.avi"])
    assert isinstance(done.exception, ValueError)
    assert "a film ends in .gif or .mp4" in str(done.exception)


def test_a_film_lasts_as_long_as_asked_and_a_length_that_makes_no_film_is_refused(tmp_path: Path) -> None:
    from PIL import Image

    words = ["resimulate", "genesis-rfs", "--controller", "stanley", "--vehicle", "vw-passat", "--quiet"]
    done = CliRunner().invoke(app, [*words, "--film", str(tmp_path / "a.gif"), "--film-lasts", "1"])
    assert done.exit_code == 0, done.output
    with Image.open(tmp_path / "a.gif") as film:
        assert film.n_frames in (8, 9)  # 8 a second, and that at the end
    done = CliRunner().invoke(app, [*words, "--film", str(tmp_path / "b.gif"), "--film-lasts", "0"])
    assert "--film-lasts: 0 [s], expected 1 to 120" in str(done.exception)
