"""A moved target comes to a lost car and goes back slowly."""

import math

import pytest

from steerkit.controllers.target_shift import TargetShift
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from tests.support.parts import Script


def test_the_target_comes_to_a_lost_car_and_goes_back_slowly() -> None:
    shift = TargetShift(limit=1.0, rate=0.4)
    e = Script(values=(0.2, 0.6, 0.6, 0.6, 0.6, 3.0, 3.0, 3.0))
    e_dot = Script(values=(0.1,))
    loop = Loop(
        blocks={"e": e, "e_dot": e_dot, "shift": shift},
        wires=[(e.length, shift.e_path), (e_dot.speed, shift.e_dot_path)],
    )
    log = simulate(loop, 8 * 0.05, record=["shift.e", "shift.e_dot", "shift.shift"])
    assert log["shift.shift"] == pytest.approx([0.0, 0.0, 0.605, 0.585, 0.565, 0.545, 1.0, 1.0])
    assert log["shift.e"] == pytest.approx([0.2, 0.6, -0.005, 0.015, 0.035, 2.455, 2.0, 2.0])
    assert log["shift.e_dot"] == pytest.approx([0.1, 0.1, *[0.5] * 6])


@pytest.mark.parametrize(
    ("before", "e_path", "e_dot_path", "after"),
    [
        (0.0, 0.5, 0.2, 0.0),  # at the trip itself
        (0.0, 0.501, 0.2, 0.511),
        (0.0, 3.0, 0.0, 1.5),
        (0.0, -3.0, 0.0, -1.5),
        (1.0, 1.0, 0.0, 1.0 - 0.0125),
        (-1.0, -1.0, 0.0, -1.0 + 0.0125),
        (0.01, 0.0, 0.0, 0.0),
        (1.0, math.nan, 0.0, 1.0 - 0.0125),
        (1.0, 5.0, math.nan, 1.0 - 0.0125),
    ],
)
def test_a_sample_by_hand(before: float, e_path: float, e_dot_path: float, after: float) -> None:
    shift, x = TargetShift(), (before,)
    y = shift.output(0.0, x, shift.D(e_path, e_dot_path))
    assert shift.update(0.0, x, shift.U(e_path, e_dot_path), y)[0] == pytest.approx(after, abs=1e-12)
