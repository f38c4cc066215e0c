"""Pictures: the right lines in the right panels; a diagram in which nothing overlaps and every wire arrives."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from steerkit.assembly import placed, steering_loop
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.stanley import Stanley
from steerkit.courses import circle
from steerkit.doe import Integrator
from steerkit.loop import Loop
from steerkit.plants.human_driver import HumanDriver
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.sensors import Sensors
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.plots.arrange import Diagram, arrange
from steerkit.plots.course import plot_course
from steerkit.plots.log import plot_log
from steerkit.plots.style import new_figure
from steerkit.simulation import simulate
from steerkit.vehicles import vehicle
from tests.support.parts import Angle, Count, Delay, Gain, Pair, Sum, Wave

PASSAT = vehicle("vw-passat")


def small() -> Loop:
    wave, gain, angle, pair, late = Wave(), Gain(), Angle(), Pair(), Delay(dt=0.1)
    wires = [(wave.v, gain.u), (gain.y, angle.u), (gain.y, pair.u), (gain.y, late.u)]
    return Loop(blocks={"wave": wave, "gain": gain, "angle": angle, "pair": pair, "late": late}, wires=wires)


def learning(sensors: Any = None) -> Loop:
    return steering_loop(
        car=placed(LinearSingleTrack(vehicle=PASSAT, v0=5.0), circle()),
        path=circle(),
        driver=HumanDriver(),
        controller=NfqPolicy(),
        doe=Integrator(),
        recovery=Stanley.of(PASSAT),
        actuator=SteeringActuator(),
        sensors=sensors,
    )


def backward() -> Loop:
    """Feedback only: every block feeds one before it."""
    a, b, c = Delay(), Delay(), Sum()
    return Loop(blocks={"a": a, "b": b, "c": c}, wires=[(b.y, a.u), (c.total, b.u), (a.y, c.u)])


LOOPS = {
    "one": lambda: Loop(blocks={"count": Count()}, wires=[]),
    "itself": lambda: (lambda total: Loop(blocks={"total": total}, wires=[(total.total, total.u)]))(Sum()),
    "small": small,
    "backward": backward,
    "learning": learning,
    "sensors": lambda: learning(Sensors()),
}
loops = pytest.mark.parametrize("name", LOOPS)


# ---- logs ---------------------------------------------------------------------------------------------------------


def test_one_panel_a_unit_over_the_same_time() -> None:
    log = simulate(small(), 2.0)
    figure = log.plot("wave.v", "angle.angle", "gain.y")
    assert isinstance(figure, Figure)
    metres, radians = figure.axes
    assert [line.get_label() for line in metres.get_lines()] == ["wave.v", "gain.y"]
    np.testing.assert_array_equal(metres.get_lines()[0].get_xydata(), np.column_stack((log.t, log["wave.v"])))
    assert metres.get_ylabel() == "[m]"
    assert radians.get_ylabel() == "angle.angle [rad]"
    assert metres.get_legend() is not None
    assert radians.get_legend() is None
    assert radians.get_xlabel() == "t [s]"
    assert metres.get_shared_x_axes().joined(metres, radians)
    assert len({line.get_color() for line in metres.get_lines()}) == 2


def test_by_default_all_signals_with_a_line_an_entry() -> None:
    figure = simulate(small(), 1.0).plot()
    assert sum(len(axes.get_lines()) for axes in figure.axes) == 6
    batch = simulate(small(), 1.0, batch=7).plot("wave.v")
    assert len(batch.axes[0].get_lines()) == 7
    assert batch.axes[0].get_lines()[0].get_label() == "wave.v (7)"


def test_signals_may_be_ports() -> None:
    loop = small()
    log = simulate(loop, 1.0)
    assert plot_log(log, [loop.blocks["gain"].y]).axes[0].get_lines()[0].get_label() == "gain.y"
    with pytest.raises(KeyError, match=r"no signal 'gain.z' in the log"):
        log.plot("gain.z")


def test_drawing_into_given_axes() -> None:
    log = simulate(small(), 1.0)
    figure, (top, low) = new_figure(2, title="mine")
    assert log.plot("wave.v", "angle.angle", ax=(top, low)) is figure
    assert len(top.get_lines()) == len(low.get_lines()) == 1
    with pytest.raises(ValueError, match=r"plot_log: 1 axes for 2 units \(m, rad\)"):
        log.plot("wave.v", "angle.angle", ax=top)


def test_a_map_beside_the_panels_comes_first() -> None:
    figure, axes = new_figure(3, title="round", map_beside=True)
    assert len(axes) == len(figure.axes) == 4
    assert axes[1].get_shared_x_axes().joined(axes[1], axes[3])
    assert not axes[0].get_shared_x_axes().joined(axes[0], axes[1])


def test_a_course_shows_its_curvature() -> None:
    axes = {panel.get_ylabel(): panel for panel in plot_course(circle(25.0)).axes}
    drawn = np.asarray(axes["y [m]"].get_lines()[0].get_xydata())[:-1]
    np.testing.assert_allclose(np.hypot(*(drawn - drawn.mean(axis=0)).T), 25.0, rtol=1e-3)
    np.testing.assert_allclose(np.asarray(axes["kappa [1/m]"].get_lines()[-1].get_ydata()), 1.0 / 25.0, rtol=1e-3)


# ---- diagrams -----------------------------------------------------------------------------------------------------


def segments(picture: Diagram) -> list[tuple[int, tuple[float, float], tuple[float, float]]]:
    """(number of the wire, from, to) of all straight pieces."""
    return [(n, a, b) for n, line in enumerate(picture.lines) for way in line.ways for a, b in pairwise(way)]


@loops
def test_every_wire_runs_from_its_output_to_all_its_inputs(name: str) -> None:
    loop = LOOPS[name]()
    picture = arrange(loop)
    at = {
        (box.name, port): (x, box.y + y)
        for box in picture.boxes
        for ports, x in ((box.inputs, box.x), (box.outputs, box.x + box.width))
        for port, y in ports.items()
    }
    drawn = {(way[0], way[-1]) for line in picture.lines for way in line.ways}
    wired = {tuple(at[tuple(loop.port_name(port).split("."))] for port in wire) for wire in loop.wires}
    assert drawn == wired
    assert sum(len(line.ways) for line in picture.lines) == len(loop.wires)


@loops
def test_wires_run_straight_and_never_through_a_box(name: str) -> None:
    picture = arrange(LOOPS[name]())
    for _, (x0, y0), (x1, y1) in segments(picture):
        assert x0 == pytest.approx(x1) or y0 == pytest.approx(y1)
        for box in picture.boxes:
            apart = (
                max(x0, x1) <= box.x + 1e-9
                or min(x0, x1) >= box.x + box.width - 1e-9
                or max(y0, y1) <= box.y
                or min(y0, y1) >= box.y + box.height
            )
            assert apart, f"a wire runs through {box.name}"


@loops
def test_boxes_do_not_overlap_and_are_inside(name: str) -> None:
    picture = arrange(LOOPS[name]())
    for k, a in enumerate(picture.boxes):
        assert a.x >= 0.0
        assert a.y >= 0.0
        assert a.x + a.width <= picture.width + 1e-9
        assert a.y + a.height <= picture.height + 1e-9
        for b in picture.boxes[:k]:
            beside = a.x >= b.x + b.width or b.x >= a.x + a.width
            assert beside or a.y >= b.y + b.height or b.y >= a.y + a.height


@loops
def test_different_wires_never_lie_on_each_other(name: str) -> None:
    pieces = segments(arrange(LOOPS[name]()))
    for k, (n, a, b) in enumerate(pieces):
        for other, c, d in pieces[:k]:
            for axis in (0, 1):  # both along this axis, at the same place on the other one
                across = 1 - axis
                along = a[across] == b[across] and c[across] == d[across] and abs(a[across] - c[across]) < 0.2
                low, high = (
                    max(min(a[axis], b[axis]), min(c[axis], d[axis])),
                    min(max(a[axis], b[axis]), max(c[axis], d[axis])),
                )
                assert n == other or not along or high - low < 1e-9


@loops
def test_the_diagram_says_names_units_and_rates(name: str) -> None:
    loop = LOOPS[name]()
    figure = loop.plot()
    said = [text.get_text() for axes in figure.axes for text in axes.texts]
    for block_name, block in loop.blocks.items():
        assert block_name in said
        assert type(block).__name__ in said
        assert f"{1.0 / block.dt:.4g} Hz" in said
        assert {port.name for port in block.inputs} <= set(said)
    for source, _ in loop.wires:
        unit = source.spec.unit
        assert (f"{source.spec.name} [{unit}]" if unit != "1" else source.spec.name) in said


def test_signals_flow_from_left_to_right() -> None:
    boxes = {box.name: box for box in arrange(learning()).boxes}
    order = ["car", "path", "controller", "doe", "supervisor"]
    assert all(boxes[a].x + boxes[a].width < boxes[b].x for a, b in pairwise(order))


def test_texts_fit_into_their_boxes() -> None:
    figure = learning().plot()
    figure.canvas.draw()
    axes = figure.axes[0]
    for box in arrange(learning()).boxes:
        inside = [
            text.get_window_extent().transformed(axes.transData.inverted())
            for text in axes.texts
            if box.x <= text.get_position()[0] <= box.x + box.width
            and box.y <= text.get_position()[1] <= box.y + box.height
        ]
        assert len(inside) == 3 + len(box.inputs) + len(box.outputs) + (not box.outputs)
        for k, a in enumerate(inside):
            assert a.x0 > box.x
            assert a.x1 < box.x + box.width
            assert not any(a.overlaps(b) for b in inside[:k])
