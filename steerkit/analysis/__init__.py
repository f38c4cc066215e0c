"""Linear analysis of loops with python-control: linearise, break open, margins; and systems to and from it.

    L = break_at(loop, "controller.delta_sw")       # a control.StateSpace; closed loop = control.feedback(L)
    print(margins(L), L.poles());  control.bode_plot(L)

A loop with several sample times is taken over its whole period, after which all blocks sample together again: one step
of the result is one period. That is exact and no approximation by the slowest block (lifting: Meyer, Burrus 1975).
"""

from __future__ import annotations

from steerkit.analysis.linear import (
    Margins,
    NotTimeInvariantError,
    Point,
    break_at,
    linearise,
    margins,
    over,
    step_response,
)
from steerkit.analysis.period import Tap
from steerkit.analysis.systems import FromControl, to_control

__all__ = [
    "FromControl", "Margins", "NotTimeInvariantError", "Point", "Tap", "break_at", "linearise", "margins", "over",
    "step_response", "to_control",
]  # fmt: skip
