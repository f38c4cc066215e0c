"""Every format, written by its own library, is read to the last bit, or to its resolution."""

import tempfile
import tracemalloc
from pathlib import Path

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


def memory(name: str, seconds: float) -> float:
    """The most memory that reading takes, in sizes of the file."""
    with tempfile.TemporaryDirectory() as folder:
        small, how = written(name, Path(folder), driven())
        read_drive(small, **how)  # what is loaded and kept once does not count
        (Path(folder) / "long").mkdir()
        file, how = written(name, Path(folder) / "long", driven(seconds, rate=50.0))
        tracemalloc.start()
        try:
            read_drive(file, **how)
            packed = 4 * 8 * round(seconds * 50.0)
            return tracemalloc.get_traced_memory()[1] / max(file.stat().st_size, packed)
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize(("name", "most"), [("npz", 2.9), ("mf4, not compressed", 3.5)])
def test_a_long_drive_takes_less_memory_than_four_times_its_numbers(name: str, most: float) -> None:
    assert memory(name, 1200.0) < most
