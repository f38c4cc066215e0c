"""A short honest text from results: where learned beats analytic, where it does not, and by how much."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.report.overall import ENOUGH, JUDGED, OPPONENT, SIGNIFICANT, headline
from benchmarks.report.parts import counted
from benchmarks.run.results import Case, Results
from benchmarks.statistics import Paired, paired, share


@dataclass(frozen=True, kw_only=True)
class Duel:
    """A learned against an analytic controller by one metric in one scenario."""

    scenario: str
    metric: str
    learned: str
    analytic: str
    mean_learned: float
    mean_analytic: float
    result: Paired | None
    """Paired over the seeds that both held; None for fewer than two."""
    seeds: int
    """Seeds that both held."""
    left_out: int
    """Seeds that one of them did not hold."""

    @property
    def decided(self) -> int:
        """-1: learned is better, beyond chance; 1: analytic is; 0: neither."""
        if self.result is None or self.result.p >= SIGNIFICANT:
            return 0
        return -1 if self.result.difference.value < 0.0 else 1


def duels(results: Results, learned: str, analytic: str, suite: str | None = None) -> list[Duel]:
    """The learned against the analytic controller, in every scenario that both drove, by every judged metric."""
    rows = []
    for scenario in dict.fromkeys(case.scenario for case in _drives(results, suite)):
        one, two = (_by_seed(results, scenario, name, suite) for name in (learned, analytic))
        if not one or not two:
            continue
        seeds = sorted(one if len(one) >= len(two) else two)  # a drive without chance has one seed: it meets all
        pairs = [(_at(one, n), _at(two, n)) for n in seeds]
        for name in JUDGED:
            held = [
                (a.metrics.get(name, math.nan), b.metrics.get(name, math.nan))
                for a, b in pairs
                if a and b and a.metrics.get("held") and b.metrics.get("held")
            ]
            values = np.array([pair for pair in held if np.isfinite(pair).all()], dtype=float).reshape(-1, 2)
            means = values.mean(axis=0) if len(values) else (math.nan, math.nan)
            rows.append(
                Duel(
                    scenario=scenario,
                    metric=name,
                    learned=learned,
                    analytic=analytic,
                    mean_learned=float(means[0]),
                    mean_analytic=float(means[1]),
                    result=paired(values[:, 0], values[:, 1]) if len(values) >= 2 else None,
                    seeds=len(values),
                    left_out=len(pairs) - len(values),
                )
            )
    return rows


def verdict(results: Results, *, suite: str | None = None) -> str:
    """The text, in Markdown. suite: of one suite only. Says so where there is nothing to compare."""
    kinds = {name: entry["kind"] for name, entry in results.provenance["controllers"].items()}
    driven = dict.fromkeys(case.controller for case in _drives(results, suite))
    learned = [name for name in driven if kinds.get(name) == "learned"]
    analytic = [name for name in driven if kinds.get(name) == "analytic"]
    lines = [f"## Learned against analytic{f', suite {suite}' if suite else ''}", ""]
    if results.missing:
        lines += [
            f"**Unfinished: {len(results.missing)} of {len(results.provenance['planned'])} cases are missing.**",
            "",
        ]
    broken = [case for case in results.cases if case.status == "error"]
    if broken:
        lines += [f"Ended with an error and left out: {len(broken)}, the first {broken[0].id}.", ""]
    if not learned or not analytic:
        return "\n".join([*lines, "Nothing to compare: these results lack drives of one of the two kinds.", ""])
    seeds = max(len({case.seed for case in _drives(results, suite) if case.controller == name}) for name in learned)
    if seeds < ENOUGH:
        lines += [
            f"**{counted(seeds, 'seed')}: with fewer than {ENOUGH} nothing is certain; the ratios are all there is.**",
            "",
        ]
    lines += [headline(results, suite=suite), ""]
    lines += [*_holding(results, [*analytic, *learned], suite), ""]
    for name in learned:
        lines += [*_of_one(results, name, analytic, suite), ""]
    return "\n".join([*lines, _SMALL_PRINT, ""])


_SMALL_PRINT = (
    "Simulated drives only; no car was driven. Each controller is judged where it has its errors measured (front axle, "
    "rear axle or centre of gravity), which also moves the lateral acceleration that a course asks of the centre of "
    "gravity. Differences are means over the seeds that both held, with 95 % bootstrap intervals. Better and worse "
    f"mean p < {SIGNIFICANT:g} in the sign-flip permutation test of the pairs, not corrected for how many there are: "
    "one in twenty is found where there is none; with five seeds or fewer no p is as small. An analytic controller in "
    "a scenario without chance drives once and meets every net. The best analytic controller is chosen after the fact, "
    "scenario by scenario."
)


def _holding(results: Results, names: Sequence[str], suite: str | None) -> list[str]:
    """How often each kept |e| <= 0.5 m to the end."""
    rows = ["| controller | drives held | share, 95 % interval |", "|---|---|---|"]
    for name in names:
        held = [bool(case.metrics.get("held")) for case in _drives(results, suite) if case.controller == name]
        if held:
            part = share(held)
            rows.append(f"| {name} | {sum(held)} of {len(held)} | {part.value:.2f} [{part.low:.2f}, {part.high:.2f}] |")
    return rows


def _of_one(results: Results, learned: str, analytic: Sequence[str], suite: str | None) -> list[str]:
    """The table of one learned controller: a row a metric and opponent, with numbers of scenarios."""
    against = [duel for name in analytic for duel in duels(results, learned, name, suite)]
    heads = ("metric", "against", "ratio", "better", "worse", "no certain difference", "never both held")
    lines = [f"### {learned}", "", f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for name, word in JUDGED.items():
        rows = [duel for duel in against if duel.metric == name]
        usual = [duel for duel in rows if duel.analytic == OPPONENT]
        for who, chosen in ((OPPONENT, usual), ("the best of each scenario", _best(rows))):
            compared = [duel for duel in chosen if duel.seeds]
            counts = [sum(duel.decided == sign for duel in compared) for sign in (-1, 1, 0)]
            cells = [word, who, _ratio(compared), *map(str, counts), str(len(chosen) - len(compared))]
            if chosen:
                lines.append(f"| {' | '.join(cells)} |")
    return lines


def _ratio(rows: Sequence[Duel]) -> str:
    """How large the learned controller's figure is beside the other's: geometric mean over the scenarios."""
    if not rows:
        return "–"
    gaps = [math.log(max(d.mean_learned, 1e-12) / max(d.mean_analytic, 1e-12)) for d in rows]
    return f"{math.exp(sum(gaps) / len(gaps)):.2f}"


def _best(rows: Iterable[Duel]) -> list[Duel]:
    """For each scenario the duel with the analytic controller whose mean is lowest, of those that held most seeds."""
    by_scenario: dict[str, list[Duel]] = {}
    for duel in rows:
        if duel.seeds:
            by_scenario.setdefault(duel.scenario, []).append(duel)
    return [min(duels, key=lambda d: (-d.seeds, d.mean_analytic)) for duels in by_scenario.values()]


def _drives(results: Results, suite: str | None) -> list[Case]:
    return [c for c in results.cases if c.kind == "drive" and c.status == "done" and suite in (None, c.suite)]


def _by_seed(results: Results, scenario: str, name: str, suite: str | None) -> dict[int, Case]:
    return {c.seed: c for c in _drives(results, suite) if (c.scenario, c.controller) == (scenario, name)}


def _at(cases: dict[int, Case], seed: int) -> Case | None:
    """The case of that seed; the only one there is, if there is one."""
    return next(iter(cases.values())) if len(cases) == 1 else cases.get(seed)
