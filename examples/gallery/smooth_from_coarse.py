"""Smooth from coarse: what a dynamic output element makes of a few actions.

The same five actions in the same order, to the wheel directly, through a low-pass, and as steps (the integrator).
"""

from itertools import pairwise

from steerkit import PlainAngle, Integrator, LowPass
from steerkit.plots.style import COLOURS, new_figure
from steerkit.diagram.units import degrees_of, radians_of

ACTIONS_DEG = [*[60] * 4, *[10] * 6, *[0] * 10, *[-10] * 8, *[-60] * 6, *[0] * 12, *[60, -60] * 6, *[10] * 4, *[0] * 8]
figure, panels = new_figure(rows=2, title="One sequence of actions, three output elements")
t = [0.05 * k for k in range(len(ACTIONS_DEG))]
panels[0].step(t, ACTIONS_DEG, where="post", color=COLOURS["muted"])
panels[0].set(ylabel="action [deg]", yticks=(-60, -10, 10, 60))
ELEMENTS = (
    ("plain, times 5", PlainAngle(), 5.0, "muted"),
    ("low-pass, times 5", LowPass(tau=0.3), 5.0, "analytic"),
    ("integrator", Integrator(), 1.0, "learned"),
)
for label, doe, scale, colour in ELEMENTS:
    x, angles = doe.init(), []
    for action_deg in ACTIONS_DEG:
        action = radians_of(scale * action_deg)
        y = doe.output(0.0, x, doe.D(action=action))
        x = doe.update(0.0, x, doe.U(action=action, applied=y.delta_sw), y)
        angles.append(degrees_of(y.delta_sw))
    panels[1].step(t, angles, where="post", color=COLOURS[colour], label=label)
    fastest = max(abs(b - a) for a, b in pairwise(angles)) / 0.05
    print(f"{label}: the wheel would have to turn at {fastest:.0f} deg/s")
panels[1].set(xlabel="t [s]", ylabel="steering wheel [deg]")
panels[1].legend(loc="upper right", bbox_to_anchor=(1.0, 1.12), ncols=3, frameon=False, fontsize=8)
figure.savefig("smooth_from_coarse.png")
