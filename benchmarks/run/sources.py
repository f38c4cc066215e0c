"""What numbers depend on: a hash of the sources and the versions of packages. It imports neither of them.

Machines of a cluster compare themselves by it: it loads fast, and says the same of a checkout and an installed wheel.
"""

import hashlib
import platform
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("numpy", "scipy", "torch", "casadi", "control", "commonroad-vehicle-models", "do-mpc", "stable-baselines3")
"""Packages whose version may change the numbers."""
_NO_NUMBERS = ("__main__.py", "app.py", "tables.py", "report/", "studies/", "run/compare.py", "run/golden.py")
"""Files and folders of benchmarks that only read the results of suites, or have no part in them."""


@lru_cache
def source(root: Path = ROOT, *, everything: bool = False) -> str:
    """A hash of every source file below `root`, where both packages are, that the suites' numbers may depend on.

    everything: of all files, for machines that work together, whatever they do.
    """
    whole = hashlib.sha256()
    for name, file in sorted(_files(root, everything).items()):
        whole.update(name.encode() + b"\0" + file.read_bytes())
    return whole.hexdigest()[:16]


def _files(root: Path, everything: bool) -> dict[str, Path]:
    files = [*root.glob("steerkit/**/*"), *root.glob("benchmarks/**/*")]
    named = {file.relative_to(root).as_posix(): file for file in files if file.suffix in (".py", ".c", ".csv")}
    without = () if everything else tuple(f"benchmarks/{name}" for name in _NO_NUMBERS)
    return {name: file for name, file in named.items() if not name.startswith(without)}


@lru_cache
def versions() -> dict[str, str]:
    """Versions of Python, steerkit and the packages that numbers may depend on; those not installed are left out."""
    installed = {"python": platform.python_version()}
    for name in ("steerkit-control", *PACKAGES):
        try:
            installed[name] = version(name)
        except PackageNotFoundError:
            continue
    return installed


@lru_cache
def identity() -> str:
    """A short word that is the same where sources and versions are."""
    return hashlib.sha256(repr((source(everything=True), sorted(versions().items()))).encode()).hexdigest()[:16]
