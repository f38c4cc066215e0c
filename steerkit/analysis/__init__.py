"""Linear analysis of loops with python-control: linearise, break open, margins; and systems to and from it::

    L = break_at(loop, "controller.delta_sw")       # a control.StateSpace; closed loop = control.feedback(L)
    print(margins(L), L.poles());  plot_bode({"Stanley": L})

A loop with several sample times is taken over its whole period, after which all blocks sample together again: one step
of the result is one period. That is exact and no approximation by the slowest block (lifting: Meyer, Burrus 1975).
"""

from steerkit.analysis.linear import Margins as Margins
from steerkit.analysis.linear import NotTimeInvariantError as NotTimeInvariantError
from steerkit.analysis.linear import Point as Point
from steerkit.analysis.linear import UnstableError as UnstableError
from steerkit.analysis.linear import break_at as break_at
from steerkit.analysis.linear import linearise as linearise
from steerkit.analysis.linear import margins as margins
from steerkit.analysis.linear import over as over
from steerkit.analysis.linear import plot_bode as plot_bode
from steerkit.analysis.linear import plot_over as plot_over
from steerkit.analysis.linear import plot_steps as plot_steps
from steerkit.analysis.linear import step_response as step_response
from steerkit.analysis.systems import FromControl as FromControl
from steerkit.analysis.systems import Tap as Tap
from steerkit.analysis.systems import to_control as to_control
