"""What a benchmark run leaves behind: one directory, written a case at a time, read whole by report and compare.

    provenance.json          format, versions, commit, platform, seeds, the protocol: every scenario and controller
    cases/CASE.json          one finished case; it is written last and at once, so that a kill loses no finished case
    trajectories/CASE.npz    a drive's decimated signals: see `TRAJECTORY`
    curves/CASE.npz          for a learner: one row a trained net, see `CURVE`
    nets/CASE.npz            for a learner: the last net

CASE is `suite--scenario--controller--sN`. All cases in one table: `load_results(DIRECTORY).table()`.
"""

import json
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path as FilePath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from steerkit._support.files import atomic_write, read_npz, write_npz, write_text
from steerkit.metrics import GOOD

if TYPE_CHECKING:
    import pandas as pd

FORMAT = "steerkit benchmark 1"
FOLDERS = ("nets", "curves", "trajectories", "cases")
"""In this order the files of a case are written."""
TRAJECTORY = {
    "t": "s",
    "s": "m",
    "x": "m",
    "y": "m",
    "e": "m",
    "psi_e": "rad",
    "v": "m/s",
    "delta_sw": "rad",
    "a_y": "m/s^2",
}
"""Signals of a trajectory and their units, (T,) each, even in t."""
CURVE = {
    "t": "s",
    "iterations": "1",
    "transitions": "1",
    "failures": "1",
    "held": "1",
    "rounds": "1",
    "rms_e": "m",
    "max_e": "m",
    "rms_wheel_rate_deg": "deg/s",
    "max_a_y": "m/s^2",
    "max_jerk": "m/s^3",
}
"""Columns of a learning curve, one row a test-driven net (n,): the driving time at which it took the wheel, trainings
and transitions used until then, and what its test drive of one round came to (NaN: it drove less than a second)."""
TIMES = ("metric.step_p50_us", "metric.step_p99_us", "cpu_seconds")
"""Columns that measure a machine, and so differ from run to run; all others are the same for the same seeds."""


def good_nets(curve: Mapping[str, np.ndarray]) -> np.ndarray:
    """Did the net of each row of a `CURVE` drive a whole round as `steerkit.metrics.GOOD` asks? (n,)"""
    within = [curve[name] < getattr(GOOD, name) for name in ("max_e", "rms_e", "max_jerk")]
    return np.logical_and.reduce([*within, curve["held"] > 0.5, curve["rounds"] >= GOOD.rounds])


@dataclass(frozen=True, kw_only=True)
class Case:
    """One finished case, as it is kept."""

    suite: str
    """The suite it belongs to."""
    scenario: str
    """Name of the scenario; its fields are in the provenance."""
    controller: str
    """Name of the controller."""
    seed: int
    """Seed of human, sensors, disturbances and, for a learner, its nets."""
    kind: str = "drive"
    """`drive`, or `learn` for a training with the test drives of its nets."""
    status: str = "done"
    """`done`: it ran to its end, well or badly (`metric.held`); `error`: an exception, its text in `error`; or `not
    installed`."""
    error: str = ""
    """What went wrong, in one line."""
    metrics: Mapping[str, float] = field(default_factory=dict)
    """Metrics by name, those of `steerkit.metrics.TABLE` and some of the case's own (`held`, `rounds`); NaN where one
    could not be measured, infinity for what a learner never reached."""
    cpu_seconds: float = math.nan
    """Computing time that the case took [s]."""
    digest: str = ""
    """Hash of all that determines the numbers: scenario, controller, seed and source; equal digests, equal numbers."""

    @property
    def id(self) -> str:
        """The name of its files."""
        return case_id(self.suite, self.scenario, self.controller, self.seed)

    def row(self) -> dict[str, Any]:
        """The case as one flat row: metrics as `metric.NAME`."""
        flat = {key: value for key, value in asdict(self).items() if key != "metrics"}
        return flat | {f"metric.{name}": float(value) for name, value in self.metrics.items()}


def case_id(suite: str, scenario: str, controller: str, seed: int) -> str:
    """`suite--scenario--controller--sN`; of a controller from a file or module, `/` and `:` are dots."""
    return f"{suite}--{scenario}--{re.sub(r'[/:]+', '.', controller)}--s{seed}".replace("\\", ".")


@dataclass(frozen=True)
class Results:
    """A results directory in memory; trajectories and curves are read when they are asked for."""

    place: FilePath
    """The directory."""
    provenance: dict[str, Any]
    """What is in provenance.json; `scenarios` and `controllers` are the protocol, `planned` the ids of all cases."""
    cases: tuple[Case, ...]
    """The finished cases, in the order planned."""

    @property
    def missing(self) -> tuple[str, ...]:
        """Ids of the planned cases that have not finished."""
        done = {case.id for case in self.cases}
        return tuple(i for i in self.provenance.get("planned", ()) if i not in done)

    @property
    def protocol(self) -> dict[str, dict[str, Any]]:
        """Every scenario's fields by its name."""
        return self.provenance["scenarios"]

    def table(self) -> "pd.DataFrame":
        """One row a case; columns of `Case`, `metric.NAME` (`metric.rms_e`) and `scenario.FIELD`."""
        import pandas as pd

        rows = []
        for case in self.cases:
            scenario = self.protocol.get(case.scenario, {})
            rows.append(case.row() | {f"scenario.{k}": v for k, v in scenario.items() if not isinstance(v, list)})
        return pd.DataFrame(rows, columns=None if rows else [f.name for f in fields(Case) if f.name != "metrics"])

    def trajectory(self, case: Case) -> dict[str, np.ndarray] | None:
        """The decimated drive, arrays by the names of `TRAJECTORY`; None if the case has none (an error, say)."""
        return self._arrays("trajectories", case)

    def curve(self, case: Case) -> dict[str, np.ndarray] | None:
        """A learner's curve, arrays by the names of `CURVE`; None if the case is no training."""
        return self._arrays("curves", case)

    def _arrays(self, folder: str, case: Case) -> dict[str, np.ndarray] | None:
        file = self.place / folder / f"{case.id}.npz"
        return read_npz(file, "results") if file.exists() else None


class Store:
    """The writing side: makes the directory, keeps finished cases."""

    def __init__(self, place: str | FilePath):
        self.place = FilePath(place)

    def open(self, provenance: Mapping[str, Any]) -> None:
        """Make the directory, or go on in one of the same sources: its finished cases stay, its plan is added to.

        Raises ValueError where there is something else: results of other sources or versions, other files.
        """
        file = self.place / "provenance.json"
        plan = {"format": FORMAT, **provenance}
        if file.exists():
            old = read_provenance(self.place)
            for key in ("source", "versions"):
                if old.get(key) != plan.get(key):
                    raise ValueError(
                        f"{self.place} holds results of another state of the program ({key} {old.get(key)}, now "
                        f"{plan.get(key)}); mixed, they could not be compared. Choose another --out, or remove it"
                    )
            for key in ("scenarios", "controllers"):
                for name, fields_now in json.loads(_json(plan[key])).items():
                    if old.get(key, {}).get(name, fields_now) != fields_now:
                        raise ValueError(
                            f"{self.place} holds results of another {key[:-1]} '{name}' (another file?); mixed, they "
                            "could not be compared. Choose another --out, or remove it"
                        )
            for key in ("suites", "scenarios", "controllers"):
                plan[key] = {**old.get(key, {}), **plan[key]}
            plan["planned"] = [*dict.fromkeys([*old.get("planned", ()), *plan["planned"]])]
            plan["seeds"] = sorted({*old.get("seeds", ()), *plan["seeds"]})
        elif self.place.exists() and any(self.place.iterdir()):
            raise ValueError(f"{self.place} is not empty and holds no results; choose another directory with --out")
        for folder in FOLDERS:
            (self.place / folder).mkdir(parents=True, exist_ok=True)
        write_text(file, _json(plan, indent=1))

    def has(self, case_id: str) -> bool:
        """Has this case finished, without an error?"""
        file = self._case_file(case_id)
        return file.exists() and json.loads(file.read_text(encoding="utf-8"))["status"] == "done"

    def keep(
        self,
        case: Case,
        *,
        trajectory: Mapping[str, np.ndarray] | None = None,
        curve: Mapping[str, np.ndarray] | None = None,
        net: Callable[[FilePath], None] | None = None,
        durable: bool = True,
    ) -> None:
        """Write a finished case, its JSON last: a kill before that leaves it unfinished, after that finished.

        durable: wait for the disk, see `steerkit._support.files.whole`.
        """
        for folder, arrays in (("trajectories", trajectory), ("curves", curve)):
            if arrays is not None:
                write_npz(self.place / folder / f"{case.id}.npz", arrays, compressed=True, durable=durable)
        if net is not None:
            net(self.net_file(case.id))
        write_text(self._case_file(case.id), _json(asdict(case)), durable=durable)

    def write(self, files: Mapping[str, bytes]) -> None:
        """Write what `packed` made elsewhere, the case's JSON last."""
        for name, data in files.items():
            with atomic_write(self.place / name) as draft:
                draft.write_bytes(data)

    def net_file(self, case_id: str) -> FilePath:
        """Where a learner's last net is."""
        return self.place / "nets" / f"{case_id}.npz"

    def _case_file(self, case_id: str) -> FilePath:
        return self.place / "cases" / f"{case_id}.json"


def packed(case: Case, **more: Any) -> dict[str, bytes]:
    """The files of a finished case, by their names in a results directory, for `Store.write`; more: as `Store.keep`.

    Compressing is most of what keeping a case costs: so done by the workers of a cluster, it does not hold up the one
    machine that writes.
    """
    with TemporaryDirectory(prefix="steerkit-case-") as folder:
        store = Store(folder)
        for name in FOLDERS:
            (store.place / name).mkdir()
        store.keep(case, durable=False, **more)
        files = [file for name in FOLDERS for file in (store.place / name).iterdir()]
        return {file.relative_to(store.place).as_posix(): file.read_bytes() for file in files}


def load_results(place: str | FilePath) -> Results:
    """Read a results directory, of a run that has ended, was killed or is still going.

    Raises ValueError where there is none, where it is of another version, or where a file in it is broken.
    """
    place = FilePath(place)
    provenance = read_provenance(place)
    cases = []
    for name in provenance.get("planned", ()):
        file = place / "cases" / f"{name}.json"
        if not file.exists():
            continue
        try:
            data = json.loads(file.read_text(encoding="utf-8"))
            data["metrics"] = {name: _number(value) for name, value in data["metrics"].items()}
            cases.append(Case(**data | {"cpu_seconds": _number(data["cpu_seconds"])}))
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            reason = (str(error).splitlines() or [type(error).__name__])[0]
            raise ValueError(f"{file} is broken ({reason}); remove it and run the suite again") from error
    return Results(place, provenance, tuple(cases))


def read_provenance(place: FilePath) -> dict[str, Any]:
    """provenance.json of a results directory. Raises ValueError: none there, broken, or of another version."""
    file = place / "provenance.json"
    if not place.is_dir():
        raise ValueError(f"{place}: there are no such results; make some with `python -m benchmarks run SUITE --out`")
    if not file.exists():
        raise ValueError(f"{place} is no results directory: it has no provenance.json; expected what `run` wrote")
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{file} is truncated or no JSON ({error})") from error
    found = data.get("format") if isinstance(data, dict) else None
    if found != FORMAT:
        raise ValueError(f"{file}: results of version {found!r}, this program reads {FORMAT!r}; run the suite again")
    return data


def _number(value: Any) -> float:
    return math.nan if value is None else float(value)


def _json(data: Any, indent: int | None = None) -> str:
    """JSON, which knows no NaN, here null, and no infinity, here "inf"."""
    return json.dumps(_finite(data), indent=indent, allow_nan=False)


def _finite(data: Any) -> Any:
    if isinstance(data, Mapping):
        return {key: _finite(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [_finite(value) for value in data]
    if isinstance(data, float | np.floating):
        return float(data) if math.isfinite(data) else None if math.isnan(data) else str(float(data))
    return data
