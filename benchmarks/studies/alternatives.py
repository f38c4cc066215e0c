"""What else could be learned from the same drive: commands in flight as inputs of the net, or an actor (NFQCA).

A car with a steering delay that nobody is told is learned by the setting `default`. From that drive's record, three
ways to learn begin anew, each with the same imagined transitions of the model of that car, number of nets, and updates:

    aligned     ours: transitions without dead time; the greedy policy acts on the state forecast over it
    in flight   the state also has the angles still on their way, and no forecast (Katsikopoulos, Engelbrecht 2003)
    actor       as `aligned`, but a net a = pi(s), trained to lessen Q(s, pi(s)), picks the action, and its Q stands in
                the targets (NFQCA: Hafner and Riedmiller 2011)

Each policy then drives a round of the test, the recovery controller beside it; `default` is the run's own last net.

    python -m benchmarks study alternatives [--delays 0.1 0.2 0.4] [--seeds 2] [--quick] [--json]
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.run.fleet import of_kind
from steerkit.controllers import delay_compensator as ahead
from steerkit.controllers.delay_compensator import DelayCompensator, Motion, moved
from steerkit.controllers.nfq_policy import Net, NfqPolicy
from steerkit.controllers.policy import ACTION, COLUMNS, DOE, E_DOT, PSI_E, R_E, E, Policy, V
from steerkit.controllers.state_description import StateDescription
from steerkit.diagram import maths as m
from steerkit.diagram.block import In, State
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.experiment import Experiment
from steerkit.learning.nfq.dead_time import Process, process_of
from steerkit.learning.nfq.iterate import FitSetting, iterate, mirror_image
from steerkit.learning.nfq.model import CarModel, imagine, speed
from steerkit.learning.nfq.network import forward, new_net
from steerkit.learning.nfq.patterns import mirror_patterns, patterns
from steerkit.learning.nfq.rprop import fit
from steerkit.learning.settings import DEFAULT, Setting
from steerkit.learning.training_run import train
from steerkit.learning.trials import TrialDrive, drive_each
from steerkit.scenario import Scenario
from steerkit.task import DT

Array = NDArray[np.float64]
WAYS = ("default", "aligned", "in flight", "actor")
UPDATES = 60
"""Updates of one iteration each; with a discount of 0.95 the targets have settled to 5 %."""
IMAGINED = 4000
"""Imagined transitions beside each update's recorded ones."""
ROWS = 3000
"""Newest recorded transitions of an update."""


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class InFlight(Policy):
    """Picks the greedy action of nets that see the angles on their way beside the state of now.

    The waiting angles are constants of a sample: W_in_flight * angles goes into the first layer's offset, and
    `NfqPolicy` does the rest. State: the angles of the last `samples` samples, oldest first.
    """

    nets: tuple[Net, ...]
    description: StateDescription
    setting: Setting
    straight: float
    """Angle of going straight on [rad]."""

    @property
    def samples(self) -> int:
        """How many angles are on their way."""
        return len(self.description.names) - len(COLUMNS)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (m.filled(0.0, batch),) * self.samples

    def settle(self, t: float, x: State, u: Any) -> State:
        return (u.doe,) * self.samples

    def output(self, t: Any, x: State, u: Any) -> Any:
        waiting = (np.array(x[::-1]) - self.straight) / self.description.half[len(COLUMNS) :]
        nets, n = [], len(COLUMNS)
        for first, offset, *rest in self.nets:
            of_seen = np.concatenate([first[:, :n], first[:, ACTION:]], axis=1)
            nets.append((of_seen, offset + first[:, n:ACTION] @ waiting, *rest))
        seen = _first(self.description, n)
        policy = NfqPolicy(nets=tuple(nets), actions=self.setting.actions, description=seen, continuous=True)
        y = policy.output(t, (), policy.D(*u[:DOE], u.doe - self.straight))
        return self.Y(*y)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return (*x[1:], u.doe)


@final
@dataclass(frozen=True, eq=False, kw_only=True)
class Actor(Policy):
    """Picks the action that a net says, of the state forecast over the dead time: pi(s) = reach*(2 sigmoid(z) - 1)."""

    preview = In("1/m", size="preview_points")

    nets: tuple[Net, ...]
    """The actor and its mirror image."""
    description: StateDescription
    reach: float
    """Largest action [rad]."""
    forecast: DelayCompensator
    preview_points: int = ahead.PREVIEW
    preview_dt: float = DT

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return ahead.nothing(batch)

    def settle(self, t: float, x: State, u: Any) -> State:
        return self.forecast.at_first(u)

    def output(self, t: Any, x: State, u: Any) -> Any:
        s = np.array([self.forecast.ahead(x, u)])
        return self.Y(action=float(self.reach * acted(self.nets[0], s, self.description)[0]), q=0.0, ready=1.0)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return self.forecast.remember(x, u)


def acted(actor: Net, s: Array, description: StateDescription) -> NDArray[np.float64]:
    """pi(s)/reach (n,) of a net without the action's column, odd in the mirror: (pi(s) - pi(mirrored s))/2."""
    x = patterns(description, s, np.zeros(len(s)), 1.0)
    one, other = (forward(actor, side[:, :ACTION]) for side in (x, mirror_patterns(description, x)))
    return (one - other).astype(np.float64)


def _first(description: StateDescription, n: int) -> StateDescription:
    """The description of the first n columns."""
    parts = {name: getattr(description, name)[:n] for name in ("names", "low", "high", "mirror_signs", "goal")}
    return replace(description, **parts)


def with_waiting(description: StateDescription, samples: int) -> StateDescription:
    """The description with `samples` angles on their way after its columns, newest first."""
    parts: dict[str, Any] = {}
    for name in ("low", "high", "mirror_signs", "goal"):
        values = getattr(description, name)
        parts[name] = (*values, *(values[DOE],) * samples)
    names = (*description.names, *(f"doe_{i + 1}" for i in range(samples)))
    return replace(description, names=names, **parts)


def waiting_record(record: Transitions, samples: int, straight: float, description: StateDescription) -> Transitions:
    """Recorded transitions with the angles of the last `samples` samples beside each state, counted from `straight`."""
    n, count = len(COLUMNS), len(record)
    row = np.arange(samples, count)
    row = row[record.episode[row] == record.episode[row - samples]]
    waiting = np.column_stack([record.s[row - i, DOE] for i in range(samples + 1)]) - straight
    s, s_next = record.s[row, :n].copy(), record.s_next[row, :n].copy()
    s[:, DOE], s_next[:, DOE] = s[:, DOE] - straight, s_next[:, DOE] - straight
    whole = Transitions(description.names)
    whole.extend(
        np.column_stack([s, waiting[:, 1:]]),
        record.a[row],
        np.column_stack([s_next, waiting[:, :-1]]),
        record.episode[row],
    )
    return whole


def imagined(
    process: Process, actions: Array, description: StateDescription, samples: int, rng: np.random.Generator
) -> Transitions:
    """Imagined transitions, each an episode of its own; `samples` > 0: with so many angles on their way.

    Those angles lead from the angle that acts now to that of the output element, by an action in every other sample.
    """
    model, base = process.model, _first(description, len(COLUMNS))
    near = imagine(model, process.record, base, IMAGINED, rng)
    a = rng.choice(actions, IMAGINED)
    if samples == 0:
        s, s_next = near.s, model.step(near.s, a, near.earlier) + near.residual
    else:
        steps = rng.choice(actions, (IMAGINED, samples)) * rng.integers(0, 2, (IMAGINED, samples))
        angles = near.s[:, [DOE]] + np.cumsum(np.column_stack([np.zeros(IMAGINED), steps]), axis=1)
        angles = np.clip(angles, -model.limit, model.limit)  # oldest first: (count, samples + 1)
        s = np.column_stack([near.s[:, :DOE], angles[:, ::-1]])
        s_next = _delayed_step(model, s, a, near.earlier, near.residual, samples)
    extra = Transitions(description.names)
    extra.extend(s, a, s_next, np.arange(IMAGINED))
    return extra


def _delayed_step(model: CarModel, s: Array, a: Array, earlier: Array, residual: Array, samples: int) -> Array:
    """The state a sample later, of a car on which the oldest angles act."""
    newest, waiting = s[:, DOE], s[:, DOE:]
    begins, acts = waiting[:, samples - 1], waiting[:, samples]
    v, c = s[:, V], s[:, E_DOT] / speed(s)
    motion = moved(model, Motion(s[:, E], c, s[:, PSI_E], s[:, R_E]), v, (begins, acts, earlier), dt=model.dt)
    doe = np.clip(model.held * newest + model.pushed * a, -model.limit, model.limit)
    seen = np.column_stack([motion.e, v * motion.c, v, motion.psi_e, motion.r_e]) + residual[:, :DOE]
    return np.column_stack([seen, doe, waiting[:, :-1]])


def both(recorded: Transitions, more: Transitions, rng: np.random.Generator) -> Transitions:
    """Recorded transitions, `ROWS` at most, and others after them, in episodes of their own."""
    row = np.sort(rng.choice(len(recorded), min(ROWS, len(recorded)), replace=False))
    whole = Transitions(recorded.names)
    whole.extend(recorded.s[row], recorded.a[row], recorded.s_next[row], row)
    whole.extend(more.s, more.a, more.s_next, more.episode + len(recorded))
    return whole


def one_step(setting: FitSetting) -> FitSetting:
    """The fit of an update: of one step, on the transitions that it is given."""
    return replace(setting, n_step=1, iterations=1, imagined=0, dead_time=0.0, keep=1, window=0)


def greedy(
    process: Process, recorded: Transitions, samples: int, setting: Setting, updates: int, seed: int
) -> tuple[Net, ...]:
    """The nets of the last updates of NFQ, for states with `samples` angles on their way."""
    description = with_waiting(replace(setting.description(), scaled_from=np.inf), samples)
    nets: tuple[Net, ...] = ()
    kept: list[tuple[Net, ...]] = []
    for number in range(updates):
        rng = np.random.default_rng([seed, number])
        whole = both(recorded, imagined(process, np.array(setting.actions), description, samples, rng), rng)
        nets = iterate(
            whole, setting.actions, setting.cost, one_step(setting.fit), description, nets, seed=seed + number
        )
        kept = [*kept, nets][-2:]
    return tuple(net for nets in kept for net in nets)


def actor_critic(process: Process, setting: Setting, updates: int, seed: int) -> Net:
    """The actor of NFQCA after so many updates: critics by Rprop, then the actor by Rprop through the critics."""
    import torch

    description, reach = replace(setting.description(), scaled_from=np.inf), max(map(abs, setting.actions))
    fits, n = setting.fit, len(COLUMNS)
    actor = new_net((n, *fits.hidden, 1), [seed, 0])
    critics: tuple[Net, ...] = ()
    for number in range(updates):
        rng = np.random.default_rng([seed, number])
        # between the actions of the set there are others: the critic has to know them
        drawn = np.linspace(-reach, reach, 101)
        some = rng.random(101) < 0.5
        some[50] = True
        whole = both(process.record, imagined(process, drawn[some], description, 0, rng), rng)
        c, terminal = setting.cost(whole.s, whole.a, whole.s_next)
        x = patterns(description, whole.s, whole.a, reach)
        follows = patterns(description, whole.s_next, reach * acted(actor, whole.s_next, description), reach)
        to_go = np.mean([forward(net, follows) for net in critics], axis=0) if critics else np.zeros(len(c))
        y = np.clip(np.where(terminal, c, c + fits.discount * to_go), *fits.clip).astype(np.float32)
        x2, y2 = np.concatenate([x, mirror_patterns(description, x)]), np.concatenate([y, y])
        sizes = (n + 1, *fits.hidden, 1)
        fitted = [fit(new_net(sizes, [seed, number, 1 + k]), x2, y2, epochs=fits.epochs).net for k in range(fits.nets)]
        critics = (*fitted, *(mirror_image(net, description) for net in fitted))
        actor = _improved(torch, actor, critics, x[:, :ACTION], np.array(description.mirror_signs), fits.epochs)
    return actor


def _improved(torch: Any, actor: Net, critics: Sequence[Net], x: NDArray[np.float32], signs: Array, epochs: int) -> Net:
    """The actor after so many epochs of Rprop on the mean of Q(s, pi(s))."""
    weights = [torch.tensor(p, dtype=torch.float32, requires_grad=True) for p in actor]
    fixed = [[torch.tensor(p, dtype=torch.float32) for p in net] for net in critics]
    states, mirrored = torch.from_numpy(x), torch.from_numpy((x * signs).astype(np.float32))

    def through(net: Any, y: Any) -> Any:
        for w, b in zip(net[::2], net[1::2], strict=True):
            y = torch.sigmoid(torch.nn.functional.linear(y, w, b))
        return y

    rule = torch.optim.Rprop(weights, lr=0.01, step_sizes=(1e-6, 1.0))
    for _ in range(epochs // 5):
        rule.zero_grad()
        action = through(weights, states) - through(weights, mirrored)
        seen = torch.cat([states, action], dim=1)
        cost = torch.stack([through(net, seen) for net in fixed]).mean()
        cost.backward()
        rule.step()
    return tuple(p.detach().numpy().copy() for p in weights)


def policies_of(scenario: Scenario, minutes: float, updates: int, seed: int) -> dict[str, Any]:
    """The policy of each way, from one drive."""
    trained = train(Experiment(setting=DEFAULT, scenario=scenario, minutes=minutes, seed=seed))
    description = DEFAULT.description()
    record = trained.run.transitions
    process = process_of(record, description, DEFAULT.fit.dead_time)
    forecast, samples = process.forecast, process.forecast.samples
    plain = replace(description, scaled_from=np.inf)
    nets = greedy(process, process.record, 0, DEFAULT, updates, seed)
    told: dict[str, Any] = dict(preview_points=ahead.PREVIEW, forecast=forecast)
    ours = NfqPolicy(nets=nets, actions=DEFAULT.actions, description=plain, continuous=True, **told)
    wide = with_waiting(plain, samples)
    waiting = waiting_record(record, samples, forecast.straight, wide)
    in_flight = greedy(process, waiting, samples, DEFAULT, updates, seed)
    actor = actor_critic(process, DEFAULT, updates, seed)
    reach = max(map(abs, DEFAULT.actions))
    return {
        "default": trained.nets[-1].policy,
        "aligned": ours,
        "in flight": InFlight(nets=in_flight, description=wide, setting=DEFAULT, straight=forecast.straight),
        "actor": Actor(nets=(actor,), description=plain, reach=reach, forecast=forecast),
    }


def row(drive: TrialDrive) -> dict[str, Any]:
    """What a test drive came to; None where it ended too early to be judged."""
    s = drive.summary
    judged = dict(rms_e_m=s.rms_e, wheel_deg_s=s.rms_wheel_rate_deg, jerk_rms=s.rms_jerk) if s else {}
    return {"held": drive.held, "rounds": drive.rounds, **judged}


def add_options(parser: argparse.ArgumentParser) -> None:
    """Its own command line options; --quick learns for 18 s, and two updates from that."""
    parser.add_argument("--delays", nargs="+", type=float, default=[0.1, 0.2, 0.4], metavar="SECONDS")
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=3.0, help="driving time of the record (default 3)")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Learn each way from each record, and drive; ratios are to `default` of the same drive."""
    delays, seeds, minutes, updates = options.delays, options.seeds, options.minutes, UPDATES
    if options.quick:
        delays, seeds, minutes, updates = [0.2], 1, 0.3, 2
    rows: list[dict[str, Any]] = []
    table = Table("delay", "seed", "learned by", "held", "RMS e (m)", "wheel (deg/s)", "jerk RMS (m/s^3)")
    jobs = [(delay, seed) for delay in delays for seed in range(seeds)]
    for delay, seed in track(jobs, "learning", console=Console(stderr=True), disable=options.json):
        scenario = replace(of_kind("delays")[0], name=f"{delay:g} s", delay=delay)
        for name, policy in policies_of(scenario, minutes, updates, seed).items():
            (drive,) = drive_each(scenario, DEFAULT, [policy], seed=seed + 1000)
            found = row(drive)
            rows.append({"delay_s": delay, "seed": seed, "way": name, **found})
            shown = [
                f"{found[key]:.{n}f}" if key in found else "-"
                for key, n in (("rms_e_m", 4), ("wheel_deg_s", 1), ("jerk_rms", 2))
            ]
            table.add_row(
                f"{delay:g} s", str(seed), name, "yes" if drive.held else f"{drive.rounds:.2f} rounds", *shown
            )
    Console(width=120).print(table)
    return {"updates": updates, "minutes": minutes, **against_aligned(rows), "drives": rows}


def against_aligned(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Of each other way: the share of drives held, and medians of RMS e and wheel speed over those of `aligned`."""
    cases = {(r["delay_s"], r["seed"]): r for r in rows if r["way"] == "aligned"}
    figures: dict[str, Any] = {}
    for way in WAYS:
        mine = [(r, cases[r["delay_s"], r["seed"]]) for r in rows if r["way"] == way]
        name = way.replace(" ", "_")
        figures[f"{name}_held_share"] = float(np.mean([r["held"] for r, _ in mine]))
        held = [pair for pair in mine if all(r["held"] for r in pair)]
        if way == "aligned" or not held:
            continue
        for short, key in (("rms", "rms_e_m"), ("wheel", "wheel_deg_s")):
            figures[f"{name}_{short}_x"] = float(np.median([r[key] / other[key] for r, other in held]))
    return figures
