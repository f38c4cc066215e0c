"""What a test engineer expects to see of a manoeuvre: histories, a characteristic curve, a Bode diagram, loops."""

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from steerkit.diagram.units import degrees_of, radians_of
from steerkit.logs.channels import Array
from steerkit.plots.style import COLOURS, PALETTE, new_figure, style
from steerkit.proving.evaluate import Evaluation, crossing, turned
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
