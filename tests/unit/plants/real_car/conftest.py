"""A recording of a drive."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.tapes import small


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    (tmp_path / "drive.mcap").write_bytes(small())
    return tmp_path / "drive.mcap"
