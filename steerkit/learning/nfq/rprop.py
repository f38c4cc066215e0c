"""The Q-network as plain arrays, and its training by full-batch Rprop: in C, or by the reference engine on PyTorch."""

import ctypes
import functools
import warnings
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit._support import native
from steerkit._support.errors import require
from steerkit._support.native import NoCompilerError
from steerkit.controllers.nfq_policy import Net, check_net


def new_net(sizes: Sequence[int] = (7, 10, 10, 1), seed: int | Sequence[int] = 0) -> Net:
    """A net with every weight and offset drawn evenly from [-0.5, 0.5] (float32; the same for the same seed).

    sizes: units a layer, the inputs first. Raises ValueError for fewer than two layers or a size below 1.
    """
    require(len(sizes) >= 2 and min(sizes) >= 1, "new_net", f"sizes = {tuple(sizes)}, expected two or more, each >= 1")
    count = sum((i + 1) * o for i, o in pairwise(sizes))
    return shaped(np.random.default_rng(seed).uniform(-0.5, 0.5, count).astype(np.float32), sizes)


def sizes_of(net: Net) -> tuple[int, ...]:
    """Units a layer, the inputs first."""
    return (net[0].shape[1], *(w.shape[0] for w in net[::2]))


def flat(net: Net) -> NDArray[np.float32]:
    """All weights in one float32 vector: W row by row, then b, a layer after the other."""
    return np.concatenate([p.ravel() for p in net]).astype(np.float32, copy=False)


def shaped(weights: NDArray[np.float32], sizes: Sequence[int]) -> Net:
    """The net whose `flat` is `weights` (a copy)."""
    net: list[NDArray[np.float32]] = []
    at = 0
    for i, o in pairwise(sizes):
        net += [weights[at : at + i * o].reshape(o, i).copy(), weights[at + i * o : at + (i + 1) * o].copy()]
        at += (i + 1) * o
    return tuple(net)


def forward(net: Net, x: NDArray[np.floating]) -> NDArray[np.floating]:
    """Outputs (n,) for inputs x (n, n_in): y <- (1 + tanh((W y + b)/2))/2, layer by layer, in NumPy."""
    y = x.T
    for w, b in zip(net[::2], net[1::2]):
        y = 0.5 + 0.5 * np.tanh(0.5 * (w @ y + b[:, None]))
    return y[0]


SOURCE = Path(__file__).with_name("kernel.c")


@functools.cache
def library() -> ctypes.CDLL:
    """The fast engine `kernel.c`, compiled for this machine at first use and kept in the user's cache.

    Raises NoCompilerError without a working C compiler.
    """
    return native.load(SOURCE.read_text(encoding="utf-8"), fused=True, optimise=True)


def _call(name: str, net: Net, weights: NDArray[np.float32], x: NDArray[Any], *rest: Any) -> None:
    """A function of `kernel.c`: layers, sizes, weights, number of patterns, patterns, and the rest."""
    sizes = np.array(sizes_of(net), dtype=np.int32)
    head = (ctypes.c_int(len(sizes) - 1), sizes, weights, ctypes.c_long(len(x)), _f32(x))
    arguments = [ctypes.c_void_p(a.ctypes.data) if isinstance(a, np.ndarray) else a for a in (*head, *rest)]
    if getattr(library(), name)(*arguments):
        raise MemoryError(f"{name}: no room for {len(x)} patterns")


def _f32(array: NDArray[Any]) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)


Engine = Literal["auto", "c", "torch"]
"""auto: C where a compiler is found, else PyTorch (with a warning, once)."""


RULE = (0.1, 0.5, 1.2, 1e-6, 50.0)
"""Rprop's standard parameters: delta_0, eta_minus, eta_plus, delta_min, delta_max.

Each weight has its own step, delta_0 at first: times eta_plus while its gradient keeps its sign, times eta_minus when
it turns, within delta_min and delta_max. The weight moves by the step against the gradient's sign, and not at all in
the epoch in which the sign has turned (the gradient is then taken as 0). This is iRprop- without weight
backtracking, and what torch.optim.Rprop does. Source: Riedmiller and Braun 1993 (the RPROP algorithm); Igel and Huesken
2000 (iRprop-).
"""


class Fit(NamedTuple):
    """A trained net and its mean squared errors: before each epoch, and after the last (epochs + 1,)."""

    net: Net
    errors: NDArray[np.float64]


def engine_of(engine: Engine = "auto") -> Literal["c", "torch"]:
    """The engine that will do the work; "auto" falls back to PyTorch with a warning when C cannot be had."""
    require(engine in ("auto", "c", "torch"), "rprop", f"engine = {engine!r}; valid: 'auto', 'c', 'torch'")
    return _auto() if engine == "auto" else engine


@functools.cache
def _auto() -> Literal["c", "torch"]:
    try:
        library()
    except NoCompilerError as why:
        warnings.warn(f"training runs on PyTorch, many times slower than in C: {why}", RuntimeWarning, stacklevel=4)
        return "torch"
    return "c"


def fit(
    net: Net, x: NDArray[np.float32], target: NDArray[np.float32], *, epochs: int = 300, engine: Engine = "auto"
) -> Fit:
    """Train `net` on inputs x (n, n_in) and targets (n,): `epochs` full-batch steps of Rprop on mean (q - target)^2.

    One thread, without the GIL in C; deterministic for a given engine and machine. The engines agree to rounding, which
    Rprop's signs magnify over many epochs. Raises ValueError for unlike shapes, an empty batch or a non-finite number.
    """
    check_net(net, x.shape[1] if x.ndim == 2 else -1, "rprop.fit")
    given = f"x {x.shape}, target {target.shape}, expected (n, n_in) and (n,) with n >= 1"
    require(len(x) > 0 and target.shape == (len(x),), "rprop.fit", given)
    require(epochs >= 0, "rprop.fit", f"epochs = {epochs}, expected >= 0")
    for name, data in (("x", x), ("target", target)):
        require(bool(np.isfinite(data).all()), "rprop.fit", f"{name} holds a NaN or infinity, expected finite numbers")
    if engine_of(engine) == "torch":
        trained, errors = _torch_fit(net, x, target, epochs)
    else:
        weights, errors = flat(net), np.zeros(epochs + 1)
        rates = np.array(RULE, dtype=np.float32)
        _call("steerkit_rprop", net, weights, x, _f32(target), ctypes.c_int(epochs), rates, errors)
        trained = shaped(weights, sizes_of(net))
    require(bool(np.isfinite(errors).all()), "rprop.fit", "the error became NaN; please report this with the data")
    return Fit(trained, errors)


def predictor(net: Net, n_in: int, *, engine: Engine = "auto") -> Callable[[NDArray[np.float32]], NDArray[np.float32]]:
    """The net's outputs (n,), as a function of x (n, n_in); NumPy stands in where there is no C."""
    check_net(net, n_in, "rprop.predictor")
    if engine_of(engine) == "torch":
        return lambda x: forward(net, np.asarray(x, dtype=np.float32)).astype(np.float32, copy=False)
    weights = flat(net)

    def predicted(x: NDArray[np.float32]) -> NDArray[np.float32]:
        q = np.empty(len(x), dtype=np.float32)
        _call("steerkit_predict", net, weights, x, q)
        return q

    return predicted


def _torch_fit(
    net: Net, x: NDArray[np.floating], target: NDArray[np.floating], epochs: int
) -> tuple[Net, NDArray[np.float64]]:
    """The reference: torch.optim.Rprop, in the precision of the net's arrays."""
    import torch

    kind = net[0].dtype
    parameters = [torch.tensor(p, requires_grad=True) for p in net]
    inputs, goal = torch.from_numpy(x.astype(kind)), torch.from_numpy(target.astype(kind))[:, None]
    optimiser = torch.optim.Rprop(parameters, lr=RULE[0], etas=RULE[1:3], step_sizes=RULE[3:])

    def error() -> torch.Tensor:
        y = inputs
        for w, b in zip(parameters[::2], parameters[1::2]):
            y = torch.sigmoid(torch.nn.functional.linear(y, w, b))
        return torch.mean((y - goal) ** 2)

    errors = np.zeros(epochs + 1)
    for epoch in range(epochs):
        optimiser.zero_grad()
        loss = error()
        loss.backward()
        errors[epoch] = loss.item()
        optimiser.step()
    with torch.no_grad():
        errors[epochs] = error().item()
    return tuple(p.detach().numpy().copy() for p in parameters), errors
