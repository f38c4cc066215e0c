"""Pictures that explain a learning run: what it values, what it would do, how it came about, where it failed.

Each function takes a `Record` (or a policy) and returns a matplotlib figure; `draw_all` draws the set of a run
directory. How to read them: docs/learning.md.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.policy import V
from steerkit.diagram.simulation import Log
from steerkit.learning import rundir
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.experiment import Experiment
from steerkit.learning.learner_state import Episode
from steerkit.learning.pictures.policy import policy_map
from steerkit.paths.path import Path
from steerkit.plots.drive import round_driven, shade_recovery
from steerkit.plots.style import COLOURS, new_figure, save, styled
from steerkit.task import GOAL

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WINDOW = 5.0
"""Time over which RMS e is taken in a learning curve [s]."""
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class Record:
    """What a run directory holds of a run."""

    name: str
    experiment: Experiment
    episodes: tuple[Episode, ...]
    log: Log
    policy: NfqPolicy
    """Of the last update."""
    path: Path
    transitions: Transitions

    @classmethod
    def read(cls, place: str | FilePath) -> "Record":
        """From a run directory; raises ValueError when there is none or it is broken."""
        place = FilePath(place)
        data = rundir.document(place)
        experiment = rundir.experiment_of(place, data)
        return cls(
            name=f"{place.resolve().name}: {experiment.setting.name} on {experiment.scenario.course.name}",
            experiment=experiment,
            episodes=tuple(Episode(**episode) for episode in data["counts"]["episodes"]),
            log=rundir.drive_log(place),
            policy=rundir.final_policy(place),
            path=experiment.scenario.path(),
            transitions=Transitions.load(place / f"transitions-{data['checkpoint']}.npz"),
        )

    @property
    def learning(self) -> NDArray[np.bool_]:
        """At each sample of the log: does the learner steer?"""
        return self.log["supervisor.learning"] > 0.5

    def ended(self, episode: Episode) -> float:
        """Driving time at which an episode ended, or the log's end [s]."""
        return float(self.log.t[-1]) if episode.ended is None else episode.ended

    @property
    def failed_at(self) -> NDArray[np.intp]:
        """Samples of the log at which the recovery controller took over."""
        times = [episode.ended for episode in self.episodes if episode.failed]
        return np.minimum(np.searchsorted(self.log.t, np.array(times, dtype=float) - 1e-6), len(self.log.t) - 1)

    def rms(self, window: float = WINDOW) -> Array:
        """RMS of e over the last `window` [s] at each sample, of the learner's samples only; NaN without any."""
        n = max(1, round(window / float(np.median(np.diff(self.log.t)))) if len(self.log.t) > 1 else 1)
        learns = self.learning
        squares, counts = (
            np.convolve(values, np.ones(n))[: len(learns)]
            for values in (np.where(learns, self.log["path.e"] ** 2, 0.0), learns)
        )
        return np.sqrt(np.divide(squares, counts, out=np.full(len(counts), np.nan), where=learns))


# ---- how it came about --------------------------------------------------------------------------------------------


@styled
def learning_curve(record: Record) -> "Figure":
    """How long the learner steered, RMS e over the last seconds, and failures; shaded: recovery steers."""
    figure, (held, error, count) = new_figure(3, title=f"{record.name}: learning curve", width=10.5)
    colour, mark, end = COLOURS["learned"], COLOURS["limit"], float(record.log.t[-1])
    for axis in (held, error, count):
        shade_recovery(axis, record.log.t, record.learning)
    for episode in record.episodes:
        t = np.geomspace(0.1, max(0.1, record.ended(episode) - episode.began), 60)
        held.plot(episode.began + t, t, color=colour, lw=1.2)
        if episode.failed:
            held.plot(episode.began + t[-1], t[-1], "x", color=mark, ms=5, mew=1.1)
    held.set(yscale="log", ylabel="learner steers for [s]")
    held.set_yticks((0.1, 1.0, 10.0, 100.0), ("0.1", "1", "10", "100"))
    error.plot(record.log.t, record.rms(), color=colour, lw=1.2)
    error.axhline(GOAL, color=COLOURS["goal"], lw=1.2, zorder=1)
    error.set(yscale="log", ylim=(1e-3, 1.0), ylabel=f"RMS e over {WINDOW:.0f} s [m]")
    error.set_yticks((0.001, 0.01, 0.1, 1.0), ("0.001", "0.01", "0.1", "1"))
    times = [0.0, *(record.ended(episode) for episode in record.episodes if episode.failed), end]
    counts = [*range(len(times) - 1), len(times) - 2]
    count.plot(times, counts, color=colour, lw=1.4, drawstyle="steps-post")
    count.annotate(f"{counts[-1]} ", (times[-1], counts[-1]), color=colour, fontsize=8, va="bottom", ha="right")
    held.plot([], [], "x", color=mark, ms=5, label="failure")
    held.legend(loc="lower right", ncols=2)
    count.set(xlabel="driving time [s]", ylabel="failures so far", ylim=(0.0, 1.15 * max(1, counts[-1])))
    count.set_xlim(0.0, end)
    count.locator_params(axis="y", integer=True)
    return figure


def replay(record: Record, number: int) -> "Figure":
    """Episode `number` (from 1): on the map, e, wheel and lateral acceleration.

    Raises ValueError for an episode that is not there.
    """
    count = len(record.episodes)
    require(1 <= number <= count, "replay", f"episode {number} of {record.name}, expected 1 to {count}")
    episode, log = record.episodes[number - 1], record.log
    began, ended = episode.began, record.ended(episode)
    part = (log.t >= began - 1e-6) & (log.t <= ended + 1e-6)
    ending = "failed" if episode.failed else "still driving"
    title = f"{record.name}: episode {number}, {ending} after {ended - began:.1f} s, {episode.distance:.0f} m"
    shown = Log(log.t[part], {name: values[part] for name, values in log.items()}, log.units)
    return round_driven(shown, title=title)


def draw_all(place: str | FilePath, out: str | FilePath | None = None) -> list[FilePath]:
    """Draw the diagnostics of a run directory as PNG files in `out` (default: `diagnostics` in it); returns them.

    Replays: the longest episode, and the last that failed. Raises ValueError for a directory that holds no whole run.
    """
    record = Record.read(place)
    folder = FilePath(place) / "diagnostics" if out is None else FilePath(out)
    folder.mkdir(parents=True, exist_ok=True)
    scenario, speeds = record.experiment.scenario, record.transitions.s[:, V]
    v = float(np.median(speeds)) if len(speeds) else 6.0
    figures: dict[str, Callable[[], Figure]] = {
        "policy-map": lambda: policy_map(record.policy, scenario, visited=record.transitions, v=v, title=record.name),
        "learning-curve": lambda: learning_curve(record),
    }
    lengths = [record.ended(episode) - episode.began for episode in record.episodes]
    failed = [k for k, episode in enumerate(record.episodes, start=1) if episode.failed]
    for number in sorted({*([int(np.argmax(lengths)) + 1] if lengths else []), *failed[-1:]}):
        figures[f"episode-{number}"] = lambda number=number: replay(record, number)  # type: ignore[misc]
    files = []
    for name, draw in figures.items():
        files.append(folder / f"{name}.png")
        save(draw(), files[-1])
    return files
