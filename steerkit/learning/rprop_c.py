"""The fast Rprop engine: `rprop_kernel.c`, compiled for this machine at first use and kept in the user's cache."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import os
import platform
import shlex
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

SOURCE = Path(__file__).with_name("rprop_kernel.c")
FLAGS = ("-O3", "-march=native", "-std=gnu11", "-fno-math-errno", "-fPIC", "-shared")


class NoKernel(RuntimeError):
    """The kernel could not be compiled or loaded; the message says why."""


@functools.cache
def library() -> ctypes.CDLL:
    """The compiled kernel; raises NoKernel without a working C compiler ($CC, else cc)."""
    compiler = shlex.split(os.environ.get("CC", "cc"))
    source = SOURCE.read_bytes()
    key = hashlib.sha256(b"\0".join([source, " ".join([*compiler, *FLAGS]).encode(), _processor()])).hexdigest()[:20]
    target = _cache() / f"rprop-{key}.so"
    try:
        if not target.exists():
            part = target.with_suffix(f".part{os.getpid()}")
            command = [*compiler, *FLAGS, str(SOURCE), "-o", str(part), "-lm"]
            done = subprocess.run(command, capture_output=True, text=True, timeout=120)
            if done.returncode:
                raise NoKernel(f"{' '.join(command)} failed: {done.stderr.strip()[:500]}")
            os.replace(part, target)  # two processes may compile at once; either result will do
        return ctypes.CDLL(str(target))
    except (OSError, subprocess.TimeoutExpired) as why:
        raise NoKernel(f"{' '.join(compiler)}: {why}") from why


def fit(
    weights: NDArray[np.float32], sizes: tuple[int, ...], x: NDArray[np.float32], target: NDArray[np.float32],
    epochs: int, rule: tuple[float, ...],
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:  # fmt: skip
    """Flat weights after `epochs` of Rprop, and the mean squared errors (epochs + 1,). The GIL is released."""
    w, errors = np.array(weights, dtype=np.float32), np.zeros(epochs + 1)
    rates = np.array(rule, dtype=np.float32)
    data = (_f32(x), _f32(target))
    _call("steerkit_rprop", sizes, w, len(x), *data, ctypes.c_int(epochs), rates, errors)
    return w, errors


def predict(weights: NDArray[np.float32], sizes: tuple[int, ...], x: NDArray[np.float32]) -> NDArray[np.float32]:
    """The net's outputs (n,) for the inputs x (n, n_in)."""
    q = np.empty(len(x), dtype=np.float32)
    _call("steerkit_predict", sizes, _f32(weights), len(x), _f32(x), q)
    return q


def gradient(
    weights: NDArray[np.float32], sizes: tuple[int, ...], x: NDArray[np.float32], target: NDArray[np.float32]
) -> tuple[NDArray[np.float64], float]:
    """dE/dw (flat) and E = mean (q - target)^2."""
    grad, error = np.zeros(len(weights)), np.zeros(1)
    _call("steerkit_gradient", sizes, _f32(weights), len(x), _f32(x), _f32(target), grad, error)
    return grad, float(error[0])


def _call(name: str, sizes: tuple[int, ...], weights: NDArray[np.float32], n: int, *rest: object) -> None:
    layout = np.array(sizes, dtype=np.int32)
    head = (ctypes.c_int(len(sizes) - 1), _pointer(layout), _pointer(weights), ctypes.c_long(n))
    tail = [_pointer(arg) if isinstance(arg, np.ndarray) else arg for arg in rest]
    if getattr(library(), name)(*head, *tail):
        raise MemoryError(f"{name}: no room for {n} patterns")


def _pointer(array: NDArray[Any]) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _f32(array: NDArray[Any]) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)


def _cache() -> Path:
    """$XDG_CACHE_HOME/steerkit, else ~/.cache/steerkit; a private temporary folder where that cannot be written."""
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "steerkit"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    except OSError:
        pass
    return Path(tempfile.mkdtemp(prefix="steerkit-"))


def _processor() -> bytes:
    """What -march=native depends on: a home folder may be shared by unlike machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        found = sorted({line for line in lines if line.startswith(("flags", "Features", "model name"))})
    except OSError:
        found = [platform.node(), platform.processor()]
    return "\n".join([platform.machine(), *found]).encode()
