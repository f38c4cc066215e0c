"""A manoeuvre's report as one HTML page: verdict, pictures, results, runs, and what ISO 7401 asks a report to state."""

import itertools
import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import File, write_text
from steerkit.diagram.units import FACTORS, degrees_of, radians_of
from steerkit.logs.channels import Array
from steerkit.plots.page import Html, document, html, picture, table
from steerkit.plots.style import COLOURS, PALETTE, new_figure, style
from steerkit.proving.evaluate import WORDS, Evaluation, Result, crossing, turned
from steerkit.proving.manoeuvre import Manoeuvre
from steerkit.proving.runs import Run, prepared

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_WIDTH = 4.6  # inches: letters stay readable on a phone
_LABELS: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "e": ("cross-track error [m]", lambda x: x),
    "delta_sw": ("steering wheel [deg]", degrees_of),
    "r": ("yaw rate [deg/s]", degrees_of),
    "a_y": ("lateral acceleration\n[m/s^2]", lambda x: x),
}


class _Drawn(NamedTuple):
    """Whose runs are drawn, as they are evaluated, and in which colour."""

    of: Evaluation
    runs: list[Run]
    colour: str


def coloured(evaluations: Sequence[Evaluation]) -> Iterator[tuple[Evaluation, str]]:
    """Each with its colour."""
    return zip(evaluations, itertools.cycle(PALETTE))


def pictures(evaluations: Sequence[Evaluation]) -> "list[tuple[str, Figure]]":
    """Captions and pictures, of evaluations of one manoeuvre, of what their valid runs tell; empty where there is none.

    All runs thin, the first one bold, in one colour for each evaluation; runs to the right with their sign changed.
    """
    drawn = [
        _Drawn(e, [prepared(run, e.manoeuvre) for run in e.valid], colour)
        for e, colour in coloured(evaluations)
        if e.valid and (e.curves or e.manoeuvre.evaluation not in ("steady", "frequency"))
    ]
    made: Mapping[str, Sequence[Callable[[list[_Drawn]], tuple[str, Figure]]]] = {
        "steady": (_characteristic,),
        "frequency": (partial(_response, name="response"), partial(_response, name="response_a_y")),
        "step": (_histories, _answers),
        "on-centre": (_loops,),
        "transition": (_loops, _histories),
    }
    with style():
        return [make(drawn) for make in made.get(evaluations[0].manoeuvre.evaluation, (_histories,))] if drawn else []


def _panels(rows: int, drawn: list[_Drawn], height: float) -> "tuple[Figure, tuple[Axes, ...]]":
    figure, panels = new_figure(rows, width=_WIDTH, height=height)
    if 1 < len(drawn) <= len(PALETTE):
        names = [(one.of.who or one.of.vehicle.name)[:44].replace("$", r"\$") for one in drawn]
        marks = [panels[0].plot([], [], color=one.colour, label=who, lw=2.0)[0] for one, who in zip(drawn, names)]
        figure.legend(handles=marks, loc="outside upper left")
    return figure, panels


def _all(panel: "Axes", drawn: list[_Drawn], x: Callable[[Run], Array], y: Callable[[Run], Array]) -> None:
    for one in drawn:
        for k, run in enumerate(one.runs):
            width, alpha = (0.7, 0.6) if k else (1.7, 1.0)
            panel.plot(x(run), y(run), color=one.colour, lw=width, alpha=alpha, zorder=2 if k else 3)


def _histories(drawn: list[_Drawn]) -> "tuple[str, Figure]":
    """Angle, yaw rate and lateral acceleration over time; on a course over the way, with the cross-track error."""
    m = drawn[0].of.manoeuvre
    names = ["a_y", "delta_sw", "r"] if m.evaluation == "request" else ["delta_sw", "r", "a_y"]
    if m.course and all("e" in run.signals for one in drawn for run in one.runs):
        names.insert(0, "e")
    figure, panels = _panels(len(names), drawn, 0.7 + 1.75 * len(names))
    for name, panel in zip(names, panels):
        label, convert = _LABELS[name]
        panel.set_ylabel(label)
        x = lambda run: np.cumsum(run["v"]) * run.dt if m.course else run.t  # noqa: E731
        _all(panel, drawn, x, lambda run: convert(run[name]))  # noqa: B023
        for limit, _ in drawn[0].of.verdicts:
            for bound in (-limit.high, limit.high) if limit.quantity == f"max_{name}" else ():
                panel.axhline(bound, color=COLOURS["limit"], ls="--", lw=1.0)
    panels[-1].set_xlabel("distance [m]" if m.course else "time [s]")
    said = "All runs that count, the first one bold; those to the right with their sign changed."
    if m.course:
        return said + (" Dashed: the limit." if drawn[0].of.verdicts else ""), figure
    panels[-1].set_xlim(left=-1.0)
    if m.evaluation == "dwell":
        for late in (1.0, 1.75):
            panels[1].axvline(turned(drawn[0].runs[0])[1] + late, color=COLOURS["limit"], ls="--", lw=1.0)
        said += " Dashed: 1.00 and 1.75 s after the input, where the yaw rate is judged."
    if m.evaluation == "request":
        for k, one in enumerate(drawn):
            run, per_a_y = one.runs[0], one.of.vehicle.wheel_per_a_y(m.conditions.v)
            asked, use = run.signals.get("delta_sw_cmd", run["delta_sw"]), run.between(-1.0, m.seconds - 2.0 * run.dt)
            label = "" if k else "requested"
            panels[0].plot(run.t[use], asked[use] / per_a_y, color=COLOURS["ink"], ls="--", zorder=4, label=label)
        panels[0].plot([], [], color=drawn[0].colour, label="actual")
        panels[0].legend(loc="upper right")
        said += " Requested: what the commanded angle, or the wheel's where none is known, asks; on the same axis."
    return said, figure


def _answers(drawn: list[_Drawn]) -> "tuple[str, Figure]":
    """Yaw rate and lateral acceleration over their steady values, with what ISO 7401 reads from them."""
    seconds, levels = drawn[0].of.manoeuvre.seconds, (0.5, 0.9)

    def share(run: Run, name: str) -> Array:
        x = run.about(name)
        return np.asarray(x / x[run.between(seconds - 1.0, seconds)].mean())

    figure, panels = _panels(2, drawn, 4.2)
    for panel, name in zip(panels, ("r", "a_y")):
        panel.axhspan(0.9, 1.1, color=COLOURS["goal"], alpha=0.35, lw=0.0)
        panel.set_ylabel(f"{name} over its\nsteady value [1]")
        _all(panel, drawn, lambda run: run.t, lambda run: share(run, name))  # noqa: B023
        for one in drawn:
            run = one.runs[0]
            after = run.between(0.0, seconds)
            times = [crossing(run.t[after], share(run, name)[after], level) for level in levels]
            panel.plot(times, levels, "o", color=one.colour, ms=5.0, zorder=4)
            panel.vlines(times, 0.0, levels, color=one.colour, ls=":", lw=1.0)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(-0.3, min(seconds, 2.5))
    return "Green: within 10 % of the steady value. Points: 50 % and 90 % of it, by the first run.", figure


def _characteristic(drawn: list[_Drawn]) -> "tuple[str, Figure]":
    """Steering-wheel angle over lateral acceleration, and what of it is beyond Ackermann's."""
    figure, panels = _panels(2, drawn, 5.2)
    for one in drawn:
        car, a_y, wheel = one.of.vehicle, one.of.curves["a_y"], one.of.curves["wheel"]
        ackermann = float(car.steer_ratio) * float(car.wheelbase) * one.of.curves["r"] / one.of.curves["v"]
        slope = float(car.steer_ratio) * one.of["understeer_gradient"].value
        beyond = wheel - ackermann
        fit = slope * (a_y - a_y.mean()) + beyond.mean()
        order = np.argsort(a_y)
        for panel, points, line in ((panels[0], wheel, ackermann + fit), (panels[1], beyond, fit)):
            panel.plot(a_y, degrees_of(points), "o", color=one.colour, ms=4.0)
            panel.plot(a_y[order], degrees_of(line[order]), color=one.colour)
        panels[0].plot(a_y[order], degrees_of(ackermann[order]), color=one.colour, ls="--")
    panels[0].set_ylabel("steering wheel [deg]")
    panels[1].set_ylabel("beyond Ackermann's\nangle [deg]")
    panels[1].set_xlabel("lateral acceleration [m/s^2], + = left")
    return "Characteristic curve: points, fitted line; dashed: Ackermann's angle (steering ratio x L r/v).", figure


def _response(drawn: list[_Drawn], name: str) -> "tuple[str, Figure]":
    """Gain, phase and, of the yaw rate, coherence over frequency; the fitted model, where there is one."""
    of_yaw = name == "response"
    scale, unit = (1.0, "1/s") if of_yaw else (radians_of(1.0), "m/s^2/deg")
    figure, panels = _panels(3 if of_yaw else 2, drawn, 6.0 if of_yaw else 4.2)
    for one in drawn:
        curves, f = one.of.curves, one.of.curves["f"]
        for curve, look in ((name, "o"), *([("model", "-")] if of_yaw and "model" in curves else [])):
            panels[0].plot(f, scale * np.abs(curves[curve]), look, color=one.colour, ms=3.0)
            panels[1].plot(f, degrees_of(np.unwrap(np.angle(curves[curve]))), look, color=one.colour, ms=3.0)
        if of_yaw:
            panels[2].plot(f, curves["coherence"], "o", color=one.colour, ms=3.0)
            panels[2].set_ylim(0.0, 1.05)
    for panel, label in zip(panels, (f"gain [{unit}]", "phase [deg]", "coherence [1]")):
        panel.set_ylabel(label)
    panels[0].set_xscale("log")
    panels[0].set_ylim(bottom=0.0)
    panels[-1].minorticks_off()
    panels[-1].set_xticks((0.1, 0.2, 0.5, 1.0, 2.0, 5.0), ("0.1", "0.2", "0.5", "1", "2", "5"))
    panels[-1].set_xlim(0.9 * f.min(), 1.1 * f.max())
    panels[-1].set_xlabel("frequency [Hz]")
    what = "yaw rate: points; line: the fitted model." if of_yaw else "lateral acceleration."
    return f"From the steering-wheel angle to the {what}", figure


def _loops(drawn: list[_Drawn]) -> "tuple[str, Figure]":
    """Lateral acceleration and yaw rate over the angle: of whole periods, or while the wheel turns."""
    m = drawn[0].of.manoeuvre
    form = m.required
    periods = (1.0 / form.frequency, (form.periods - 1.0) / form.frequency)
    begin, end = periods if m.evaluation == "on-centre" else (0.0, form.rise)
    cut = lambda run, name: run[name][run.between(begin, end)]  # noqa: E731
    figure, panels = _panels(2, drawn, 5.2)
    for panel, name in zip(panels, ("a_y", "r")):
        label, convert = _LABELS[name]
        panel.set_ylabel(label)
        _all(panel, drawn, lambda run: degrees_of(cut(run, "delta_sw")), lambda run: convert(cut(run, name)))  # noqa: B023
        panel.axhline(0.0, color=COLOURS["muted"], lw=0.7, zorder=1)
        panel.axvline(0.0, color=COLOURS["muted"], lw=0.7, zorder=1)
    panels[-1].set_xlabel("steering wheel [deg]")
    return "The answer over the steering-wheel angle, all runs that count.", figure


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
