"""python-can, imported as quickly as it can be."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


def python_can() -> ModuleType:
    """The module `can`, without its support of MF4 files.

    python-can imports asammdf where that is installed, and with it pandas and SymPy: more than a second, for files that
    nobody on a car asks it for. Call it before cantools is imported too, which imports `can`. Raises ImportError where
    python-can is not installed.
    """
    modules: dict[str, Any] = sys.modules
    absent = "can" not in modules and "asammdf" not in modules
    if absent:
        modules["asammdf"] = None  # as if it were not installed
    try:
        import can
    finally:
        if absent:
            del modules["asammdf"]
    return can
