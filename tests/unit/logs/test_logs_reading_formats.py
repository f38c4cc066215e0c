"""Every format, written by its own library, is read to the last bit, or to its resolution; with one defect in its good
part, with the defect named; damaged as it was, or with words, or refused in words."""

import os
import re
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit.logs import read_drive, read_log
from tests.support.written_logs import FORMATS, STEPS, driven, written


@pytest.fixture(scope="module", autouse=True)
def libraries() -> None:
    """Imported where they are needed: they take a second."""
    for package in ("rosbags", "asammdf", "can", "cantools", "pyarrow"):
        pytest.importorskip(package)


@pytest.mark.parametrize("name", FORMATS)
def test_what_was_written_is_read(name: str, tmp_path: Path) -> None:
    columns = driven()
    file, how = written(name, tmp_path, columns)
    log = read_log(file, **how)
    kind = FORMATS[name]
    drive = read_drive(file, steer_ratio=15.0, **how)
    for quantity, step in STEPS.items():
        if kind.exact:
            np.testing.assert_array_equal(log.channels[quantity].values, columns[quantity])
            np.testing.assert_array_equal(log.channels[quantity].t, columns["t"])
        n = len(drive.v) - 1
        low = max(abs(columns[quantity])) * 1e-6 if not kind.dbc else 0.51 * step  # float32, or half a step
        between = kind.clock * 10.0  # how far a value goes in a step of the clock
        np.testing.assert_allclose(getattr(drive, quantity)[:n], columns[quantity][:n], atol=low + between)
    assert not any("broken" in note or "left out" in note for note in drive.notes)


def test_reports_of_autoware_are_known_by_kind_and_keep_float32_to_the_last_bit(tmp_path: Path) -> None:
    columns = driven()
    for name in ("ros2 mcap", "ros2 sqlite"):
        log = read_log(written(name, tmp_path, columns)[0])
        steering = log.channels["/vehicle/status/steering_status.steering_tire_angle"]
        assert (steering.means, steering.unit) == ("delta", "rad")
        np.testing.assert_array_equal(steering.values, (columns["delta_sw"] / 15.0).astype(np.float32))
        np.testing.assert_allclose(steering.t - steering.t[0], columns["t"], atol=1e-6)
        assert read_drive(written(name, tmp_path, columns)[0]).notes[1].startswith("delta_sw = 15 * the road wheels'")
    with pytest.raises(ValueError, match="steer_ratio = 0, expected more than 0"):
        read_drive(written("ros2 mcap", tmp_path, columns)[0], steer_ratio=0.0)


@pytest.mark.parametrize(("name", "most"), [("npz", 2.9), ("mf4, not compressed", 3.5)])
def test_a_long_drive_takes_less_memory_than_four_times_its_numbers(name: str, most: float, tmp_path: Path) -> None:
    read_drive(written(name, tmp_path, driven())[0])  # what is loaded and kept once does not count
    file, _ = written(name, tmp_path, driven(1200.0, rate=50.0))
    tracemalloc.start()
    read_drive(file)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < most * max(file.stat().st_size, 4 * 8 * 60_000)


COUNT = int(os.environ.get("STEERKIT_DAMAGED", "4"))
"""Damaged files a format."""
SECONDS = 40.0


def rows(columns: dict[str, Any], kept: Any) -> dict[str, Any]:
    return {name: values[kept] for name, values in columns.items()}


DEFECTS: dict[str, tuple[Callable[[dict[str, Any]], dict[str, Any]], str]] = {
    "a gap of 10 s": (lambda c: rows(c, (c["t"] < 15.0) | (c["t"] > 25.0)), r"gaps, (9|10)\.\d s in all"),
    "a late row": (lambda c: rows(c, [*range(300), 301, 300, *range(302, 800)]), r"sorted by time|came out of order"),
    "a time twice": (lambda c: rows(c, [*range(301), *range(300, 800)]), "repeat the time of the one before"),
    "a lone speed": (lambda c: c | {"v": c["v"] + 40.0 * (np.arange(800) == 300)}, "v stands off from all around in 1"),
}


@pytest.mark.parametrize("defect", DEFECTS)
@pytest.mark.parametrize("name", FORMATS)
def test_a_log_with_one_defect_opens_in_its_good_part(name: str, defect: str, tmp_path: Path) -> None:
    change, says = DEFECTS[defect]
    good = driven(SECONDS)
    file, how = written(name, tmp_path, change(good))
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
