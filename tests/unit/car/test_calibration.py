"""The guided drive: what it does to the car, who may end it, and what its recording gives again."""

from typing import Any

import pytest

from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car.calibration import SHARES, SLOWEST, check
from steerkit.car.state_machine import Mode, Order
from tests.support.calibrated_car import CalibratedWorld, Made


def engaged(minutes: float, seconds: float, **more: Any) -> tuple[CalibratedWorld, Any]:
    """A guided drive that was engaged so many seconds ago, and its guide."""
    world = CalibratedWorld(minutes=minutes, **more)
    world.order(Order.ARM, then=0.2)
    world.order(Order.ENGAGE)
    world.until(world.t + seconds)
    return world, world.guided


def test_all_waves_are_driven_within_the_gates_limits_and_near_the_course(calibration: Made) -> None:
    world = calibration.world
    assert world.over
    assert world.mode is Mode.ENGAGED
    world.check_bus()
    driven = [s for s in world.seen if s.mode is Mode.ENGAGED]
    assert len(driven) == pytest.approx(0.5 * 60.0 * 20.0, abs=5)
    assert max(abs(s.e) for s in driven) < 0.6
    assert max(abs(s.a_y) for s in driven) < 3.0


def test_its_recording_says_which_wave_was_on_top_and_replays_bit_for_bit(calibration: Made) -> None:
    recorded = recordings.read(calibration.record)
    config = recordings.config_of(recorded)
    (drive,) = replays.drives(recorded)
    assert [steers.name for _, steers in drive.remarks] == [f"stanley+{wave}" for wave in SHARES]
    same = replays.replayed_requests(drive, config)
    assert same == len(drive.requests) > 600


def test_the_estimates_are_recorded_once_a_second_and_come_out_bit_for_bit_again(calibration: Made) -> None:
    recorded = recordings.read(calibration.record)
    (drive,) = replays.drives(recorded)
    estimators, same = replays.replayed_estimates(drive, recordings.config_of(recorded))
    recorded_estimates = recorded.of("/estimates")
    assert same == len(drive.estimates) == len(recorded_estimates) > 25
    assert estimators.found() == calibration.world.watched.estimators.found()
    last = calibration.world.watched.found
    assert {name: recorded_estimates[-1][name] for name in last} == {name: q.value for name, q in last.items()}
    assert {recorded_estimates[-1][f"{name}_valid"] for name in last} == {0.0, 1.0}
    one = drive.samples[400]
    assert one is not None
    drive.samples[400] = one._replace(r=one.r + 1e-9)  # which the replay notices
    assert 0 < replays.replayed_estimates(drive, recordings.config_of(recorded))[1] < same


def test_the_clock_stands_while_the_human_has_the_wheel_and_the_wave_goes_on_later() -> None:
    world, guided = engaged(0.4, 3.0)
    driven = guided.driven
    assert driven == pytest.approx(3.0, abs=0.1)
    assert guided.status().startswith("sine, the wheel swings slowly: 3 s of driving left, then steps")
    world.fault("override", length=0.1, then=1.0)
    assert world.mode is Mode.OVERRIDE
    assert guided.driven == pytest.approx(driven, abs=0.1)
    assert "until you engage" in guided.status()
    world.order(Order.ACKNOWLEDGE, then=0.2)
    assert world.mode is Mode.READY, "nothing engages by itself"
    world.order(Order.ENGAGE, then=1.0)
    assert guided.wave == "sine"
    assert guided.driven == pytest.approx(4.0, abs=0.2)
    world.check_bus()


def test_below_3_metres_a_second_the_clock_stands_and_says_so() -> None:
    world, guided = engaged(0.4, 1.0, v=(2.5, 2.6))
    assert world.mode is Mode.ENGAGED
    assert guided.driven == 0.0
    assert f"below {SLOWEST:g} m/s" in guided.status()


def test_the_operator_is_warned_before_the_end(calibration: Made) -> None:
    said = calibration.world.said
    assert any("HANDS ON THE WHEEL" in text for text in said)
    assert said[-1] == "all is driven: take the wheel"
    assert not any("HANDS" in text for text in said if text.startswith(("sine", "steps")))


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ({"minutes": 0.0}, "minutes = 0, expected 0.1 to 60"),
        ({"minutes": float("nan")}, "minutes = nan, expected 0.1 to 60"),
        ({"base": "stanly"}, "did you mean 'stanley'"),
        ({"base": "nfq"}, "calibrate: controller"),
    ],
)
def test_what_cannot_be_driven_is_refused(more: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        check(**({"base": "stanley", "minutes": 4.0} | more))
    for minutes in (0.1, 60.0):
        check("stanley", minutes)
