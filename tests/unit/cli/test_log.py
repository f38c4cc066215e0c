"""What `steerkit log` says, and logs of other programs; mistakes stand in test_app.py."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.logs import read_drive
from tests.support.written_logs import driven, written


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
