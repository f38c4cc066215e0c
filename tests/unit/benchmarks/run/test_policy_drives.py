"""Drives of learned policies, compiled, are those that are interpreted."""

from dataclasses import dataclass, replace
from typing import Any

import pytest

from benchmarks.run.policy_drives import PolicyDrives, policy_drives
from steerkit.controllers.delay_compensator import LONGEST, DelayCompensator
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.diagram.simulation import simulate
from steerkit.doe import Integrator
from steerkit.learning.learner_state import untrained
from steerkit.learning.nfq import iterate as nfq
from steerkit.learning.nfq.iterate import FitSetting
from steerkit.learning.settings import DEFAULT
from steerkit.scenario import Scenario
from steerkit.scenario.drive import assembled, controller, drive_loop


def learned(**changes: Any) -> NfqPolicy:
    policy = replace(untrained(DEFAULT, 3), **changes)
    return replace(policy, nets=tuple(tuple(3.0 * p for p in net) for net in policy.nets or ()))


FORECAST = DelayCompensator(samples=3, now=0.02, before=0.03, earlier=0.01, back=0.3, slip=0.001, yaw=0.4, trust=0.3)


@pytest.mark.parametrize(
    "policy",
    [
        learned(),
        learned(nets=untrained(DEFAULT, 7).nets[:1], actions=(-0.5, 0.5)),  # type: ignore[index]
        learned(nets=nfq.fresh_nets(FitSetting(nets=3, hidden=(6,)), DEFAULT.description(), seed=9)),
        *(learned(forecast=replace(FORECAST, samples=n, loss=0.002, straight=0.05)) for n in (0, 1, LONGEST)),
    ],
)
def test_compiled_drives_serve_every_policy_to_the_last_bit(policy: NfqPolicy) -> None:
    scenario, doe = Scenario.under("hard", course="circle", driver={"v_max": 9.0}), DEFAULT.element()
    recovery = scenario.recovery_controller()
    one, other = (assembled(scenario, p, doe=doe, recovery=recovery, seed=4) for p in (learned(), policy))
    log = PolicyDrives(one, ["path.e", "car.delta_sw", "supervisor.learning", "controller.q"]).run(other, 4.0)
    plain = simulate(other, 4.0, every=5)
    for name in log:
        assert log[name].tobytes() == plain[name].tobytes(), name
    assert log.state == plain.state


def test_what_cannot_be_compiled_is_interpreted() -> None:
    scenario = Scenario(course="circle")
    loop = assembled(scenario, learned(), doe=Untraceable(), recovery=scenario.recovery_controller())
    assert policy_drives(loop, ["path.e"]) is None
    with pytest.raises(ValueError, match="the controller is a Stanley, expected an NfqPolicy"):
        PolicyDrives(drive_loop(scenario, controller("stanley", scenario)), ["path.e"])


def test_a_policy_with_other_ports_is_refused() -> None:
    scenario = Scenario(course="circle")
    one, other = (drive_loop(scenario, p, doe=DEFAULT.element()) for p in (learned(), learned(preview_points=0)))
    with pytest.raises(ValueError, match="a policy with another preview or dt"):
        PolicyDrives(one, ["path.e"]).run(other, 1.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class Untraceable(Integrator):
    """Asks a number what it is."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return super().output(t, x, u) if u.action > 0.0 else self.Y(state=x[0], delta_sw=x[0])
