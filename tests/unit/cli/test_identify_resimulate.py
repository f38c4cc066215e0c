"""`steerkit resimulate`: a table, a picture, JSON; its mistakes stand in test_app.py."""

from pathlib import Path
from typing import Any

import pytest


def test_a_recorded_drive_is_driven_again_and_drawn(tmp_path: Path, cli: Any) -> None:
    picture = tmp_path / "again.png"
    words = ("genesis-rfs", "--controller", "stanley", "--vehicle", "vw-passat", "--quiet")
    said = cli("resimulate", *words, "--plot", picture, "--json")
    (figures,) = said.json["resimulated"]
    assert figures["controller"] == "stanley"
    assert figures["compared_seconds"] == pytest.approx(62.6, abs=1.0)
    assert figures["max_e"] < 0.1
    assert 3 <= len(figures["places"]) <= 5
    assert picture.read_bytes()[:4] == b"\x89PNG"
