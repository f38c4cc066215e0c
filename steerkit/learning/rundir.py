"""A run's directory: all that is needed to resume it, to replay it and to draw it::

run.json            the experiment, the counts, and which checkpoint is the last whole one; written last
state-N.npz         the loop's state at checkpoint N
transitions-N.npz   all transitions until then
nets/net-NNNN.npz   the policy after update NNNN (0: the untrained net)
drive/NNNN.npz      the signals between two checkpoints, 20 a second
"""

import json
import math
import os
import shlex
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, fields, is_dataclass, replace
from functools import partial
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import made_of, require
from steerkit._support.files import read_bytes, write_text
from steerkit._support.plugins import fingerprints, imported, is_outside, name_of, named_in
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.loop import LoopState
from steerkit.diagram.simulation import Log, joined
from steerkit.learning import costs
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.experiment import Experiment, LearningRun, Watcher
from steerkit.learning.learner_state import Before, Counts, Episode, Recovery
from steerkit.learning.nfq.iterate import NOTHING_LEARNED, FitSetting, Learned
from steerkit.learning.settings import Setting
from steerkit.learning.trainer import SimulatedTrainer
from steerkit.scenario import Scenario, of_table

LOCK, HOLDER = ".lock", ".learner"
"""The lock, which ends with its process, however that ends; and a line that names its holder."""


@contextmanager
def held(place: FilePath) -> Iterator[None]:
    """Hold a run's directory for learning in it; reading needs no such thing.

    place: an existing directory. Raises ValueError naming another process that learns there; killed ones hold nothing.
    """
    from filelock import FileLock, Timeout

    lock = FileLock(place / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout as why:
        what = f"{place} is being learned by {holder(place)}"
        raise ValueError(f"learn: {what}; wait for its end, stop it, or choose another directory") from why
    try:
        command = shlex.join([FilePath(sys.argv[0]).name, *sys.argv[1:]])
        since = time.strftime("%Y-%m-%d %H:%M:%S")
        write_text(place / HOLDER, f"process {os.getpid()} ({command}) since {since}", durable=False)
        yield
    finally:
        (place / HOLDER).unlink(missing_ok=True)
        lock.release()


def holder(place: FilePath) -> str:
    """Who holds a directory, or held it last when it was killed."""
    try:
        return (place / HOLDER).read_text(encoding="utf-8")
    except OSError:
        return "another process"


def is_free(place: FilePath) -> bool:
    """Is there nothing in a directory but what `held` leaves there?"""
    return all(file.name in (LOCK, HOLDER) for file in place.iterdir())


FORMAT = "steerkit run 3"
KEYS = ("experiment", "checkpoint", "counts", "pending", "trusted", "before")
"""What run.json holds besides its format."""


KINDS = {c.__name__: c for c in (Experiment, Scenario, Setting, FitSetting, *costs.COSTS)}
"""What an experiment is made of, by the names under which runs keep it; scenarios are read by `of_table`."""


def kind_of(cls: type) -> str:
    """The name under which a run keeps a class, and finds it again; raises ValueError for one that cannot be found.

    One of your own is `package.module:Class`, or `my_file.py:Class` if it was loaded by that name.
    """
    if KINDS.get(cls.__name__) is cls:
        return cls.__name__
    name = name_of(cls)
    what = (
        f"a {cls.__name__} of your own ({cls.__module__}.{cls.__qualname__}), which the run could not find again; put "
        f"the class into a module that can be imported, and take it from there: from my_parts import {cls.__name__}"
    )
    require(name, "experiment", what)
    return name


def plain(value: Any) -> Any:
    """Nested dataclasses as dictionaries that JSON and TOML can hold; the class is kept under `kind`."""
    if isinstance(value, Scenario):
        return {"kind": kind_of(type(value)), **asdict(value)}
    if is_dataclass(value) and not isinstance(value, type):
        return {"kind": kind_of(type(value))} | {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    return list(value) if isinstance(value, tuple) else value


def from_plain(data: Any, where: str, default: type | None = None) -> Any:
    """What `plain` was given; missing fields take their defaults. Raises ValueError naming an unknown key."""
    if not isinstance(data, dict):
        require(default is None, where, f"{data!r:.50}, expected a table")
        return tuple(data) if isinstance(data, list) else data
    name = str(data.get("kind", default.__name__ if default else None))
    kind: Any = imported(name, where) if is_outside(name) else KINDS.get(name)
    require(kind is not None, where, f"kind {name!r} is not known; valid: {', '.join(KINDS)}, package.module:Class")
    fits, known = isinstance(kind, type) and is_dataclass(kind), (Scenario, Setting, FitSetting, Experiment)
    part = fits and (issubclass(kind, known) or any("__call__" in vars(base) for base in kind.__mro__))
    expected = "a dataclass that extends Scenario or Setting, or a cost"  # and nothing else that could be imported
    require(part, where, f"kind '{name}' is no part of an experiment, expected {expected}")
    if issubclass(kind, Scenario):
        return of_table(data, where, kind)
    require(default is None or default is costs.TanhCost or issubclass(kind, default), where, f"is a {name}")
    inside = {"setting": Setting, "scenario": Scenario, "fit": FitSetting, "cost": costs.TanhCost}
    valid, own = {f.name for f in fields(kind)}, {k: v for k, v in data.items() if k != "kind"}
    values = {k: from_plain(v, f"{where}.{k}", inside.get(k)) if k in valid else v for k, v in own.items()}
    return made_of(kind, values, where)


def keep_in(run: LearningRun, place: FilePath) -> None:
    """From now on, write a checkpoint of the run into `place` at every training; write the first one now."""
    run.keep = partial(save, place=place)
    save(run, place)


def save(run: LearningRun, place: FilePath) -> None:
    """Write a checkpoint; a kill at any moment leaves this one or the one before, whole."""
    number = len(list(place.glob("drive/*.npz")))
    pending, before = run.trainer.pending, run.learner_state.before
    (place / "nets").mkdir(exist_ok=True)
    (place / "drive").mkdir(exist_ok=True)
    run.loop.save_state(LoopState(run.counts.k, tuple(run.x), tuple(run.y)), place / f"state-{number}.npz")
    run.transitions.save(place / f"transitions-{number}.npz")
    policy = run.learner_state.policy
    nets, forecast = pending[2] if pending else (policy.nets, policy.forecast)
    net = replace(policy, nets=nets, forecast=forecast, ready_from=0.0)
    net.save(net_file(place, run.counts.updates))
    replace(run.policy, ready_from=0.0).save(steering_file(place, number))
    run.recorder.log().save(part_file(place, number))
    run.recorder.clear()
    document = {
        "format": FORMAT,
        "experiment": (experiment := plain(run.experiment)),
        "code": fingerprints(experiment),
        "checkpoint": number,
        "counts": asdict(run.counts),
        "pending": pending[0] if pending else None,
        "trusted": run.learner_state.trusted,
        "before": None if before is None else before._asdict(),
        "source": run.source,
    }
    write_text(place / "run.json", json.dumps(document, indent=1))
    for stale in (*place.glob("state-*.npz"), *place.glob("transitions-*.npz"), *place.glob("nets/steering-*.npz")):
        if int(stale.stem.split("-")[1]) not in (number, number - 1):  # a reader may be at the one before
            stale.unlink()


def document(place: FilePath, name: str = "run.json", form: str = FORMAT, keys: Iterable[str] = KEYS) -> dict[str, Any]:
    """The contents of run.json; raises ValueError when there is none, it is broken, or of another format."""
    file = FilePath(place) / name
    if not file.exists():
        raise ValueError(f"{place} is no run directory: it has no {name}; make one with `steerkit learn`")
    try:
        data = json.loads(read_bytes(file))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{file} is truncated or no JSON ({error}); the run cannot be read") from error
    if not isinstance(data, dict) or data.get("format") != form:
        raise ValueError(f"{file}: format {data.get('format') if isinstance(data, dict) else None!r}, not {form!r}")
    missing = ", ".join(key for key in keys if key not in data)
    require(not missing, str(file), f"damaged, without {missing}; the run cannot be read")
    return data


def load(place: FilePath) -> LearningRun:
    """The run as it was at its last checkpoint, also while it is being learned; raises ValueError for a broken one."""
    while True:
        data = document(place)
        try:
            return _load(place, data)
        except (ValueError, OSError):
            if document(place)["checkpoint"] == data["checkpoint"]:
                raise  # else the learner wrote a newer one meanwhile, and took this one away


def resumed(place: FilePath, *, watch: Watcher | None = None) -> LearningRun:
    """The run, to go on with and to be kept where it is; only for who has `held` its directory."""
    data = document(place)
    run = _load(place, data)
    run.watch, run.keep = watch, partial(save, place=place)
    for stale in place.glob("drive/*.npz"):  # a chunk written after the last whole checkpoint
        if int(stale.stem) > data["checkpoint"]:
            stale.unlink()
    return run


def _load(place: FilePath, data: dict[str, Any]) -> LearningRun:
    number = data["checkpoint"]
    run = LearningRun(experiment_of(place, data))
    run.source = data.get("source")
    learner_state = run.learner_state
    learner_state.counts = _counts(place, data["counts"])
    state = run.loop.load_state(_existing(place / f"state-{number}.npz"))
    run.x, run.y = list(state.x), list(state.y)
    learner_state.transitions = Transitions.load(_existing(place / f"transitions-{number}.npz"))
    learner_state.policy = NfqPolicy.load(_existing(steering_file(place, number)))
    learner_state.trusted = data["trusted"]
    run.steer()
    learned, updates = NOTHING_LEARNED, learner_state.counts.updates
    if updates:
        newest = NfqPolicy.load(_existing(net_file(place, updates)))
        learned = Learned(newest.nets or (), newest.forecast)
    run.trainer = learner_state.trainer = SimulatedTrainer(
        seconds=run.experiment.setting.fit_seconds,
        learned=learned,
        pending=None if data["pending"] is None else (data["pending"], updates, learned),
    )
    if data["before"] is not None:  # of the last sample that was driven
        kept = data["before"]
        learner_state.before = Before(**kept | {"s": tuple(kept["s"])})
    return run


def _counts(place: FilePath, kept: dict[str, Any]) -> Counts:
    try:
        episodes, lasting = [Episode(**e) for e in kept["episodes"]], kept["recovery"]
        return Counts(**{**kept, "episodes": episodes, "recovery": Recovery(**lasting) if lasting else None})
    except (KeyError, TypeError) as error:
        raise ValueError(f"{place / 'run.json'}: damaged counts ({error}); the run cannot be read") from error


def drive_log(place: FilePath, *, until: float = math.inf) -> Log:
    """All signals of a run, from its start to its last checkpoint, or to an earlier one at driving time `until` [s]."""
    data = document(place)
    parts = [Log.load(_existing(part_file(place, n))) for n in range(data["checkpoint"] + 1)]
    return joined([part for part in parts if not len(part.t) or part.t[0] < until])


def experiment_of(place: FilePath, data: dict[str, Any] | None = None) -> Experiment:
    """The experiment that a run directory holds; data: its `document`, if that was read already."""
    data = document(place) if data is None else data
    with named_in(f"{place}/run.json", data.get("code")):
        return from_plain(data["experiment"], "run.json", Experiment)


def final_policy(place: FilePath, updates: int | None = None) -> NfqPolicy:
    """The policy of a run's last update, or of an earlier one by its number."""
    updates = document(place)["counts"]["updates"] if updates is None else updates
    return NfqPolicy.load(_existing(net_file(place, updates)))


def part_file(place: FilePath, number: int) -> FilePath:
    """The log of what was driven up to a checkpoint, from the one before."""
    return FilePath(place) / "drive" / f"{number:04d}.npz"


def steering_file(place: FilePath, number: int) -> FilePath:
    """The policy that steered at a checkpoint."""
    return FilePath(place) / "nets" / f"steering-{number}.npz"


def net_file(place: FilePath, updates: int) -> FilePath:
    """The policy of an update."""
    return FilePath(place) / "nets" / f"net-{updates:04d}.npz"


def _existing(file: FilePath) -> FilePath:
    if not file.exists():
        raise ValueError(f"{file.parent} is not whole: {file.name} is missing; the run cannot be read")
    return file
