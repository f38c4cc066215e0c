"""What is in a log is told: rates, gaps, ranges, what is read as what, and why there is no drive."""

from pathlib import Path

import numpy as np
import pytest

from steerkit.cli.log import contents
from steerkit.logs import ColumnMap, read_log
from tests.support.written_logs import driven, written


def test_rows_say_rate_gaps_and_range(tmp_path: Path) -> None:
    columns = driven()
    t = columns["t"]
    columns = {name: values[(t < 5.0) | (t >= 8.0)].copy() for name, values in columns.items()}
    columns["v"][17] = np.nan
    file, _ = written("csv", tmp_path, columns)
    found, drive, _ = contents(read_log(file), ColumnMap({}))
    rows = {row["name"]: row for row in found}
    assert (rows["v"]["samples"], rows["v"]["invalid"], rows["v"]["gaps"], rows["v"]["quantity"]) == (440, 1, 1, "v")
    assert rows["v"]["rate"] == pytest.approx(20.0)
    assert rows["v"]["longest"] == pytest.approx(3.05)
    assert (rows["r"]["low"], rows["r"]["high"]) == (columns["r"].min(), columns["r"].max())
    assert drive is not None
    assert found[0]["name"] == "delta_sw"


def test_a_log_without_a_drive_says_why_and_what_could_be(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,yaw_rate,other\n" + "".join(f"{k},0,1\n" for k in range(50)))
    log = read_log(tmp_path / "a.csv")
    rows, drive, trouble = contents(log, ColumnMap({}))
    assert drive is None
    assert "which column is delta_sw, v? Columns: yaw_rate, other" in trouble
    assert {row["name"]: row["quantity"] for row in rows} == {"yaw_rate": "(r)", "other": ""}
    *_, trouble = contents(log, ColumnMap.of({"v": "speed"}))
    assert "column for v 'speed' is not known" in trouble
