"""The terminal that programs of steerkit write to."""

from __future__ import annotations

from rich.console import Console

console = Console() if Console().is_terminal else Console(width=110)
"""With `stderr` set, all that is for people goes there."""
