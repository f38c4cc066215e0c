"""Safe commands pass unchanged, others are corrected, and no adversary leaves the path."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.delay import DelayPredictor, delayed_stanley
from steerkit.controllers.offset_free import CommandCompensation
from steerkit.controllers.safety_filter import _BANK, BEHIND_GATE, REASONS, SafetyFilter, _known, doubted
from steerkit.controllers.stanley import Stanley
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, Wrapper
from steerkit.diagram.simulation import Log, simulate
from steerkit.scenario import Scenario
from steerkit.scenario.drive import assembled
from steerkit.task import STOP
from steerkit.vehicles import VW_PASSAT as PASSAT
from steerkit.vehicles.rollout import GateLimits, GateModel

SURE: dict[str, float] = dict(e_doubt=0.0, psi_doubt=0.0, yaw_doubt=0.0, ratio_doubt=0.0, delay_doubt=0.0)
DOUBTS: dict[str, float] = dict(e_doubt=0.1, psi_doubt=0.02, yaw_doubt=0.05, ratio_doubt=0.3, delay_doubt=0.15)
HERE: dict[str, float] = dict(command=0.0, e=0.0, psi_e=0.0, v=6.0, r=0.0, delta_sw_meas=0.0)


def asked(block: SafetyFilter, *, kappa: float = 0.0, **values: float) -> Any:
    """The outputs of a filter that starts here, with the wheel where it is measured."""
    u = {**HERE, "applied": 0.0, "preview": (kappa,) * block.preview_points, **values}
    ports = block.D(**{name: u[name] for name in block.D._fields})
    return block.output(0.0, block.settle(0.0, block.init(), ports), ports)


@pytest.mark.parametrize("v", [0.0, 2.0, 5.0, 9.0])
def test_near_its_path_no_command_of_a_careful_driver_is_touched(v: float) -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        e, psi_e, command = rng.uniform(-1.0, 1.0, 3) * (0.1, 0.03, 0.2)
        y = asked(SafetyFilter.of(PASSAT), command=float(command), e=float(e), psi_e=float(psi_e), v=v)
        assert (y.delta_sw, y.correction, y.share, y.reason) == (float(command), 0.0, 0.0, 0.0)


def test_a_car_beside_a_straight_path_reaches_what_it_has_and_no_more() -> None:
    """Parallel to it, nothing but the bound and the doubt of e decides."""
    for doubt in (0.0, 0.07):
        block = SafetyFilter.of(PASSAT, **(SURE | {"e_doubt": doubt}))
        for side in (1.0, -1.0):
            assert asked(block, e=0.3 * side).reach == pytest.approx(0.3 + doubt, abs=1e-12)
            assert asked(block, e=side * (0.499 - doubt)).share == 0.0
            assert asked(block, e=side * (0.501 - doubt)).share > 0.0


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.2])
def test_a_car_that_runs_away_goes_on_for_dead_time_and_hold(delay: float) -> None:
    """Straight on at an angle, v sin(psi_e) a second, before the backup can begin to turn it."""
    psi, v, e = 0.03, 6.0, 0.05
    block = SafetyFilter.of(PASSAT, delay=delay, bound=5.0, **SURE)
    least = e + v * math.sin(psi) * (delay + block.hold * block.dt)
    assert least < asked(block, e=e, psi_e=psi).reach < least + v * math.sin(psi) * 0.6


def doubts(block: SafetyFilter, wrong: Any, samples: int = 400) -> list[float]:
    """The doubt of the yaw rate, read off `reach` of a car on its path, where the yaw rate is off by so much."""
    u = {**HERE, "preview": (0.0,) * block.preview_points}
    x, found = block.settle(0.0, block.init(), block.D(**{n: u[n] for n in block.D._fields})), []
    for k in range(samples):
        now = u | {"r": wrong(0.05 * k)}
        y = block.output(0.05 * k, x, block.D(**{name: now[name] for name in block.D._fields}))
        x = block.update(0.05 * k, x, block.U(**{name: now[name] for name in block.U._fields}), y)
        found.append(y.reach)
    return found


def test_the_yaw_rate_is_doubted_less_while_the_model_proves_right_and_at_once_when_it_does_not() -> None:
    settings: dict[str, Any] = {**SURE, "yaw_doubt": 0.02, "bound": 5.0}
    wide = SafetyFilter.of(PASSAT, **settings)
    narrows = replace(wide, yaw_doubt_least=0.004)
    least = asked(replace(wide, yaw_doubt=0.004)).reach
    always, found = doubts(wide, lambda t: 0.0, 50), doubts(narrows, lambda t: 0.0)
    assert found[0] == always[0], "wide at first"
    assert max(np.diff(found)) <= 0.0
    assert found[-1] == pytest.approx(least), "a model that is right leaves what is doubted in any case"
    assert len(set(always)) == 1
    off = 0.01  # from 10 s on the car turns faster than it should
    changed = [doubts(block, lambda t: off * (t > 10.0), 231) for block in (narrows, wide)]
    assert changed[0][200] < 0.8 * changed[1][200]
    assert changed[0][230] == pytest.approx(changed[1][230]), "all of it again after 1.5 s"
    constant = doubts(narrows, lambda t: 0.01), doubts(replace(wide, yaw_doubt=0.004), lambda t: 0.01)
    assert constant[0][-1] < 1.1 * constant[1][-1], "an error that stays is known, not doubted"


@dataclass(frozen=True, eq=False, kw_only=True)
class HeldThenStanley(Wrapper):
    """What a roll-out takes for granted: a command for some time, then the backup."""

    held: float
    until: float

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(m.where(t < self.until - 1e-9, self.held, self.inner_output(t, x, u).delta_sw))


@pytest.mark.parametrize("v", [3.0, 6.0, 9.0])
def test_what_is_rolled_out_is_what_the_car_does_and_the_drift_of_a_sample_more(v: float) -> None:
    """For a command acts between now and a sample later, as the actuator's and the path's samples fall."""
    law, held = Stanley.of(PASSAT), 0.2
    block = SafetyFilter.of(PASSAT, **SURE)
    place = Scenario(course="straight", driver={"v_min": v, "v_max": v})
    until = block.hold * block.dt
    log = simulate(assembled(place, HeldThenStanley(block=law, held=held, until=until)), 3.0)
    drift = float(np.gradient(log["path.e"], log.t).max()) * block.dt
    found = asked(block, command=held, v=v).reach
    assert 0.3 * drift < found - float(np.abs(log["path.e"]).max()) < drift


def test_a_drift_at_the_end_of_the_roll_out_counts_on() -> None:
    """One that runs away faster than it can be turned."""
    y = asked(SafetyFilter.of(PASSAT), e=0.2, psi_e=0.5, v=9.0)
    assert y.reach > asked(SafetyFilter.of(PASSAT, approach=0.0), e=0.2, psi_e=0.5, v=9.0).reach + 0.4


def test_more_doubt_is_more_reach() -> None:
    wheel = dict(e=0.2, psi_e=0.02, delta_sw_meas=0.5, command=0.9, r=0.05)
    sure = asked(SafetyFilter.of(PASSAT, **SURE), **wheel).reach
    for name, value in DOUBTS.items():
        one, more = (asked(SafetyFilter.of(PASSAT, **(SURE | {name: k * value})), **wheel).reach for k in (1.0, 2.0))
        assert sure + 1e-3 < one < more - 1e-3, name


def test_what_leaves_is_turned_back_no_further_than_needed() -> None:
    block = SafetyFilter.of(PASSAT)
    leaving = dict(e=0.3, psi_e=0.03, command=0.3)
    y = asked(block, **leaving)
    assert 0.0 < y.share < 1.0
    assert REASONS[int(y.reason)] == "corrected"
    assert y.correction < 0.0
    assert y.reach > block.bound
    kept = asked(block, **(leaving | {"command": y.delta_sw}))
    assert (kept.delta_sw, kept.share) == (y.delta_sw, 0.0)
    finer = asked(replace(block, halvings=12), **leaving)
    assert finer.share <= y.share <= finer.share + 1.0 / 32.0


def test_left_and_right_are_mirror_images() -> None:
    rng, block = np.random.default_rng(1), SafetyFilter.of(PASSAT, delay=0.1)
    reasons = set()
    for _ in range(40):
        u = dict(zip(("command", "e", "psi_e", "r", "delta_sw_meas", "kappa"), rng.uniform(-1.0, 1.0, 6).tolist()))
        u |= dict(e=0.45 * u["e"], psi_e=0.1 * u["psi_e"], r=0.2 * u["r"], kappa=0.05 * u["kappa"])
        one, other = asked(block, **u), asked(block, **{name: -value for name, value in u.items()})
        assert (other.delta_sw, other.correction) == (-one.delta_sw, -one.correction)
        assert (other.share, other.reach, other.reason) == (one.share, one.reach, one.reason)
        reasons.add(one.reason)
    assert {0.0, 2.0, 3.0} <= reasons


def test_the_wheels_limits_hold_for_every_command() -> None:
    block = SafetyFilter.of(PASSAT)
    y = asked(block, command=STOP)
    assert REASONS[int(y.reason)] in ("wheel limits", "corrected")
    assert abs(y.delta_sw) <= block.backup.model.rate_limit * block.dt + 1e-12
    assert REASONS[int(asked(block, command=0.6, v=2.0).reason)] == "wheel limits"
    back = asked(replace(block, bound=5.0), command=-STOP, delta_sw_meas=1.0, v=3.0)
    assert 1.0 - back.delta_sw == pytest.approx(block.backup.rate_limit * block.dt)  # from the command before
    turned = asked(replace(block, bound=5.0), command=STOP, delta_sw_meas=2.0, v=9.0)
    steady = 9.0**2 * math.tan(turned.delta_sw / PASSAT.steer_ratio) / PASSAT.wheelbase
    assert steady < 3.0 * (1.0 + PASSAT.understeer_gradient * 9.0**2 / PASSAT.wheelbase)


@pytest.mark.parametrize("broken", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_a_command_that_is_none_leaves_the_wheel_to_stanley_where_the_car_will_be(broken: float, delay: float) -> None:
    """The car runs straight on, so that e grows by v sin(psi_e) a second until the command arrives."""
    law, block = Stanley.of(PASSAT), SafetyFilter.of(PASSAT, delay=delay)
    e, psi_e, v = -0.2, -0.05, 6.0
    y = asked(block, command=broken, e=e, psi_e=psi_e, v=v)
    assert (REASONS[int(y.reason)], y.share) == ("backup: the command is not finite", 1.0)
    there = law.D(e=e + delay * v * math.sin(psi_e), psi_e=psi_e, kappa=0.0, v=v, r=0.0, delta_sw_meas=0.0)
    assert y.delta_sw == pytest.approx(law.output(0.0, law.init(), there).delta_sw, abs=1e-12)
    assert abs(y.delta_sw) > 0.1


def test_what_was_sent_is_what_is_on_its_way() -> None:
    block = SafetyFilter.of(PASSAT, delay=0.1)
    u: Any = block.U(**{**HERE, "preview": (0.0,) * block.preview_points, "command": math.nan, "e": 0.3})
    x = block.settle(0.0, block.init(), u)
    y = block.output(0.0, x, u)
    after = block.update(0.0, x, u, y)
    assert after[-1] == y.delta_sw != 0.0
    assert after[-block._kept : -1] == x[1 - block._kept :]
    assert block.update(0.0, after, u, y._replace(delta_sw=math.nan))[-1] == after[-1] != after[-2]


@pytest.mark.parametrize("blind", ["e", "psi_e", "v", "r", "delta_sw_meas"])
def test_a_backup_that_sees_nothing_is_no_angle(blind: str) -> None:
    block = SafetyFilter.of(PASSAT, delay=0.05)
    u: Any = block.D(**{**HERE, "preview": (0.0,) * 16})
    x = block.settle(0.0, block.init(), u)
    y = block.output(0.0, x, u._replace(**{blind: math.nan}))
    assert math.isnan(y.delta_sw)
    assert y.reason >= 3.0
    assert np.isfinite(block.update(0.0, x, block.U(**u._asdict())._replace(**{blind: math.nan}), y)).all()


def behind_gate(**limits: float) -> SafetyFilter:
    return SafetyFilter.of(PASSAT, delay=0.05, gate=GateModel(limits=GateLimits(**limits)), **BEHIND_GATE)


def test_the_slower_the_gate_the_further_and_a_command_within_it_is_left_to_it() -> None:
    turning = dict(command=2.0, delta_sw_meas=0.6, applied=0.6, e=0.05, v=8.0)
    reaches = [asked(behind_gate(jerk_max=jerk), **turning).reach for jerk in (10.0, 6.0, 4.0)]
    assert reaches[0] < reaches[1] < reaches[2]
    y = asked(behind_gate(), command=STOP, applied=0.0)  # 9 rad, of which the gate makes 0.1 in this sample
    assert (y.delta_sw, y.correction, y.reason) == (STOP, 0.0, 0.0)


def test_what_the_gate_made_of_a_command_is_what_is_on_its_way() -> None:
    block = behind_gate()
    u: Any = block.U(**{**HERE, "preview": (0.0,) * block.preview_points, "command": STOP, "applied": 0.25})
    x = block.settle(0.0, block.init(), u)
    y = block.output(0.0, x, u)
    after = block.update(0.0, x, u, y)
    assert after[-2:] == (0.25, y.delta_sw)
    heard = block.output(0.05, after, u)._asdict()
    other = block.output(0.05, (*after[:-1], 9.0), u)._asdict()
    assert heard == other, "the request is replaced by what the gate let through"


@dataclass(frozen=True, eq=False, kw_only=True)
class Adversary(Block):
    """One that wants to leave: to one side, to and fro, away from where the path is, or by chance."""

    e = In("m")
    psi_e = In("rad")
    delta_sw = Out("rad")

    kind: str = "left"

    def output(self, t: Any, x: Any, u: Any) -> Any:
        half = m.where(m.sin(2.0 * m.pi * t / (0.1 if self.kind == "bang-bang" else 1.4) + 0.1) > 0.0, 1.0, -1.0)
        away = m.where(u.e + 1.5 * u.psi_e >= 0.0, 1.0, -1.0)
        side = {"left": 1.0, "right": -1.0, "away": away}.get(self.kind, half)
        return self.Y(side * STOP + 0.0 * u.e)


def driven(kind: str, scenario: Scenario, **settings: Any) -> Log:
    design_model = scenario.design_model()
    block = SafetyFilter.of(design_model.vehicle, delay=design_model.delay, lag=design_model.lag, **settings)
    return simulate(assembled(scenario, Adversary(kind=kind), safety=block), 5.0, every=5)


WORST = Scenario.under(
    "hard", course="paper", vehicle={"tyres": 0.7}, steering={"delay": 0.1}, knowledge={"delay": 0.05}
)


@pytest.mark.parametrize(("kind", "v", "ratio"), [("left", 6.5, 0.9), ("right", 4.0, 1.1), ("bang-bang", 5.0, 1.1)])
def test_no_adversary_leaves_the_path_with_a_car_that_is_not_as_believed(kind: str, v: float, ratio: float) -> None:
    log = driven(kind, WORST.with_(driver={"v_min": v, "v_max": v}, vehicle={"ratio": ratio}), delay_doubt=0.1)
    assert np.abs(log["path.e"]).max() < 0.5
    assert np.abs(log["path.e"]).max() > 0.3
    assert (log["safety.share"] > 0.0).any()


def test_without_the_filter_an_adversary_leaves_it_at_once() -> None:
    free = simulate(assembled(WORST, Adversary()), 3.0, every=5)
    assert np.abs(free["path.e"]).max() > 2.0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"horizon": 0.69}, "horizon"),  # the hold, and 0.3 s
        ({"yaw_doubt_least": 0.011}, "yaw_doubt_least"),
        ({"gate": GateModel(), "horizon": 1.59}, "horizon"),  # the hold, and 1.2 s from side to side
        ({"backup": Stanley.of(PASSAT)}, "backup of another kind than DelayPredictor around Stanley"),
        ({"backup": DelayPredictor(block=CommandCompensation(block=Stanley.of(PASSAT)))}, "backup of another kind"),
        ({"backup": delayed_stanley(PASSAT, delay=0.1, lag=0.1, dt=0.02)}, "dt = 0.05 s, but the backup has 0.02 s"),
    ],
)
def test_what_cannot_be_is_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(SafetyFilter.of(PASSAT), **settings)


def test_where_nothing_new_is_safe_the_plan_goes_on_and_then_the_backup_steers() -> None:
    """The car is suddenly seen further off than any plan keeps it: the command that was safe is held for what is left
    of its time, along the bend, and dropped at once where the recovery controller steered in between."""
    block = SafetyFilter.of(PASSAT)
    u: Any = block.U(**{**HERE, "preview": (0.01,) * block.preview_points, "command": 0.3, "r": 0.06})
    x = block.settle(0.0, block.init(), u)
    y = block.output(0.0, x, u)
    assert y.share == 0.0
    x = dropped = block.update(0.0, x, u, y)
    lost = u._replace(e=0.45, psi_e=0.2, preview=(0.012,) * block.preview_points, command=9.0)
    sent = []
    for _ in range(block.hold + 1):
        y = block.output(0.0, x, lost)
        sent.append((REASONS[int(y.reason)], y.delta_sw))
        x = block.update(0.0, x, lost, y)
    per_kappa = block.backup.model.wheelbase + block.backup.model.understeer * u.v**2
    turned = PASSAT.steer_ratio * (math.atan(0.012 * per_kappa) - math.atan(0.01 * per_kappa))
    assert [why for why, _ in sent] == ["plan: what was found safe goes on"] * 7 + ["backup: nothing else is safe"] * 2
    assert [angle for _, angle in sent[:7]] == pytest.approx([0.3 + turned] * 7)
    assert sent[-1][1] < 0.0
    recovered = y._replace(delta_sw=0.1, share=1.0, reason=float(len(REASONS)))
    assert block.output(0.0, block.update(0.0, dropped, u, recovered), lost).reason == 3.0


def followed(block: SafetyFilter, late: int, gain: float, *, seconds: float = 8.0) -> tuple[Any, list[Any]]:
    """The last state and the outputs of a filter that passes all, whose car is its model, late, with another gain."""
    model, rng, soonest = block.backup.model, np.random.default_rng(0), round(block.backup.model.delay / block.dt)
    sent, wheel, r, said = [0.0] * (soonest + late + 1), 0.0, 0.0, list[Any]()
    share, wide = 1.0 - math.exp(-block.dt / model.lag), replace(block, bound=90.0)
    x = wide.settle(0.0, wide.init(), wide.D(**{**HERE, "preview": (0.0,) * block.preview_points}))
    for k in range(round(seconds / block.dt)):
        command = 0.5 * math.sin(3.0 * k * block.dt) + 0.2 * float(rng.normal())
        u: Any = wide.U(**{**HERE, "preview": (0.0,) * block.preview_points, "command": command, "r": gain * r})
        y = wide.output(k * block.dt, x, u)
        x = wide.update(k * block.dt, x, u, y)
        sent.append(y.delta_sw)
        turned = min(max(share * (sent[-1 - soonest - late] - wheel), -model.rate_limit * block.dt), 9.0)
        r, wheel = model.yaw_rate_after(r, wheel + 0.5 * turned, u.v, block.dt), wheel + turned
        said.append(y)
    return x, said


@pytest.mark.parametrize(
    ("delay", "late", "gain"),
    [(0.0, 0, 1.0), (0.1, 2, 1.0), (0.0, 4, 1.0), (0.1, 8, 0.8), (0.0, 5, 1.25), (0.1, 10, 1.0)],
)
def test_how_late_commands_arrive_is_found_beyond_the_doubt_whatever_the_ratio(
    delay: float, late: int, gain: float
) -> None:
    """Within the doubt, which is two samples, nothing moves; eight samples later is the latest that is believed."""
    block = SafetyFilter.of(PASSAT, delay=delay)
    y = followed(block, late, gain)[1][-1]
    assert y.late == pytest.approx(0.05 * min(8, late if late > 2 else 0))
    assert followed(replace(block, later=0.0), late, gain, seconds=3.0)[1][-1].late == 0.0


def test_the_ratio_is_doubted_as_much_as_it_is_off_at_most_four_times_and_less_with_time() -> None:
    block = SafetyFilter.of(PASSAT, yaw_doubt=1e-5)
    widened = [followed(block, 1, gain, seconds=5.0)[1][-1].widened for gain in (1.0, 0.95, 0.8, 1.3, 2.0)]
    assert widened[:2] == [1.0, 1.0]
    assert widened[2:] == pytest.approx([2.5, 3.0 / 1.3, 4.0], rel=0.01), "shares of the car's own yaw rate, over 0.1"
    u: Any = block.U(**{**HERE, "preview": (0.0,) * block.preview_points})
    x = block.settle(0.0, block.init(), u)
    x = (*_known(x)._replace(widened=3.0), *x[_BANK:])
    for k in range(400):
        x = block.update(0.05 * k, x, u, block.output(0.05 * k, x, u))
    after = block.output(0.0, x, u).widened
    assert after == pytest.approx(1.0 + 2.0 * math.exp(-20.0 / 15.0), rel=0.01), "20 s straight on"
    assert block.output(0.0, block.on_standby(x, block.settle(0.0, x, u)), u).widened == after


def test_a_car_that_is_found_to_be_late_is_rolled_out_as_one_that_was_believed_to_be() -> None:
    rng, late = np.random.default_rng(3), SafetyFilter.of(PASSAT, delay=0.05, gate=GateModel(), **BEHIND_GATE)
    told, extra = SafetyFilter.of(PASSAT, delay=0.2, gate=GateModel(), **BEHIND_GATE), 3
    outputs = []
    for _ in range(12):
        values = dict(zip(("command", "e", "psi_e", "r", "delta_sw_meas"), rng.uniform(-0.3, 0.3, 5).tolist()))
        sent = tuple(rng.uniform(-0.4, 0.4, 40).tolist())
        preview = tuple(rng.uniform(-0.02, 0.02, late.preview_points).tolist())
        u: Any = late.U(**{**HERE, **values, "preview": preview, "applied": sent[-1]})
        found = []
        for block, n in ((late, extra), (told, 0)):
            x = block.settle(0.0, block.init(), u)
            x = (*_known(x)._replace(late=float(n)), *x[_BANK : len(x) - block._kept], *sent[-block._kept :])
            found.append(block.output(0.0, x, u)[:5])
        assert found[0] == pytest.approx(found[1], abs=1e-12)
        outputs.append((*_known(x)._replace(late=float(extra)), *x[_BANK:], *found[0]))
    assert len({round(output[-1]) for output in outputs}) > 1


def test_a_batch_is_as_late_as_each_of_its_cars() -> None:
    block = SafetyFilter.of(PASSAT, delay=0.1)
    cars = [followed(block, late, gain, seconds=5.0)[0] for late, gain in ((0, 1.0), (5, 0.8), (8, 1.3))]
    batch = tuple(np.array(column) for column in zip(*cars))
    here = {**HERE, "preview": tuple(np.linspace(0.0, 0.02, block.preview_points).tolist()), "command": 0.6, "e": 0.3}
    u: Any = block.U(**here)
    together = block.output(0.0, batch, u)
    after = block.update(0.0, batch, u, together)
    for n, x in enumerate(cars):
        y = block.output(0.0, x, u)
        assert [float(np.broadcast_to(value, 3)[n]) for value in together] == pytest.approx(list(y), abs=1e-12)
        alone = block.update(0.0, x, u, y)
        assert [float(np.broadcast_to(value, 3)[n]) for value in after] == pytest.approx(list(alone), abs=1e-12)
    assert sorted({float(value) for value in together.late}) == pytest.approx([0.0, 0.25, 0.4])


@pytest.mark.parametrize("kind", ["left", "slow"])
def test_with_ratio_tyres_and_delay_off_by_three_doubts_it_notices_and_keeps_the_car(kind: str) -> None:
    """The first half second is not noticed in time."""
    car: dict[str, Any] = {"vehicle": {"ratio": 0.7, "tyres": 0.7}, "steering": {"delay": 0.2}}
    off = Scenario.under("hard", course="paper", driver={"v_min": 3.0, "v_max": 3.0}, knowledge={"delay": 0.05}, **car)
    log = driven(kind, off)
    settled = log.t > 3.0
    assert np.abs(log["path.e"][settled]).max() < 0.5
    assert doubted(log["safety.late"][-1], log["safety.widened"][-1]).startswith("commands arrive 0.20 s later than")
    if kind == "slow":
        stubborn = driven(kind, off, later=0.0, widest=1.0)
        assert np.abs(stubborn["path.e"][settled]).max() > 1.0
    assert np.abs(log["path.e"]).max() < 0.65


def test_what_was_found_is_told_in_words() -> None:
    assert (doubted(0.0, 1.5), doubted(math.nan, math.nan)) == ("", "")
    assert doubted(0.15, 1.2) == "commands arrive 0.15 s later than believed"
    assert doubted(0.0, 2.0) == "ratio and tyres doubted 2.0 times as much"
