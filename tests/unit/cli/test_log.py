"""`steerkit log` and `steerkit plot`; their mistakes stand in test_app.py."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.logs import read_drive
from tests.support.written_logs import driven, written


def test_a_log_is_shown_and_drawn(tmp_path: Path, cli: Any) -> None:
    file, _ = written("csv", tmp_path, driven())
    picture = tmp_path / "a.png"
    printed = cli("log", file, "--plot", picture).out
    assert "a drive of 24.9 s at 20 Hz" in printed or "a drive of 25.0 s at 20 Hz" in printed
    assert f"next: steerkit identify {file} --out my-car.toml" in printed
    assert picture.read_bytes()[:4] == b"\x89PNG"
    channels = cli("log", file, "--json").json["channels"]
    assert [row["quantity"] for row in channels] == ["delta_sw", "v", "r"]


def test_the_next_command_keeps_what_was_said_and_a_long_name_is_not_cut(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cli: Any
) -> None:
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
