"""The fast Rprop engine: `kernel.c`, compiled for this machine at first use and kept in the user's cache."""

from __future__ import annotations

import ctypes
import functools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support import native

SOURCE = Path(__file__).with_name("kernel.c")


@functools.cache
def library() -> ctypes.CDLL:
    """The compiled kernel; raises NoCompilerError without a working C compiler."""
    return native.load(SOURCE.read_text(encoding="utf-8"), fused=True, optimise=True)


def fit(
    weights: NDArray[np.float32],
    sizes: tuple[int, ...],
    x: NDArray[np.float32],
    target: NDArray[np.float32],
    epochs: int,
    rule: tuple[float, ...],
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
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
