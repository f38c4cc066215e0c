"""Logs that are cut off or spoilt: what `read_drive` makes of each format, truncated at 64 places, a bit turned at 200.

Every file holds the same drive, written by the format's own library. `refused`: an error that says why; `same`: the
drive, to the last bit; `noted`: another drive (shorter, rows left out), and a note says so; `shorter`: cut off where
the format cannot tell, all that is there is right; `untold`: a number differs, and nothing says so. Formats without
check sums cannot tell that a digit is another one: for them `worst` is by how much, in parts of what a car can reach in
one step. `slowest_s` is the longest read, `memory_x` the most memory for a drive of an hour (6 MB of numbers), in
sizes of the file, or of its numbers where they are packed smaller.

    python -m benchmarks study log_damage [--formats csv mf4 ...] [--quick] [--json]
"""

from __future__ import annotations

import argparse
import logging
import tempfile
import time
import tracemalloc
import warnings
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.written_logs import FORMATS, driven, written
from steerkit.logs import Drive, read_drive
from steerkit.logs.spoilt import FASTEST

LONG = 3600.0
"""Length of the file whose memory is measured [s]."""
COMPARED = ("delta_sw", "v", "r")
"""Quantities of a drive whose errors are told, in parts of what no car changes faster than."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Which formats."""
    parser.add_argument("--formats", nargs="+", default=list(FORMATS), choices=list(FORMATS), metavar="NAME")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """A row a format."""
    logging.disable(logging.CRITICAL)  # libraries report what they cannot read, hundreds of times
    cuts, flips = (2, 3) if options.quick else (64, 200)
    figures: dict[str, Any] = {}
    print(f"{'format':22}{'cut off':>34}{'a bit turned':>46}{'worst':>8}{'slowest':>9}{'memory':>8}")
    try:
        for name in options.formats:
            row = damaged(name, cuts, flips)
            row["memory_x"] = memory(name, 25.0 if options.quick else LONG)
            figures[name] = row
            cut, bit = (", ".join(f"{n} {what}" for what, n in row[part].items()) for part in ("cut", "bit"))
            print(
                f"{name:22}{cut:>34}{bit:>46}{row['worst']:8.2g}{row['slowest_s']:8.2f}s{row['memory_x']:7.1f}x",
                flush=True,
            )
    finally:
        logging.disable(logging.NOTSET)
    return figures


def objection(figures: dict[str, Any]) -> str:
    """A number that is wrong and could have been told to be."""
    wrong = [name for name, row in figures.items() if FORMATS[name].sums and row["bit"].get("untold")]
    slow = [name for name, row in figures.items() if row["slowest_s"] > 20.0]
    return f"numbers that are wrong, untold, in {', '.join(wrong)}; slow: {', '.join(slow)}" if wrong or slow else ""


def damaged(name: str, cuts: int, flips: int) -> dict[str, Any]:
    """How often each answer was given, when a file is cut off and when one of its bits is turned."""
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as folder:
        file, how = written(name, Path(folder), driven())
        whole = file.read_bytes()
        right = read_drive(file, **how)
        answers: dict[str, Counter[str]] = {"cut": Counter(), "bit": Counter()}
        slowest, worst = 0.0, 0.0
        places = [(n, -1) for n in np.linspace(0, len(whole) - 1, cuts).astype(int).tolist()]
        places += list(zip(rng.integers(0, len(whole), flips).tolist(), rng.integers(0, 8, flips).tolist()))
        for place, bit in places:
            spoilt = bytearray(whole[:place] if bit < 0 else whole)
            if bit >= 0:
                spoilt[place] ^= 1 << bit
            file.write_bytes(spoilt)
            begun = time.perf_counter()
            answer, error = _answer(file, how, right)
            slowest = max(slowest, time.perf_counter() - begun)
            worst = max(worst, error)
            answers["cut" if bit < 0 else "bit"][answer] += 1
    return {"cut": dict(answers["cut"]), "bit": dict(answers["bit"]), "slowest_s": slowest, "worst": worst}


def _answer(file: Path, how: dict[str, Any], right: Drive) -> tuple[str, float]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            drive = read_drive(file, **how)
    except ValueError:
        return "refused", 0.0
    n = min(len(drive.v), len(right.v))
    error = max(_beyond(getattr(drive, q)[:n], getattr(right, q)[:n], q, right.dt) for q in COMPARED)
    if drive.notes != right.notes:
        return "noted", 0.0
    if error == 0.0:
        return ("same" if len(drive.v) == len(right.v) else "shorter"), 0.0
    return "untold", error


def _beyond(values: np.ndarray, right: np.ndarray, quantity: str, dt: float) -> float:
    """The largest difference, in parts of what a car can change in a step; rounding of the clock's grid is none."""
    difference = np.abs(values - right)
    return float(difference[difference > 1e-7].max(initial=0.0) / (FASTEST[quantity] * dt))


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
