"""What a file of a log holds before anybody says what is what: channels, each with its own clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Channel:
    """One number over time, as the file has it."""

    name: str
    """`speed` of a table, `/vehicle/status.longitudinal_velocity` of a bag, `SPEED.SPEED` of a CAN log."""
    t: Array
    """When it was sampled, in the file's own time (n,) [s]."""
    values: Array
    """In the file's own unit (n,)."""
    unit: str = ""
    """As the file names it; empty where it does not."""
    means: str = ""
    """The quantity that it is, where the kind of message settles that: `delta` for an Autoware steering report."""

    @property
    def rate(self) -> float:
        """Samples a second, by the usual step; 0 for a single one [Hz]."""
        steps = np.diff(self.t)
        step = float(np.median(steps)) if len(steps) else 0.0
        return 1.0 / step if step > 0.0 else 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Table:
    """Columns that were sampled together: a CSV file, a topic, a CAN message, a channel group."""

    columns: Mapping[str, Array]
    """By name, all of one length."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Of those columns whose unit the file tells."""
    means: Mapping[str, str] = field(default_factory=dict)
    """Of those columns whose quantity the kind of message settles."""
    t: Array | None = None
    """Their times (n,) [s]; None where one of the columns is the time."""


@dataclass(frozen=True)
class Options:
    """What a reader is told beside the file."""

    dbc: tuple[str, ...] = ()
    """Files, or names of the package opendbc, that say what is in a CAN frame."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Source:
    """One file as it was read."""

    path: Path
    tables: tuple[Table, ...]
    notes: tuple[str, ...]
    """What was repaired, in words."""
    digest: str
    """SHA-256 of the file."""
    size: int
    """Bytes of the file."""
