"""A short honest text from results: by which metrics learned beats analytic, by which it does not, and by how much."""

from benchmarks.report.overall import JUDGED, SIGNIFICANT, Glance, Match, glances
from benchmarks.report.parts import controllers
from benchmarks.run.results import Case, Results
from benchmarks.statistics import share

NOTHING = "Nothing to compare: these results lack drives of one of the two kinds."
SMALL_PRINT = (
    "Simulated drives only; no car was driven. Each controller is judged where it has its errors measured (front axle, "
    "rear axle or centre of gravity), which also moves the lateral acceleration that a course asks of the centre of "
    "gravity. Ratios are geometric means over the scenarios that both held on all seeds, with 95 % bootstrap intervals "
    f"over the seeds. Better and worse mean p < {SIGNIFICANT:g} in the sign-flip permutation test of the pairs, not "
    "corrected for how many there are: one in twenty is found where there is none; with five seeds or fewer no p is as "
    "small. An analytic controller in a scenario without chance drives once and meets every net."
)


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
