"""The version of the installed package, looked up when it is asked for: that takes longer than importing steerkit."""

from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as _of


def version() -> str:
    """Of the installed package; `0+unknown` in a source tree that was never installed."""
    try:
        return _of("steerkit-control")
    except PackageNotFoundError:
        return "0+unknown"
