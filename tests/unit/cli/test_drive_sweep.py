"""`steerkit sweep`: the drives of `steerkit drive`, many at once."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.own_controller import own_controller


def test_the_command_drives_as_drive_does(tmp_path: Path, cli: Any) -> None:
    """The value that the controller has by itself gives the row that `drive` gives."""
    name, course = own_controller(tmp_path), ("--course", "circle", "--conditions", "hard", "--seed", 3, "--json", "-q")
    said = cli("sweep", name, "--set", "gain=1:2.5:3", *course, "--out", tmp_path / "swept").json
    drive = cli("drive", name, *course, "--out", tmp_path / "driven").json
    for metric in ("rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y"):
        assert said["columns"][metric][2] == pytest.approx(drive[metric], rel=1e-9)
    table = np.genfromtxt(tmp_path / "swept/sweep.csv", delimiter=",", names=True, deletechars="")
    np.testing.assert_array_equal(table["controller.gain"], [1.0, 1.75, 2.5])
    assert (tmp_path / "swept/sweep.png").read_bytes()[:4] == b"\x89PNG"


def test_the_command_finds_the_field_inside_a_wrapper_and_says_what_is_wrong(tmp_path: Path, cli: Any) -> None:
    where = ("--course", "circle", "--seconds", 2, "--json", "-q", "--out", tmp_path / "swept")
    said = cli("sweep", "stanley-delay", "--set", "k=1:4:3:log", "--set", "car.vehicle.m=1500,1700", *where).json
    assert said["columns"]["controller.block.k"] == pytest.approx([1.0, 1.0, 2.0, 2.0, 4.0, 4.0])
    assert said["columns"]["car.vehicle.m"] == [1500.0, 1700.0] * 3
    assert [*said["best"]] == ["rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y"]
