"""The verdict: each learned controller against each analytic one, by each metric; at a glance and as an honest text."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.report.parts import METRICS, Drives, controllers, counted, paired_logs
from benchmarks.run.results import Case, Results
from benchmarks.statistics import Interval, paired, share

JUDGED = {
    "rms_e": ("distance from the path", "RMS e"),
    "rms_wheel_rate_deg": ("turning of the wheel", "RMS wheel rate"),
    "max_jerk": ("jolts to the side", "max jerk"),
    "max_a_y": ("sideways acceleration", "max a_y"),
}
"""What is compared, less being better: in words for somebody who steers no cars by program, and the metric."""
SIGNIFICANT = 0.05
ENOUGH = 6
"""Seeds: with fewer no p of the test is below SIGNIFICANT."""
OPPONENT = "stanley"
"""The analytic controller that every text also compares with, whichever was best."""
WIDEST = math.log(8.0)
"""The picture's ratios reach from an eighth to eight times."""
NOTHING = "Nothing to compare: these results lack drives of one of the two kinds."
SMALL_PRINT = (
    "Simulated drives only; no car was driven. Each controller is judged where it has its errors measured (front axle, "
    "rear axle or centre of gravity), which also moves the lateral acceleration that a course asks of the centre of "
    "gravity. Ratios are geometric means over the scenarios that both held on all seeds, with 95 % bootstrap intervals "
    f"over the seeds. Better and worse mean p < {SIGNIFICANT:g} in the sign-flip permutation test of the pairs, not "
    "corrected for how many there are: one in twenty is found where there is none; with five seeds or fewer no p is as "
    "small. An analytic controller in a scenario without chance drives once and meets every net."
)


@dataclass(frozen=True, kw_only=True)
class Match:
    """A learned against an analytic controller by one metric, over all scenarios that both held on all seeds."""

    learned: str
    analytic: str
    metric: str
    ratio: Interval
    """The learned one's figure over the other's: geometric mean over scenarios, then seeds; bounds NaN for one seed."""
    p: float
    scenarios: int

    @property
    def decided(self) -> int:
        """-1: the learned one is better, beyond chance; 1: it is worse; 0: neither is certain."""
        return 0 if self.p >= SIGNIFICANT else -1 if self.ratio.value < 1.0 else 1

    @property
    def bar(self) -> tuple[float, float, float] | None:
        """Where low, value and high lie on the picture's axis, 0 to 100; one is at 50. None where there is no ratio."""
        at = [50.0 + 50.0 * math.log(r) / WIDEST for r in (self.ratio.low, self.ratio.value, self.ratio.high)]
        if not math.isfinite(at[1]):
            return None
        low, value, high = (min(max(place if math.isfinite(place) else at[1], 0.0), 100.0) for place in at)
        return low, value, high


@dataclass(frozen=True, kw_only=True)
class Glance:
    """One learned controller: how often it held, what to say of it, and its matches by opponent."""

    learned: str
    held: int
    drives: int
    sentence: str
    matches: dict[str, list[Match]]
    """By analytic controller, a match a metric."""


def glances(results: Results, *, suite: str | None = None) -> list[Glance]:
    """Each learned controller that drove, the best first: most drives held, then the nearest to the path."""
    kinds = {name: entry["kind"] for name, entry in results.provenance["controllers"].items()}
    cases = [c for c in results.cases if c.kind == "drive" and c.status == "done" and suite in (None, c.suite)]
    table: Drives = {}
    for case in cases:
        table.setdefault(case.controller, {}).setdefault(case.scenario, {})[case.seed] = case
    analytic = [name for name in table if kinds.get(name) == "analytic"]
    found = (
        [_glance(table, cases, name, analytic) for name in table if kinds.get(name) == "learned"] if analytic else []
    )
    return sorted(found, key=lambda g: (-g.held / g.drives, _hardest(g.matches, default=math.inf)))


def _glance(table: Drives, cases: Sequence[Case], learned: str, analytic: Sequence[str]) -> Glance:
    own = [case for case in cases if case.controller == learned]
    held = sum(bool(case.metrics.get("held")) for case in own)
    matches = {name: [_match(table, learned, name, metric) for metric in JUDGED] for name in analytic}
    met = {name: [m for m in row if m is not None] for name, row in matches.items()}
    met = {name: row for name, row in met.items() if row}
    return Glance(
        learned=learned, held=held, drives=len(own), sentence=_sentence(learned, held, len(own), met), matches=met
    )


def _match(table: Drives, learned: str, analytic: str, name: str) -> Match | None:
    metric = next(m for m in METRICS if m.name == name)
    pairs = paired_logs(table, learned, analytic, metric)
    if pairs is None:
        return None
    ours, theirs, scenarios = pairs
    if len(ours) < 2:
        ratio, p = Interval(float(np.exp(ours - theirs)[0]), math.nan, math.nan, 1), 1.0
    else:
        test = paired(ours, theirs)
        gap = test.difference
        ratio, p = Interval(math.exp(gap.value), math.exp(gap.low), math.exp(gap.high), gap.n), test.p
    return Match(learned=learned, analytic=analytic, metric=name, ratio=ratio, p=p, scenarios=scenarios)


def _hardest(matches: dict[str, list[Match]], default: float) -> float:
    """The largest ratio of the distance from the path: against the best analytic controller."""
    return max((m.ratio.value for row in matches.values() for m in row if m.metric == "rms_e"), default=default)


def _sentence(learned: str, held: int, drives: int, matches: dict[str, list[Match]]) -> str:
    every = "its one drive" if drives == 1 else f"all {drives} drives"
    of_all = every if held == drives else f"{held} of {drives} drives"
    said = [f"{learned} kept to the course in {of_all}."]
    rows = [m for row in matches.values() for m in row if m.metric == "rms_e"]
    if not rows:
        return f"{said[0]} There is no scenario that it and an analytic controller both held with every seed."
    rival = max(rows, key=lambda m: m.ratio.value)
    usual = next((m for m in rows if m.analytic == OPPONENT), rival)
    texts = [f"{times(usual.ratio.value)} that of {usual.analytic}"]
    if rival is not usual:
        texts.append(f"{times(rival.ratio.value)} that of {rival.analytic}, the best of the analytic controllers")
    said.append(f"Its distance from the path was {' and '.join(texts)}.")
    seeds = max(m.ratio.n for m in rows)
    if seeds < ENOUGH:
        said.append(f"No difference is certain with {counted(seeds, 'seed')}; {ENOUGH} are needed.")
        return " ".join(said)
    groups = {
        "certainly nearer to the path than": [m.analytic for m in rows if m.decided < 0],
        "certainly further from the path than": [m.analytic for m in rows if m.decided > 0],
        "not certainly different from": [m.analytic for m in rows if m.decided == 0],
    }
    said.append(f"It was {'; '.join(f'{word} {_listed(names)}' for word, names in groups.items() if names)}.")
    return " ".join(said)


def times(ratio: float) -> str:
    """A ratio as one says it: "16 % less than", "1.9 times", "as large as"."""
    if ratio < 0.995:
        return f"{100.0 * (1.0 - ratio):.0f} % less than"
    if ratio < 1.005:
        return "as large as"
    return f"{100.0 * (ratio - 1.0):.0f} % more than" if ratio < 1.5 else f"{ratio:.1f} times"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def verdict(results: Results, *, suite: str | None = None) -> str:
    """The text, in Markdown. suite: of one suite only. Says so where there is nothing to compare."""
    lines = [f"## Learned against analytic{f', suite {suite}' if suite else ''}", ""]
    if results.missing:
        planned = len(results.provenance["planned"])
        lines += [f"**Unfinished: {len(results.missing)} of {planned} cases are missing.**", ""]
    broken = [case for case in results.cases if case.status == "error"]
    if broken:
        lines += [f"Ended with an error and left out: {len(broken)}, the first {broken[0].id}.", ""]
    found = glances(results, suite=suite)
    if not found:
        return "\n".join([*lines, NOTHING, ""])
    drives = [c for c in results.cases if c.kind == "drive" and c.status == "done" and suite in (None, c.suite)]
    lines += [found[0].sentence, "", *_holding(drives), ""]
    for glance in found:
        lines += [*_of_one(glance), ""]
    return "\n".join([*lines, SMALL_PRINT, ""])


def _holding(drives: list[Case]) -> list[str]:
    """How often each kept |e| <= 0.5 m to the end."""
    rows = ["| controller | drives held | share, 95 % interval |", "|---|---|---|"]
    for name in controllers(drives):
        held = [bool(case.metrics.get("held")) for case in drives if case.controller == name]
        part = share(held)
        rows.append(f"| {name} | {sum(held)} of {len(held)} | {part.value:.2f} [{part.low:.2f}, {part.high:.2f}] |")
    return rows


def _of_one(glance: Glance) -> list[str]:
    """The table of one learned controller: its figure over that of each analytic one."""
    heads = ("over", "scenarios", *(label for _, label in JUDGED.values()))
    lines = [f"### {glance.learned}", "", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, matches in glance.matches.items():
        by_metric = {match.metric: match for match in matches}
        cells = [_ratio(by_metric.get(metric)) for metric in JUDGED]
        lines.append(f"| {' | '.join([name, str(matches[0].scenarios), *cells])} |")
    return lines


def _ratio(match: Match | None) -> str:
    if match is None:
        return "–"
    if match.ratio.n < 2:
        return f"{match.ratio.value:.2f}"
    word = {-1: ", better", 0: "", 1: ", worse"}[match.decided]
    return f"{match.ratio.value:.2f} [{match.ratio.low:.2f}, {match.ratio.high:.2f}]{word}"
