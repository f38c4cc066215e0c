"""C source to a loaded library, by way of gcc and a cache on disk that all processes share."""

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from pathlib import Path

from steerkit._support.files import atomic_write

FLAGS = ("-O3", "-march=native", "-std=gnu99", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math", "-w")
"""None of these changes a result; -ffast-math is not among them."""
EXACT = ("-ffp-contract=off",)
"""No fused multiply-add: every operation rounds as Python's does."""
FUSED = ("-ffp-contract=fast",)
"""Fused operations, each rounded once instead of twice: for loops, whose sines are not libm's anyway, and for nets."""


class NoCompilerError(RuntimeError):
    """There is no C compiler, or it does not work."""


def compiler() -> tuple[str, ...] | None:
    """The C compiler's command: $CC with its options, where that is set, else gcc, else cc; None if it is not there."""
    asked = shlex.split(os.environ.get("CC", ""))
    for words in [asked] if asked else [["gcc"], ["cc"]]:
        if path := shutil.which(words[0]):
            return (path, *words[1:])
    return None


@functools.cache
def directory() -> Path:
    """$XDG_CACHE_HOME/steerkit (default ~/.cache/steerkit), or a private temporary folder if that cannot be written."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "steerkit"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix="steerkit-"))


def load(source: str, *, fused: bool = False, vector_maths: bool = False, optimise: bool = False) -> ctypes.CDLL:
    """The library of a C file, compiled at the first call on this machine and found in the cache after that.

    fused: multiply-adds may be fused (quicker; rounded once instead of twice). vector_maths: for vectors of
    cars; fused, and linked to glibc's libmvec where there is one. optimise: in full whatever $CC asks for, for code
    that runs for minutes. Raises NoCompilerError when there is no compiler, or it refuses.
    """
    tool = compiler()
    if tool is None:
        missing = f"CC = {os.environ['CC']} is not there" if os.environ.get("CC") else "neither gcc nor cc is there"
        raise NoCompilerError(f"no C compiler found ({missing}): install gcc (or clang), or set CC")
    rounding = FUSED if fused or vector_maths else EXACT
    # those of $CC win over ours, but for the rounding; it may define always_inline away, to compile quickly
    options = (*FLAGS, *tool[1:], *((FLAGS[0], "-Ualways_inline") if optimise else ()), *rounding)
    flags = (*options, *(["libmvec"] if vector_maths else []))
    key = hashlib.sha256("\0".join((source, _machine(tool[0]), *flags)).encode()).hexdigest()[:32]
    library = directory() / f"{key}.so"
    try:
        if not library.exists():
            _build(tool[0], options, source, library, vector_maths=vector_maths)
        return ctypes.CDLL(str(library))
    except OSError as error:
        raise NoCompilerError(f"cannot compile in {library.parent}, or load from it: {error}") from error


def _build(tool: str, options: tuple[str, ...], source: str, library: Path, *, vector_maths: bool) -> None:
    with tempfile.TemporaryDirectory(dir=library.parent) as folder, atomic_write(library) as made:
        file = Path(folder, "source.c")
        file.write_text(source, encoding="utf-8")
        tries = [["-DVECTOR_MATHS", "-Wl,--no-undefined", "-lmvec"], []] if vector_maths else [[]]
        for extra in tries:  # the second, lane by lane, is for machines without libmvec
            command = [tool, *options, *extra[:1], str(file), "-o", str(made), *extra[1:], "-lm"]
            done = subprocess.run(command, capture_output=True, encoding="utf-8", errors="replace", check=False)
            if done.returncode == 0:
                return
        raise NoCompilerError(f"{tool} refused the generated code: {done.stderr.strip()[:500]}")


@functools.cache
def _machine(tool: str) -> str:
    """What a library built with -march=native depends on."""
    version = subprocess.run(
        [tool, "--version"], capture_output=True, encoding="utf-8", errors="replace", check=False
    ).stdout
    cpu = Path("/proc/cpuinfo")
    lines = cpu.read_text(encoding="utf-8", errors="replace").splitlines() if cpu.exists() else []
    return "\n".join([version, platform.machine(), *next(([line] for line in lines if line.startswith("flags")), [])])
