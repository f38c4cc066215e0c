"""Where on Earth is land, roughly: to tell positions of a car from positions in the open sea."""

from __future__ import annotations

import sys
import zlib
from functools import lru_cache
from importlib.resources import files
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit.files import read_npz

CELL_DEG = 0.5
"""Side of a cell of the map [degrees]."""
_SHAPE = (round(180.0 / CELL_DEG), round(360.0 / CELL_DEG))


def near_land(lat_deg: float, lon_deg: float) -> bool:
    """Is there land within this cell of the map or one of its eight neighbours, 28 to 110 km away at most?

    For the question whether a car can have been there: no position on land is ever said to be at sea.
    lat_deg within +-90, lon_deg within +-180. Source: GLOBE (NOAA, 1 km), by the package global-land-mask 1.0.0.
    """
    row, column = (int((90.0 - lat_deg) / CELL_DEG), int((lon_deg + 180.0) / CELL_DEG))
    return bool(_map()[min(row, _SHAPE[0] - 1), min(column, _SHAPE[1] - 1)])


@lru_cache(maxsize=1)
def _map() -> NDArray[Any]:
    packed = zlib.decompress((files("steerkit") / "land.bin").read_bytes())
    return np.unpackbits(np.frombuffer(packed, dtype=np.uint8)).reshape(_SHAPE)


def main(source: str, out: str) -> None:
    """Make land.bin of global-land-mask's globe_combined_mask_compressed.npz; not needed at run time."""
    from scipy.ndimage import maximum_filter

    land = ~read_npz(source, "land")["mask"]
    rows, columns = (n // m for n, m in zip(land.shape, _SHAPE))
    cells = land.reshape(_SHAPE[0], rows, _SHAPE[1], columns).any(axis=(1, 3))
    near = maximum_filter(cells, size=3, mode=("nearest", "wrap"))
    FilePath(out).write_bytes(zlib.compress(np.packbits(near).tobytes(), 9))


if __name__ == "__main__":
    main(*sys.argv[1:])
