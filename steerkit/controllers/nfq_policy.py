"""The greedy policy of a learned Q-function: inference only, plain arrays, no learning library."""

import functools
import math
import operator
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit._support.files import read_arrays, write_arrays
from steerkit.controllers import delay_compensator as ahead
from steerkit.controllers.delay_compensator import DelayCompensator
from steerkit.controllers.policy import ACTION, COLUMNS, LARGEST_POLICY, Policy, StateDescription, check_layers
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, Out, State, without_port
from steerkit.diagram.units import radians_of
from steerkit.task import STOP

Net = tuple[NDArray[Any], ...]
"""An all-sigmoid net as plain arrays: W [n_out, n_in] and b [n_out] of each layer in turn; the last has one unit."""

_INPUTS = len(COLUMNS)

IDOE_ACTIONS = tuple(radians_of(a) for a in (0.0, -10.0, 10.0, -60.0, 60.0))
"""Steps of the steering wheel [rad] that an integrating dynamic output element takes (the paper's I-DOE set)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NfqPolicy(Policy):
    """Steers greedily by a learned Q-function: the action of the least expected cost.

        action = argmin_a q(s, a),   q = mean over the nets of Q(s, a)
        y = sigmoid(W y + b) in each layer of Q, from the scaled (s, a) on,   sigmoid(z) = (1 + tanh(z/2))/2

    `continuous`: any action between those of the set, the lowest point of the parabola through the best one's value and
    its neighbours'. `forecast`: the state s is not the one that is seen but the one in which the command will act.

    Inputs: e [m], e_dot [m/s], v [m/s], psi_e [rad], r_e [rad/s], doe [rad] (the dynamic output element's angle),
    preview [1/m] (of `preview_points`, none without a forecast), all direct. Outputs: action [rad], q [1] in (0, 1),
    ready [1] (1.0 once t >= ready_from with a net, else 0.0).
    Without a net, action and q are 0.0. Equal values: the smallest |action| wins, then the first given. A NaN or an
    infinity among the inputs makes action and q NaN, so that a supervisor sees the fault. State: what a forecast
    remembers; none without `preview_points`.
    Raises ValueError for an empty or non-finite action set, nets of unlike or wrong layout, or
    non-finite weights. Source: Riedmiller 2005 (Neural Fitted Q Iteration), eq. for the greedy policy.
    """

    q = Out("1")
    preview = In("1/m", size="preview_points")

    nets: tuple[Net, ...] | None = ()
    """The ensemble; empty: nothing learned yet."""
    actions: tuple[float, ...] = IDOE_ACTIONS
    """The action set [rad]."""
    description: StateDescription = StateDescription()
    """Scaling of the six inputs, in the order of the ports."""
    ready_from: float = 0.0
    """Time from which a net counts as there [s]."""
    continuous: bool = False
    """Take actions between those of the set too?"""
    preview_points: int = 0
    """`forecast.PREVIEW` for a policy that has a forecast, or may get one while it drives; else 0."""
    forecast: DelayCompensator | None = None
    """The car's dead time and how it answers the wheel; None: commands act at once."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where = "NfqPolicy"
        actions = tuple(float(a) for a in self.actions)
        fits = len(actions) > 0 and all(abs(action) <= 4.0 * STOP for action in actions)
        require(
            fits, where, f"actions = {actions} [rad], expected one or more, each finite and within +-{4.0 * STOP:.0f}"
        )
        object.__setattr__(self, "actions", actions)
        object.__setattr__(self, "nets", tuple(tuple(np.asarray(p) for p in net) for net in self.nets or ()))
        n = len(self.description.names)
        of_ports = f"description has {n} columns, expected {len(COLUMNS)}, one for each of the ports e ... doe"
        require(n == len(COLUMNS), where, of_ports)
        for net in self.nets or ():
            check_net(net, n + 1, where)
            same = [p.shape for p in net] == [p.shape for p in self.nets[0]]  # type: ignore[index]
            require(same, where, "nets of different layouts, expected one layout for the whole ensemble")
        points = f"preview_points = {self.preview_points}; valid: 0, or {ahead.PREVIEW}, which a forecast needs"
        valid = self.preview_points == ahead.PREVIEW or (self.preview_points == 0 and self.forecast is None)
        require(valid, where, points)
        if not self.preview_points:
            without_port(self, "preview")

    @functools.cached_property
    def _order(self) -> tuple[float, ...]:
        """The order of search: of equal values the gentlest action's is found first."""
        return tuple(sorted(self.actions, key=abs))

    @functools.cached_property
    def _folded(self) -> tuple[NDArray[Any], NDArray[Any], list[tuple[NDArray[Any], NDArray[Any]]]]:
        """The ensemble as one tanh net h -> tanh(A h + d) per layer, with the scaling inside.

        With sigmoid = (1 + tanh(z/2))/2, the halves move into the next layer's weights: A = W/4 and
        d = (b + W 1 / 2)/2; the first layer is A = W/2 of the scaled state, plus one column of offsets an action.
        """
        nets = [[np.asarray(p, dtype=np.float64) for p in net] for net in self.nets or ()]
        mid, half, scale = self.description.mid, self.description.half, self.description.scale_of(self.actions)
        first = 0.5 * np.concatenate([net[0] for net in nets])
        of_state = first[:, :ACTION] / half
        offset = 0.5 * np.concatenate([net[1] for net in nets]) - of_state @ mid
        of_action = offset[:, None] + np.outer(first[:, ACTION], np.array(self._order) / scale)
        layers = []
        for i in range(2, len(nets[0]), 2):
            each = np.array([net[i] for net in nets])
            w = (np.eye(len(nets))[:, None, :, None] * each[:, :, None, :]).reshape(len(nets) * each.shape[1], -1)
            d = 0.5 * (np.concatenate([net[i + 1] for net in nets]) + 0.5 * w.sum(axis=1))
            layers.append((0.25 * w, d[:, None]))
        return of_state, of_action, layers

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return ahead.nothing(batch) if self.preview_points else ()

    def settle(self, t: float, x: State, u: Any) -> State:
        return (self.forecast or _STANDS).at_first(u) if self.preview_points else ()

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (self.forecast or _STANDS).remember(x, u) if self.preview_points else ()

    def output(self, t: Any, x: State, u: Any) -> Any:
        """The greedy action, its value, and whether to be trusted with the wheel."""
        s = tuple(u[:_INPUTS]) if self.forecast is None else self.forecast.ahead(x, u)
        if not self.nets:
            nothing = np.zeros(np.broadcast(*s).shape) if any(isinstance(value, np.ndarray) for value in s) else 0.0
            return self.Y(action=nothing, q=nothing, ready=nothing)
        share: Any = 1.0
        if self.description.scaled_from < math.inf:
            excess, s = self.description.excess(u.v), self.description.scaled(s)
            share = 1.0 / (excess * excess)
        ready, nan = m.where(t >= self.ready_from, 1.0, 0.0), float("nan")
        sound = m.is_finite(s[0] + s[1] + s[2] + s[3] + s[4] + s[5])  # tanh would hide an infinity
        if all(value.__class__ is float for value in s):
            column = self._values(np.array(s if sound else [nan] * len(s))[:, None]).tolist()
            q = min(column)
            action = self._order[column.index(q)]
            if self.continuous:
                action = self._between(column, action)
        elif any(map(m.is_symbol, s)):
            action, q = self._symbolic(s)
            q = m.where(sound, q, nan)
        else:
            states = np.where(sound, np.array(np.broadcast_arrays(*s), dtype=float), nan)
            values = self._values(states.reshape(len(s), -1)).reshape(-1, *states.shape[1:])
            action, q = np.array(self._order)[values.argmin(axis=0)], values.min(axis=0)
            if self.continuous:
                action = self._between(list(values), action)
            ready = ready + np.zeros(states.shape[1:])
        return self.Y(action=m.where(sound, share * action, nan), q=q, ready=ready)

    @functools.cached_property
    def _neighbours(self) -> tuple[tuple[int, int, int], ...]:
        """Places in `_order` of every action but the outermost ones, between those of the actions beside it."""
        rising = sorted(range(len(self._order)), key=self._order.__getitem__)
        return tuple(zip(rising, rising[1:], rising[2:]))

    def _between(self, values: list[Any], best: Any) -> Any:
        """The lowest point of the parabola through the best action's value and those beside it; `values` by `_order`.

        a = a1 + ((a2 - a1)^2 (q0 - q1) - (a1 - a0)^2 (q2 - q1)) / (2 ((a2 - a1)(q0 - q1) + (a1 - a0)(q2 - q1)))
        """
        for left, middle, right in self._neighbours:
            a1 = self._order[middle]
            below, above = a1 - self._order[left], self._order[right] - a1
            rise, other = values[left] - values[middle], values[right] - values[middle]  # >= 0 beside the best one
            curved = above * rise + below * other
            step = 0.5 * (above**2 * rise - below**2 * other) / m.where(curved > 0.0, curved, 1.0)
            best = m.where(m.both(best == a1, curved > 0.0), a1 + step, best)  # at most half way to the next
        return best

    def _values(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """q of every action for the states (columns, N), as (A * N,)."""
        of_state, of_action, layers = self._folded
        h = np.tanh((of_state @ s)[:, None, :] + of_action[:, :, None]).reshape(len(of_state), -1)
        for w, d in layers:
            h = np.tanh(w @ h + d)
        return 0.5 + 0.5 * mean_of(h)

    def _symbolic(self, u: Any) -> tuple[Any, Any]:
        """The same in scalars, for tracing."""
        of_state, of_action, layers = self._folded
        z = [_dot(row, u) for row in of_state.tolist()]
        values = []
        for offsets in of_action.T.tolist():
            h = [m.tanh(a + b) for a, b in zip(z, offsets, strict=True)]
            for w, d in layers:
                h = [m.tanh(_dot(row, h) + c) for row, (c,) in zip(w.tolist(), d.tolist(), strict=True)]
            values.append(0.5 + 0.5 * mean_of(h))
        return self.least(values)

    def least(self, values: Sequence[Any]) -> tuple[Any, Any]:
        """The action of least value, and that value; values: symbols, those of the actions, gentlest first."""
        best: Any = values[0]
        action: Any = self._order[0]
        for candidate, q in zip(self._order[1:], values[1:], strict=True):
            better = q < best
            best, action = m.where(better, q, best), m.where(better, candidate, action)
        return (self._between(list(values), action) if self.continuous else action), best

    def save(self, path: str | os.PathLike[str], *, durable: bool = True) -> None:
        """Write the policy to one small file (NumPy .npz, no pickle) that `load` gives back bit for bit.

        durable: wait for the disk; False for a thread that may not (`steerkit._support.files.whole`).
        """
        arrays = {
            "actions": self.actions,
            "ready_from": self.ready_from,
            "continuous": self.continuous,
            "dt": self.dt,
            "preview_points": self.preview_points,
            **self.description.arrays(),
            "nets": len(self.nets or ()),
            **{f"net{k}_{i}": p for k, net in enumerate(self.nets or ()) for i, p in enumerate(net)},
        }
        if self.forecast is not None:
            arrays |= {
                "dead_samples": self.forecast.samples,
                "forecast": [getattr(self.forecast, name) for name in _KEPT],
            }
        write_arrays(path, "policy", arrays, durable=durable)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "NfqPolicy":
        """The policy that `save` wrote; raises ValueError for a truncated or foreign file."""
        f = read_arrays(path, "policy", largest=LARGEST_POLICY)
        try:
            require(str(f.get("combine", "mean")) == "mean", "nets", "not to be joined by their mean; learn anew")
            layout = [sum(name.startswith(f"net{k}_") for name in f) for k in range(int(f["nets"]))]
            return cls(
                nets=tuple(tuple(f[f"net{k}_{i}"] for i in range(n)) for k, n in enumerate(layout)),
                actions=tuple(f["actions"].tolist()),
                description=StateDescription.of_arrays(f),
                ready_from=float(f["ready_from"]),
                dt=float(f["dt"]),
                continuous=bool(f["continuous"]),
                preview_points=int(f["preview_points"]),
                forecast=_forecast_in(f),
            )
        except (ValueError, TypeError, KeyError) as why:
            raise ValueError(f"{path}: the policy in it does not hold together: {why}") from why


_STANDS = DelayCompensator()  # what a policy without a forecast remembers by
_KEPT = (*ahead.ANSWER[:6], "straight", "trust", "trust_course", *ahead.ANSWER[6:], *ahead.FELT)
"""The numbers of a forecast, in the order of a policy's file."""


def _forecast_in(f: Any) -> DelayCompensator | None:
    """The forecast of a policy's file, if it holds one."""
    if "dead_samples" not in f:
        return None
    numbers = f["forecast"].tolist()
    require(len(numbers) == len(_KEPT), "forecast", f"{len(numbers)} numbers, expected {len(_KEPT)}; learn anew")
    found = DelayCompensator(samples=int(f["dead_samples"]), dt=float(f["dt"]), **dict(zip(_KEPT, numbers)))
    for name in (*ahead.ANSWER, "straight"):  # some 0.01, 0.2 and 0.4; others would steer straight on in silence
        require(
            abs(getattr(found, name)) <= 10.0, "forecast", f"{name} = {getattr(found, name):g}, expected within +-10"
        )
    for name, low, high in (("lead", -1.0, 10.0), ("fade", 0.0, 1.0), ("most", 0.0, math.inf), ("slew", 0.0, math.inf)):
        value = getattr(found, name)
        require(low <= value <= high, "forecast", f"{name} = {value:g}, expected {low:g} to {high:g}")
    return found


def check_net(net: Net, n_in: int, where: str) -> None:
    """Raise ValueError unless `net` is W, b, W, b, ... from n_in inputs to one unit, all finite."""
    require(len(net) >= 2 and len(net) % 2 == 0, where, f"a net of {len(net)} arrays, expected W, b of each layer")
    n = check_layers(list(zip(net[::2], net[1::2])), n_in, where)
    require(n == 1, where, f"the last layer has {n} units, expected 1")


def mean_of(values: Any) -> Any:
    """The mean (...) of the nets' values (nets, ...), of arrays or of symbols, added up in their order."""
    return functools.reduce(operator.add, values) / len(values)


def _dot(row: Any, h: Any) -> Any:
    total: Any = 0.0
    for a, b in zip(row, h, strict=True):
        if m.is_symbol(a) or a != 0.0:
            total = total + a * b
    return total
