"""Good logs of other people's writers with one defect each open in their good part, with the defect named; and files
damaged by their structure are read as they were, or say so, or are refused in words."""

import os
import re
import time
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


def gap(columns: dict[str, Any]) -> dict[str, Any]:
    return rows(columns, (columns["t"] < 15.0) | (columns["t"] > 25.0))


def late_row(columns: dict[str, Any]) -> dict[str, Any]:
    order = np.arange(len(columns["t"]))
    order[[300, 301]] = 301, 300
    return rows(columns, order)


def time_twice(columns: dict[str, Any]) -> dict[str, Any]:
    return rows(columns, np.insert(np.arange(len(columns["t"])), 300, 300))


def lone_speed(columns: dict[str, Any]) -> dict[str, Any]:
    v = columns["v"].copy()
    v[300] += 40.0
    return columns | {"v": v}


def unit(columns: dict[str, Any]) -> dict[str, Any]:
    return columns | {"v": np.where(columns["t"] < 20.0, 1.0, 3.6) * columns["v"]}


DEFECTS: dict[str, tuple[Any, str]] = {
    "a gap of 10 s": (gap, r"gaps, (9|10)\.\d s in all"),
    "a late row": (late_row, r"sorted by time|came out of order"),
    "a time twice": (time_twice, "repeat the time of the one before"),
    "a lone speed": (lone_speed, r"v stands off from all around in 1 samples"),
    "km/h from the middle on": (unit, r"v goes from .* its unit changes there between m/s and km/h"),
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


def damaged(data: bytes, text: bool, rng: np.random.Generator) -> bytes:
    """By its structure: of text lines and cells, else blocks of bytes; or cut off."""
    kind = int(rng.integers(5))
    if not text:
        begin = int(rng.integers(len(data)))
        end = min(len(data), begin + int(2 ** rng.integers(0, 9)))
        block = data[begin:end]
        other = [b"", block + block, bytes(len(block)), bytes(rng.integers(0, 256, len(block), dtype=np.uint8))]
        return data[:begin] if kind == 4 else data[:begin] + other[kind] + data[end:]
    lines = data.decode("latin-1").splitlines(keepends=True)
    k = int(rng.integers(len(lines)))
    cells = re.split(r"([ ,;#]+)", lines[k])
    c = int(rng.integers(len(cells)))
    if kind == 0:
        del lines[k]
    elif kind == 1:
        lines.insert(int(rng.integers(len(lines))), lines[k])
    elif kind == 2:
        lines = [*lines[:k], lines[k][: len(lines[k]) // 2]]
    else:
        cells[c] = str(rng.choice(["", "nan", "inf", "-1e9", "1e309", "x", "0", "\0", "é", "9" * 400]))
        lines[k] = "".join(cells) if kind == 3 else lines[k].replace(cells[0], cells[c], 1)
    return "".join(lines).encode("latin-1")


@pytest.mark.parametrize("name", FORMATS)
def test_a_damaged_log_is_read_as_it_was_or_says_so(name: str, tmp_path: Path) -> None:
    kind = FORMATS[name]
    file, how = written(name, tmp_path, driven(SECONDS))
    data, text = file.read_bytes(), kind.suffix in (".csv", ".log", ".asc", ".trc")
    right = read_drive(file, **how)
    quiet = set(right.notes)
    rng, said = np.random.default_rng(39), list[str]()
    for number in range(COUNT):
        file.write_bytes(damaged(data, text, rng))
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
