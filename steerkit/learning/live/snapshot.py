"""What the live page shows of a run: read from its directory, as plain numbers."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from pathlib import Path as FilePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.simulation import Log
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.learning import rundir
from steerkit.learning.counts import Episode
from steerkit.learning.curve import Curve
from steerkit.learning.experiment import Experiment
from steerkit.learning.ownership import learner
from steerkit.learning.pictures.policy import course_angle, states
from steerkit.learning.progress import LAST
from steerkit.paths.path import Path
from steerkit.task import DT, GOAL, RELEASE, TRIP

POINTS = 600
"""Points of a curve or of the path, at most: as many as a page has room for."""
TRACE = 1500
"""Points of the car's way, at most."""
GRID = 41
"""Squares of the policy's map, each way."""
HEADING_DEG = 10.0
"""Half of the policy's map in heading."""
WINDOW = 5.0
"""Time over which the RMS e of the learning curve is taken [s]."""
LATELY = 20
"""Checkpoints over which the speed of learning is taken."""
_SIGNALS = ("path.e", "path.psi_e", "car.x", "car.y", "car.v", "car.delta_sw", "supervisor.learning")
Array = NDArray[np.float64]


class Reader:
    """Reads a run's directory again and again, while somebody else learns there; writes nothing.

    `read` gives what is to be shown; what was read before is not read anew. Raises ValueError, and OSError, for what is
    no run or broken; the next `read` tries again.
    """

    def __init__(self, place: FilePath):
        self.place = place
        self._of: tuple[int, int] | None = None
        self._forget()

    def _forget(self) -> None:
        self._parts: list[dict[str, Array]] = []
        self._shown: tuple[int, dict[str, Any]] | None = None
        self._path: Path | None = None

    def read(self) -> dict[str, Any]:
        """The run as it was at its last checkpoint, with when that was written, and whether somebody learns on."""
        written = (self.place / "run.json").stat().st_mtime if (self.place / "run.json").exists() else 0.0
        data = rundir.document(self.place)
        first = rundir.part_file(self.place, 0).stat()
        if self._of != (first.st_ino, first.st_mtime_ns):  # the directory holds another run now
            self._forget()
            self._of = (first.st_ino, first.st_mtime_ns)
        if self._shown is None or self._shown[0] != data["checkpoint"]:
            self._shown = (data["checkpoint"], self._picture(data))
        experiment = data["experiment"]
        ends = {name: experiment.get(name) for name in ("minutes", "rounds", "episodes")}
        return {**self._shown[1], "ends": ends, "written": written, "learner": learner(self.place)}

    def _picture(self, data: dict[str, Any]) -> dict[str, Any]:
        for number in range(len(self._parts), data["checkpoint"] + 1):
            log = Log.load(rundir.part_file(self.place, number))
            self._parts.append({"t": log.t, **{name: log.signals[name] for name in _SIGNALS}})
        drive = {name: np.concatenate([part[name] for part in self._parts]) for name in ("t", *_SIGNALS)}
        counts = data["counts"]
        experiment: Experiment = rundir.from_plain(data["experiment"], "run.json")
        episodes = [Episode(**episode) for episode in counts["episodes"]]
        policy = NfqPolicy.load(rundir.steering_file(self.place, data["checkpoint"]))
        path = self._path = self._path or experiment.scenario.path()
        t = float(drive["t"][-1]) if len(drive["t"]) else 0.0
        failed = np.array([one.ended for one in episodes if one.failed], dtype=float)
        lasting = episodes[-1] if episodes and episodes[-1].ended is None else None
        v = float(np.median(drive["car.v"][-1200:])) if len(drive["t"]) else 6.0
        return {
            "name": f"{experiment.setting.name} on {experiment.scenario.course}, seed {experiment.seed}",
            "place": str(self.place),
            "checkpoint": data["checkpoint"],
            "t": t,
            "failures": len(failed),
            "rounds": sum(one.rounds for one in episodes),
            "updates": counts["updates"],
            "driven_km": counts["driven"] / 1000.0,
            "first_round": [counts["first_round_begun"], counts["first_round_done"]],
            "held": t - lasting.began if lasting else None,
            "stuck": counts["stuck"][-3:],
            "pace": self._pace(data["checkpoint"], t),
            "limits": {"goal": GOAL, "trip": TRIP, "release": RELEASE},
            "curve": _curve(drive, failed),
            "map": _map(drive, failed, path),
            "policy": _policy(policy, experiment, drive, v),
        }

    def _pace(self, checkpoint: int, t: float) -> float | None:
        """Driving time that went by in a second of computing, of late; None: nobody can tell yet."""
        first = max(1, checkpoint - LATELY)  # the one before is of the first moment, and empty
        if checkpoint <= first:
            return None
        ages = [rundir.part_file(self.place, number).stat().st_mtime for number in (first, checkpoint)]
        return (t - float(self._parts[first]["t"][-1])) / (ages[1] - ages[0]) if ages[1] > ages[0] else None


def _curve(drive: dict[str, Array], failed: Array) -> dict[str, Any]:
    """RMS e of the learner over the last WINDOW at each time, when the recovery controller steered, and failures."""
    t, learns = drive["t"], drive["supervisor.learning"] > 0.5
    late = drive["path.e"][learns][-round(LAST / DT) :]
    curve = Curve.of_drive(t, learns, drive["path.e"], failed)
    edges = np.linspace(0.0, curve.t, min(POINTS, max(1, round(curve.t))) + 1)
    steered = curve.over(edges).share > 0.0
    rms = np.where(steered, curve.between(edges[1:] - WINDOW, edges[1:]).rms_e, np.nan)
    return {
        "t": _plain(edges[1:], 2),
        "rms": _plain(rms, 5),
        "lately": round(float(np.sqrt(np.mean(late**2))), 5) if len(late) else None,
        "recovery": [[round(a, 2), round(b, 2)] for a, b in _stretches(t, ~learns)],
        "failed": _plain(failed, 2),
    }


def _map(drive: dict[str, Array], failed: Array, path: Path) -> dict[str, Any]:
    """The path, the car's way by who steered, where it failed, and where it is now."""
    t, x, y = drive["t"], drive["car.x"], drive["car.y"]
    xy = path.samples.xy
    line = np.concatenate([xy[:: max(1, math.ceil(len(xy) / POINTS))], xy[:1] if path.closed else xy[-1:]])
    ways: dict[str, list[list[list[float]]]] = {"learner": [], "recovery": []}
    learns = drive["supervisor.learning"] > 0.5
    every = max(1, math.ceil(len(t) / TRACE))
    carried = np.hypot(np.diff(x), np.diff(y)) > 1.0 + 2.0 * DT * drive["car.v"][1:]
    breaks = np.flatnonzero(np.diff(learns) | carried) + 1
    for began, ended in pairwise([0, *breaks.tolist(), len(t)]):
        if ended > began:
            joined = ended < len(t) and not carried[ended - 1]  # to the way of who steered next
            kept = [*range(began, ended, every), ended if joined else ended - 1]
            way = np.column_stack([x[kept], y[kept]])
            ways["learner" if learns[began] else "recovery"].append(_plain(way, 2))
    at = np.minimum(np.searchsorted(t, failed - 1e-6), len(t) - 1)
    return {
        "path": _plain(line, 2),
        **ways,
        "failed": [[round(float(x[k]), 2), round(float(y[k]), 2)] for k in at],
        "car": [round(float(x[-1]), 2), round(float(y[-1]), 2)] if len(t) else None,
        "learning": bool(learns[-1]) if len(t) else None,
    }


def _policy(policy: NfqPolicy, experiment: Experiment, drive: dict[str, Array], v: float) -> dict[str, Any]:
    """What the net does over e and psi_e, the wheel straight ahead, at speed v [m/s]; and where the car was of late.

    In a bend a car that holds the path has a heading error of its own, psi_0; the car is shown by psi_e - psi_0.
    """
    e, psi = np.linspace(-TRIP, TRIP, GRID), np.linspace(-radians_of(HEADING_DEG), radians_of(HEADING_DEG), GRID)
    n = GRID * GRID
    seen = replace(policy, forecast=None, ready_from=0.0)  # it looks at the state in which its command will act
    names = policy.description.names
    s = states(experiment.scenario, names, n, v=v, doe=0.0, psi=np.repeat(psi, GRID), e=np.tile(e, GRID))
    preview = {"preview": np.zeros((seen.preview_points, n))} if seen.preview_points else {}
    inputs = seen.U(**dict(zip(names, s.T)), **preview)
    action = np.broadcast_to(np.asarray(seen.output(0.0, (), inputs).action, dtype=float), n)
    late = slice(-round(LAST / DT), None, 2)
    heading = drive["path.psi_e"][late] + course_angle(experiment.scenario, drive["car.delta_sw"][late])
    return {
        "v": round(v, 1),
        "element": experiment.setting.doe,
        "e": _plain(e, 4),
        "psi_e_deg": _plain(degrees_of(psi), 3),
        "action_deg": _plain(degrees_of(action).reshape(GRID, GRID), 1),
        "largest_deg": round(float(degrees_of(max(map(abs, policy.actions)))), 1),
        "lately": _plain(np.column_stack([drive["path.e"][late], degrees_of(heading)]), 4),
    }


def _stretches(t: Array, mask: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """From when to when [s] a mask holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]])))
    return [(float(t[began]), float(t[min(ended, len(t) - 1)])) for began, ended in zip(edges[::2], edges[1::2])]


def _plain(values: Any, digits: int) -> Any:
    """Rounded numbers in lists, as JSON has them: null for what is none."""
    if np.ndim(values) > 1:
        return [_plain(row, digits) for row in values]
    return [round(float(value), digits) if math.isfinite(value) else None for value in values]
