"""Driving seconds to a good driver: NFQ beside the sample-efficient agents of others, on one car.

All learn on the 795 m course with the nonlinear car, clean, from its beginning; a car that has failed (|e| > 0.5 m) is
put back on the path where it failed, which takes no time. Seconds of driving count from the first sample on, with all
that is driven: exploration, failures and, of NFQ, the waiting for a training. What an agent of others computes is not
waited for. GOOD is the criterion of the study `learning` (`benchmarks.run.trials.drive_each`): a whole round with
max |e| < 0.25 m, RMS e < 0.10 m, jerk < 5 m/s^3, off the clock, with another seed, at the times of GRID: every 2 s at
first, every 30 s in the end. A run ends with the first GOOD policy, which then drives a second round with another seed
(`confirmed`), or after --minutes of driving, or after --computing seconds of computing.

* good_seconds: median over the seeds of the seconds of driving to the first GOOD policy, null for never.
* good_share: share of the seeds that came to one.
* computing_seconds: median CPU time of the trainings alone until then (the first, which compiles, left out).

Agents: NFQ's settings as they are (`default`, `model-free`, `paper`, with after_failure=reset); SAC, TQC, CrossQ, DroQ
and PPO of sbx-rl on `steerkit/TrackSteeringContinuous-v0`; and the first four with `+model`, which learn mostly from
what the car model imagines that NFQ `default` learns (the same states, residuals and horizon), so that structure and
algorithm can be told apart. PPO learns from its own driving alone, and has no such form. The agents of others are tuned
first: --draws drawn sets of hyper-parameters each, on seeds that are not used afterwards, for --tuning minutes of
driving; the best is what runs. NFQ has its defaults, which were found on this course.

    python -m benchmarks study scoreboard --parts agents --keep FILE [--agents AGENT ...] [--seeds N] [--json]
"""

import argparse
import itertools
import json
import math
import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.run import kept, spread
from benchmarks.run.trials import TrialDrive, drive_each
from benchmarks.statistics import Interval, interval, share
from benchmarks.tables import show
from steerkit.controllers.network_policy import BOUND, Network
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import COLUMNS, DOE
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.experiment import Experiment, LearningRun
from steerkit.learning.nfq.dead_time import process_of
from steerkit.learning.nfq.model import Explained, explained, imagine
from steerkit.learning.settings import DEFAULT, SETTINGS
from steerkit.scenario import Scenario
from steerkit.task import DT

NFQ = ("default", "model-free", "paper")
OTHERS = ("sac", "tqc", "crossq", "droq", "ppo")
WITH_MODEL = ("sac+model", "tqc+model", "crossq+model", "droq+model")
AGENTS = (*NFQ, *OTHERS, *WITH_MODEL)
PLACE = Scenario.under("clean", course="paper")
TUNED_ON = 1000
"""The seed of a tuning run is this and the number of its draw."""
TEST, AGAIN = 1000, 2000
"""What is added to a run's seed for its test drives, and for the second one of a GOOD policy."""
HIDDEN, BATCH = (64, 64), 128
"""Of all agents of others: units of their nets' hidden layers, and samples of a batch."""
EVERY = 6
"""Samples between two trainings of an agent of others: 0.3 s."""
FRESH = 40
"""Samples after which there are new imagined ones: 2 s."""
STARTS = 500
"""Imagined states from which the car is followed then."""
IMAGINED = 25_000
"""Imagined transitions that are kept, the newest."""
GRID = ((20.0, 2.0), (60.0, 5.0), (120.0, 10.0), (math.inf, 30.0))
"""Until when [s] it is tested how often [s]."""
WITHIN = (1.0, 3.0, 10.0, 30.0)
"""Seconds of computing within which an agent may be GOOD."""


@dataclass(frozen=True)
class Job:
    """One run of an agent."""

    agent: str
    seed: int
    draw: int
    """Of its hyper-parameters (`drawn`); 0 for NFQ's settings."""
    minutes: float
    computing: float
    """Seconds of computing after which it ends [s]."""


@dataclass(frozen=True)
class Outcome:
    """What a run came to; times in seconds."""

    good: float | None
    """Driving until the first GOOD policy; None: it never came."""
    computing: float
    """CPU time of the trainings until then, or until the end."""
    driven: float
    failures: int
    confirmed: bool
    """Was it GOOD in a second test drive too?"""
    rounds: float
    """Driven in the test drive that went furthest [1]."""
    rms_e: float
    """In the last test drive [m]."""
    max_jerk: float
    """The same [m/s^3]."""
    how: str
    """Its hyper-parameters."""


def drawn(agent: str, draw: int) -> dict[str, Any]:
    """The hyper-parameters of a draw; nothing for NFQ, whose settings are as they are."""
    if agent in NFQ:
        return {}
    kind, _, model = agent.partition("+")
    rng = np.random.default_rng([draw, *agent.encode()])

    def one(*choices: Any) -> Any:
        return choices[rng.integers(len(choices))]

    common = {
        "learning_rate": float(np.round(10.0 ** rng.uniform(-3.3, -2.5), 5)),
        "gamma": one(0.9, 0.95, 0.98),
        "failure": one(2.0, 4.0, 10.0),
    }
    if kind == "ppo":
        return common | {"n_steps": one(256, 512), "n_epochs": one(10, 20), "ent_coef": one(0.0, 0.001)}
    updates = one(4, 8) if model or kind == "droq" else one(1, 2)
    own = {"updates": updates, "ent_coef": one("auto_0.01", "auto_0.001")}
    return common | own | ({"share": one(0.5, 0.8, 0.95)} if model else {})


def one_run(job: Job) -> Outcome:
    """Run an agent until its first GOOD policy, or to its end."""
    return (_nfq if job.agent in NFQ else _of_others)(job)


class Trials:
    """The test drives of a run: when they are due, and what they came to."""

    def __init__(self, job: Job):
        self._job, self._due = job, _times(60.0 * job.minutes)
        self.next = next(self._due)
        self.good: float | None = None
        self.confirmed, self.rounds = False, 0.0
        self.rms_e = self.max_jerk = math.nan

    def look(self, t: float, policy: Callable[[], Any | None]) -> bool:
        """Test the policy at t [s] if that is due (None: nothing new); has one been GOOD by now?"""
        if t < self.next - 1e-9 or self.good is not None:
            return self.good is not None
        self.next = next(self._due)
        driver = policy()
        if driver is None:
            return False
        trial = self._drive(driver, TEST)
        self.rounds = max(self.rounds, trial.rounds)
        self.rms_e, self.max_jerk = (
            (trial.summary.rms_e, trial.summary.max_jerk) if trial.summary else (math.nan, math.nan)
        )
        if trial.good:
            self.good, self.confirmed = t, self._drive(driver, AGAIN).good
        return trial.good

    def _drive(self, driver: Any, seed: int) -> TrialDrive:
        return drive_each(PLACE, DEFAULT, [driver], seed=self._job.seed + seed)[0]

    def outcome(self, *, computing: float, driven: float, failures: int) -> Outcome:
        """What the run came to."""
        how = ", ".join(f"{name} {value}" for name, value in drawn(self._job.agent, self._job.draw).items())
        return Outcome(
            self.good, computing, driven, failures, self.confirmed, self.rounds, self.rms_e, self.max_jerk, how
        )


def _times(end: float) -> Iterator[float]:
    """When a run that ends then [s] is tested [s]."""
    t = 0.0
    while t < end:
        t = min(end, t + next(step for until, step in GRID if t < until))
        yield t
    yield math.inf


def _nfq(job: Job) -> Outcome:
    setting = replace(SETTINGS[job.agent], after_failure="reset", reset_seconds=0.0)
    run = LearningRun(Experiment(setting=setting, scenario=PLACE, minutes=job.minutes, seed=job.seed, episodes=10**6))
    tests, clock, tested = Trials(job), _Clock(run.trainer.submit), 0
    run.trainer.submit = clock  # type: ignore[method-assign]

    def newest() -> Any | None:
        nonlocal tested
        before, tested = tested, run.learner_state.net
        return run.policy if tested != before else None

    while not run.done() and clock.spent < job.computing:
        run.drive()
        if tests.look(run.t, newest):
            break
    return tests.outcome(computing=clock.spent, driven=run.t, failures=run.counts.failures)


class _Clock:
    """A function, and the CPU time of its calls [s]; the first is left out where that compiles."""

    def __init__(self, function: Callable[..., Any], *, compiles: bool = False):
        self._function, self._compiles, self.spent = function, compiles, 0.0

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        began = time.process_time()
        answer = self._function(*args, **kwargs)
        self.spent += 0.0 if self._compiles else time.process_time() - began
        self._compiles = False
        return answer


# ---- agents of others ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class AtTheWheel(NfqPolicy):
    """A network in the place of an NFQ policy, so that it drives in the loops that are compiled for those.

        action = largest network(clip((s - mid)/half, -10, 10)),   s the inputs without preview; q = 0, ready = 1

    Ports and state: `NfqPolicy`. Source: `PolicyBlock`, of which this is one sample in less time.
    """

    network: Network
    largest: float
    """The angle [rad] that the network's 1 means."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        d = self.description
        seen = np.clip((np.array(u[: len(COLUMNS)]) - d.mid) / d.half, -BOUND, BOUND)
        return self.Y(action=self.largest * float(self.network(seen[None])[0]), q=0.0, ready=1.0)


def network(model: Any) -> Network:
    """The greedy policy of an sbx model with an MLP of two hidden layers: what `predict(deterministic=True)` does.

    The batch normalisation of CrossQ's actor, y = (x - mean) scale/sqrt(var + eps) + bias, goes into the layer after.
    """
    state, ppo = model.policy.actor_state, type(model).__name__ == "PPO"
    params = state.params.get("params", state.params)
    means = getattr(state, "batch_stats", None) or {}
    layers = []
    for i in range(3):
        w, b = (np.asarray(params[f"Dense_{i}"][part], dtype=float) for part in ("kernel", "bias"))
        w = w.T
        if f"BatchRenorm_{i}" in params:
            seen, learned = means[f"BatchRenorm_{i}"], params[f"BatchRenorm_{i}"]
            factor = np.asarray(learned["scale"], dtype=float) / np.sqrt(np.asarray(seen["var"], dtype=float) + 1e-3)
            b = b + w @ (np.asarray(learned["bias"], dtype=float) - factor * np.asarray(seen["mean"], dtype=float))
            w = w * factor
        layers.append((w, b))
    return Network(layers=tuple(layers), activation="tanh" if ppo else "relu", head="clip" if ppo else "tanh")


def _of_others(job: Job) -> Outcome:
    how = drawn(job.agent, job.draw)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        model, course, imaginer = _made(job, how)
        _as_compiled(model, (job.agent, job.draw))
    task = course.unwrapped.task
    tests = Trials(job)
    train = _Clock(model.train, compiles=True)
    model.train = train
    dream = _Clock(imaginer.fresh if imaginer else lambda model: None, compiles=True)

    def at_the_wheel() -> AtTheWheel:
        return AtTheWheel(network=network(model), largest=task.scale, description=task.description, dt=task.dt)

    def go_on(seen: dict[str, Any], _: dict[str, Any]) -> bool:
        if imaginer and model.num_timesteps % FRESH == 0:
            dream(model)
        good = tests.look(model.num_timesteps * DT, at_the_wheel)
        return not good and train.spent + dream.spent < job.computing

    model.learn(round(60.0 * job.minutes / DT), callback=go_on)
    driven = min(60.0 * job.minutes, model.num_timesteps * DT)
    return tests.outcome(computing=train.spent + dream.spent, driven=driven, failures=course.failures)


def _made(job: Job, how: dict[str, Any]) -> "tuple[Any, Any, _Imaginer | None]":
    """The model of a job, its course, and who imagines for it."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    import gymnasium
    import sbx

    import steerkit.gym  # noqa: F401  registers the environments

    how, (kind, _, with_model) = dict(how), job.agent.partition("+")
    failure, updates, part = (how.pop(name, None) for name in ("failure", "updates", "share"))
    env = gymnasium.make(
        "steerkit/TrackSteeringContinuous-v0", backend="c", failure=failure, duration=1e8, disable_env_checker=True
    )
    course = _course(env, recorded=bool(with_model))
    net: dict[str, Any] = {"net_arch": {name: list(HIDDEN) for name in ("pi", "vf" if kind == "ppo" else "qf")}}
    common = dict(how, seed=job.seed, device="cpu", batch_size=BATCH)
    if kind == "ppo":
        return sbx.PPO("MlpPolicy", course, policy_kwargs=net, **common), course, None
    if kind == "droq":
        net |= {"dropout_rate": 0.01, "layer_norm": True}
        common["policy_delay"] = updates
    imaginer = _Imaginer(course, part, job.seed) if with_model else None
    if imaginer:
        common["replay_buffer_class"] = _buffer()
        common["replay_buffer_kwargs"] = {"imaginer": imaginer}
    agent = {"sac": sbx.SAC, "tqc": sbx.TQC, "crossq": sbx.CrossQ, "droq": sbx.SAC}[kind]
    model = agent(
        "MlpPolicy",
        course,
        policy_kwargs=net,
        buffer_size=round(60.0 * job.minutes / DT) + 1000,
        learning_starts=60 if with_model else 100,
        train_freq=EVERY,
        gradient_steps=EVERY * updates,
        **common,
    )
    return model, course, imaginer


_COMPILED: dict[tuple[tuple[str, int], str], tuple[Any, Any]] = {}


def _as_compiled(model: Any, kind: tuple[str, int]) -> None:
    """Let a model use what was compiled for the one before it of its kind: JAX knows functions by their identity."""
    from flax.training.train_state import TrainState

    for owner in (model, model.policy):
        for name, state in vars(owner).items():
            if isinstance(state, TrainState):
                apply, steps = _COMPILED.setdefault((kind, name), (state.apply_fn, state.tx))
                setattr(owner, name, state.replace(apply_fn=apply, tx=steps))


def _course(env: Any, *, recorded: bool) -> Any:
    """The environment with NFQ's protocol: it begins where the course does, and goes on where it failed."""
    import gymnasium

    class Course(gymnasium.Wrapper[Any, Any, Any, Any]):
        def __init__(self) -> None:
            super().__init__(env)
            self.task = env.unwrapped.task
            self.record, self.failures, self._s = Transitions((*COLUMNS, "kappa")), 0, PLACE.course.start

        def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
            seen, info = env.reset(seed=seed, options={"s": self._s, "e": 0.0, "psi_e": 0.0})
            if recorded:
                self._before = self._state(seen, info)
            return seen, info

        def step(self, action: Any) -> Any:
            seen, reward, terminated, truncated, info = env.step(action)
            if recorded:
                after = self._state(seen, info)
                a = float(np.clip(np.ravel(action)[0], -1.0, 1.0)) * self.task.scale
                self.record.append(self._before, a, after, self.failures)
                self._before = after
            if terminated:
                self.failures += 1
                self._s = info["s"] % self.task.path.length
            return seen, reward, terminated, truncated, info

        def _state(self, seen: Any, info: Any) -> NDArray[np.float64]:
            described = self.task.description
            kappa = float(self.task.path.kappa(info["s"]))
            return np.append(np.asarray(seen, dtype=float) * described.half + described.mid, kappa)

    return Course()


class _Imaginer:
    """Imagined transitions for an agent of others, from the car model that NFQ `default` learns, as that imagines them.

    States as `nfq.model.imagine` draws them, the first action drawn evenly, then the agent's own, for `horizon`
    samples; the first step with what the model left unexplained of the recorded one. Cost and failure: the task's.
    """

    def __init__(self, course: Any, share: float, seed: int):
        self.share, self._course, self._rng = share, course, np.random.default_rng([seed, 7])
        self._parts: list[tuple[NDArray[np.float32], ...]] = []
        self.rows: tuple[NDArray[np.float32], ...] | None = None
        """Observations, actions, next observations, dones and rewards; None: nothing is imagined yet."""
        self._fitted, self._straight = 0, 0.0
        self._known: Explained | None = None

    def fresh(self, model: Any) -> None:
        """Learn the car anew where the record has grown by a tenth, and imagine driving with the agent as it is."""
        record, task, rng = self._course.record, self._course.task, self._rng
        if len(record) >= 1.1 * self._fitted:
            process = process_of(record, DEFAULT.description(), DEFAULT.fit.dead_time)
            self._known, self._fitted = explained(process.model, process.record), len(record)
            self._straight = process.forecast.straight
        known = self._known
        assert known is not None
        near = imagine(known, DEFAULT.description(), STARTS, rng)
        s, earlier, felt, car = near.s, near.earlier, near.felt, known.model
        a, going = rng.uniform(-1.0, 1.0, len(s)), np.ones(len(s), dtype=bool)
        parts = []
        for step in range(DEFAULT.fit.horizon):
            after = car.step(s, a * task.scale, earlier, felt)
            if step == 0:
                after = after + near.residual
            felt = felt and car.after(s, after[:, DOE], felt)
            cost, failed = task.price(s, a * task.scale, after)
            reward = np.where(failed, -task.failure, -cost)
            seen_next = self._seen(after)
            rows = self._seen(s), a[:, None], seen_next, failed[:, None], reward[:, None]
            parts.append(tuple(values[going] for values in rows))
            going = going & ~failed
            s, earlier = after, s[:, DOE]  # those that have failed too: what is compiled is for so many cars
            a = np.asarray(model.predict(seen_next, deterministic=False)[0], dtype=float)[:, 0]
        self._parts.append(tuple(np.concatenate(rows).astype(np.float32) for rows in zip(*parts)))
        while sum(len(rows[0]) for rows in self._parts) > IMAGINED:
            del self._parts[0]
        self.rows = tuple(np.concatenate(rows) for rows in zip(*self._parts))

    def _seen(self, s: NDArray[np.float64]) -> NDArray[np.float32]:
        shown = s.copy()
        shown[:, DOE] += self._straight
        return self._course.task.observation(shown)

    def drawn(self, count: int) -> tuple[NDArray[np.float32], ...]:
        """So many imagined transitions, drawn evenly."""
        assert self.rows is not None
        place = self._rng.integers(len(self.rows[0]), size=count)
        return tuple(rows[place] for rows in self.rows)


def _buffer() -> type:
    """A replay buffer, a share of whose samples is imagined."""
    import torch
    from stable_baselines3.common.buffers import ReplayBuffer

    class Mixed(ReplayBuffer):
        def __init__(self, *args: Any, imaginer: _Imaginer, **kwargs: Any):
            super().__init__(*args, **kwargs)
            self._imaginer = imaginer

        def sample(self, batch_size: int, env: Any = None) -> Any:
            imagined = 0 if self._imaginer.rows is None else round(self._imaginer.share * batch_size)
            real = super().sample(max(1, batch_size - imagined), env)
            if not imagined:
                return real
            order = torch.randperm(batch_size)
            names = ("observations", "actions", "next_observations", "dones", "rewards")
            both = {
                name: torch.cat([getattr(real, name), torch.from_numpy(rows)])[order]
                for name, rows in zip(names, self._imaginer.drawn(imagined))
            }
            return real._replace(**both)

    return Mixed


# ---- the study -----------------------------------------------------------------------------------------------------


def add_options(parser: Any) -> None:
    """Which agents, how many seeds, and for how long."""
    parser.add_argument("--agents", nargs="+", choices=AGENTS, default=None, help="which (default all)")
    parser.add_argument("--seeds", type=int, default=6, help="runs of each agent")
    parser.add_argument("--minutes", type=float, default=30.0, help="driving after which a run ends")
    parser.add_argument("--computing", type=float, default=120.0, help="computing after which a run ends [s]")
    parser.add_argument("--draws", type=int, default=3, help="sets of hyper-parameters that are tried")
    parser.add_argument("--tuning", type=float, default=2.0, help="minutes of driving of each of those")
    parser.add_argument("--tuning-computing", type=float, default=8.0, help="and its computing [s]")
    parser.add_argument("--keep", type=Path, default=None, help="file of the runs: after a stop it goes on from there")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Tune, run the seeds, print the tables."""
    agents, seeds, minutes, draws = options.agents or AGENTS, options.seeds, options.minutes, options.draws
    if options.quick:
        agents, seeds, minutes, draws = options.agents or ("default", "sac+model"), 1, 0.2, 1
    tuned = [a for a in agents if a not in NFQ] if draws > 1 else []
    trials = [
        Job(agent, TUNED_ON + draw, draw, options.tuning, options.tuning_computing)
        for agent in tuned
        for draw in range(draws)
    ]
    best = dict.fromkeys(agents, 0)
    rows = _done(trials, options)
    for agent, those in itertools.groupby(trials, key=lambda job: job.agent):
        best[agent] = min(those, key=lambda job: _merit(rows[job])).draw
    jobs = [Job(agent, seed, best[agent], minutes, options.computing) for seed in range(seeds) for agent in agents]
    rows = _done(jobs, options)
    return _judged({agent: [rows[job] for job in jobs if job.agent == agent] for agent in agents}, options)


def _merit(row: kept.Row) -> tuple[float, float, float]:
    """The less, the better: seconds to GOOD; else how far a test drive went, and how well the last one."""
    return _never(row["good"]), -row["rounds"], row["rms_e"] if row["rms_e"] == row["rms_e"] else math.inf


def _never(seconds: float | None) -> float:
    return math.inf if seconds is None else float(seconds)


def _done(jobs: Sequence[Job], options: argparse.Namespace) -> dict[Job, kept.Row]:
    answered = _good_before(jobs, options.keep) if options.keep else {}
    left = [job for job in jobs if job not in answered]
    with spread.computing(spread.where(options)) as those:
        return answered | kept.done(one_run, left, those, options.keep)


def _good_before(jobs: Sequence[Job], file: Path) -> dict[Job, kept.Row]:
    """Rows of runs with no larger budget that came to a GOOD policy: a larger one would change nothing."""
    found = {}
    for name, row in kept.stored(file).items():
        kept_job = Job(**json.loads(name)[1])
        for job in jobs if row["good"] is not None else ():
            within = kept_job.minutes <= job.minutes and kept_job.computing <= job.computing
            if within and job == replace(kept_job, minutes=job.minutes, computing=job.computing):
                found[job] = row
    return found


def _judged(rows: dict[str, list[kept.Row]], options: argparse.Namespace) -> dict[str, Any]:
    """The figures, and the tables, whoever wins first."""
    good = {agent: interval([_never(row["good"]) for row in those], np.median) for agent, those in rows.items()}
    shares = {agent: share([row["good"] is not None for row in those]) for agent, those in rows.items()}
    spent = {
        agent: [row["computing"] if row["good"] is not None else math.inf for row in those]
        for agent, those in rows.items()
    }
    computing = {agent: interval(values, np.median) for agent, values in spent.items()}
    within = {agent: [float(np.mean(np.array(values) <= limit)) for limit in WITHIN] for agent, values in spent.items()}
    table = [
        {
            "agent": agent,
            "good share": str(shares[agent]),
            "seconds to GOOD": str(good[agent]),
            "failures": float(np.median([row["failures"] for row in rows[agent]])),
            "confirmed": sum(row["confirmed"] for row in rows[agent]),
            "computing to GOOD [s]": str(computing[agent]),
            **{f"GOOD within {limit:g} s": part for limit, part in zip(WITHIN, within[agent])},
            "driven at most [s]": max(row["driven"] for row in rows[agent]),
        }
        for agent in sorted(rows, key=lambda agent: (good[agent].value, -shares[agent].value))
    ]
    show("driving seconds to a good driver: median over the seeds [95 %]", table)
    figures = {
        "good_seconds": {agent: found.value for agent, found in good.items()},
        "good_seconds_interval": {agent: [found.low, found.high] for agent, found in good.items()},
        "good_share": {agent: found.value for agent, found in shares.items()},
        "computing_seconds": {agent: found.value for agent, found in computing.items()},
        "good_within_computing": within,
        "agents_x_model_free": _times_sooner(good, OTHERS),
        "agents_x_same_model": _times_sooner(good, WITH_MODEL),
        "agents_runs": rows,
    }
    for name, wanted in (("agents_x_model_free", 10), ("agents_x_same_model", 2)):
        print(f"{name}: {figures[name]} (wanted: at least {wanted})")
    return figures


def _times_sooner(good: dict[str, Interval], agents: Sequence[str]) -> float | None:
    """How many times the best of the agents takes the seconds that `default` takes; None where either is not there."""
    times = [good[agent].value for agent in agents if agent in good]
    return min(times) / good["default"].value if times and "default" in good else None
