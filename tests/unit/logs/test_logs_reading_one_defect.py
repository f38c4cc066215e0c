"""Good logs of other people's writers with one defect each open in their good part, with the defect named; and files
damaged somewhere are read as they were, or say so, or are refused in words."""

import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.logs import read_drive
from tests.support.written_logs import FORMATS, driven, written

COUNT = int(os.environ.get("STEERKIT_DAMAGED", "4"))
"""Damaged files a format."""
SECONDS = 40.0


@pytest.fixture(scope="module", autouse=True)
def libraries() -> None:
    for package in ("rosbags", "asammdf", "can", "cantools", "pyarrow"):
        pytest.importorskip(package)


def rows(columns: dict[str, Any], kept: Any) -> dict[str, Any]:
    return {name: values[kept] for name, values in columns.items()}


DEFECTS: dict[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    "a gap of 10 s": (lambda c: rows(c, (c["t"] < 15.0) | (c["t"] > 25.0)), r"gaps, (9|10)\.\d s in all"),
    "a late row": (lambda c: rows(c, [*range(300), 301, 300, *range(302, 800)]), r"sorted by time|came out of order"),
    "a time twice": (lambda c: rows(c, [*range(301), *range(300, 800)]), "repeat the time of the one before"),
    "a lone speed": (lambda c: c | {"v": c["v"] + 40.0 * (np.arange(800) == 300)}, "v stands off from all around in 1"),
    "km/h from the middle on": (
        lambda c: c | {"v": np.where(c["t"] < 20.0, 1.0, 3.6) * c["v"]},
        r"v goes from .* its unit changes there between m/s and km/h",
    ),
}


_CHANGES = "km/h from the middle on"


@pytest.mark.parametrize("defect", DEFECTS)
@pytest.mark.parametrize("name", FORMATS)
def test_a_log_with_one_defect_opens_in_its_good_part(name: str, defect: str, tmp_path: Path) -> None:
    change, says = DEFECTS[defect]
    good = driven(SECONDS)
    file, how = written(name, tmp_path, change(good))
    if defect == _CHANGES:
        with pytest.raises(ValueError, match=says):
            read_drive(file, **how)
        return
    drive = read_drive(file, **how)
    sorted_by_reader = name.startswith("ros2") and defect == "a late row"
    assert sorted_by_reader or re.search(says, " ".join(drive.notes)), drive.notes
    near = drive.measured & (drive.t < SECONDS - 0.2)
    off = np.abs(drive.v - np.interp(drive.t, good["t"], good["v"]))[near]
    assert np.quantile(off, 0.99) < 0.05
    assert np.isfinite(drive.v).all()
    assert np.isfinite(drive.r).all()


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """With a block lost, doubled, of zeros or of noise; or cut off."""
    begin, size = int(rng.integers(len(data))), int(2 ** rng.integers(0, 9))
    block, rest = data[begin : begin + size], data[begin + size :]
    other = [b"", block + block, bytes(len(block)), bytes(rng.integers(0, 256, len(block), dtype=np.uint8))]
    kind = int(rng.integers(5))
    return data[:begin] if kind == 4 else data[:begin] + other[kind] + rest


@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_log_is_read_as_it_was_or_says_so(name: str, tmp_path: Path) -> None:
    kind = FORMATS[name]
    file, how = written(name, tmp_path, driven(SECONDS))
    data, right = file.read_bytes(), read_drive(file, **how)
    quiet = set(right.notes)
    rng, said = np.random.default_rng(39), list[str]()
    for number in range(COUNT):
        file.write_bytes(damaged(data, rng))
        begun = time.perf_counter()
        try:
            drive = read_drive(file, **how)
        except ValueError as error:
            said.append(str(error))
            continue
        finally:
            assert time.perf_counter() - begun < 5.0, f"file {number} took too long"
        for quantity in ("delta_sw", "v", "r"):
            assert np.isfinite(getattr(drive, quantity)).all(), f"file {number}: {quantity}"
        if kind.sums and not set(drive.notes) - quiet:
            assert len(drive.v) == len(right.v), f"file {number}"
            np.testing.assert_array_equal(drive.v, right.v, err_msg=f"file {number}")
    assert all(len(one.splitlines()) <= 10 for one in said)
