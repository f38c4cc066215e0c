"""What a person sees of a run while it learns: curves and counts on a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import math
import time
from collections import deque
from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from steerkit.learning.curve import Curve
from steerkit.learning.experiment import Experiment, LearningRun, Watcher
from steerkit.task import GOAL

HEIGHT, LARGEST_WIDTH = 7, 100
LOW, HIGH = 1e-3, 1.0
"""RMS e at the foot and at the head of the curve [m]."""
LAST = 10.0
"""Time over which the RMS e in words is taken [s]."""
MEMORY = 20.0
"""Computing time over which the speed is taken that foretells the rest [s]."""


def spoken(seconds: float) -> str:
    """A time in words: 41 s, 2 min 10 s, 3 h 20 min."""
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    minutes = whole // 60
    return f"{minutes} min {whole % 60} s" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def learner_state(run: LearningRun) -> str:
    """A run in one line."""
    episode = run.counts.episodes[-1] if run.counts.episodes else None
    held = (episode.ended or run.t) - episode.began if episode else 0.0
    return (
        f"episode {len(run.counts.episodes)}, {run.t / 60:.1f} min driven, held {held:.0f} s, "
        f"RMS e {episode.rms_e if episode else 0:.3f} m, {len(run.transitions)} transitions"
    )


def in_lines(say: Callable[[str], None]) -> Watcher:
    """A line for every round, every fifth failure, and whenever the recovery controller does not get to hand over."""

    def watch(what: str, run: LearningRun) -> None:
        if what == "stuck":
            say(run.counts.stuck[-1])
        if what == "round":
            say(f"{'first learned round' if run.counts.rounds == 1 else 'round'}: {learner_state(run)}")
        if what == "failed" and run.counts.failures % 5 == 0:
            say(f"failed: {learner_state(run)}")

    return watch


@contextlib.contextmanager
def on_terminal(
    experiment: Experiment, console: Console, *, note: str = "", before: Curve | None = None
) -> Iterator[Watcher]:
    """A picture that moves, drawn by a thread of its own; the run only tells it that a second has passed.

    note: one more line, such as where else to look. before: of a run that goes on, what was before.
    """
    picture = Picture(experiment, note=note, before=before)
    live = Live(get_renderable=lambda: picture.drawn(console), console=console, refresh_per_second=4)

    def watch(what: str, run: LearningRun) -> None:
        if what == "stuck":
            live.console.print(run.counts.stuck[-1], soft_wrap=True, style="yellow")
        picture.see(run)

    with live:
        yield watch


class Picture:
    """The curve of RMS e, who steered, the counts and the time to go, as text; `see` the run whenever it has moved."""

    def __init__(
        self,
        experiment: Experiment,
        *,
        note: str = "",
        before: Curve | None = None,
        clock: Callable[[], float] = time.monotonic,
    ):
        self.experiment, self.note, self.clock = experiment, note, clock
        self.curve = before or Curve()
        self.run: LearningRun | None = None
        self._pace: deque[tuple[float, float]] = deque()

    def see(self, run: LearningRun) -> None:
        """Take up what has happened since."""
        self.run, now = run, self.clock()
        if run.t > self.curve.t:
            self.curve.add_counts(run.t, run.counts)
            self._pace.append((now, run.t))
        while len(self._pace) > 2 and self._pace[1][0] < now - MEMORY:
            self._pace.popleft()

    def to_go(self) -> float:
        """Computing time until all minutes are driven, as fast as in the last ones [s]; NaN: nobody can tell yet."""
        if len(self._pace) < 2 or self._pace[-1][0] <= self._pace[0][0]:
            return math.nan
        (began, first), (now, t) = self._pace[0], self._pace[-1]
        return max(0.0, 60.0 * self.experiment.minutes - t) * (now - began) / (t - first)

    def drawn(self, console: Console) -> Table:
        """What is to be seen now, as wide as the console, up to LARGEST_WIDTH."""
        table, ascii_only = Table.grid(), console.options.ascii_only
        columns = min(console.width, LARGEST_WIDTH) - 10
        end = 60.0 * self.experiment.minutes
        halves = self.curve.over(np.linspace(0.0, end, 2 * columns + 1)).rms_e
        e = self.experiment
        table.add_row(Text(f"{e.setting.name} on {e.scenario.course}, seed {e.seed}: RMS e while the learner steers"))
        for mark, row in zip(
            ("1 m", "", "0.1", "", "0.01", "", "1 mm"), _dots(halves, ascii_only=ascii_only), strict=True
        ):
            line = Text.assemble((f"{mark:>6} ", "dim"), (row, "cyan"))
            line.highlight_regex("[┄-]+", "bright_black")
            table.add_row(line)
        table.add_row(self._who_steered(columns, ascii_only))
        end_mark, legend = (
            f"{e.minutes:g} min",
            "   ".join(f"{sign} {name}" for name, sign in _signs(ascii_only).items()),
        )
        table.add_row(Text(f"{'0':>8}{legend:^{columns - 1 - len(end_mark)}}{end_mark}", "dim"))
        for line in self._words():
            table.add_row(line)
        done = Table.grid(padding=(0, 1))
        done.add_row(ProgressBar(end, min(self.curve.t, end), width=columns - 30), self._time())
        table.add_row(done)
        if self.note:
            table.add_row(Text(self.note, style="dim"))
        return table

    def _who_steered(self, columns: int, ascii_only: bool) -> Text:
        """One character a stretch: the learner, its recovery, a failure; and what they mean."""
        learner, recovery, failure = _signs(ascii_only).values()
        _, share, failures = self.curve.over(np.linspace(0.0, 60.0 * self.experiment.minutes, columns + 1))
        driven = (
            sign
            for sign, part in zip(np.where(failures > 0, failure, np.where(share > 0.5, learner, recovery)), share)
            if not math.isnan(part)
        )
        line = Text("".join(driven))
        for sign, style in ((learner, "blue"), (recovery, "yellow"), (failure, "bold red")):
            line.highlight_regex(f"{sign}+", style)
        return Text(" steers").append_text(line)

    def _words(self) -> Iterator[Text]:
        if self.run is None:
            yield Text("begins")
            return
        counts, t = self.run.counts, self.curve.t
        episode = counts.episode
        if episode is not None:
            who = Text(f"the learner steers, for {spoken(max(0.0, t - episode.began))}", "blue")
        else:
            who = Text("the recovery controller steers", "yellow")
        (rms,), _, _ = self.curve.over((max(0.0, t - LAST), t))
        yield who.append("" if math.isnan(rms) else f"; RMS e {rms:.3f} m over the last {LAST:.0f} s", "default")
        first = counts.first_round_done
        rounds = f"rounds {counts.rounds}" + ("" if first is None else f" (the first after {spoken(first)})")
        trained = f"nets trained {counts.updates}, transitions {len(self.run.transitions)}"
        yield Text(f"failures {counts.failures}, {rounds}, {trained}")

    def _time(self) -> Text:
        left = self.to_go()
        driven = f"{self.curve.t / 60.0:.1f} of {self.experiment.minutes:g} min"
        return Text(driven + ("" if math.isnan(left) else f", {spoken(left)} to go"))


def _signs(ascii_only: bool) -> dict[str, str]:
    signs = "=%x" if ascii_only else "━▒×"
    return dict(zip(("learner", "recovery", "failure"), signs))


_GOAL = ("┄", "-")
_DOTS = np.array([[0x40, 0x04, 0x02, 0x01], [0x80, 0x20, 0x10, 0x08]])
"""Bits of a Braille character, from below, left and right."""


def _dots(rms: NDArray[np.float64], *, ascii_only: bool) -> list[str]:
    """A curve on a logarithmic scale, from above, two values a character; a thin line at the goal band's edge."""

    def level(value: NDArray[np.float64] | float) -> NDArray[np.float64]:
        share = np.log(np.clip(value, LOW, HIGH) / LOW) / math.log(HIGH / LOW)
        return np.round((4 * HEIGHT - 1) * share)

    cells = np.zeros((HEIGHT, len(rms) // 2), dtype=int)
    before = math.nan
    for k, y in enumerate(level(rms)):
        if not math.isnan(y):
            ends = sorted((y, y if math.isnan(before) else before))
            for dot in range(int(ends[0]), int(ends[1]) + 1):
                cells[dot // 4, k // 2] |= _DOTS[k % 2, dot % 4]
        before = y
    goal = int(level(GOAL)) // 4
    signs = []
    for row in range(HEIGHT - 1, -1, -1):
        empty = _GOAL[ascii_only] if row == goal else " "
        signs.append("".join(("*" if ascii_only else chr(0x2800 + cell)) if cell else empty for cell in cells[row]))
    return signs
