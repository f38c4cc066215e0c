"""C source to a loaded library, by way of gcc and a cache on disk that all processes share."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shutil
import subprocess
import tempfile
from pathlib import Path

FLAGS = ("-O3", "-march=native", "-std=gnu99", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math", "-w")
"""None of these changes a result; -ffast-math is not among them."""
EXACT = ("-ffp-contract=off",)
"""No fused multiply-add: every operation rounds as Python's does."""
LANES = ("-ffp-contract=fast",)
"""For vectors of cars, whose functions are libmvec's anyway: fused operations, each rounded once instead of twice."""


class NoCompilerError(RuntimeError):
    """There is no C compiler, or it does not work."""


def compiler() -> str | None:
    """The C compiler: $CC, else gcc, else cc, else None."""
    return next((path for name in (os.environ.get("CC"), "gcc", "cc") if name and (path := shutil.which(name))), None)


def directory() -> Path:
    """Where libraries are kept: $XDG_CACHE_HOME/steerkit, by default ~/.cache/steerkit."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "steerkit"


def load(source: str, *, vector_maths: bool = False) -> ctypes.CDLL:
    """The library of a C file, compiled at the first call on this machine and found in the cache after that.

    vector_maths: for vectors of cars; link glibc's libmvec where there is one. Raises NoCompilerError when there is
    no compiler, or it refuses.
    """
    tool = compiler()
    if tool is None:
        raise NoCompilerError("no C compiler found: install gcc (or clang), or set CC")
    key = hashlib.sha256("\0".join((source, _machine(tool), *FLAGS, *_more(vector_maths))).encode()).hexdigest()[:32]
    library = directory() / f"{key}.so"
    if not library.exists():
        _build(tool, source, library, vector_maths)
    return ctypes.CDLL(str(library))


def _build(tool: str, source: str, library: Path, vector_maths: bool) -> None:
    try:
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as folder:
            file, made = Path(folder, "loop.c"), Path(folder, "loop.so")
            file.write_text(source, encoding="utf-8")
            tries = [["-DVECTOR_MATHS", "-Wl,--no-undefined", "-lmvec"], []] if vector_maths else [[]]
            for extra in tries:  # the second, lane by lane, is for machines without libmvec
                flags = [*FLAGS, *_more(vector_maths), *extra[:1]]
                command = [tool, *flags, str(file), "-o", str(made), *extra[1:], "-lm"]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                if done.returncode == 0:
                    os.replace(made, library)  # atomic: another process sees all of it or nothing
                    return
    except OSError as error:
        raise NoCompilerError(f"cannot compile in {library.parent}: {error}") from error
    raise NoCompilerError(f"{tool} refused the generated code: {done.stderr.strip()[:500]}")


def _more(vector_maths: bool) -> tuple[str, ...]:
    return LANES if vector_maths else EXACT


@functools.cache
def _machine(tool: str) -> str:
    """What a library built with -march=native depends on."""
    version = subprocess.run([tool, "--version"], capture_output=True, text=True, check=False).stdout
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text().splitlines() if cpu.exists() else []
    return "\n".join([version, platform.machine(), *next(([line] for line in lines if line.startswith("flags")), [])])
