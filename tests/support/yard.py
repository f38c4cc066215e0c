"""A course in a file."""

from pathlib import Path

import numpy as np


def yard(place: Path, name: str = "yard.csv", *, radius: float = 20.0, share: float = 1.0) -> Path:
    """A CSV file of a circle, or of a share of one."""
    turn = np.linspace(0.0, 2.0 * np.pi * share, 120, endpoint=False)
    rows = "\n".join(f"{x:.6f},{y:.6f}" for x, y in zip(radius * np.cos(turn), radius * np.sin(turn)))
    (place / name).write_text(f"x,y\n{rows}\n")
    return place / name
