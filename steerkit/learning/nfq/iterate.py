"""Neural Fitted Q Iteration: from recorded transitions to a better Q-function, one update at a time."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.controllers.delay_compensator import LONGEST, PREVIEW, DelayCompensator
from steerkit.controllers.nfq_policy import COMBINATIONS, Combine, combined
from steerkit.controllers.policy import ACTION, DOE, E, V
from steerkit.controllers.state_description import StateDescription
from steerkit.learning.costs import Cost
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.dead_time import process_of
from steerkit.learning.nfq.model import CarModel, Imagined, imagine
from steerkit.learning.nfq.rprop import Engine, Fit, Net, engine_of, fit, new_net, predict, sizes_of
from steerkit.task import DT

STANDARD = StateDescription()
"""The six inputs of the steering task, in their usual ranges."""


def patterns(
    description: StateDescription, s: NDArray[np.float64], a: NDArray[np.float64], scale: float
) -> NDArray[np.float32]:
    """Net inputs (n, columns + 1) of states s (n, columns) and actions a (n,) [rad]; scale [rad] becomes 1."""
    if description.scaled_from < math.inf:
        s, a = np.column_stack(description.scaled(tuple(s.T))), a * description.excess(s[:, V]) ** 2
    x = np.empty((len(s), s.shape[1] + 1), dtype=np.float32)
    x[:, :ACTION] = (s - description.mid) / description.half
    x[:, ACTION] = a / scale
    return x


def mirror_patterns(description: StateDescription, x: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same patterns seen in the mirror: a change of signs, as ranges are centred wherever the sign is -1."""
    return x * np.array([*description.mirror_signs, -1.0], dtype=np.float32)


def goal_patterns(
    description: StateDescription, actions: Sequence[float], count: int, rng: np.random.Generator
) -> NDArray[np.float32]:
    """`count` hint-to-goal patterns: states drawn evenly from the goal region, with the action that stays in it.

    That action is 0 where the set has it (an integrating output element holds its angle), else any one of the set.
    """
    scale = description.scale_of(tuple(actions))
    x = rng.uniform(-1.0, 1.0, (count, len(description.names) + 1)) * np.array([*description.goal, 0.0])
    x[:, ACTION] = 0.0 if 0.0 in actions else rng.choice(np.array(actions), count) / scale
    return x.astype(np.float32)


Nets = tuple[Net, ...]
STAY = 20
"""Samples for which a state has to stay in the goal band to be a dynamic hint."""
GUARD_STATES = 500
"""Imagined states from which a guard lets old and new nets drive."""


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
    """Hint-to-goal patterns (target 0) in each fit; they pin the level of the Q-function. They are wrong where the car
    cannot stay for nothing, such as in a bend: 0 gives quicker and far steadier learning (model-free, 8 seeds: GOOD in
    all after 75 s instead of in half after 170 s; default: RMS e of 16 nets in a row 12-14 mm instead of 13-32 mm)."""
    hint_from: Literal["region", "record"] = "region"
    """region: states drawn from the description's goal region. record: recorded states from which the car was found to
    stay in the cost's goal band for the next `STAY` samples, with the action taken there (dynamic hints)."""
    n_step: int = 1
    """Costs summed before bootstrapping; 3 carries a failure back three samples an iteration, at the price of judging
    the recorded actions rather than the greedy ones."""
    window: int = 0
    """Only the newest so many transitions are fitted, which bounds the time of a fit; 0: all of them. The model that
    imagines others learns from all."""
    nets: int = 1
    """Members of the ensemble: same targets, own random weights; three smooth out single unlucky fits."""
    keep: int = 1
    """Updates whose nets work together, the newest and those before it: an average over several updates, at no cost
    in training, that chatters less from one update to the next."""
    combine: Combine = "mean"
    """How the members' values become one, in the targets and in the policy: mean, max or disagreement."""
    mirror: bool = False
    """Learn from every transition's mirror image too, with the same target: twice the data for twice the time."""
    iterations: int = 1
    """NFQ iterations (new targets, new fit) of one update."""
    imagined: int = 0
    """Patterns a learned model of the car adds to each fit (`steerkit.learning.nfq.model`): states near the recorded
    ones, in bends of any strength, with any action. They stand for most of the driving: failures fall from 20 or 30 to
    1."""
    horizon: int = 4
    """Samples for which an imagined car is followed, greedily after its first action, before bootstrapping."""
    hidden: tuple[int, ...] = (10, 10)
    """Units of the hidden layers."""
    symmetric: bool = False
    """Every net works together with its mirror image, so that the Q-function is that of a car that is the same in the
    mirror, by construction. RMS e on a recorded lap without noise halves; a net's use costs twice the time. A car
    that is not the same in the mirror, as its wheel is mounted off centre: see `dead_time`."""
    dead_time: float = 0.0
    """Longest dead time that is looked for in the record [s], 0: none. The commands' way is then found from the record,
    fractions of a sample and the angle of going straight on with it; nets learn the process without it, and the
    policy acts on the state forecast over it (`steerkit.learning.nfq.dead_time`). Needs `imagined`."""
    guard: float = 0.0
    """New nets are refused, and those before go on, when the learned model says that their first second costs more than
    this many times that of the nets before (needs `imagined`); 0: every net is accepted."""
    clip: tuple[float, float] = (0.0, 1.0)
    """Targets are limited to this range; a sigmoid reaches no further."""
    engine: Engine = "auto"
    """Where the fits run: "c", "torch", or "auto" (C where a compiler is found)."""

    def __post_init__(self) -> None:
        where = "FitSetting"
        require(0.0 <= self.discount < 1.0, where, f"discount = {self.discount}, expected 0 <= discount < 1")
        require(self.init in ("fresh", "warm"), where, f"init = {self.init!r}; valid: 'fresh', 'warm'")
        require(self.combine in COMBINATIONS, where, f"combine = {self.combine!r}; valid: {', '.join(COMBINATIONS)}")
        require(self.engine in ("auto", "c", "torch"), where, f"engine = {self.engine!r}; valid: 'auto', 'c', 'torch'")
        least_of = {"epochs": 0, "hints": 0, "n_step": 1, "nets": 1, "iterations": 1, "imagined": 0, "horizon": 1}
        for name, least in {**least_of, "keep": 1, "window": 0}.items():
            require(getattr(self, name) >= least, where, f"{name} = {getattr(self, name)}, expected >= {least}")
        sought = f"dead_time = {self.dead_time} s with imagined = {self.imagined}, expected 0, or 0 to "
        bridged = 0.0 <= self.dead_time <= LONGEST * DT and (self.dead_time == 0.0 or self.imagined > 0)
        require(bridged, where, sought + f"{LONGEST * DT:g} with imagined > 0")
        origins = f"hint_from = {self.hint_from!r}; valid: 'region', 'record'"
        require(self.hint_from in ("region", "record"), where, origins)
        guarded = f"guard = {self.guard} with imagined = {self.imagined}, expected 0, or >= 1 with imagined > 0"
        require(self.guard == 0.0 or (self.guard >= 1.0 and self.imagined > 0), where, guarded)
        require(all(h >= 1 for h in self.hidden), where, f"hidden = {self.hidden}, expected sizes >= 1")
        require(self.clip[0] < self.clip[1], where, f"clip = {self.clip}, expected low < high")

    @property
    def preview_points(self) -> int:
        """Of the policies that it makes: see `NfqPolicy.preview_points`."""
        return PREVIEW if self.dead_time else 0


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
    return action_values(nets, s, actions, description, setting).min(axis=0)


def action_values(
    nets: Sequence[Net],
    s: NDArray[np.float64],
    actions: Sequence[float],
    description: StateDescription,
    setting: FitSetting = FitSetting(),
) -> NDArray[np.float32]:
    """q(s, a) of every action for the states s (n, columns), as (actions, n)."""
    scale = description.scale_of(tuple(actions))
    x = patterns(description, s, np.zeros(len(s)), scale)
    q = np.empty((len(actions), len(s)), dtype=np.float32)
    for row, action in zip(q, actions, strict=True):
        x[:, ACTION] = action / scale
        values = np.array([predict(net, x, engine=setting.engine) for net in nets])
        row[:] = combined(values, setting.combine)
    return q


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


def imagined_targets(
    model: CarModel,
    states: Imagined,
    a: NDArray[np.float64],
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting,
    description: StateDescription,
    nets: Sequence[Net] = (),
) -> NDArray[np.float32]:
    """What Q(s, a) should be at imagined states (n,): the model drives on, greedily after the first action.

        y = sum_{i<h} gamma^i c_i + gamma^h min_b q(s_h, b),  h = `horizon`;   what follows a terminal step counts 0

    The first step has the residual of the recorded transition that the state was imagined from, so that bends, delays
    and noise that the model does not know are in the targets. Source: Sutton 1990 (Dyna); Feinberg et al. 2018 (model
    based value expansion).
    """
    y, weight, last = _imagined_costs(model, states, a, actions, cost, setting, description, nets, setting.horizon)
    return np.clip(y + weight * last, *setting.clip).astype(np.float32)


def _imagined_costs(
    model: CarModel,
    states: Imagined,
    a: NDArray[np.float64],
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting,
    description: StateDescription,
    nets: Sequence[Net],
    steps: int,
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Discounted costs of `steps` imagined samples, the discount after them (0 after a failure), and min_b q there."""
    gentlest_first = sorted(actions, key=abs)  # of equal values, as the policy does
    s, earlier, choices = states.s, states.earlier, np.array(gentlest_first)
    total, weight, least = np.zeros(len(s)), np.ones(len(s)), np.zeros(len(s))
    for step in range(steps if nets else 1):
        s_next = model.step(s, a, earlier)
        if step == 0:
            s_next += states.residual
        c, terminal = cost(s, a, s_next)
        total += weight * c
        weight = weight * setting.discount * ~terminal
        s, earlier = s_next, s[:, DOE]
        if nets:
            q = action_values(nets, s, gentlest_first, description, setting)
            a, least = choices[q.argmin(axis=0)] / description.excess(s[:, V]) ** 2, q.min(axis=0).astype(float)
    return total, weight, least


def imagined_cost(
    model: CarModel,
    states: Imagined,
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting,
    description: StateDescription,
    nets: Sequence[Net],
) -> float:
    """Mean discounted cost of a second of greedy driving by the nets, from imagined states, in the learned model."""
    q = action_values(nets, states.s, actions, description, setting)
    a = np.array(actions)[q.argmin(axis=0)] / description.excess(states.s[:, V]) ** 2
    steps = round(1.0 / model.dt)
    return float(_imagined_costs(model, states, a, actions, cost, setting, description, nets, steps)[0].mean())


def staying(record: Transitions, goal: float) -> NDArray[np.intp]:
    """Rows from which |e| stayed below `goal` [m] for STAY samples of the same episode."""
    inside = (np.abs(record.s_next[:, E]) < goal).astype(int)
    sums = np.concatenate(([0], np.cumsum(inside)))
    rows = np.arange(max(0, len(record) - STAY + 1))
    whole = record.episode[rows] == record.episode[rows + STAY - 1]
    return rows[(sums[rows + STAY] - sums[rows] == STAY) & whole]


def iterate(
    transitions: Transitions,
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting = FitSetting(),
    description: StateDescription = STANDARD,
    nets_before: Sequence[Net] | None = (),
    seed: int = 0,
    model: CarModel | None = None,
) -> tuple[Net, ...]:
    """One update of the Q-function: `setting.iterations` rounds of new targets and a new fit of every net.

    Takes the recorded transitions, the action set [rad], the cost, and the nets of the update before (none at
    first: the targets are then the costs alone). Returns the new nets, for `NfqPolicy(nets=...)` and for the next
    update. The result depends on its arguments, engine and machine only. model: of the car, for `imagined`;
    default: fitted. Two members train at once where two cores are there. Raises ValueError for no transitions,
    unlike columns, an action set that `mirror` needs and that is not its own mirror image, or nets of another
    layout than the setting's. Source: Riedmiller 2005 (NFQ), batch with Rprop.
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

    scale = description.scale_of(tuple(actions))
    recent = newest(transitions, setting.window)
    states = patterns(description, recent.s, recent.a, scale)
    if setting.imagined and model is None:
        model = CarModel.fit(transitions, description)
    for iteration in range(setting.iterations):
        hints = _hints(recent, actions, cost, setting, description, np.random.default_rng([seed, iteration, 0]))
        y = targets(recent, actions, cost, setting, description, nets)
        x = np.concatenate([states, hints])
        y = np.concatenate([y, np.zeros(len(hints), dtype=np.float32)])
        if model is not None:
            rng = np.random.default_rng([seed, iteration, 1_000_003])
            near = imagine(model, transitions, description, setting.imagined, rng)
            a = rng.choice(np.array(actions), setting.imagined) / description.excess(near.s[:, V]) ** 2
            x = np.concatenate([x, patterns(description, near.s, a, scale)])
            dreamt = imagined_targets(model, near, a, actions, cost, setting, description, nets)
            y = np.concatenate([y, dreamt])
        if setting.mirror:
            x, y = np.concatenate([x, mirror_patterns(description, x)]), np.concatenate([y, y])
        starts = [new_net(sizes, [seed, iteration, 1 + k]) for k in range(setting.nets)]
        if setting.init == "warm":
            starts[: len(nets)] = nets[-setting.nets :]
        nets = tuple(result.net for result in _fit_all(starts, x, y, setting))
        if setting.symmetric:
            nets = (*nets, *(mirror_image(net, description) for net in nets))
    together = (*(nets_before or ()), *nets)[-setting.keep * len(nets) :]
    if model is not None and setting.guard and nets_before:
        near = imagine(model, transitions, description, GUARD_STATES, np.random.default_rng([seed, 1_000_033]))
        new, old = (imagined_cost(model, near, actions, cost, setting, description, n) for n in (together, nets_before))
        if new > setting.guard * old:
            return tuple(nets_before)
    return together


def _hints(
    record: Transitions,
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting,
    description: StateDescription,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    if setting.hint_from == "region":
        return goal_patterns(description, actions, setting.hints, rng)
    rows = staying(record, cost.goal)
    rows = rng.choice(rows, min(setting.hints, len(rows)), replace=False) if len(rows) else rows
    return patterns(description, record.s[rows], record.a[rows], description.scale_of(tuple(actions)))


def mirror_image(net: Net, description: StateDescription) -> Net:
    """The net whose value of a state and an action is that of `net` for both as seen in the mirror."""
    signs = np.array([*description.mirror_signs, -1.0], dtype=net[0].dtype)
    return (net[0] * signs, *net[1:])


def newest(transitions: Transitions, count: int) -> Transitions:
    """The newest `count` transitions, all of them for 0."""
    if count == 0 or count >= len(transitions):
        return transitions
    rows = slice(-count, None)
    part = Transitions(transitions.names)
    part.extend(transitions.s[rows], transitions.a[rows], transitions.s_next[rows], transitions.episode[rows])
    return part


def _fit_all(starts: Sequence[Net], x: NDArray[np.float32], y: NDArray[np.float32], setting: FitSetting) -> list[Fit]:
    engine = engine_of(setting.engine)

    def one(net: Net) -> Fit:
        return fit(net, x, y, epochs=setting.epochs, engine=engine)

    if len(starts) == 1 or engine == "torch":  # PyTorch has threads of its own
        return [one(net) for net in starts]
    with ThreadPoolExecutor(max_workers=threads()) as pool:
        return list(pool.map(one, starts))


def threads() -> int:
    """How many members train at once: two, or as many as this process has cores, or as OMP_NUM_THREADS allows.

    Whoever runs several processes on a machine sets that variable for them, as joblib does; nets do not depend on it.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return max(1, min(2, cores, int(asked) if asked.isdigit() else cores))


class Learned(NamedTuple):
    """What an update of the Q-function gives a policy."""

    nets: Nets = ()
    forecast: DelayCompensator | None = None
    """Of a setting with `dead_time`."""


NOTHING = Learned()
"""Before the first update."""


def update(
    transitions: Transitions,
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting,
    description: StateDescription,
    before: Learned = NOTHING,
    seed: int = 0,
) -> Learned:
    """One update: `iterate`, and before it the search for the dead time, where the setting has it; see there."""
    if not setting.dead_time:
        return Learned(iterate(transitions, actions, cost, setting, description, before.nets, seed))
    require(len(transitions) > 0, "nfq.update", "no transitions, expected at least one")
    process = process_of(transitions, description, setting.dead_time)
    nets = iterate(process.record, actions, cost, setting, description, before.nets, seed, model=process.model)
    return Learned(nets, process.forecast)
