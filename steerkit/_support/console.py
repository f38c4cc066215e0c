"""The terminal that programs of steerkit write to."""

import sys
from typing import Any

from rich.console import Console

console = Console() if Console().is_terminal else Console(width=110)
"""With `stderr` set, all that is for people goes there."""


def shown(steps: Any, what: str) -> Any:
    """The steps, with a bar of that name on the terminal, if there is one and a name."""
    if not what or not sys.stderr.isatty():
        return steps
    from rich.progress import track

    return track(steps, description=what, transient=True)
