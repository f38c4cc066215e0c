"""Stanley on cars and paths where the answer is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from steerkit.controllers.stanley import Stanley
from steerkit.diagram.simulation import Log, simulate
from steerkit.paths.courses import circle, straight
from steerkit.paths.path import Path
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack
from tests.support.straight_road import PASSAT, looped

RADIUS = 40.0


def driven(plant: Any, stanley: Stanley, path: Path, v: float, seconds: float, **start: float) -> Log:
    """A car steered by Stanley without actuator; e is that of the front axle."""
    return simulate(looped(stanley, path, v, 0.0, car=plant(vehicle=PASSAT, v0=v), actuator=None, **start), seconds)


def offset_on_the_circle(plant: Any, stanley: Stanley, v: float, left: bool) -> float:
    path = circle(RADIUS) if left else circle(RADIUS).reversed()
    e = driven(plant, stanley, path, v, 15.0)["path.e"][-40:]
    assert np.ptp(e) < 1e-4  # steady
    return float(e[-1]) * (1.0 if left else -1.0)


@pytest.mark.parametrize(
    ("plant", "v", "left"),
    [(LinearSingleTrack, 4.0, True), (LinearSingleTrack, 9.0, False), (NonlinearSingleTrack, 6.0, False)],
)
def test_a_steady_circle_is_held_with_the_front_axle_on_the_path(plant: Any, v: float, left: bool) -> None:
    """With psi_ss the offset is gone; without, it is what psi_ss makes up for; with the wrong sign it would double."""
    stanley = Stanley.of(PASSAT)
    psi_ss = PASSAT.m * v * v / RADIUS * PASSAT.l_r / (PASSAT.c_f * PASSAT.wheelbase)
    expected = psi_ss * (stanley.k_soft + v) / stanley.k  # what the cross-track term has to ask for: outside, so e < 0
    assert offset_on_the_circle(plant, replace(stanley, mass=0.0), v, left) == pytest.approx(-expected, rel=0.1)
    assert abs(offset_on_the_circle(plant, stanley, v, left)) < max(0.1 * expected, 5e-4)


def test_at_walking_pace_the_offset_dies_out_as_the_law_says() -> None:
    """A rolling car's front axle goes where its wheels point: without damping e' = -v arctan(k e/(k_soft + v)).

    The kinematic model's wheels lag by tau: tau z' = delta - z, e' = v (psi + z), psi' = v/L z; with tau = 0 the
    poles are -k v/(k_soft + v) and -v/L.
    """
    v, tau = 1.0, 0.05
    bare = replace(Stanley.of(PASSAT, dt=0.01), k_d_yaw=0.0, k_d_steer=0.0, rate_limit=1e3)
    log = driven(LinearSingleTrack, bare, straight(100.0), v, 5.0, s=10.0, e=0.05)
    k, curve = bare.k / (bare.k_soft + v), v / PASSAT.wheelbase
    matrix = np.array([[0.0, v, v], [0.0, 0.0, curve], [-k / tau, -1.0 / tau, -1.0 / tau]])
    expected = [linalg.expm(matrix * t)[0, 0] for t in log.t]
    np.testing.assert_allclose(log["path.e"] / 0.05, expected, atol=0.01)
    assert np.exp(-k * v * 1.0) == pytest.approx(expected[100], abs=0.03)
