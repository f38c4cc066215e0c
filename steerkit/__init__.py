"""steerkit: blocks, loops, cars and controllers for steering along a path, analytic and learned.

The public names stand in `__init__.pyi`; each is loaded when it is first used, so that `import steerkit` stays fast.
"""

from typing import Any

import lazy_loader

_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from steerkit._support.version import version

        return version()
    try:
        return _load(name)
    except AttributeError:
        if name in __all__:
            raise
        raise AttributeError(f"module 'steerkit' has no attribute '{name}'; it offers: {', '.join(__all__)}") from None
