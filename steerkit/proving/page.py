"""A manoeuvre's report as one HTML page: verdict, pictures, results, runs, and what ISO 7401 asks a report to state."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from steerkit._support.errors import require
from steerkit._support.files import File, toml_of, write_text
from steerkit.diagram.units import FACTORS, degrees_of, radians_of
from steerkit.logs.channels import Array
from steerkit.plots.page import Html, document, html, picture, table
from steerkit.plots.style import COLOURS, PALETTE, new_figure, styled
from steerkit.proving.evaluate import Evaluation, Result, crossing
from steerkit.proving.manoeuvre import Manoeuvre
from steerkit.proving.runs import Run, prepared

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_WORDS = toml_of(Path(__file__).with_name("words.toml").read_text(encoding="utf-8"), "words.toml")
_JUDGED = {True: ("passed", "good"), False: ("failed", "bad"), None: ("not judged", "open")}
_KEPT = {True: "kept", False: "not kept", None: "not judged"}
_WIDTH = 4.6  # inches: letters stay readable on a phone
_SETTINGS = ("repeats", "sides", "cutoff", "sensor_x")
_NO_CAR = "Simulated; no car was driven."


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
    facts = {
        "how": "not said",
        "date": "not said",
        "load": "as the vehicle file has it",
        "tyres": "as the vehicle file has them",
        "instruments": "not said",
    }
    simulated = general.get("how", "").startswith("simulat")
    if simulated:
        facts |= {"date": time.strftime("%Y-%m-%d"), "instruments": "none, the simulation's own signals"}
    facts |= general
    notes = [f"{e.who}: {note}" if len(evaluations) > 1 else note for e in evaluations for note in e.notes]
    figures = [picture(figure, caption) for caption, figure in _figures(evaluations)]
    verdicts = [_verdict(e, colour) for e, colour in _coloured(evaluations)]
    parted = "</div><div class=beside>" if len(evaluations) > 1 else ""
    parts = [
        Html(f"<h1>{html(manoeuvre.title)}</h1><p>{html(manoeuvre.norm)}<br>{html(manoeuvre.about)}</p>"),
        Html(f"<div class=beside>{''.join(verdicts)}{parted}{''.join(figures)}</div>"),
        Html("<h2>Results</h2>" + _results(evaluations)),
        Html("<h2>Runs</h2>" + _runs(evaluations)),
        Html("<h2>General data</h2>" + table(("", ""), facts.items())),
        Html("<h2>Cars</h2>" + _cars(evaluations)),
        Html("<h2>Method</h2>" + _method(manoeuvre)),
        Html("<h2>Notes</h2><ul>" + "".join(f"<li>{html(note)}</li>" for note in notes or ["none"]) + "</ul>"),
    ]
    closing = _NO_CAR if simulated else ""
    write_text(file, document(manoeuvre.title, "\n".join(parts), command=command, closing=closing))


# ---- words and tables ---------------------------------------------------------------------------------------------


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
    told = math.isfinite(result.low) and math.isfinite(result.high)
    return f"{_number(result.low)} to {_number(result.high)}" if told else "none"


def _said(result: Result) -> str:
    """Value, interval, and in degrees."""
    beside = _beside(result.value, result.unit)
    interval = _interval(result)
    more = [f"95 % interval {interval}" if interval != "none" else "no interval", *([beside] if beside else [])]
    return f"{_with_unit(result.value, result.unit)} ({'; '.join(more)})"


def _words(quantity: str) -> str:
    return str(_WORDS["results"].get(quantity, quantity))


def _who(e: Evaluation, colour: str) -> Html:
    return Html(f"<i class=dot style='background:{colour}'></i>{html(e.who or e.vehicle.name)}")


def _coloured(evaluations: Sequence[Evaluation]) -> Iterator[tuple[Evaluation, str]]:
    return zip(evaluations, itertools.cycle(PALETTE))


def _verdict(e: Evaluation, colour: str) -> Html:
    word, tone = _JUDGED[e.passed]
    known, lines = {result.quantity: result for result in e.results}, list[str]()
    for limit, passed in e.verdicts:
        result = known.get(limit.quantity)
        bounds = f"limit {limit.text()}" + (f" {result.unit}" if result and result.unit != "1" else "")
        astride = result and any(result.low < bound < result.high for bound in (limit.low, limit.high))
        doubt = "; the interval reaches beyond the limit" if astride else ""
        said = f"{_said(result) if result else 'not evaluated'}, {bounds}: "
        lines.append(
            f"{html(_words(limit.quantity))}: {html(said)}<b class={_JUDGED[passed][1]}>{_KEPT[passed]}</b>{doubt}"
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


def _results(evaluations: Sequence[Evaluation]) -> Html:
    rows, before = list[tuple[object, ...]](), ""
    for quantity in dict.fromkeys(result.quantity for e in evaluations for result in e.results):
        for e, colour in _coloured(evaluations):
            for r in e.results:
                if r.quantity == quantity:
                    first = not rows or quantity != before
                    before = quantity
                    value = Html(f"<b>{_fixed(_with_unit(r.value, r.unit))}</b>")
                    cells = (value, _fixed(_interval(r)), _fixed(_beside(r.value, r.unit)), r.n, r.note)
                    rows.append((_words(quantity) if first else "", _who(e, colour), *cells))
    return table(("quantity", "car", "value", "95 % interval", "that is", "repeats", "note"), rows)


def _runs(evaluations: Sequence[Evaluation]) -> Html:
    rows = []
    for e, colour in _coloured(evaluations):
        for run in e.runs:
            counts = Html(f"<b class=bad>no</b>: {html(run.invalid)}") if run.invalid else "yes"
            speed = _with_unit(float(run["v"].mean()), "m/s")
            rows.append((_who(e, colour), run.number, run.side, speed, f"{run.t[-1] - run.t[0]:.1f} s", counts))
    return table(("car", "number", "side", "mean speed", "length", "counts"), rows)


def _cars(evaluations: Sequence[Evaluation]) -> Html:
    def of(e: Evaluation) -> dict[str, str]:
        car, m = e.vehicle, e.manoeuvre
        numbers = {
            "mass": (car.m, "kg"),
            "wheelbase": (car.wheelbase, "m"),
            "centre of gravity to front axle": (car.l_f, "m"),
            "yaw inertia": (car.i_z, "kg m^2"),
            "cornering stiffness, front axle": (car.c_f, "N/rad"),
            "cornering stiffness, rear axle": (car.c_r, "N/rad"),
            "steering ratio": (car.steer_ratio, "1"),
            "friction": (car.mu, "1"),
        }
        told = {name: _with_unit(float(value), unit) for name, (value, unit) in numbers.items()}
        if m.input:
            angle = m.input.angle(car, m.conditions.v)
            told["steering-wheel angle of the input"] = f"{_number(angle)} rad, {_beside(angle, 'rad')}"
        if e.runs:
            told |= {"sampling rate": f"{1.0 / e.runs[0].dt:.4g} Hz", "signals": ", ".join(e.runs[0].signals)}
        return {"vehicle file": car.name, **told}

    columns = [of(e) for e in evaluations]
    names = dict.fromkeys(name for column in columns for name in column)
    head = ("", *(_who(e, colour) for e, colour in _coloured(evaluations)))
    return table(head, ((name, *(column.get(name, "") for column in columns)) for name in names))


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
            text = ", ".join(str(_WORDS["forms"].get(item, item)) for item in listed)
            if plain:
                beside = _beside(value, unit)
                text = _fixed(_with_unit(value, unit) + (f", {beside}" if beside else ""))
            source = m.sources.get(key, "" if f.default is MISSING else "steerkit's default")
            if "unverified" in source:
                source = Html(f"<b class=open>unverified</b>: {html(source.rpartition(': ')[2])}")
            rows.append((_WORDS["settings"].get(key, key), text, source))
    text = (
        "The input begins at t = 0. Runs to the right change their sign before they are evaluated. "
        f"Unverified, as the norm's text was not at hand: {len(m.unverified)} of {len(rows)} numbers."
    )
    return Html(f"<p>{html(text)}</p>" + table(("", "value", "source"), rows))


# ---- pictures -----------------------------------------------------------------------------------------------------


class _Drawn(NamedTuple):
    """Whose runs are drawn, and how."""

    of: Evaluation
    runs: list[Run]
    colour: str

    @property
    def label(self) -> str:
        who = self.of.who or self.of.vehicle.name
        return (who if len(who) <= 44 else f"{who[:43]}...").replace("$", r"\$")


_SIGNALS: Mapping[str, tuple[str, Callable[[Any], Any]]] = {
    "e": ("cross-track error [m]", lambda x: x),
    "delta_sw": ("steering wheel [deg]", degrees_of),
    "r": ("yaw rate [deg/s]", degrees_of),
    "a_y": ("lateral acceleration\n[m/s^2]", lambda x: x),
}


def _figures(evaluations: Sequence[Evaluation]) -> list[tuple[str, Figure]]:
    """Captions and pictures of whatever valid runs tell."""
    drawn = [
        _Drawn(e, [prepared(run, e.manoeuvre) for run in e.valid], colour)
        for e, colour in _coloured(evaluations)
        if e.valid
    ]
    kind = evaluations[0].manoeuvre.evaluation
    if kind in ("steady", "frequency"):
        drawn = [one for one in drawn if one.of.curves]
        made = {"steady": [_characteristic], "frequency": [_bode, _bode_a_y]}[kind]
    else:
        made = {"step": [_histories, _answers], "on-centre": [_loops], "transition": [_loops, _histories]}.get(
            kind, [_histories]
        )
    return [make(drawn) for make in made] if drawn else []


def _panels(rows: int, drawn: list[_Drawn], height: float = 0.0) -> tuple[Figure, tuple[Axes, ...]]:
    figure, panels = new_figure(rows, width=_WIDTH, height=height or 0.7 + 1.75 * rows)
    if 1 < len(drawn) <= len(PALETTE):
        marks = [panels[0].plot([], [], color=one.colour, label=one.label, lw=2.0)[0] for one in drawn]
        figure.legend(handles=marks, loc="outside upper left", ncols=1)
    return figure, panels


def _all(panel: Axes, one: _Drawn, x: Callable[[Run], Array], y: Callable[[Run], Array]) -> None:
    """All runs thin, the first bold."""
    for k, run in enumerate(one.runs):
        width, alpha = (0.7, 0.6) if k else (1.7, 1.0)
        panel.plot(x(run), y(run), color=one.colour, lw=width, alpha=alpha, zorder=2 if k else 3)


@styled
def _histories(drawn: list[_Drawn]) -> tuple[str, Figure]:
    """Angle, yaw rate and lateral acceleration over time; on a course, the cross-track error too, over the way."""
    m = drawn[0].of.manoeuvre
    names = ["delta_sw", "r", "a_y"]
    if m.evaluation == "course" and all("e" in run.signals for one in drawn for run in one.runs):
        names.insert(0, "e")
    if m.evaluation == "request":
        names = ["a_y", "delta_sw", "r"]
    x = (lambda run: np.cumsum(run["v"]) * run.dt) if m.course else (lambda run: run.t)
    figure, panels = _panels(len(names), drawn)
    for name, panel in zip(names, panels):
        label, convert = _SIGNALS[name]
        panel.set_ylabel(label)
        for one in drawn:
            _all(panel, one, x, lambda run: convert(run[name]))  # noqa: B023
        for verdict in drawn[0].of.verdicts:
            if verdict.limit.quantity == f"max_{name}":
                for sign in (-1.0, 1.0):
                    panel.axhline(sign * verdict.limit.high, color=COLOURS["limit"], ls="--", lw=1.0)
    said = "All runs that count, the first one bold; those to the right with their sign changed."
    if m.course:
        said += " Dashed: the limit."
    elif m.evaluation == "dwell":
        end = 1.0 / m.required.frequency + m.required.dwell
        for late in (1.0, 1.75):
            panels[1].axvline(end + late, color=COLOURS["limit"], ls="--", lw=1.0)
        said += " Dashed: 1.00 and 1.75 s after the input, where the yaw rate is judged."
    elif m.evaluation == "request":
        for k, one in enumerate(drawn):
            run, per_a_y = one.runs[0], m.at(a_y=1.0).required.angle(one.of.vehicle, m.conditions.v)
            asked = run["delta_sw_cmd" if "delta_sw_cmd" in run.signals else "delta_sw"] / per_a_y
            panels[0].plot(run.t, asked, color=COLOURS["ink"], ls="--", lw=1.0, label="" if k else "requested")
        panels[0].plot([], [], color=drawn[0].colour, label="actual")
        panels[0].legend(loc="upper right")
        said += " Requested: what the commanded angle, or the wheel's where none is known, asks; on the same axis."
    panels[-1].set_xlabel("distance [m]" if m.course else "time [s]")
    if m.input:
        panels[-1].set_xlim(left=-1.0)
    return said, figure


@styled
def _answers(drawn: list[_Drawn]) -> tuple[str, Figure]:
    """Yaw rate and lateral acceleration over their steady values, with what ISO 7401 reads from them."""
    seconds = drawn[0].of.manoeuvre.seconds

    def share(run: Run, name: str) -> Array:
        before = run.between(-1.0, -run.dt)
        x = run[name] - (run[name][before].mean() if before.any() else 0.0)
        return np.asarray(x / x[run.between(seconds - 1.0, seconds)].mean())

    figure, panels = _panels(2, drawn, 4.2)
    for panel, name in zip(panels, ("r", "a_y")):
        panel.axhspan(0.9, 1.1, color=COLOURS["goal"], alpha=0.35, lw=0.0)
        panel.set_ylabel(f"{name} over its\nsteady value [1]")
        for one in drawn:
            _all(panel, one, lambda run: run.t, lambda run: share(run, name))  # noqa: B023
            first = one.runs[0]
            after = first.between(0.0, seconds)
            levels = (0.5, 0.9)
            times = [crossing(first.t[after], share(first, name)[after], level) for level in levels]
            panel.plot(times, levels, "o", color=one.colour, ms=5.0, zorder=4)
            panel.vlines(times, 0.0, levels, color=one.colour, ls=":", lw=1.0)
    panels[-1].set_xlabel("time [s]")
    panels[-1].set_xlim(-0.3, min(seconds, 2.5))
    return "Green: within 10 % of the steady value. Points: 50 % and 90 % of it, by the first run.", figure


@styled
def _characteristic(drawn: list[_Drawn]) -> tuple[str, Figure]:
    """Steering-wheel angle over lateral acceleration, and what of it is beyond Ackermann's."""
    figure, panels = _panels(2, drawn, 5.2)
    for one in drawn:
        curves, car, gradient = one.of.curves, one.of.vehicle, one.of["understeer_gradient"].value
        ratio = float(car.steer_ratio)
        a_y, wheel = curves["a_y"], curves["wheel"]
        ackermann = ratio * float(car.wheelbase) * curves["r"] / curves["v"]
        beyond = wheel - ackermann
        fit = ratio * gradient * (a_y - a_y.mean()) + beyond.mean()
        order = np.argsort(a_y)
        for panel, points, line in ((panels[0], wheel, ackermann + fit), (panels[1], beyond, fit)):
            panel.plot(a_y, degrees_of(points), "o", color=one.colour, ms=4.0)
            panel.plot(a_y[order], degrees_of(line[order]), color=one.colour)
        panels[0].plot(a_y[order], degrees_of(ackermann[order]), color=one.colour, ls="--")
    panels[0].set_ylabel("steering wheel [deg]")
    panels[1].set_ylabel("beyond Ackermann's\nangle [deg]")
    panels[-1].set_xlabel("lateral acceleration [m/s^2], + = left")
    return "Characteristic curve: points, fitted line; dashed: Ackermann's angle (steering ratio x L r/v).", figure


def _bode(drawn: list[_Drawn]) -> tuple[str, Figure]:
    return _response(drawn, "response", "yaw rate", "1/s", 1.0)


def _bode_a_y(drawn: list[_Drawn]) -> tuple[str, Figure]:
    return _response(drawn, "response_a_y", "lateral acceleration", "m/s^2/deg", radians_of(1.0))


@styled
def _response(drawn: list[_Drawn], name: str, what: str, unit: str, scale: float) -> tuple[str, Figure]:
    """Gain, phase and, of the yaw rate, coherence over frequency; the fitted model, where there is one."""
    fitted = name == "response"
    figure, panels = _panels(3 if fitted else 2, drawn)
    for one in drawn:
        f = one.of.curves["f"]
        styles: list[tuple[str, dict[str, Any]]] = [(name, {"marker": "o", "ls": "", "ms": 3.0})]
        if fitted and "model" in one.of.curves:
            styles.append(("model", {"lw": 1.4}))
        for curve, look in styles:
            response = one.of.curves[curve]
            panels[0].plot(f, scale * np.abs(response), color=one.colour, **look)
            panels[1].plot(f, degrees_of(np.unwrap(np.angle(response))), color=one.colour, **look)
        if fitted:
            panels[2].plot(f, one.of.curves["coherence"], "o", color=one.colour, ms=3.0)
            panels[2].set_ylim(0.0, 1.05)
            panels[2].set_ylabel("coherence [1]")
    panels[0].set_xscale("log")
    panels[0].set_ylim(bottom=0.0)
    panels[-1].minorticks_off()
    panels[-1].set_xticks((0.1, 0.2, 0.5, 1.0, 2.0, 5.0), ("0.1", "0.2", "0.5", "1", "2", "5"))
    panels[-1].set_xlim(0.9 * f.min(), 1.1 * f.max())
    panels[0].set_ylabel(f"gain [{unit}]")
    panels[1].set_ylabel("phase [deg]")
    panels[-1].set_xlabel("frequency [Hz]")
    return f"From the steering-wheel angle to the {what}: points{'; line: the fitted model' if fitted else ''}.", figure


@styled
def _loops(drawn: list[_Drawn]) -> tuple[str, Figure]:
    """Lateral acceleration and yaw rate over the angle."""
    m = drawn[0].of.manoeuvre
    form = m.required
    whole = (1.0 / form.frequency, (form.periods - 1.0) / form.frequency)
    begin, end = whole if m.evaluation == "on-centre" else (0.0, form.rise)
    figure, panels = _panels(2, drawn, 5.2)
    for panel, name in zip(panels, ("a_y", "r")):
        label, convert = _SIGNALS[name]
        panel.set_ylabel(label)
        for one in drawn:
            cut = lambda run, name: run[name][run.between(begin, end)]  # noqa: E731
            _all(panel, one, lambda run: degrees_of(cut(run, "delta_sw")), lambda run: convert(cut(run, name)))  # noqa: B023
        for line in (panel.axhline, panel.axvline):
            line(0.0, color=COLOURS["muted"], lw=0.7, zorder=1)
    panels[-1].set_xlabel("steering wheel [deg]")
    return "The answer over the steering-wheel angle, all runs that count.", figure
