"""Pictures of a policy show the values and actions that it takes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.units import degrees_of, radians_of
from steerkit.learning.pictures import Record, course_angle, policy_map, q_values, states
from steerkit.scenario import Scenario

pytestmark = pytest.mark.usefixtures("without_layout")  # many pictures are drawn


def test_values_lead_to_the_actions_that_the_policy_takes(record: Record) -> None:
    policy = replace(record.policy, continuous=False)
    s = record.transitions.s[:200]
    q = q_values(policy, s).mean(axis=0)
    y = policy.output(0.0, (), policy.D(*s.T))
    np.testing.assert_allclose(q.min(axis=0), y.q, atol=1e-6)
    clear = np.partition(q, 1, axis=0)[1] - q.min(axis=0) > 1e-5
    assert clear.sum() > 100
    np.testing.assert_array_equal(np.sort(policy.actions)[q.argmin(axis=0)][clear], y.action[clear])


@pytest.mark.parametrize("reference", ["front", "cg"])
def test_states_on_a_steady_bend_are_where_a_car_really_is(reference: str) -> None:
    """A slow car in a steady bend: r = v tan(delta)/L, every point turns about the same centre."""
    scenario = Scenario(reference=reference)
    car, delta, v = scenario.nominal, 0.1, 2.0
    b = car.l_r + scenario.ahead
    r = v * math.tan(delta) / car.wheelbase
    course = course_angle(scenario, delta * car.steer_ratio)
    assert course == pytest.approx(math.atan2(b * r, v))
    if reference == "front":
        assert course == pytest.approx(delta)
    names = NfqPolicy().description.names
    steady = dict(zip(names, states(scenario, names, 1, v=v, doe=delta * car.steer_ratio)[0]))
    assert steady["psi_e"] == pytest.approx(-course)
    assert (steady["e"], steady["e_dot"], steady["r_e"], steady["v"]) == (0.0, 0.0, 0.0, v)
    psi_e = 0.05 - course  # turned out of it: the point's speed across the path, component by component
    across = v * math.sin(psi_e) + b * r * math.cos(psi_e)
    turned = dict(zip(names, states(scenario, names, 1, v=v, doe=delta * car.steer_ratio, psi=0.05)[0]))
    assert turned["e_dot"] == pytest.approx(across)


def test_the_map_shows_the_action_that_the_policy_takes(record: Record) -> None:
    policy, scenario = replace(record.policy, continuous=False), record.experiment.scenario  # the map shows the set's
    figure = policy_map(policy, scenario, visited=record.transitions, v=5.0, doe_deg=(0.0, 120.0))
    above = [axis for axis in figure.axes if axis.get_title(loc="left")]
    assert len(above) == 2
    legend = {handle.get_label(): handle.get_color() for handle in above[0].get_lines() if handle.get_label()[0] != "_"}
    shade_of = {tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)): name for name, c in legend.items()}
    assert len(shade_of) == len(policy.actions)
    checked = 0
    for axis, doe in zip(above, (0.0, radians_of(120.0))):
        pixels = np.asarray(axis.get_images()[0].get_array())
        for i, j in np.random.default_rng(0).integers(0, 161, (40, 2)):
            e, psi = np.linspace(-0.5, 0.5, 161)[j], np.linspace(-1.0, 1.0, 161)[i] * radians_of(10.0)
            s = states(scenario, policy.description.names, 1, v=5.0, doe=doe, e=e, psi=psi)
            q = np.sort(q_values(policy, s).mean(axis=0)[:, 0])
            if q[1] - q[0] > 1e-5:
                action = float(policy.output(0.0, (), policy.D(*s.T)).action[0])
                shown = shade_of[tuple(pixels[i, j].tolist())]
                assert shown == (f"{degrees_of(action):+.0f}°" if action else "hold, 0°")
                checked += 1
    assert checked > 40


def test_a_policy_without_nets_has_nothing_to_show() -> None:
    with pytest.raises(ValueError, match="the policy has no nets"):
        policy_map(NfqPolicy(), Scenario())
