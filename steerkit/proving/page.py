"""A manoeuvre's report as one HTML page: verdict, pictures, results, runs, and what ISO 7401 asks a report to state."""

import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields

from steerkit._support.errors import require
from steerkit._support.files import File, write_text
from steerkit.diagram.units import FACTORS, degrees_of, radians_of
from steerkit.plots.page import Html, document, html, picture, table
from steerkit.proving.evaluate import WORDS, Evaluation, Result
from steerkit.proving.manoeuvre import Manoeuvre
from steerkit.proving.pictures import coloured, pictures

_JUDGED = {
    True: ("passed", "good", "kept"),
    False: ("failed", "bad", "not kept"),
    None: ("not judged", "open", "not judged"),
}
_MANY = 12
"""More evaluations than these get a row each."""
_SETTINGS = ("course", "repeats", "sides", "cutoff")


def write(file: File, evaluations: Sequence[Evaluation], *, general: Mapping[str, str] = {}, command: str = "") -> None:
    """Write the report of one manoeuvre, of several cars or controllers side by side.

    general: general data by name, such as `how` ("simulation", "log", "car"), `place`, `load`, `tyres`, `instruments`.
    command: that made it. Raises ValueError for no evaluations, or of manoeuvres that differ.
    Source: ISO 7401, annexes A and B (what a report states).
    """
    require(evaluations, f"{file}", "no evaluation, expected one or more")
    manoeuvre = evaluations[0].manoeuvre
    same = all(e.manoeuvre == manoeuvre for e in evaluations)
    require(same, f"{file}", "manoeuvres differ, expected evaluations of one, with the same numbers")
    simulated = general.get("how", "").startswith("simulat")
    facts = WORDS["general"] | (WORDS["simulated"] | {"date": time.strftime("%Y-%m-%d")} if simulated else {}) | general
    notes = [f"{e.who}: {note}" if len(evaluations) > 1 else note for e in evaluations for note in e.notes]
    figures = [picture(figure, caption) for caption, figure in pictures(evaluations)]
    verdicts: list[str] = [_verdict(e, colour) for e, colour in coloured(evaluations)]
    if len(evaluations) > _MANY:
        words = [_JUDGED[e.passed][0] for e in evaluations]
        counts = ", ".join(f"{words.count(word)} {word}" for word, *_ in _JUDGED.values())
        verdicts = [f"<div class='verdict'><strong>{counts}</strong>of {len(words)} cars; each: see results</div>"]
    parted = "</div><div class=beside>" if len(evaluations) + len(figures) > 3 else ""
    parts = [
        Html(f"<h1>{html(manoeuvre.title)}</h1><p>{html(manoeuvre.norm)}<br>{html(manoeuvre.about)}</p>"),
        Html(f"<div class=beside>{''.join(verdicts)}{parted}{''.join(figures)}</div>"),
        Html("<h2>Results</h2>" + _results(evaluations)),
        Html(f"<h2>Runs{' that do not count' if len(evaluations) > _MANY else ''}</h2>" + _runs(evaluations)),
        Html("<h2>General data</h2>" + table(("", ""), facts.items())),
        Html("<h2>Cars</h2>" + _cars(evaluations)),
        Html("<h2>Method</h2>" + _method(manoeuvre)),
        Html("<h2>Notes</h2><ul>" + "".join(f"<li>{html(note)}</li>" for note in notes or ["none"]) + "</ul>"),
    ]
    closing = "Simulated; no car was driven." if simulated else ""
    write_text(file, document(manoeuvre.title, "\n".join(parts), command=command, closing=closing))


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "none"
    return "0" if abs(value) < 1e-6 else f"{value:.0f}" if 1e4 <= abs(value) < 1e9 else f"{value:.4g}"


def _with_unit(value: float, unit: str) -> str:
    return _number(value) + (f" {unit}" if unit != "1" and math.isfinite(value) else "")


def _beside(value: float, unit: str) -> str:
    """The same in degrees or km/h, where people think in them; else ""."""
    if not math.isfinite(value):
        return ""
    if unit == "m/s":
        return _with_unit(value / FACTORS["m/s"]["km/h"], "km/h")
    if unit.startswith("rad"):
        return _with_unit(degrees_of(value), f"deg{unit[3:]}")
    return _with_unit(radians_of(value), f"{unit[:-3]}deg") if unit.endswith("/rad") else ""


def _fixed(text: str) -> Html:
    """Not to be broken."""
    return Html(f"<span class=fixed>{html(text)}</span>")


def _interval(result: Result) -> str:
    return f"{_number(result.low)} to {_number(result.high)}" if math.isfinite(result.high - result.low) else "none"


def _said(result: Result) -> str:
    """Value, interval, and in degrees."""
    interval = _interval(result)
    more = (
        "no interval" if interval == "none" else f"95 % interval {interval}",
        _beside(result.value, result.unit),
        result.note,
    )
    return f"{_with_unit(result.value, result.unit)} ({'; '.join(filter(None, more))})"


def _words(quantity: str) -> str:
    return str(WORDS["results"].get(quantity, quantity))


def _who(e: Evaluation, colour: str) -> Html:
    return Html(f"<i class=dot style='background:{colour}'></i>{html(e.who or e.vehicle.name)}")


def _verdict(e: Evaluation, colour: str) -> Html:
    word, tone, _ = _JUDGED[e.passed]
    known, lines = {result.quantity: result for result in e.results}, list[str]()
    for limit, passed in e.verdicts:
        result = known.get(limit.quantity)
        bounds = f"limit {limit.text()}" + (f" {result.unit}" if result and result.unit != "1" else "")
        astride = result and any(result.low < bound < result.high for bound in (limit.low, limit.high))
        doubt = "; the interval reaches beyond the limit" if astride else ""
        said = f"{_said(result) if result else 'not evaluated'}, {bounds}: "
        lines.append(
            f"{html(_words(limit.quantity))}: {html(said)}<b class={_JUDGED[passed][1]}>{_JUDGED[passed][2]}</b>{doubt}"
            f"<small>{html(limit.source)}</small>"
        )
    if not e.verdicts:
        lines = [f"{html(_words(r.quantity))}: {html(_said(r))}" for r in e.results[:4]]
        lines.insert(0, "No limits were given. Of the results:" if lines else "Nothing was found.")
    asked = e.manoeuvre.repeats * len(e.manoeuvre.sides)
    counted = f"{len(e.valid)} of {len(e.runs)} runs count" + (f"; {asked} are asked" if len(e.valid) < asked else "")
    items = "".join(f"<li>{line}</li>" for line in [*lines, counted])
    head = f"{_who(e, colour)}<strong class={tone}>{word.upper()}</strong>"
    return Html(f"<div class='verdict {tone}'>{head}<ul>{items}</ul></div>")


def _per_car(head: Sequence[str], rows: Iterable[Sequence[object]], evaluations: Sequence[Evaluation]) -> Html:
    """A table without its column `car` where there is one car only."""
    shown = [k for k, name in enumerate(head) if name != "car" or len(evaluations) > 1]
    return table([head[k] for k in shown], ([row[k] for k in shown] for row in rows))


def _results(evaluations: Sequence[Evaluation]) -> Html:
    rows = list[tuple[object, ...]]()
    quantities = dict.fromkeys(result.quantity for e in evaluations for result in e.results)
    cars = [(e, _who(e, colour), {r.quantity: r for r in e.results}) for e, colour in coloured(evaluations)]
    if len(evaluations) > _MANY:
        for e, who, known in cars:
            values = (_with_unit(known[name].value, known[name].unit) if name in known else "" for name in quantities)
            rows.append((who, Html(f"<b class={_JUDGED[e.passed][1]}>{_JUDGED[e.passed][0]}</b>"), *values))
        return table(("car", "verdict", *map(_words, quantities)), rows)
    for quantity in quantities:
        name = _words(quantity)
        for who, r in ((who, known[quantity]) for _, who, known in cars if quantity in known):
            value = Html(f"<b>{_fixed(_with_unit(r.value, r.unit))}</b>")
            rows.append((name, who, value, _fixed(_interval(r)), _fixed(_beside(r.value, r.unit)), r.n, r.note))
            name = ""
    return _per_car(("quantity", "car", "value", "95 % interval", "that is", "repeats", "note"), rows, evaluations)


def _runs(evaluations: Sequence[Evaluation]) -> Html:
    rows = []
    for e, colour in coloured(evaluations):
        for run in (run for run in e.runs if run.invalid or len(evaluations) <= _MANY):
            counts = Html(f"<b class=bad>no</b>: {html(run.invalid)}") if run.invalid else "yes"
            speed = _with_unit(float(run["v"].mean()), "m/s")
            rows.append((_who(e, colour), run.number, run.side, speed, f"{run.t[-1] - run.t[0]:.1f} s", counts))
    return _per_car(("car", "number", "side", "mean speed", "length", "counts"), rows, evaluations)


def _cars(evaluations: Sequence[Evaluation]) -> Html:
    def of(e: Evaluation) -> dict[str, str]:
        car, m = e.vehicle, e.manoeuvre
        told = {name: _with_unit(float(getattr(car, of)), unit) for of, (name, unit) in WORDS["car"].items()}
        if m.input:
            angle = m.input.angle(car, m.conditions.v)
            told["steering-wheel angle of the input"] = f"{_number(angle)} rad, {_beside(angle, 'rad')}"
        if e.runs:
            told |= {"sampling rate": f"{1.0 / e.runs[0].dt:.4g} Hz", "signals": ", ".join(e.runs[0].signals)}
        return {"vehicle file": car.name, **told}

    columns = [of(e) for e in evaluations]
    names = dict.fromkeys(name for column in columns for name in column)
    told = [[column.get(name, "") for name in names] for column in columns]
    rows = [("", *names), *((_who(e, colour), *row) for (e, colour), row in zip(coloured(evaluations), told))]
    head, *below = rows if len(evaluations) > _MANY else zip(*rows)
    return table(head, below)


def _method(m: Manoeuvre) -> Html:
    """Every number of the manoeuvre, and where it comes from."""
    rows: list[tuple[object, ...]] = []
    for part, of in (("conditions", m.conditions), ("input", m.input), ("abort", m.abort), ("", m)):
        for f in fields(of) if of else ():
            key, value = f"{part}.{f.name}".strip("."), getattr(of, f.name)
            told = f.default is MISSING or value != f.default or key in m.sources or part in ("conditions", "abort")
            if not told or (of is m and f.name not in _SETTINGS):
                continue
            unit = f.metadata.get("number", ("1",))[0]
            plain = isinstance(value, (int, float))
            listed = (value,) if isinstance(value, str) else () if plain else value
            text = ", ".join(str(WORDS["forms"].get(item, item)) for item in listed)
            if plain:
                beside = _beside(value, unit)
                text = _fixed(_with_unit(value, unit) + (f", {beside}" if beside else ""))
            source = m.sources.get(key, "" if f.default is MISSING else "steerkit's default")
            if "unverified" in source:
                source = Html(f"<b class=open>unverified</b>: {html(source.rpartition(': ')[2])}")
            rows.append((WORDS["settings"].get(key, key), text, source))
    begin = "The input begins at t = 0. " if m.input else ""
    text = f"{begin}Unverified, as the norm's text was not at hand: {len(m.unverified)} of {len(rows)} numbers."
    return Html(f"<p>{html(text)}</p>" + table(("", "value", "source"), rows))
