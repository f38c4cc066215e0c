"""Programs that tests start."""

from __future__ import annotations

from pathlib import Path


def alive(pid: int) -> bool:
    """Does it still run? One whose end nobody has asked for yet does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")")[1].split()[0] != "Z"
    except OSError:
        return False
