"""Linear analysis of loops with python-control: linearise, break open, margins; and systems to and from it::

    L = break_at(loop, "controller.delta_sw")       # a control.StateSpace; closed loop = control.feedback(L)
    print(margins(L), L.poles());  plot_bode({"Stanley": L})

A loop with several sample times is taken over its whole period, after which all blocks sample together again: one step
of the result is one period. That is exact and no approximation by the slowest block (lifting: Meyer, Burrus 1975).
"""

from __future__ import annotations

from steerkit.analysis.linear import (
    Margins,
    NotTimeInvariantError,
    Point,
    UnstableError,
    break_at,
    linearise,
    margins,
    over,
    step_response,
)
from steerkit.analysis.period import Tap
from steerkit.analysis.pictures import plot_bode, plot_over, plot_steps
from steerkit.analysis.systems import FromControl, to_control

__all__ = [
    "FromControl",
    "Margins",
    "NotTimeInvariantError",
    "Point",
    "Tap",
    "UnstableError",
    "break_at",
    "linearise",
    "margins",
    "over",
    "plot_bode",
    "plot_over",
    "plot_steps",
    "step_response",
    "to_control",
]
