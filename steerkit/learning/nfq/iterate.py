"""Neural Fitted Q Iteration: from recorded transitions to a better Q-function, one update at a time."""

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import check_numbers, number, require
from steerkit.controllers.delay_compensator import LONGEST, PREVIEW, DelayCompensator
from steerkit.controllers.nfq_policy import NfqPolicy, mean_of
from steerkit.controllers.policy import ACTION, DOE, E, StateDescription, V
from steerkit.learning.costs import Cost, Costs, TanhCost
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.dead_time import SETTLED, process_of
from steerkit.learning.nfq.model import CarModel, Explained, Imagined, explained, imagine, near_path
from steerkit.learning.nfq.rprop import Net, engine_of, fit, new_net, predictor, sizes_of
from steerkit.task import DT, RELEASE

NEWEST = 600
"""Samples by which it is judged how good the driving is: 30 s."""
TRIALS = 40
"""Drives on the learned car by which a net is judged."""
FAR = 8
"""One in so many begins beside the path, by up to twice RELEASE, the others on it."""
TRIAL = 60
"""Samples of each."""
LATER, CALM, CHEAPER = 0.3, 1.5, 0.85
"""From SETTLED on, nets of a car with overshoot or slew stay that act at most CALM times as much as the calmest, where
commands are LATER than forecast, in dead times [1]: of nets that cost alike, wheel rates differ widely. What a new one
costs, and acts, is divided by CHEAPER: those of the update before mostly stay."""
DEARER, DEAREST = 16.0, 3.0
"""How many times as much an action of such a car costs [1]: DEARER/fast^2, within 1 and DEAREST."""

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


Nets = tuple[Net, ...]
Predict = Callable[[NDArray[np.float32]], NDArray[np.float32]]


@dataclass(frozen=True, kw_only=True)
class FitSetting:
    """How an update of the Q-function is made; the defaults are the paper's."""

    discount: float = 0.95
    """gamma, in [0, 1): how much the next step's cost-to-go counts; 0.95 at 20 Hz looks about a second ahead."""
    epochs: int = number(300, low=0)
    """Rprop epochs of each fit, from new random weights: those of the last net saturate, and learning stalls."""
    hints: int = number(100, low=0)
    """Hint-to-goal patterns (target 0) in each fit; they pin the level of the Q-function. They are wrong where the car
    cannot stay for nothing, such as in a bend: 0 gives quicker and far steadier learning."""
    n_step: int = number(1, low=1)
    """Costs summed before bootstrapping; 3 carries a failure back three samples an iteration, at the price of judging
    the recorded actions rather than the greedy ones."""
    window: int = number(0, low=0)
    """Only the newest so many transitions are fitted, which bounds the time of a fit; 0: all of them. The model that
    imagines others learns from all."""
    nets: int = number(1, low=1)
    """Members of the ensemble: same targets, own random weights. Where a model of the car is learned, those of all
    iterations and of the update before drive that car (`trials`), and the ones with the least cost stay; of a car with
    overshoot or slew, of the CALM ones. Without a model: the last iteration's."""
    mirror: bool = False
    """Learn from every transition's mirror image too, with the same target: twice the data for twice the time."""
    iterations: int = number(1, low=1)
    """NFQ iterations (new targets, new fit) of one update."""
    imagined: int = number(0, low=0)
    """Patterns a learned model of the car adds to each fit (`steerkit.learning.nfq.model`): states near the recorded
    ones, in bends of any strength, with any action. They stand for most of the driving."""
    horizon: int = number(4, low=1)
    """Samples for which an imagined car is followed, greedily after its first action, before bootstrapping."""
    hidden: tuple[int, ...] = (10, 10)
    """Units of the hidden layers."""
    symmetric: bool = False
    """Every net works together with its mirror image, so that the Q-function is that of a car that is the same in the
    mirror, by construction. RMS e on a recorded lap without noise halves; a net's use costs twice the time. A car
    that is not the same in the mirror, as its wheel is mounted off centre: see `dead_time`."""
    dead_time: float = number(0.0, "s", low=0.0, high=LONGEST * DT)
    """Longest dead time that is looked for in the record [s], 0: none. The commands' way is then found from the record,
    fractions of a sample and the angle of going straight on with it; nets learn the process without it, and the
    policy acts on the state forecast over it (`steerkit.learning.nfq.dead_time`). Needs `imagined`."""

    def __post_init__(self) -> None:
        where = "FitSetting"
        check_numbers(self, where)
        require(0.0 <= self.discount < 1.0, where, f"discount = {self.discount}, expected 0 <= discount < 1")
        bridged = self.dead_time == 0.0 or self.imagined > 0
        require(
            bridged, where, f"dead_time = {self.dead_time} s with imagined = {self.imagined}, expected imagined > 0"
        )
        require(all(h >= 1 for h in self.hidden), where, f"hidden = {self.hidden}, expected sizes >= 1")

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


@dataclass(frozen=True, kw_only=True)
class Problem:
    """What is learned, and how: actions, cost, fit, and what the nets see of the car.

    Raises ValueError for no actions, or for a set that `mirror` needs and that is not its own mirror image.
    """

    actions: Sequence[float]
    """Action set [rad]."""
    cost: Cost
    fit: FitSetting = FitSetting()
    description: StateDescription = STANDARD
    continuous: bool = False
    """Does the policy take actions between those of the set?"""

    def __post_init__(self) -> None:
        require(len(self.actions) > 0, "nfq.Problem", "actions is empty, expected at least one angle [rad]")
        symmetric = all(min(abs(a + b) for b in self.actions) < 1e-9 for a in self.actions)
        asked = f"mirror=True needs -a for each a in actions, got {tuple(self.actions)}"
        require(symmetric or not self.fit.mirror, "nfq.Problem", asked)

    @property
    def scale(self) -> float:
        """The action [rad] that a net sees as 1."""
        return self.description.scale_of(tuple(self.actions))

    @property
    def sizes(self) -> tuple[int, ...]:
        """Units of the nets' layers, the inputs first."""
        return (len(self.description.names) + 1, *self.fit.hidden, 1)

    def costs(self, s: NDArray[np.float64], a: NDArray[np.float64], s_next: NDArray[np.float64]) -> Costs:
        """Costs of transitions (n,) by actions a [rad] as they were applied, and which of them have failed."""
        return self.cost(s, a * self.description.excess(s[:, V]) ** 2, s_next)

    def patterns(self, s: NDArray[np.float64], a: NDArray[np.float64]) -> NDArray[np.float32]:
        """Net inputs of states s (n, columns) and actions a (n,) [rad]."""
        return patterns(self.description, s, a, self.scale)


def goal_patterns(problem: Problem, rng: np.random.Generator) -> NDArray[np.float32]:
    """Hint-to-goal patterns: states drawn evenly from the goal region, with the action that stays in it.

    That action is 0 where the set has it (an integrating output element holds its angle), else any one of the set.
    """
    count, actions = problem.fit.hints, np.array(problem.actions)
    x = rng.uniform(-1.0, 1.0, (count, problem.sizes[0]))
    x[:, :ACTION] *= problem.description.goal
    x[:, ACTION] = 0.0 if 0.0 in problem.actions else rng.choice(actions, count) / problem.scale
    return x.astype(np.float32)


def action_values(problem: Problem, nets: Sequence[Net], s: NDArray[np.float64]) -> NDArray[np.float32]:
    """q(s, a) of every action for the states s (n, columns), as (actions, n)."""
    x = _with_each_action(problem, s)
    return _values([predictor(net, x.shape[-1]) for net in nets], x)


def _with_each_action(problem: Problem, s: NDArray[np.float64]) -> NDArray[np.float32]:
    """Net inputs (actions, n, columns + 1)."""
    x = np.tile(problem.patterns(s, np.zeros(len(s))), (len(problem.actions), 1, 1))
    x[:, :, ACTION] = (np.array(problem.actions) / problem.scale)[:, None]
    return x


def _values(members: Sequence[Predict], x: NDArray[np.float32]) -> NDArray[np.float32]:
    """The mean of what the members of an ensemble say of net inputs (..., columns + 1)."""
    rows = x.reshape(-1, x.shape[-1])
    return mean_of(np.array([member(rows) for member in members])).reshape(x.shape[:-1])


def targets(problem: Problem, transitions: Transitions, nets: Sequence[Net] = ()) -> NDArray[np.float32]:
    """What Q(s, a) should be at each transition (n,).

        y_k = sum_{i<m} gamma^i c_{k+i} + gamma^m min_b q(s_{k+m}, b),   limited to [0, 1]

    m is n_step, or fewer where the episode ends first; after a terminal transition there is no second term, so a
    1-step terminal target is the cost itself. Without nets q = 0. Source: Riedmiller 2005 (NFQ); Watkins 1989 for
    several steps.
    """
    discount = problem.fit.discount
    c, terminal = problem.costs(transitions.s, transitions.a, transitions.s_next)
    ahead = action_values(problem, nets, transitions.s_next).min(axis=0) if nets else 0.0
    y = one_step = np.where(terminal, c, c + discount * ahead)
    runs_on = np.zeros(len(c), dtype=bool)  # does the row below continue this one?
    runs_on[:-1] = (transitions.episode[1:] == transitions.episode[:-1]) & ~terminal[:-1]
    for _ in range(problem.fit.n_step - 1):  # y(n) = c + gamma y(n-1) of the row below, backwards from one step
        y = np.where(runs_on, c + discount * np.append(y[1:], 0.0), one_step)
    return np.clip(y, 0.0, 1.0).astype(np.float32)


def imagined_targets(
    problem: Problem, model: CarModel, states: Imagined, a: NDArray[np.float64], nets: Sequence[Net] = ()
) -> NDArray[np.float32]:
    """What Q(s, a) should be at imagined states (n,): the model drives on, greedily after the first action.

        y = sum_{i<h} gamma^i c_i + gamma^h min_b q(s_h, b),  h = `horizon`;   what follows a terminal step counts 0

    The first step has the residual of the recorded transition that the state was imagined from, so that bends, delays
    and noise that the model does not know are in the targets. Source: Sutton 1990 (Dyna); Feinberg et al. 2018 (model
    based value expansion).
    """
    order = np.argsort(np.abs(problem.actions), kind="stable")  # of equal values the gentlest, as the policy does
    choices, description = np.array(problem.actions)[order], problem.description
    s, earlier, felt = states.s, states.earlier, states.felt
    total, weight, least = np.zeros(len(s)), np.ones(len(s)), np.zeros(len(s))
    for step in range(problem.fit.horizon if nets else 1):
        s_next = model.step(s, a, earlier, felt)
        if step == 0:
            s_next += states.residual
        felt = felt and model.after(s, s_next[:, DOE], felt)
        c, terminal = problem.costs(s, a, s_next)
        total += weight * c
        weight = weight * problem.fit.discount * ~terminal
        s, earlier = s_next, s[:, DOE]
        if nets:
            q = action_values(problem, nets, s)[order]
            a, least = choices[q.argmin(axis=0)] / description.excess(s[:, V]) ** 2, q.min(axis=0).astype(float)
    return np.clip(total + weight * least, 0.0, 1.0).astype(np.float32)


def iterate(
    transitions: Transitions,
    problem: Problem,
    nets_before: Sequence[Net] = (),
    seed: int = 0,
    model: CarModel | None = None,
    samples: int = 0,
) -> Nets:
    """One update of the Q-function: `fit.iterations` rounds of new targets and a new fit of every net.

    nets_before: of the update before (none at first: the targets are then the costs alone). Returns the new nets.
    model: of the car, for `imagined`; default: fitted; samples: its dead time, for `trials`. The result depends on its
    arguments, engine and machine only. Two members train at once where two cores are there. Raises ValueError for no
    transitions, unlike columns, or nets of another layout than the problem's. Source: Riedmiller 2005 (NFQ, Rprop).
    """
    where, setting, names = "nfq.iterate", problem.fit, problem.description.names
    require(len(transitions) > 0, where, "no transitions, expected at least one; drive (or load) an episode first")
    own = bool(transitions.own.any()) or setting.imagined > 0
    require(own, where, "no transitions of the learner's own, expected at least one where none are imagined")
    require(transitions.names == names, where, f"transitions of {transitions.names}, but the description has {names}")
    layouts = [sizes_of(net) for net in nets_before]
    fits = all(layout == problem.sizes for layout in layouts)
    require(fits, where, f"nets_before of layouts {layouts}, expected {problem.sizes}")
    if setting.imagined and model is None:
        model = CarModel.fit(transitions, problem.description)
    if isinstance(problem.cost, TanhCost):
        newest_s = transitions.s[-NEWEST:]
        fast = float(problem.description.excess(np.median(newest_s[:, V])))
        dearer = min(max(1.0, DEARER / fast**2), DEAREST) if model is not None and model.feels else 1.0
        problem = replace(problem, cost=problem.cost.suited(newest_s[:, E], fast, dearer))
    nets: Nets = tuple(nets_before)
    size = 2 if setting.symmetric else 1
    members = [nets[i : i + size] for i in range(0, len(nets), size)]
    known = None if model is None else explained(model, transitions)
    for iteration in range(setting.iterations):
        x, y = _patterns(problem, transitions, nets, known, [seed, iteration])
        starts = [new_net(problem.sizes, [seed, iteration, 1 + k]) for k in range(setting.nets)]
        new: list[Nets] = [(net,) for net in _fit_all(starts, x, y, setting.epochs)]
        if setting.symmetric:
            new = [(net, mirror_image(net, problem.description)) for (net,) in new]
        nets = tuple(chain.from_iterable(new))
        members += new
    if known is not None:
        costs, turns = trials(problem, known, members, np.random.default_rng([seed, 2_000_003]))
        if known.model.feels and len(transitions) >= SETTLED:
            _, turns = trials(problem, known, members, np.random.default_rng([seed, 2_000_003]), samples)
            for each in (costs, turns):
                each[len(nets_before) // size :] /= CHEAPER
            costs[turns > CALM * np.sort(turns)[: setting.nets].max()] = math.inf
        nets = tuple(chain.from_iterable(members[i] for i in np.argsort(costs, kind="stable")[: setting.nets]))
    return nets


def trials(
    problem: Problem, known: Explained, members: Sequence[Nets], rng: np.random.Generator, samples: int = 0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean cost and |action| [rad] of a sample (members,) with each member alone at the wheel of the learned car.

    TRIALS drives of TRIAL samples, or until they fail, which costs 1 a sample from then on. All members meet the same:
    what the model left unexplained of the record (noise, bends, changes of speed), in the order in which it was
    recorded. samples: of dead time, of a car with overshoot or slew, over which nets act on a forecast, while commands
    are LATER than it believes. Any other learned car has no dead time, and the noise of a forecast is left out.
    """
    policy = NfqPolicy(actions=tuple(problem.actions), continuous=problem.continuous)
    order = np.argsort(np.abs(problem.actions), kind="stable")
    model, record, before, felt, unexplained = known
    near = near_path(record)
    place = rng.integers(len(near), size=TRIALS)
    s, earlier = record.s[near[place]].copy(), before[near[place]]
    s[:, E] = 0.0
    s[::FAR, E] = 2.0 * RELEASE * rng.uniform(-1.0, 1.0, len(s[::FAR]))
    s, earlier, place = np.tile(s, (len(members), 1)), np.tile(earlier, len(members)), np.tile(place, len(members))
    felt = felt and felt.part(near[place])
    drivers = [[predictor(net, problem.sizes[0]) for net in nets] for nets in members]
    total, turned, drives = np.zeros(len(s)), np.zeros(len(s)), np.ones(len(s), dtype=bool)
    later = round(LATER * samples)
    way = [s[:, DOE]] * (samples + later if model.feels else 0)  # angles that have not arrived, the next one first
    for _ in range(TRIAL):
        ahead, was, feels = s, earlier, felt
        for angle in way[later:]:
            feels_next = feels and model.after(ahead, angle, feels)
            ahead, was, feels = model.turned(ahead, angle, was, feels), ahead[:, DOE], feels_next
        parts = np.split(_with_each_action(problem, ahead), len(members), axis=1)
        each = [_values(those, part) for those, part in zip(drivers, parts, strict=True)]
        a = policy.least(list(np.concatenate(each, axis=1)[order]))[0] / problem.description.excess(s[:, V]) ** 2
        way.append(model.step(ahead, a, was, feels)[:, DOE])
        s_next = model.turned(s, way.pop(0), earlier, felt) + unexplained[near[place]]
        felt = felt and model.after(s, s_next[:, DOE], felt)
        place = (place + 1) % len(near)
        s_next[:, V] = record.s[near[place], V]
        c, failed = problem.costs(s, a, s_next)
        drives &= ~failed
        total += np.where(drives, c, 1.0)
        turned += np.where(drives, np.abs(a), problem.scale)
        s, earlier = np.where(drives[:, None], s_next, s), np.where(drives, s[:, DOE], earlier)
    return tuple(sums.reshape(len(members), -1).mean(axis=1) / TRIAL for sums in (total, turned))


def _patterns(
    problem: Problem, transitions: Transitions, nets: Nets, known: Explained | None, seed: list[int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What a fit learns: patterns and targets of recorded transitions, of hints, and of imagined ones."""
    setting, description = problem.fit, problem.description
    recent = newest(transitions.part(transitions.own), setting.window)
    hints = goal_patterns(problem, np.random.default_rng([*seed, 0]))
    x = [problem.patterns(recent.s, recent.a), hints]
    y = [targets(problem, recent, nets), np.zeros(len(hints), dtype=np.float32)]
    if known is not None:
        rng = np.random.default_rng([*seed, 1_000_003])
        near = imagine(known, description, setting.imagined, rng)
        a = rng.choice(np.array(problem.actions), setting.imagined) / description.excess(near.s[:, V]) ** 2
        x.append(problem.patterns(near.s, a))
        y.append(imagined_targets(problem, known.model, near, a, nets))
    if setting.mirror:
        x, y = [*x, *(mirror_patterns(description, part) for part in x)], [*y, *y]
    return np.concatenate(x), np.concatenate(y)


def mirror_image(net: Net, description: StateDescription) -> Net:
    """The net whose value of a state and an action is that of `net` for both as seen in the mirror."""
    signs = np.array([*description.mirror_signs, -1.0], dtype=net[0].dtype)
    return (net[0] * signs, *net[1:])


def newest(transitions: Transitions, count: int) -> Transitions:
    """The newest `count` transitions, all of them for 0."""
    if count == 0 or count >= len(transitions):
        return transitions
    return transitions.part(slice(-count, None))


def _fit_all(starts: Sequence[Net], x: NDArray[np.float32], y: NDArray[np.float32], epochs: int) -> list[Net]:
    def one(net: Net) -> Net:
        return fit(net, x, y, epochs=epochs).net

    if len(starts) == 1 or engine_of() == "torch":  # PyTorch has threads of its own
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


NOTHING_LEARNED = Learned()
"""Before the first update."""


def update(transitions: Transitions, problem: Problem, before: Learned, seed: int = 0) -> Learned:
    """One update: `iterate`, and before it the search for the dead time, where the fit has it; see there."""
    if not problem.fit.dead_time:
        return Learned(iterate(transitions, problem, before.nets, seed))
    process = process_of(transitions, problem.description, problem.fit.dead_time, before.forecast)
    nets = iterate(process.record, problem, before.nets, seed, process.model, process.forecast.samples)
    return Learned(nets, process.forecast)
