"""The ports of every policy that picks actions for a dynamic output element, and how it sees the learner's state."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import check_numbers, number, require
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.task import STOP


@dataclass(frozen=True, eq=False, kw_only=True)
class Policy(Block):
    """Picks an action from the learner's state; abstract.

    Inputs, all direct: e [m], e_dot [m/s], v [m/s], psi_e [rad], r_e [rad/s], doe [rad] (the dynamic output element's
    angle). Outputs: action [rad]; ready [1], whether the policy may steer.
    """

    e = In("m")
    e_dot = In("m/s")
    v = In("m/s")
    psi_e = In("rad")
    r_e = In("rad/s")
    doe = In("rad")
    action = Out("rad")
    ready = Out("1", direct=())


COLUMNS = tuple(port.name for port in Policy.inputs)
"""The columns of the learner's state, in recorded transitions and in a net's input: a policy's inputs, in order."""
UNITS = {port.name: port.unit for port in Policy.inputs}
"""Their units."""
E, E_DOT, V, PSI_E, R_E, DOE = range(len(COLUMNS))
"""Their numbers: `s[:, DOE]` are the output element's angles of the states s (n, columns)."""
LARGEST_POLICY = 64_000_000
"""Bytes that a policy's file may ask for in memory: a hundred thousand times the paper's net."""
ACTION = -1
"""In a net's input, the candidate action: the last column, after the state's."""


def check_layers(layers: Sequence[tuple[NDArray[Any], NDArray[Any]]], n_in: int | None, where: str) -> int:
    """Units of the last layer (W, b); raises ValueError unless they fit together, from n_in inputs, and are finite.

    n_in: None: as many as the first W has columns.
    """
    n = n_in
    for i, (w, b) in enumerate(layers):
        n = w.shape[-1] if n is None and w.ndim else n
        fits = w.ndim == 2 and w.shape[1] == n and b.shape == (w.shape[0],)
        require(fits, where, f"layer {i}: W {w.shape}, b {b.shape}, expected W (n_out, {n}), b (n_out,)")
        finite = bool(np.isfinite(w).all() and np.isfinite(b).all())
        require(finite, where, f"layer {i} holds a NaN or an infinity, expected finite weights")
        n = w.shape[0]
    require(n is not None, where, "no layers, expected at least one")
    return n or 0


@dataclass(frozen=True, kw_only=True)
class StateDescription:
    """What the learner's state is made of: names, ranges, and how it looks in a mirror.

    A net sees x = (s - mid) / half, which brings [low, high] to [-1, 1] (values outside go beyond, nothing is cut),
    and the candidate action a / action_scale. Mirrored left to right, the car is the same car: s -> mirror_signs * s,
    a -> -a. Raises ValueError when the lengths differ, a range is empty, or a sign of -1 has a range not centred
    on 0 (the mirror would not be a sign in scaled units).
    """

    names: tuple[str, ...] = COLUMNS
    """The state's columns, in order; the cost functions read the first as e [m]."""
    low: tuple[float, ...] = (-1.0, -2.0, 0.0, -0.6, -0.6, -STOP)
    """Value that becomes -1 (SI)."""
    high: tuple[float, ...] = (1.0, 2.0, 10.0, 0.6, 0.6, STOP)
    """Value that becomes +1 (SI)."""
    mirror_signs: tuple[float, ...] = (-1.0, -1.0, 1.0, -1.0, -1.0, -1.0)
    """Sign of each column seen in the mirror."""
    goal: tuple[float, ...] = (0.02, 0.02, 1.0, 0.02, 0.02, 1.0)
    """Half-widths, in scaled units about 0, of the goal region that hint-to-goal patterns are drawn from: on the path
    and parallel to it, at any speed and any steering angle (a steady bend)."""
    action_scale: float | None = number(None, "rad", above=0.0)
    """Action [rad] that becomes 1; None: the largest |action| of the set."""
    scaled_from: float = number(math.inf, "m/s", above=0.0)
    """Speed above which the same action turns the wheel the less, and angles count the more, the faster the car is
    [m/s]: see `scaled`."""

    def __post_init__(self) -> None:
        check_numbers(self, "StateDescription")
        for name in ("low", "high", "mirror_signs", "goal"):
            values = tuple(float(value) for value in getattr(self, name))
            n = len(self.names)
            require(len(values) == n, "StateDescription", f"{name} has {len(values)} entries, expected {n}, as names")
            require(all(np.isfinite(values)), "StateDescription", f"{name} = {values}, expected finite numbers")
            object.__setattr__(self, name, values)
        object.__setattr__(self, "names", tuple(self.names))
        for name, low, high, sign in zip(self.names, self.low, self.high, self.mirror_signs, strict=True):
            require(low < high, "StateDescription", f"{name}: low {low} and high {high}, expected low < high")
            require(sign in (-1.0, 1.0), "StateDescription", f"{name}: mirror sign {sign}; valid: -1, 1")
            centred = sign > 0.0 or abs(low + high) <= 1e-12 * high
            require(centred, "StateDescription", f"{name}: sign -1 and range [{low}, {high}], expected low = -high")

    def arrays(self) -> dict[str, Any]:
        """What a file keeps of it: see `of_arrays`."""
        return asdict(self) | {"action_scale": self.action_scale or 0.0}

    @classmethod
    def of_arrays(cls, f: Mapping[str, Any]) -> "StateDescription":
        """The one whose `arrays` are among those of a file."""
        given = {field.name: f[field.name].tolist() for field in fields(cls)}
        return cls(**given | {"action_scale": given["action_scale"] or None})

    @cached_property
    def mid(self) -> NDArray[np.float64]:
        """Centre of each range."""
        return 0.5 * (np.array(self.low) + np.array(self.high))

    @cached_property
    def half(self) -> NDArray[np.float64]:
        """Half-width of each range."""
        return 0.5 * (np.array(self.high) - np.array(self.low))

    def excess(self, v: Any) -> Any:
        """How many times `scaled_from` the speed v [m/s] is, 1 at least; for floats, arrays and symbols."""
        return m.maximum(v / self.scaled_from, 1.0)

    def scaled(self, s: Sequence[Any]) -> tuple[Any, ...]:
        """The columns e, e_dot, v, psi_e, r_e, doe as a net sees them; for floats, arrays and symbols.

            x = max(1, v/scaled_from):   e, e_dot, v/sqrt(x), c x - w x^2, r_e x, doe x^2;   an action a turns by a/x^2
            c = e_dot/v,   w = c - psi_e

        The same number then means about the same e_dot, or the same lateral acceleration, at any speed: 25 degrees of
        the wheel are a touch at 5 m/s and a swerve at 25.
        """
        e, e_dot, v, psi_e, r_e, doe = s
        x = self.excess(v)
        w = e_dot / m.maximum(v, self.scaled_from) - psi_e  # where x is 1 it does not count
        return e, e_dot, v / m.sqrt(x), psi_e * x - w * (x * x - x), r_e * x, doe * x * x

    def scale_of(self, actions: tuple[float, ...]) -> float:
        """The action [rad] that a net sees as 1."""
        return self.action_scale or max(map(abs, actions)) or 1.0
