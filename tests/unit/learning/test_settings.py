"""Settings are changed by name, and wrong changes are told."""

import re
from dataclasses import replace

import numpy as np
import pytest

from steerkit.learning.costs import TanhCost
from steerkit.learning.settings import DEFAULT, SETTINGS, Setting, changed
from steerkit.scenario import Scenario


def test_settings_are_changed_by_name() -> None:
    new = changed(DEFAULT, ["fit.nets=2", "after_failure=reset", "cost.goal=0.1", "calm=1", "actions_deg=[-9,0,9]"])
    assert (new.fit.nets, new.after_failure, new.cost.goal, new.calm) == (2, "reset", 0.1, 1)
    assert new.actions_deg == (-9, 0, 9)
    assert replace(DEFAULT.fit, nets=2) == new.fit
    priced = changed(DEFAULT, ["cost.dear_from=2"])  # None, where it is left out
    assert replace(DEFAULT, cost=replace(DEFAULT.cost, dear_from=2)) == priced  # type: ignore[type-var]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ("fit=2", "expected FitSetting, or its parts by their names"),
        ("fit.nets.x=2", "'nets' has no parts"),
        ("fit.nets=0", "expected >= 1"),
        ("after_failure=cry", "valid: recovery, reset"),
        ("corrected_seconds=0", "corrected_seconds = 0 [s], expected > 0"),
        ("safe=1", "expected bool"),
        ("cost.dear_from=x", "'cost.dear_from=x': expected float"),
        ("cost.dear_from=0.5", "dear_from = 0.5 [1], expected >= 1"),
    ],
)
def test_wrong_changes_are_told(change: str, told: str) -> None:
    with pytest.raises(ValueError, match=re.escape(told)):
        changed(DEFAULT, [change])


def test_a_filter_goes_with_the_recovery_controller_only() -> None:
    assert changed(DEFAULT, ["safe=true"]).safe
    with pytest.raises(ValueError, match="after_failure = 'reset' with safe, expected recovery"):
        changed(DEFAULT, ["after_failure=reset", "safe=true"])


def price_at(v: float, setting: Setting) -> float:
    cost = setting.cost
    assert isinstance(cost, TanhCost)
    return cost.suited(np.zeros(3), float(setting.description().excess(v))).action_cost


def test_where_torque_steers_no_action_asks_for_more_than_its_slew() -> None:
    scenario = Scenario(
        course="sweeping-7", steering={"command": "torque", "delay": 0.35}, driver={"v_min": 12.0, "v_max": 20.0}
    )
    car, suited = scenario.nominal, DEFAULT.suited(scenario.design_model())
    for v in (12.0, 16.0, 20.0):
        step = max(suited.actions) / suited.description().excess(v) ** 2
        slewed = car.steer_ratio * car.wheelbase * scenario.steering.slew * 0.05 / v**2
        assert step == pytest.approx(slewed, rel=1e-12)
    ratio = suited.scaled_from / DEFAULT.scaled_from
    assert price_at(10.0, suited) == price_at(5.0, DEFAULT)
    assert price_at(40.0, suited) == pytest.approx(price_at(40.0, DEFAULT) * 5.0 * ratio**2)
    assert DEFAULT.suited(Scenario().design_model()) is DEFAULT
    assert SETTINGS["paper"].suited(scenario.design_model()) is SETTINGS["paper"]
