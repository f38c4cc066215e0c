"""A drive: held, caught, or lost; and those of learned policies, compiled."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.delay_compensator import LONGEST, DelayCompensator
from steerkit.controllers.nfq_policy import BANG_BANG_ACTIONS, Kind, NfqPolicy
from steerkit.diagram.simulation import Log, simulate
from steerkit.doe import Integrator
from steerkit.learning.learner_state import untrained
from steerkit.learning.settings import DEFAULT
from steerkit.scenario import Scenario
from steerkit.scenario.drive import (
    PolicyDrives,
    assembled,
    comparison,
    controller,
    drive,
    drive_loop,
    held_all_along,
    policy_drives,
    row_of,
)


def log_of(e: Any, learning: Any = None) -> Log:
    signals = {"path.e": np.array(e, dtype=float)}
    if learning is not None:
        signals["supervisor.learning"] = np.array(learning, dtype=float)
    return Log(0.05 * np.arange(len(e)), signals, dict.fromkeys(signals, "1"))


@pytest.mark.parametrize(
    ("e", "learning", "held"),
    [
        ([0.1, -0.5, 0.5], None, True),
        ([0.1, -0.51, 0.1], None, False),
        ([0.1, math.nan, 0.1], None, False),
        ([0.1, 0.1, 0.1], [1, 1, 1], True),
        ([0.1, 0.1, 0.1], [1, 0, 1], False),
        ([0.1, 0.1, 0.1], [0, 1, 1], False),
        ([0.1, 0.1, 0.1], [1, 1, 0], False),
        ([0.1, 0.6, 0.1], [1, 1, 1], False),
        ([0.1, math.nan, 0.1], [1, 1, 1], False),
    ],
)
def test_a_drive_is_held_by_who_kept_the_lane_and_the_wheel(e: list[float], learning: Any, held: bool) -> None:
    assert held_all_along(log_of(e, learning)) is held


def test_a_learned_controller_is_caught_where_an_analytic_one_is_alone() -> None:
    scenario = Scenario(course="circle")
    assert "recovery" in drive_loop(scenario, untrained(DEFAULT, 0), doe=DEFAULT.element(scenario.nominal)).blocks
    assert "recovery" not in drive_loop(scenario, controller("stanley", scenario)).blocks
    log = drive(scenario, untrained(DEFAULT, 0), doe=DEFAULT.element(scenario.nominal))
    assert not held_all_along(log)
    assert log["supervisor.learning"].min() == 0.0


def learned(**changes: Any) -> NfqPolicy:
    policy = replace(untrained(DEFAULT, 3), **changes)
    return replace(policy, nets=tuple(tuple(3.0 * p for p in net) for net in policy.nets or ()))


FORECAST = DelayCompensator(samples=3, now=0.02, before=0.03, earlier=0.01, back=0.3, slip=0.001, yaw=0.4, trust=0.3)


@pytest.mark.parametrize(
    "policy",
    [
        learned(),
        learned(nets=untrained(DEFAULT, 7).nets[:1]),  # type: ignore[index]
        learned(combine="max"),
        learned(combine="disagreement"),
        *(learned(forecast=replace(FORECAST, samples=n, loss=0.002, straight=0.05)) for n in (0, 1, 2, LONGEST)),
    ],
)
def test_compiled_drives_serve_every_policy_of_a_kind_to_the_last_bit(policy: NfqPolicy) -> None:
    scenario, doe = Scenario.under("hard", course="circle", driver={"v_max": 9.0}), DEFAULT.element()
    recovery = scenario.recovery_controller()
    one, other = (assembled(scenario, p, doe=doe, recovery=recovery, seed=4) for p in (learned(), policy))
    log = PolicyDrives(one, ["path.e", "car.delta_sw", "supervisor.learning", "controller.q"]).run(other, 6.0)
    plain = simulate(other, 6.0, every=5)
    for name in log:
        assert log[name].tobytes() == plain[name].tobytes(), name
    assert log.state == plain.state
    assert Kind(learned()) == Kind(policy)


@pytest.mark.parametrize(
    "changes",
    [
        {"actions": BANG_BANG_ACTIONS},
        {"continuous": False},
        {"preview_points": 0},
        {"dt": 0.1},
        {"ready_from": math.inf},
        {"description": replace(DEFAULT.description(), scaled_from=5.0)},
    ],
)
def test_what_a_compiled_drive_depends_on_is_the_kind(changes: dict[str, Any]) -> None:
    assert Kind(learned()) != Kind(learned(**changes))


def test_what_cannot_be_compiled_is_interpreted() -> None:
    scenario = Scenario(course="circle")
    loop = assembled(scenario, learned(), doe=Untraceable(), recovery=scenario.recovery_controller())
    assert policy_drives(loop, ["path.e"]) is None
    with pytest.raises(ValueError, match="the controller is a Stanley, expected an NfqPolicy"):
        PolicyDrives(drive_loop(scenario, controller("stanley", scenario)), ["path.e"])


@dataclass(frozen=True, eq=False, kw_only=True)
class Untraceable(Integrator):
    """Asks a number what it is."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return super().output(t, x, u) if u.action > 0.0 else self.Y(state=x[0], delta_sw=x[0])


def test_the_table_says_of_each_drive_what_its_figures_are() -> None:
    scenario = Scenario(course="circle")
    logs = {"stanley": drive(scenario, controller("stanley", scenario), rounds=0.2)}
    row = row_of("stanley", logs["stanley"])
    (name,), (held,), *figures = (list(column.cells) for column in comparison("one", logs).columns)
    assert (name, held, row["controller"], row["held"]) == ("stanley", "yes", "stanley", True)
    expected = [row[key] for key in ("rms_e", "max_e", "rms_wheel_rate_deg", "max_a_y")]
    expected += [100.0 * row["share_within_5cm"], row["max_jerk"]]
    digits = (3, 3, 0, 2, 1, 1)
    assert [cell for (cell,) in figures] == [f"{value:.{n}f}" for value, n in zip(expected, digits, strict=True)]
    log = logs["stanley"]
    lost = Log(log.t, {**log.signals, "path.e": np.full(len(log.t), 0.6)}, log.units)
    assert [next(iter(column.cells)) for column in comparison("lost", {"a": lost}).columns][1] == "no"
