"""Neural Fitted Q Iteration: from recorded transitions to a better Q-function, one update at a time."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from steerkit.block import require
from steerkit.learning.costs import Cost
from steerkit.learning.qnetwork import Net, new_net, sizes_of
from steerkit.learning.rprop import Engine, Fit, engine_of, fit, predict
from steerkit.learning.state import STANDARD, StateDescription, goal_patterns, mirror_patterns, patterns
from steerkit.learning.transitions import Transitions

Progress = Callable[[int, Sequence[float]], None]
"""Called after each NFQ iteration with its number (from 0) and the nets' mean squared errors."""


@dataclass(frozen=True, kw_only=True)
class FitSetting:
    """How an update of the Q-function is made; the defaults are the paper's."""

    discount: float = 0.95
    """gamma, in [0, 1): how much the next step's cost-to-go counts; 0.95 at 20 Hz looks about a second ahead."""
    epochs: int = 300
    """Rprop epochs of each fit."""
    init: Literal["fresh", "warm"] = "fresh"
    """fresh: each fit starts from new random weights. warm: from the last net; quicker at first, but its sigmoids
    saturate and learning stalls."""
    hints: int = 100
    """Hint-to-goal patterns (state in the description's goal region, target 0) in each fit; they pin the level of the
    Q-function, which otherwise drifts upwards."""
    n_step: int = 1
    """Costs summed before bootstrapping; 3 carries a failure back three samples an iteration, at the price of judging
    the recorded actions rather than the greedy ones."""
    nets: int = 1
    """Members of the ensemble: same targets, own random weights; three smooth out single unlucky fits."""
    combine: Literal["mean", "max"] = "mean"
    """How the members' values become one, in the targets and in the policy; max is the cautious reading."""
    mirror: bool = False
    """Learn from every transition's mirror image too, with the same target: twice the data for twice the time."""
    iterations: int = 1
    """NFQ iterations (new targets, new fit) of one update."""
    hidden: tuple[int, ...] = (10, 10)
    """Units of the hidden layers."""
    clip: tuple[float, float] = (0.0, 1.0)
    """Targets are limited to this range; a sigmoid reaches no further."""
    engine: Engine = "auto"
    """Where the fits run: "c", "torch", or "auto" (C where a compiler is found)."""

    def __post_init__(self) -> None:
        where = "FitSetting"
        require(0.0 <= self.discount < 1.0, where, f"discount = {self.discount}, expected 0 <= discount < 1")
        require(self.init in ("fresh", "warm"), where, f"init = {self.init!r}; valid: 'fresh', 'warm'")
        require(self.combine in ("mean", "max"), where, f"combine = {self.combine!r}; valid: 'mean', 'max'")
        require(self.engine in ("auto", "c", "torch"), where, f"engine = {self.engine!r}; valid: 'auto', 'c', 'torch'")
        for name, least in (("epochs", 0), ("hints", 0), ("n_step", 1), ("nets", 1), ("iterations", 1)):
            require(getattr(self, name) >= least, where, f"{name} = {getattr(self, name)}, expected >= {least}")
        require(all(h >= 1 for h in self.hidden), where, f"hidden = {self.hidden}, expected sizes >= 1")
        require(self.clip[0] < self.clip[1], where, f"clip = {self.clip}, expected low < high")


def fresh_nets(
    setting: FitSetting = FitSetting(), description: StateDescription = STANDARD, seed: int = 0
) -> tuple[Net, ...]:
    """Untrained nets to begin with: `setting.nets` of them, drawn from the seed."""
    sizes = (len(description.names) + 1, *setting.hidden, 1)
    return tuple(new_net(sizes, [seed, k]) for k in range(setting.nets))


def cost_to_go(
    nets: Sequence[Net],
    s: NDArray[np.float64],
    actions: Sequence[float],
    description: StateDescription,
    setting: FitSetting = FitSetting(),
) -> NDArray[np.float32]:
    """min over the actions of q(s, a) for the states s (n, columns); zeros without nets."""
    if not nets:
        return np.zeros(len(s), dtype=np.float32)
    scale = description.scale_of(tuple(actions))
    x = patterns(description, s, np.zeros(len(s)), scale)
    best = np.full(len(s), np.inf, dtype=np.float32)
    for action in actions:
        x[:, -1] = action / scale
        values = np.array([predict(net, x, engine=setting.engine) for net in nets])
        best = np.minimum(best, values.max(axis=0) if setting.combine == "max" else values.mean(axis=0))
    return best


def targets(
    transitions: Transitions,
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting = FitSetting(),
    description: StateDescription = STANDARD,
    nets: Sequence[Net] = (),
) -> NDArray[np.float32]:
    """What Q(s, a) should be at each transition (n,).

        y_k = sum_{i<m} gamma^i c_{k+i} + gamma^m min_b q(s_{k+m}, b),   limited to `clip`

    m is n_step, or fewer where the episode ends first; after a terminal transition there is no second term, so a
    1-step terminal target is the cost itself. Without nets q = 0. Source: Riedmiller 2005 (NFQ); Watkins 1989 for
    several steps.
    """
    c, terminal = cost(transitions.s, transitions.a, transitions.s_next)
    ahead = cost_to_go(nets, transitions.s_next, actions, description, setting)
    y = np.where(terminal, c, c + setting.discount * ahead)
    if setting.n_step > 1:
        one_step = y
        runs_on = np.zeros(len(c), dtype=bool)  # does the row below continue this one?
        runs_on[:-1] = (transitions.episode[1:] == transitions.episode[:-1]) & ~terminal[:-1]
        for _ in range(setting.n_step - 1):  # y(n) = c + gamma y(n-1) of the row below, backwards from one step
            below = np.append(y[1:], 0.0)
            y = np.where(runs_on, c + setting.discount * below, one_step)
    return np.clip(y, *setting.clip).astype(np.float32)


def iterate(
    transitions: Transitions,
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting = FitSetting(),
    description: StateDescription = STANDARD,
    nets_before: Sequence[Net] | None = (),
    seed: int = 0,
    progress: Progress | None = None,
) -> tuple[Net, ...]:
    """One update of the Q-function: `setting.iterations` rounds of new targets and a new fit of every net.

    Takes the recorded transitions, the action set [rad], the cost, and the nets of the update before (none at first:
    the targets are then the costs alone). Returns the new nets, for `NfqPolicy(nets=...)` and for the next update. The
    result depends on its arguments, engine and machine only. Two members train at once where two cores are there.
    Raises ValueError for no transitions, unlike columns, an action set that `mirror` needs and that is not its own
    mirror image, or nets of another layout than the setting's. Source: Riedmiller 2005 (NFQ), batch with Rprop.
    """
    where = "nfq.iterate"
    names = description.names
    require(len(transitions) > 0, where, "no transitions, expected at least one; drive (or load) an episode first")
    require(transitions.names == names, where, f"transitions of {transitions.names}, but the description has {names}")
    require(len(actions) > 0, where, "actions is empty, expected at least one angle [rad]")
    symmetric = all(min(abs(a + b) for b in actions) < 1e-9 for a in actions)
    require(symmetric or not setting.mirror, where, f"mirror=True needs -a for each a in actions, got {tuple(actions)}")
    sizes = (len(names) + 1, *setting.hidden, 1)
    nets = tuple(nets_before or ())
    fits = all(sizes_of(net) == sizes for net in nets)
    require(fits, where, f"nets_before of layouts {[sizes_of(net) for net in nets]}, expected {sizes}")

    states = patterns(description, transitions.s, transitions.a, description.scale_of(tuple(actions)))
    for iteration in range(setting.iterations):
        hints = goal_patterns(description, actions, setting.hints, np.random.default_rng([seed, iteration, 0]))
        y = targets(transitions, actions, cost, setting, description, nets)
        x = np.concatenate([states, hints])
        y = np.concatenate([y, np.zeros(setting.hints, dtype=np.float32)])
        if setting.mirror:
            x, y = np.concatenate([x, mirror_patterns(description, x)]), np.concatenate([y, y])
        starts = [new_net(sizes, [seed, iteration, 1 + k]) for k in range(setting.nets)]
        if setting.init == "warm":
            starts[: len(nets)] = nets[: setting.nets]
        done = _fit_all(starts, x, y, setting)
        nets = tuple(result.net for result in done)
        if progress is not None:
            progress(iteration, [float(result.errors[-1]) for result in done])
    return nets


def _fit_all(starts: Sequence[Net], x: NDArray[np.float32], y: NDArray[np.float32], setting: FitSetting) -> list[Fit]:
    engine = engine_of(setting.engine)

    def one(net: Net) -> Fit:
        return fit(net, x, y, epochs=setting.epochs, engine=engine)

    if len(starts) == 1 or engine == "torch":  # PyTorch has threads of its own
        return [one(net) for net in starts]
    with ThreadPoolExecutor(max_workers=min(2, os.cpu_count() or 1)) as pool:
        return list(pool.map(one, starts))
