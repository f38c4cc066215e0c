"""Any policy as a controller block: a function of the scaled state, or a net's weights as plain arrays."""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from steerkit._support.errors import known, number, require
from steerkit._support.files import read_arrays, write_arrays
from steerkit.controllers.policy import COLUMNS, LARGEST_POLICY, Policy, StateDescription, check_layers
from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.maths import Array
from steerkit.diagram.units import radians_of

BOUND = 10.0
"""Scaled inputs are cut off here, as the environments of `steerkit.gym` cut them."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Network:
    """A feed-forward net as plain arrays: what is left of a trained policy when the learning library has gone.

        h = x,   h = act(W h + b) in all layers but the last,   z = W h + b in the last

    head: argmax (the number of the largest z), tanh (tanh z) or clip (z limited to [-1, 1]), of one z the latter two.

    Call it with scaled states (n, columns): it answers (n,). `symbolic` is the same in scalars, for tracing.
    Raises ValueError for layers that do not fit together or are not finite.
    """

    layers: tuple[tuple[Array, Array], ...]
    """W (n_out, n_in) and b (n_out,) of each layer."""
    activation: Literal["relu", "tanh"] = "relu"
    """Of the hidden layers."""
    head: Literal["argmax", "tanh", "clip"] = "argmax"
    """What becomes of the last layer."""

    def __post_init__(self) -> None:
        where = "Network"
        known(self.activation, ("relu", "tanh"), f"{where}: activation")
        known(self.head, ("argmax", "tanh", "clip"), f"{where}: head")
        layers = tuple((np.array(w, dtype=np.float64), np.array(b, dtype=np.float64)) for w, b in self.layers)
        n = check_layers(layers, None, where)
        require(self.head == "argmax" or n == 1, where, f"{n} outputs, expected 1 for the head {self.head!r}")
        object.__setattr__(self, "layers", layers)

    def __call__(self, x: Array) -> Array:
        """The actions (n,) for scaled states (n, columns)."""
        h = np.asarray(x, dtype=np.float64).T
        for i, (w, b) in enumerate(self.layers):
            h = w @ h + b[:, None]
            if i < len(self.layers) - 1:
                h = np.maximum(h, 0.0) if self.activation == "relu" else np.tanh(h)
        if self.head == "argmax":
            return h.argmax(axis=0)
        return np.tanh(h[0]) if self.head == "tanh" else np.clip(h[0], -1.0, 1.0)

    def symbolic(self, x: Sequence[Any], actions: Sequence[float]) -> Any:
        """The action for one scaled state of scalars or symbols: of a head argmax, one of `actions`."""
        h = list(x)
        for i, (w, b) in enumerate(self.layers):
            h = [sum((a * v for a, v in zip(row, h)), c) for row, c in zip(w.tolist(), b.tolist())]
            if i < len(self.layers) - 1:
                h = [m.maximum(v, 0.0) if self.activation == "relu" else m.tanh(v) for v in h]
        if self.head != "argmax":
            return m.tanh(h[0]) if self.head == "tanh" else m.clip(h[0], -1.0, 1.0)
        best, action = h[0], actions[0]
        for v, a in zip(h[1:], actions[1:]):
            better = v > best
            best, action = m.where(better, v, best), m.where(better, a, action)
        return action


def angles_of(answer: Any, n: int, actions: Sequence[float] | None, largest: float, where: str) -> Array:
    """The actions [rad] (n,) that an agent means by numbers of `actions` or, without them, by shares of `largest`.

    Raises ValueError, beginning with `where`, for anything else.
    """
    given = np.asarray(answer)
    fits = given.dtype.kind in "iuf" and given.size == n
    low, high = (-1.0 - 1e-6, 1.0 + 1e-6) if actions is None else (0, len(actions) - 1)
    if not (fits and ((low <= given) & (given <= high)).all() and (actions is None or (given % 1 == 0).all())):
        expected = "numbers within [-1, 1]" if actions is None else f"whole numbers 0 to {high}"
        raise ValueError(f"{where} {answer!r:.80}, expected {expected}: {n} in all, one a car")
    given = given.reshape(-1)
    return given.astype(float) * largest if actions is None else np.array(actions)[given.astype(np.intp)]


@dataclass(frozen=True, eq=False, kw_only=True)
class PolicyBlock(Policy):
    """Steers by any policy of the scaled state, such as an agent that was trained in `steerkit.gym`.

        x = clip((s - mid)/half, -10, 10),   s the columns of `description`
        action = actions[policy(x)]   discrete
        action = largest*policy(x)    continuous, policy in [-1, 1]

    Inputs: e [m], e_dot [m/s], v [m/s], psi_e [rad], r_e [rad/s], doe [rad], all direct. Outputs: action [rad], for a
    dynamic output element; ready [1], 1. No state. A NaN or an infinity among the inputs makes
    action NaN, so that a supervisor sees the fault. Raises ValueError for a description with other columns, bad
    actions, or (when it runs) a policy that answers something else.
    """

    policy: Callable[[Any], Any]
    """Of scaled states, float32 (n, columns): answers n numbers of actions, or n numbers in [-1, 1]. A `Network` can be
    compiled and exported too, other functions can only be run."""
    actions: tuple[float, ...] | None = None
    """The angles [rad] that a discrete policy chooses from; None: a continuous one."""
    largest: float = number(radians_of(25.0), "rad", above=0.0, high=20.0)
    """The angle [rad] that a continuous policy's 1 means."""
    description: StateDescription = StateDescription()
    """Which of the inputs the policy sees, in which order, and their ranges."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where = "PolicyBlock"
        other = [name for name in self.description.names if name not in COLUMNS]
        require(not other, where, f"description column {other[:1]} is no input; valid: {', '.join(COLUMNS)}")
        chooses = isinstance(self.policy, Network) and self.policy.head == "argmax"
        require(self.actions or not chooses, where, "a Network that chooses needs the actions [rad] it chooses from")
        if self.actions is not None:
            object.__setattr__(self, "actions", tuple(float(a) for a in self.actions))
            fits = len(self.actions) > 0 and bool(np.isfinite(self.actions).all())
            require(fits, where, f"actions = {self.actions}, expected finite angles [rad]")

    def output(self, t: Any, x: State, u: Any) -> Any:
        """The policy's action, and whether it may be trusted with the wheel."""
        d = self.description
        nan = float("nan")
        sound = m.is_finite(u.e + u.e_dot + u.v + u.psi_e + u.r_e + u.doe)
        s = [getattr(u, name) for name in d.names]
        if any(map(m.is_symbol, u)):
            if not isinstance(self.policy, Network):
                raise TypeError(f"policy {self.policy!r} is no Network: it cannot be traced, only run (simulate)")
            scaled = [m.clip((v - a) / b, -BOUND, BOUND) for v, a, b in zip(s, d.mid.tolist(), d.half.tolist())]
            action = self.policy.symbolic(scaled, self.actions or ()) * (1.0 if self.actions else self.largest)
            return self.Y(action=m.where(sound, action, nan), ready=1.0)
        rows = np.stack(np.broadcast_arrays(*s), axis=-1)
        shape = rows.shape[:-1]
        rows = np.where(np.reshape(sound, (*shape, 1)), rows, 0.0).reshape(-1, len(s))
        scaled_rows = np.clip((rows - d.mid) / d.half, -BOUND, BOUND)
        exact = isinstance(self.policy, Network)
        answer = self.policy(scaled_rows if exact else scaled_rows.astype(np.float32))
        angles = angles_of(answer, len(rows), self.actions, self.largest, "PolicyBlock: the policy answered")
        if not shape:
            return self.Y(action=float(angles[0]) if sound else nan, ready=1.0)
        return self.Y(action=np.where(sound, angles.reshape(shape), nan), ready=np.ones(shape))

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the block of a `Network` to a small file (NumPy .npz, no pickle); `load` gives it back bit for bit."""
        net = self.policy
        if not isinstance(net, Network):
            raise TypeError(f"PolicyBlock.save: {net!r} is no Network; only weights can be written to a file")
        arrays = {f"{kind}{i}": a for i, layer in enumerate(net.layers) for kind, a in zip("wb", layer)}
        write_arrays(
            path,
            "policy block",
            {
                "actions": self.actions or (),
                "largest": self.largest,
                "dt": self.dt,
                **self.description.arrays(),
                "activation": net.activation,
                "head": net.head,
                "layers": len(net.layers),
                **arrays,
            },
        )

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "PolicyBlock":
        """The block that `save` wrote; raises ValueError for a truncated or foreign file."""
        f = read_arrays(path, "policy block", largest=LARGEST_POLICY)
        try:
            net = Network(
                layers=tuple((f[f"w{i}"], f[f"b{i}"]) for i in range(int(f["layers"]))),
                activation=str(f["activation"]),  # type: ignore[arg-type]
                head=str(f["head"]),  # type: ignore[arg-type]
            )
            return cls(
                policy=net,
                actions=tuple(f["actions"].tolist()) or None,
                largest=float(f["largest"]),
                description=StateDescription.of_arrays(f),
                dt=float(f["dt"]),
            )
        except (ValueError, TypeError, KeyError) as why:
            raise ValueError(f"{path}: the policy in it does not hold together: {why}") from why
