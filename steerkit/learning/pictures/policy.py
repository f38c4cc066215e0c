"""Pictures of a policy: what its nets expect, and what it would do. How to read them: docs/learning.md."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from steerkit._support.errors import require
from steerkit.controllers.nfq_policy import NfqPolicy, mean_of
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.iterate import patterns
from steerkit.learning.nfq.rprop import forward
from steerkit.plots.style import COLOURS, new_figure, styled
from steerkit.scenario import Scenario
from steerkit.task import TRIP

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]


def q_values(policy: NfqPolicy, s: Array) -> Array:
    """Each net's value of each action (nets, actions, n) for the states s (n, columns); actions in rising order.

    In doubles: in singles the last digits, and so the contours, are another machine's.
    """
    require(bool(policy.nets), "diagnostics", "the policy has no nets, expected at least one; let it learn first")
    d, scale = policy.description, policy.description.scale_of(policy.actions)
    inputs = [patterns(d, s, np.full(len(s), a), scale) for a in sorted(policy.actions)]
    nets = [tuple([part.astype(float) for part in net]) for net in policy.nets or ()]
    return np.array([[forward(net, x) for x in inputs] for net in nets])


def course_angle(scenario: Scenario, doe: Any) -> Any:
    """Angle [rad] between the car's axis and the way its reference point goes, wheel at `doe` [rad], without slip.

        tan(course) = b/L tan(delta),  b: from the rear axle to the reference point, L: wheelbase

    A car that holds the path through a steady bend has psi_e = -course: at the front axle -delta itself.
    """
    car = scenario.nominal
    return np.arctan((car.l_r + scenario.ahead) / car.wheelbase * np.tan(np.asarray(doe) / car.steer_ratio))


def states(
    scenario: Scenario, names: Sequence[str], n: int, *, v: Any, doe: Any = 0.0, psi: Any = 0.0, **more: Any
) -> Array:
    """States (n, columns) that a car can be in: v [m/s], wheel at doe [rad], heading psi [rad] off the steady bend's.

        psi_e = psi - course,  e_dot = v/cos(course) sin(psi),  e = r_e = 0, unless `more` says otherwise

    Each a number or (n,). Nets are only good where cars have been: a heading error without its e_dot is no such place.
    """
    course = course_angle(scenario, doe)
    columns = {"v": v, "doe": doe, "psi_e": psi - course, "e_dot": v / np.cos(course) * np.sin(psi)} | more
    return np.stack([np.broadcast_to(columns.get(name, 0.0), n) for name in names], axis=1).astype(float)


@styled
def policy_map(
    policy: NfqPolicy,
    scenario: Scenario,
    *,
    visited: Transitions | None = None,
    v: float = 6.0,
    doe_deg: Sequence[float] = (-120.0, 0.0, 120.0),
    title: str = "",
) -> "Figure":
    """The greedy action and its value over (e, psi_e) at speed v [m/s], for several angles of the steering wheel.

    Headings count from psi_0, that of a car which holds the path through the bend of that angle. Dots: the visited
    states within 0.75 m/s and 40 degrees of the wheel; elsewhere the net is guessing.
    """
    n = 161
    names, actions = policy.description.names, sorted(policy.actions)
    e, psi = np.linspace(-TRIP, TRIP, n), np.linspace(-radians_of(10.0), radians_of(10.0), n)
    over = {"e": np.tile(e, n), "psi": np.repeat(psi, n), "v": v}
    q = [mean_of(q_values(policy, states(scenario, names, n * n, doe=radians_of(doe), **over))) for doe in doe_deg]
    colours = _action_colours(actions)
    shades = np.array([[int(colour[i : i + 2], 16) for i in (1, 3, 5)] for colour in colours], dtype=np.uint8)
    look: dict[str, Any] = {"extent": (-TRIP, TRIP, -10.0, 10.0), "origin": "lower", "aspect": "auto"}
    top = max(float(values.min(axis=0).max()) for values in q)
    title = f"{title or 'NfqPolicy'}: what the net does at {v:.1f} m/s"
    figure, (only,) = new_figure(title=title, width=10.5, height=6.8)
    figure.delaxes(only)
    axes = figure.subplots(2, len(q), squeeze=False, sharey=True)
    seen = dict(zip(names, (visited or Transitions(names)).s.T))
    for (above, below), doe, values in zip(axes.T, doe_deg, q):
        course = course_angle(scenario, radians_of(doe))
        value = values.min(axis=0).reshape(n, n)
        above.imshow(shades[values.argmin(axis=0).reshape(n, n)], **look)
        picture = below.imshow(value, cmap="viridis", vmin=0.0, vmax=top, **look)
        below.contour(e, degrees_of(psi), value, levels=8, colors="white", linewidths=0.5, alpha=0.6)
        near = (np.abs(seen["v"] - v) < 0.75) & (np.abs(seen["doe"] - radians_of(doe)) < radians_of(40.0))
        heading = degrees_of(seen["psi_e"][near] + course_angle(scenario, seen["doe"][near]))
        for axis, colour in ((above, COLOURS["ink"]), (below, COLOURS["paper"])):
            axis.plot(seen["e"][near], heading, ".", ms=2.2, mew=0, color=colour, alpha=0.6)
            axis.grid(False)
            axis.axvline(0.0, color=colour, lw=0.5, alpha=0.6)
            axis.axhline(0.0, color=colour, lw=0.5, alpha=0.6)
            axis.set(xlim=(-TRIP, TRIP), ylim=(-10.0, 10.0))
        above.tick_params(labelbottom=False)
        above.set_title(f"wheel at {doe:+.0f}°, psi_0 = {degrees_of(-course):+.1f}°" if doe else "wheel straight")
        below.set_xlabel("e [m], + = left")
    for row in axes:
        row[0].set_ylabel("psi_e - psi_0 [deg], + = left")
    for action, colour in zip(actions, colours):
        axes[0, 0].plot([], [], "s", ms=7, color=colour, label=f"{degrees_of(action):+.0f}°" if action else "hold, 0°")
    figure.legend(loc="outside lower center", ncols=len(actions), frameon=False)
    figure.colorbar(picture, ax=list(axes.flat), label="expected cost to go", aspect=40, pad=0.01)
    return figure


def _action_colours(actions: Sequence[float]) -> list[str]:
    """Blue to the right, orange to the left, the stronger the darker; grey for none."""

    def shades(scale: Sequence[str], count: int) -> list[str]:
        return [scale[round(2 * k / max(1, count - 1))] for k in range(count)]

    right = shades(("#0b3c5d", "#2f7fb5", "#9cc9e3"), sum(a < 0.0 for a in actions))
    left = shades(("#8a3b06", "#d9772b", "#f2c39b"), sum(a > 0.0 for a in actions))
    return [*right, *(["#b4bcc4"] * (0.0 in actions)), *left[::-1]]
