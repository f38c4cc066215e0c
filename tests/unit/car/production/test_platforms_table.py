"""The table of production cars, and the file that is written for one."""

from typing import Any

import pytest

pytest.importorskip("opendbc")

from steerkit.car.production import platforms


def test_the_table_lists_each_platform_once_and_writes_a_file_that_is_sound(tmp_path: Any) -> None:
    rows = platforms.rows()
    assert len({row["name"] for row in rows}) == len(rows) == 243
    assert {row["by"] for row in rows} == {"angle", "curvature", "torque"}
    assert sum(not row["obstacle"] for row in rows) == 208
    text = "\n".join(platforms.lines(rows))
    assert "TESLA_MODEL_3" in text
    assert "208 of 243" in text
    platforms.write("NISSAN_ROGUE", tmp_path / "car.toml")
    assert 'opendbc = "NISSAN_ROGUE"' in (tmp_path / "car.toml").read_text(encoding="utf-8")
    with pytest.raises(ValueError, match="exists already"):
        platforms.write("NISSAN_ROGUE", tmp_path / "car.toml")
