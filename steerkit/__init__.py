"""steerkit: blocks, loops, cars and controllers for steering along a path, analytic and learned.

The public names stand in `__init__.pyi`; each is loaded when it is first used, so that `import steerkit` stays fast.
"""

from __future__ import annotations

from typing import Any

import lazy_loader

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    try:
        return _load(name)
    except AttributeError:
        if name in __all__:
            raise
        raise AttributeError(f"module 'steerkit' has no attribute '{name}'; it offers: {', '.join(__all__)}") from None


def _version() -> str:
    """Of the installed package; looked up when it is asked for, as that takes longer than importing steerkit."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("steerkit-control")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "0+unknown"
