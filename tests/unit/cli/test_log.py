"""What `steerkit log` says, and logs of other programs; mistakes stand in test_app.py."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.cli.log import contents
from steerkit.logs import ColumnMap, read_drive, read_log
from tests.support.written_logs import driven, written


def test_the_next_command_keeps_what_was_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any) -> None:
    columns = driven()
    long = "steering_column_of_the_second_prototype_at_the_front_left_wheel_hub"
    file, table = tmp_path / "my lap.csv", tmp_path / "map.toml"
    names = ["t", long, "v", "r"]
    rows = np.column_stack([columns[key] for key in ("t", "delta_sw", "v", "r")])
    np.savetxt(file, rows, delimiter=",", header=",".join(names), comments="")
    table.write_text(f'[columns]\nr = "r"\ndelta_sw = "{long}"\n')
    monkeypatch.setenv("COLUMNS", "80")
    printed = cli("log", file, "--column", f"delta_sw={long}", "--steer-ratio", "15", "--map", table).out
    said = f"'{file}' --map {table} --column delta_sw={long} --steer-ratio 15"
    assert f"next: steerkit identify {said} --out my-car.toml" in printed
    assert "…" not in printed
    assert long[:30] in printed


def test_plot_and_export_take_logs_of_other_programs(tmp_path: Path, cli: Any) -> None:
    file, _ = written("csv", tmp_path, driven())
    assert "picture: " in cli("plot", file, "v").out
    pytest.importorskip("asammdf")
    out = tmp_path / "again.mf4"
    cli("export", file, "--mf4", out)
    for name in ("delta_sw", "v", "r"):
        np.testing.assert_array_equal(getattr(read_drive(out), name), getattr(read_drive(file), name))


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
