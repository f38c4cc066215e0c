"""`steerkit resimulate`: a table, a picture, a film, JSON; its mistakes stand in test_app.py."""

from pathlib import Path
from typing import Any

import pytest
from PIL import Image


def test_a_recorded_drive_is_driven_again_drawn_and_filmed(tmp_path: Path, cli: Any) -> None:
    picture, film = tmp_path / "again.png", tmp_path / "a.gif"
    words = ("genesis-rfs", "--controller", "stanley", "--vehicle", "vw-passat", "--quiet")
    said = cli("resimulate", *words, "--plot", picture, "--film", film, "--film-lasts", 1, "--json")
    (figures,) = said.json["resimulated"]
    assert figures["controller"] == "stanley"
    assert figures["compared_seconds"] == pytest.approx(62.6, abs=1.0)
    assert figures["max_e"] < 0.1
    assert 3 <= len(figures["places"]) <= 5
    assert picture.stat().st_size > 10_000
    with Image.open(film) as frames:
        assert frames.n_frames in (8, 9)  # 8 a second, and that at the end
