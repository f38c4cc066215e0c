"""Full-batch Rprop for the Q-network: a reference engine on PyTorch, and a fast one in C."""

from __future__ import annotations

import functools
import warnings
from dataclasses import astuple, dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit._support.native import NoCompilerError
from steerkit.learning.nfq import kernel as rprop_c
from steerkit.learning.nfq.network import Net, check_net, flat, forward, shaped, sizes_of

Engine = Literal["auto", "c", "torch"]
"""auto: C where a compiler is found, else PyTorch (with a warning, once)."""


@dataclass(frozen=True, kw_only=True)
class Rprop:
    """Rprop's parameters; the defaults are the standard ones.

    Each weight has its own step: times eta_plus while its gradient keeps its sign, times eta_minus when it turns; the
    weight moves by the step against the gradient's sign, and not at all in the epoch in which the sign has turned (the
    gradient is then taken as 0). This is iRprop- without weight backtracking, and what torch.optim.Rprop does.
    Source: Riedmiller and Braun 1993 (the RPROP algorithm); Igel and Huesken 2000 (iRprop-).
    Raises ValueError unless 0 < eta_minus < 1 < eta_plus and 0 < delta_min <= delta_0 <= delta_max.
    """

    delta_0: float = 0.1
    """First step."""
    eta_minus: float = 0.5
    """Factor on a turn."""
    eta_plus: float = 1.2
    """Factor otherwise."""
    delta_min: float = 1e-6
    """Smallest step."""
    delta_max: float = 50.0
    """Largest step."""

    def __post_init__(self) -> None:
        etas = f"eta_minus = {self.eta_minus}, eta_plus = {self.eta_plus}, expected 0 < eta_minus < 1 < eta_plus"
        require(0.0 < self.eta_minus < 1.0 < self.eta_plus, "Rprop", etas)
        steps = (
            f"delta_min, _0, _max = {self.delta_min}, {self.delta_0}, {self.delta_max}, expected 0 < min <= _0 <= max"
        )
        require(0.0 < self.delta_min <= self.delta_0 <= self.delta_max, "Rprop", steps)


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
        rprop_c.library()
    except NoCompilerError as why:
        warnings.warn(f"training runs on PyTorch, many times slower than in C: {why}", RuntimeWarning, stacklevel=4)
        return "torch"
    return "c"


def fit(
    net: Net,
    x: NDArray[np.float32],
    target: NDArray[np.float32],
    *,
    epochs: int = 300,
    rule: Rprop = Rprop(),
    engine: Engine = "auto",
) -> Fit:
    """Train `net` on inputs x (n, n_in) and targets (n,): `epochs` full-batch steps of Rprop on mean (q - target)^2.

    One thread; deterministic for a given engine and machine. The engines agree to rounding, which Rprop's signs
    magnify over many epochs. Raises ValueError for unlike shapes, an empty batch or a non-finite number.
    """
    check_net(net, x.shape[1] if x.ndim == 2 else -1, "rprop.fit")
    require(
        len(x) > 0 and target.shape == (len(x),),
        "rprop.fit",
        f"x {x.shape}, target {target.shape}, expected (n, n_in) and (n,) with n >= 1",
    )
    require(epochs >= 0, "rprop.fit", f"epochs = {epochs}, expected >= 0")
    for name, data in (("x", x), ("target", target)):
        require(bool(np.isfinite(data).all()), "rprop.fit", f"{name} holds a NaN or infinity, expected finite numbers")
    sizes = sizes_of(net)
    if engine_of(engine) == "c":
        weights, errors = rprop_c.fit(flat(net), sizes, x, target, epochs, astuple(rule))
        trained = shaped(weights, sizes)
    else:
        trained, errors = _torch_fit(net, x, target, epochs, rule)
    require(bool(np.isfinite(errors).all()), "rprop.fit", "the error became NaN; please report this with the data")
    return Fit(trained, errors)


def predict(net: Net, x: NDArray[np.float32], *, engine: Engine = "auto") -> NDArray[np.float32]:
    """The net's outputs (n,) for x (n, n_in); NumPy stands in where there is no C."""
    check_net(net, x.shape[1] if x.ndim == 2 else -1, "rprop.predict")
    if engine_of(engine) == "c":
        return rprop_c.predict(flat(net), sizes_of(net), x)
    return forward(net, np.asarray(x, dtype=np.float32)).astype(np.float32, copy=False)


def _torch_fit(
    net: Net, x: NDArray[np.floating], target: NDArray[np.floating], epochs: int, rule: Rprop
) -> tuple[Net, NDArray[np.float64]]:
    """The reference: torch.optim.Rprop, in the precision of the net's arrays."""
    import torch

    kind = net[0].dtype
    parameters = [torch.tensor(p, requires_grad=True) for p in net]
    inputs, goal = torch.from_numpy(x.astype(kind)), torch.from_numpy(target.astype(kind))[:, None]
    optimiser = torch.optim.Rprop(
        parameters, lr=rule.delta_0, etas=(rule.eta_minus, rule.eta_plus), step_sizes=(rule.delta_min, rule.delta_max)
    )

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
