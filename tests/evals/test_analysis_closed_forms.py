"""Margins of a double integrator behind a delay, where they are known in closed form."""

import math

import control
import numpy as np
import pytest
from scipy.optimize import brentq

from steerkit.analysis import FromControl, break_at, margins
from steerkit.diagram.loop import Loop

DT = 0.05


def loop(n: int, every: int = 1, k: float = 1.0, d: float = 1.5) -> Loop:
    """p'' = a, exactly, for a held over a step, and a spring that is late: a(t) = -(k p + d v)(t - n dt)."""
    h = DT / every
    moves = control.ss([[1, h], [0, 1]], [[0.5 * h * h], [h]], np.eye(2), 0.0, h, inputs=["a"], outputs=["p", "v"])
    late = control.tf2ss([1.0], [1.0, *[0.0] * n], DT) * control.ss([], [], [], [[-k, -d]], DT)
    mass = FromControl(system=moves, dt=h)
    spring = FromControl(system=control.ss(late, inputs=["p", "v"], outputs=["a"]), dt=DT)
    return Loop(
        blocks={"mass": mass, "spring": spring}, wires=[(mass.p, spring.p), (mass.v, spring.v), (spring.a, mass.a)]
    )


def closed_form(n: int, k: float, d: float) -> tuple[float, float, float]:
    """Phase and delay margin, gain margin, and gain crossing.

    L(z) = z^-n (d dt/(z - 1) + k dt^2 (z + 1)/(2 (z - 1)^2)). With z = exp(2j b), b = w dt/2:
    L = -(k dt^2 cos b/(4 sin^2 b) + j d dt/(2 sin b)) exp(-j b (2 n + 1)). |L| = 1 is quadratic in q = sin^2 b:
    16 q^2 = 4 d^2 dt^2 q + k^2 dt^4 (1 - q); the phase is -pi + atan(2 d tan b/(k dt)) - b (2 n + 1).
    """
    p = 4.0 * d**2 * DT**2 - k**2 * DT**4
    b = math.asin(math.sqrt((p + math.sqrt(p * p + 64.0 * k**2 * DT**4)) / 32.0))

    def phase(b: float) -> float:
        return math.atan(2.0 * d * math.tan(b) / (k * DT)) - b * (2 * n + 1)

    w = 2.0 * b / DT
    turn = float(brentq(phase, b, math.pi / 2.0 - 1e-9)) if n else math.pi / 2.0
    size = math.hypot(k * DT**2 * math.cos(turn) / (4.0 * math.sin(turn) ** 2), d * DT / (2.0 * math.sin(turn)))
    return phase(b), phase(b) / w, 1.0 / size


@pytest.mark.parametrize("every", [1, 5])
@pytest.mark.parametrize("n", [0, 1, 4])
@pytest.mark.parametrize(("k", "d"), [(1.0, 1.5), (4.0, 2.0)])
def test_margins_of_a_double_integrator_with_delay(n: int, every: int, k: float, d: float) -> None:
    """One rate, or a mass five times as fast as its spring: the same sampled system, hence the same margins."""
    phase, delay, gain = closed_form(n, k, d)
    found = margins(break_at(loop(n, every, k, d), "spring.a"))
    assert found.phase == pytest.approx(phase, rel=1e-6)
    assert found.delay == pytest.approx(delay, rel=1e-6)
    assert found.gain == pytest.approx(gain, rel=1e-6)


def test_beyond_the_delay_margin_of_the_closed_form_there_are_no_margins() -> None:
    """k = 4, d = 2: the undelayed margin is 0.331 s, so that 6 samples are stable and 7 are not."""
    _, delay, _ = closed_form(0, 4.0, 2.0)
    assert 6 < delay / DT < 7
    assert margins(break_at(loop(6, 1, 4.0, 2.0), "spring.a")).delay == pytest.approx(delay - 6 * DT, rel=1e-6)
    with pytest.raises(ValueError, match="the closed loop is unstable"):
        margins(break_at(loop(7, 1, 4.0, 2.0), "spring.a"))
