"""An adaptive controller follows valid estimates, slowly and within bounds, and drives as if it knew its car."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.offset_free import CommandCompensation, OffsetFree
from steerkit.controllers.pure_pursuit import PurePursuit
from steerkit.controllers.stanley import Stanley
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import YawDelay
from steerkit.paths.courses import circle
from steerkit.vehicles import VW_PASSAT as PASSAT
from tests.support.steered_car import answered, steered

HERE = dict(e=0.02, psi_e=0.01, kappa=0.01, v=6.0, r=0.05, delta_sw_meas=0.01)
HARD = replace(Stanley.of(PASSAT), k=5.0)
SOFT = replace(HARD, k=1.0)


def adaptive(**settings: Any) -> Adaptive:
    parts: dict[str, Any] = dict(
        blocks=(SOFT, HARD),
        delays=(0.0, 0.1),
        delay=YawDelay(vehicle=PASSAT, prior_lag=0.1),
        steering=SingleTrackFilter(vehicle=PASSAT),
    )
    return Adaptive(**parts | settings)


def asked(block: Any, x: Any, **u: float) -> float:
    return float(block.output(0.0, x, block.D(**HERE | u)).delta_sw)


def test_between_two_dead_times_two_controllers_are_mixed() -> None:
    block = adaptive()
    x = block.settle(0.0, block.init(), block.U(**HERE))
    soft, hard = (asked(law, law.settle(0.0, law.init(), law.U(**HERE))) for law in (SOFT, HARD))
    assert abs(soft - hard) > 0.05
    for delay, expected in ((0.0, soft), (0.1, hard), (0.025, 0.75 * soft + 0.25 * hard)):
        assert asked(block, (*x[:-2], delay, 1.0)) == pytest.approx(expected)


def test_the_ratio_is_in_the_command_and_taken_off_the_measured_wheel() -> None:
    block = adaptive()
    x = block.settle(0.0, (*block.init()[:-2], 0.0, 1.25), block.U(**HERE))
    seen = HERE | {"delta_sw_meas": 0.01 / 1.25}
    settled = SOFT.settle(0.0, SOFT.init(), SOFT.U(**seen))
    inner = asked(SOFT, settled, delta_sw_meas=0.01 / 1.25)
    assert asked(block, x) == pytest.approx(1.25 * inner)
    turned = asked(SOFT, settled, delta_sw_meas=0.1 / 1.25)  # the law is damped by how far the wheel has turned
    assert abs(turned - inner) > 1e-3
    assert asked(block, x, delta_sw_meas=0.1) == pytest.approx(1.25 * turned)
    y = block.output(0.0, x, block.D(**HERE))
    assert block.update(0.0, x, block.U(**HERE), y)[1] == pytest.approx(inner)  # it goes on from its own angle
    assert abs(asked(replace(block, limit=0.01), x)) == 0.01


@pytest.mark.parametrize("valid", [1.0, 0.0])
def test_beliefs_move_by_half_a_second_a_second_and_a_tenth_towards_valid_estimates(
    valid: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a delay and lag, the lag of 0.1 s is not dead time; a ratio is believed from 0.6 to 1.6."""
    for takes_turns in (False, True):
        block = adaptive(delays=(0.0, 0.5), takes_turns=takes_turns)
        x = block.settle(0.0, block.init(), block.U(**HERE | ({"doe": 0.0} if takes_turns else {})))
        for found, ratio, before, after in (
            (0.5, 5.0, (0.1, 1.0), (0.125, 1.005)),
            (0.11, 0.1, (0.0, 0.603), (0.025 if takes_turns else 0.01, 0.6)),
            (0.0, 1.9, (0.3, 1.597), (0.275, 1.6)),
        ):
            for kind, values in ((YawDelay, dict(delay_lag=found)), (SingleTrackFilter, dict(ratio=ratio))):
                names = dict.fromkeys(kind.Y._fields, 0.0) | values
                names |= {name: valid for name in ("delay_lag_valid", "ratio_valid") if name in names}
                y = kind.Y(**names)
                monkeypatch.setattr(kind, "output", lambda *_, y=y: y)
            u = block.U(**HERE | ({"doe": 0.0} if takes_turns else {}))
            believed = block.update(0.0, (*x[:-2], *before), u, block.Y(0.0))[-2:]
            assert believed == pytest.approx(after if valid else before)


def test_one_that_takes_turns_learns_from_the_commands_of_others_which_it_sees_a_sample_late() -> None:
    signals = answered(steered(20.0), delay=0.15, lag=0.1, v=7.0 + np.zeros(400))
    found = []
    for block in (adaptive(delays=(0.0, 0.5)), adaptive(delays=(0.0, 0.5), takes_turns=True)):
        x = block.settle(0.0, block.init(), block.U(**HERE | {"doe": 0.0} if block.takes_turns else HERE))
        for k in range(400):
            u, sent = HERE | {"r": float(signals["r"][k]), "v": 7.0}, float(signals["delta_sw"][k])
            seen = {"doe": sent} if block.takes_turns else {}
            x = block.update(0.05 * k, x, block.U(**u | seen), block.Y(0.0 if block.takes_turns else sent))
        found.append(x[-2])
    assert found[0] == pytest.approx(0.15, abs=0.04)
    assert found[1] == pytest.approx(found[0] + 0.05, abs=1e-9)


def test_integral_action_stays_as_it_is_while_another_controller_steers_beside_the_path() -> None:
    law = OffsetFree.around(Stanley.of(PASSAT), PASSAT)
    block: Any = CommandCompensation(block=adaptive(blocks=(law, law), takes_turns=True), offset=0.05, gain=1.1)
    x = block.settle(0.0, block.init(), block.U(**HERE, doe=0.0))
    z, doe = len(law.init()) - 5, 0.05
    for k in range(60):
        own, before = block.output(0.05 * k, x, block.D(**HERE)).delta_sw, x[z]
        x = block.update(0.05 * k, x, block.U(**HERE, doe=doe), block.Y(own))
        doe = own + 0.1 if k < 30 else own
        if k <= 30:
            assert x[z] == 0.0, "the e of another one's drive"
        else:
            assert x[z] < before, "it steers itself, and stays left of the path"


def test_on_standby_it_keeps_its_estimates_and_learns_nothing_from_its_own_commands() -> None:
    block = adaptive(delay_rate=0.0, ratio_rate=0.0)
    first = block._parts[len(block.blocks)][1]

    def driven(x: Any, samples: range, *, standby: bool) -> Any:
        for k in samples:
            u = block.U(**HERE | {"r": 0.1 * math.sin(0.2 * k)})
            x = block.update(0.05 * k, x, u, block.Y(math.sin(0.2 * k + (3.0 if standby else 1.0))))
            if standby:
                fresh = block.settle(0.0, block.init(), block.U(**HERE))
                x = block.on_standby(x, fresh)
                assert x[:first] == fresh[:first], "the controllers begin anew"
        return x

    x = driven(block.settle(0.0, block.init(), block.U(**HERE)), range(80), standby=False)
    x = (*x[:-2], 0.07, 1.1)
    assert block.believed(x) == (0.07, 1.1)
    after = driven(driven(x, range(80, 81), standby=True), range(81, 300), standby=True)

    def estimates(x: Any) -> list[float]:
        states = block._states(x)
        ratio = block.steering.output(0.0, states[-1], ()).ratio
        return [*block.believed(x), block.delay.output(0.0, states[-2], ()).delay_lag, ratio]

    assert estimates(after)[2:] != estimates(block.init())[2:], "it had learned"
    once = block.on_standby(x, block.settle(0.0, block.init(), block.U(**HERE)))
    assert estimates(after) == pytest.approx(estimates(once), abs=1e-12)
    again = driven(after, range(300, 303), standby=False)
    assert again[-3] == 0.0
    assert estimates(again)[2:] == pytest.approx(estimates(once)[2:], abs=1e-12), "its commands have not acted yet"
    spoilt = list(x)
    spoilt[first + 20] = math.nan
    fresh = block.settle(0.0, block.init(), block.U(**HERE))
    assert block.on_standby(tuple(spoilt), fresh) == (*fresh[:-3], 1.0, *fresh[-2:]), "an end to what would never end"
    long = driven(after, range(300, 400), standby=False)
    assert estimates(long)[2:] != pytest.approx(estimates(once)[2:], abs=1e-6), "now they have"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"delays": (0.0,)}, "2 blocks for 1 delays, expected 2 or more"),
        ({"delays": (0.1, 0.0)}, "expected growing by the same step"),
        ({"blocks": (SOFT, PurePursuit.of(PASSAT, circle()))}, "blocks have different ports"),
        ({"blocks": (PurePursuit.of(PASSAT, circle()),) * 2}, "expected among them v, r"),
        ({"prior_delay": 0.11}, r"prior_delay = 0.11 .*expected 0 to 0.1"),
    ],
)
def test_what_it_is_not_made_for(settings: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        adaptive(**settings)
