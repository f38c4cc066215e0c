"""What is found of a car in any drive: true, within its intervals, and never at the cost of the drive."""

import copy
import math
from dataclasses import replace
from typing import Any

import pytest

from steerkit.car import estimates, protocol
from steerkit.car.estimates import CarEstimators, Watched, changes, in_words, known_in
from steerkit.car.protocol import ESTIMATES, Snapshot
from steerkit.car.state_machine import Mode
from steerkit.diagram.units import radians_of
from steerkit.estimators.estimate import Estimated
from steerkit.vehicles import vehicle_text
from tests.support.calibrated_car import CONFIG, DELAY, LAG, OFFSET, RATE_ZERO, RATIO, Made

NAN = math.nan


def fed(samples: list[Snapshot]) -> dict[str, Estimated]:
    estimators = CarEstimators(CONFIG)
    for sample in samples:
        estimators.sample(sample)
    return estimators.found()


def test_the_truth_is_in_the_intervals(calibration: Made) -> None:
    found = calibration.world.watched.found
    late = calibration.world.late()
    assert 0.005 < late < 0.035, "the car server's share"
    truth = {
        "delay_lag": DELAY + LAG + late,
        "delay": DELAY + late,
        "lag": LAG,
        "steer_ratio": RATIO * CONFIG.vehicle.steer_ratio,
        "understeer": CONFIG.vehicle.understeer_gradient,
        "offset": OFFSET,
        "rate_zero": RATE_ZERO,
        "friction": 0.0,
    }
    assert list(found) == list(ESTIMATES)
    outside = {
        name: (found[name], true) for name, true in truth.items() if not found[name].low <= true <= found[name].high
    }
    assert not outside
    known = {name for name, q in found.items() if q.valid > 0.5}
    assert {"delay", "lag", "delay_lag", "steer_ratio", "rate_zero"} <= known
    assert "understeer" not in known, "it cannot be found below 15 m/s"
    assert found["delay_lag"].high - found["delay_lag"].low < 0.03
    assert found["lag"].value == pytest.approx(LAG, abs=0.02), "half of it again would be beyond one prior's reach"
    assert found["steer_ratio"].high - found["steer_ratio"].low < 3.6, (
        "mostly that of a gyro whose scale may be 5 % off"
    )


def test_a_samples_motion_goes_with_the_next_ones_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    """The filter takes the wheel a sample late (`held`)."""
    got: dict[str, dict[str, float]] = {}
    monkeypatch.setattr(CarEstimators, "_feed", lambda of, name, given: got.update({name: given}))
    one = Snapshot(t=1.0, v=5.0, r=0.1, psi=0.2, delta_sw=0.3)
    estimators = CarEstimators(CONFIG)
    for sample in (one, Snapshot(t=1.05, v=6.0, r=0.5, psi=0.6, delta_sw=0.7)):
        estimators.sample(sample)
    motion = {key: got["filter"][key] for key in ("v", "r", "psi", "delta_sw", "delay", "lag")}
    assert motion == {"v": 5.0, "r": 0.1, "psi": 0.2, "delta_sw": 0.7, "delay": 0.05, "lag": 0.0}
    assert {got[name]["delta_sw_meas"] for name in ("short lag", "long lag", "friction")} == {0.3}


def test_driving_by_hand_shows_the_ratio_but_no_delay(calibration: Made) -> None:
    by_hand = [s._replace(mode=Mode.STANDBY) for s in calibration.world.seen]
    found = fed(by_hand)
    assert found["steer_ratio"].valid == 1.0
    assert found["steer_ratio"].low < RATIO * CONFIG.vehicle.steer_ratio < found["steer_ratio"].high
    prior = fed([])
    for name in ("delay", "lag", "delay_lag", "friction"):
        assert (found[name].value, found[name].valid) == (prior[name].value, 0.0)


def test_nothing_drifts_at_standstill() -> None:
    still = [
        Snapshot(t=0.05 * k, v=0.0, r=0.001, psi=0.3, delta_sw=0.2, command=0.2, report_age=0.01) for k in range(800)
    ]
    found, prior = fed([s._replace(mode=Mode.ENGAGED) for s in still]), fed([])
    for name in set(ESTIMATES) - {"rate_zero", "delay", "delay_lag"}:
        assert found[name].value == prior[name].value, name
        assert found[name].deviation >= prior[name].deviation, name
    assert found["delay_lag"].value == pytest.approx(prior["delay_lag"].value - 0.01)  # the report's age
    assert not any(found[name].valid for name in ESTIMATES if name != "rate_zero")
    assert found["rate_zero"].value == pytest.approx(0.001, abs=1e-4), "a gyro that stands says its zero"


@pytest.fixture(scope="module")
def under_way(calibration: Made) -> tuple[CarEstimators, list[Snapshot], dict[str, Estimated]]:
    """Estimators after 15 s, the samples of the next 6, and what they find in these."""
    samples = calibration.world.seen[:420]
    estimators = CarEstimators(CONFIG)
    for sample in samples[:300]:
        estimators.sample(sample)
    return estimators, samples[300:], fed(samples)


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (value, name)
        for i, name in enumerate(("r", "v", "delta_sw", "psi", "command", "report_age"))
        for value in ((NAN, math.inf, -math.inf)[i % 3], 1e300)
    ],
)
def test_a_signal_that_is_no_number_for_a_while_is_not_used_and_harms_nothing(
    under_way: tuple[CarEstimators, list[Snapshot], dict[str, Estimated]], name: str, value: float
) -> None:
    before, samples, whole = under_way
    estimators = copy.deepcopy(before)
    for k, sample in enumerate(samples):
        estimators.sample(sample._replace(**{name: value}) if k < 40 else sample)
    found = estimators.found()
    assert all(math.isfinite(number) for q in found.values() for number in q)
    for quantity in ("steer_ratio", "delay_lag"):
        assert found[quantity].value == pytest.approx(whole[quantity].value, abs=3.0 * found[quantity].deviation + 0.02)


def test_samples_that_come_late_or_are_lost_are_waited_out(calibration: Made) -> None:
    """Without that, what is 0.2 s older than it is taken for would be delay, and heading that nobody measured."""
    samples = calibration.world.seen
    found = fed([s for k, s in enumerate(samples) if k % 97 not in (1, 2, 3)])
    late = calibration.world.late()
    assert found["delay_lag"].low < DELAY + LAG + late < found["delay_lag"].high
    assert found["rate_zero"].low < RATE_ZERO < found["rate_zero"].high


def test_a_frozen_gyro_is_not_believed_to_be_a_car(calibration: Made) -> None:
    samples = calibration.world.seen
    found = fed([s._replace(r=samples[0].r, psi=samples[0].psi) for s in samples])
    assert found["delay_lag"].valid == 1.0, "the wheel goes on being measured"
    assert not (found["steer_ratio"].valid > 0.5 and found["steer_ratio"].high < 2.0 * CONFIG.vehicle.steer_ratio)


def test_an_error_of_arithmetic_resets_the_estimators_and_is_counted(
    calibration: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    estimators = CarEstimators(CONFIG)
    samples = calibration.world.seen
    for sample in samples[:200]:
        estimators.sample(sample)

    def divides(*_: Any) -> Any:
        raise ZeroDivisionError

    with monkeypatch.context() as patch:
        patch.setattr(type(estimators.blocks["friction"]), "update", divides)
        estimators.sample(samples[200])
    assert estimators.faults == 1
    assert estimators.found() == CarEstimators(CONFIG).found()
    for sample in samples[201:300]:
        estimators.sample(sample)
    estimators.x["filter"] = tuple(-1.0 for _ in estimators.x["filter"])  # no covariance: its roots do not exist
    assert estimators.found() == CarEstimators(CONFIG).found()
    assert estimators.faults == 2


def test_after_a_fault_all_is_found_anew_and_a_drive_that_ends_in_one_says_so(calibration: Made) -> None:
    samples, noted = calibration.world.seen, list[protocol.Estimates]()
    watched, prior = Watched(CONFIG, noted.append), fed([])
    for sample in samples:
        watched.sample(sample)
    assert len(noted) == len(samples) // estimates.EVERY, "once a second"
    assert watched.found["steer_ratio"].valid == 1.0
    ended = samples[-1]._replace(mode=Mode.FAULT)
    watched.sample(ended)
    assert watched.report() == [estimates.DOUBTED]
    assert watched.rows() == [("", estimates.DOUBTED)]
    assert watched.estimators.found() == prior
    for sample in [ended] * 20 + samples[:100]:
        watched.sample(sample)
    assert noted[-1] == estimates.message_of(watched.found)
    assert watched.estimators.found() == fed(samples[:100])
    assert len(watched.report()) == len(ESTIMATES), "and nothing is in doubt"


def test_a_screen_has_few_rows() -> None:
    watched = Watched(CONFIG, print)
    assert watched.rows() == []
    watched.found = {name: Estimated(0.1, 0.01, float(name == "lag")) for name in ESTIMATES}
    watched.before, watched.estimators.faults = {"lag": Estimated(0.3, 0.01, 1.0)}, 2
    assert [words for words, _ in watched.rows()] == ["found", "not yet", "", ""]
    assert watched.rows()[0][1] == "lag 0.100 [0.080, 0.120] s"
    assert watched.rows()[3][1].startswith("the estimators were reset 2 times")
    assert len(watched.report()) == len(ESTIMATES) + 2


# ---- since the last drive ----------------------------------------------------------------------------------------


def known(value: float, deviation: float, valid: float = 1.0) -> dict[str, Estimated]:
    return {"steer_ratio": Estimated(value, deviation, valid)}


def test_a_change_is_put_in_words_and_chance_is_none() -> None:
    (said,) = changes(known(15.6, 0.1), known(17.2, 0.1))
    assert said == (
        "changed since the last calibration: steering ratio 15.60 [15.40, 15.80] then, 17.20 [17.00, 17.40] now"
    )
    assert changes(known(15.6, 0.1), known(15.85, 0.1)) == []
    assert len(changes(known(15.6, 0.1), known(15.9, 0.1))) == 1
    assert changes(known(15.6, 0.1), known(17.2, 0.1, valid=0.0)) == []
    assert changes({}, known(17.2, 0.1)) == []
    assert in_words("offset", radians_of(1.5), 0.0) == "offset of the wheel 1.50 [1.50, 1.50] deg"


def test_only_what_a_drive_found_counts_as_known() -> None:
    rows: dict[str, Any] = {
        "steer_ratio": {"value": 17.0, "low": 16.8, "high": 17.2, "unit": "1", "source": "drive"},
        "offset": {"value": 0.0, "unit": "rad", "source": "data sheet"},
        "lag": {"value": 0.1, "low": 0.05, "high": 0.15, "unit": "s", "source": "log"},
        "delay": {"value": 0.1, "low": NAN, "high": 0.15, "unit": "s", "source": "drive"},
        "colour": {"value": 0.1, "low": 0.0, "high": 0.15, "unit": "s", "source": "drive"},
    }
    text = vehicle_text(CONFIG.vehicle, estimates=rows)
    found = estimates.earlier(replace(CONFIG, vehicle_file="mine.toml", texts={**CONFIG.texts, "mine.toml": text}))
    assert list(found) == ["steer_ratio"]
    assert estimates.earlier(CONFIG) == {}
    assert (found["steer_ratio"].low, found["steer_ratio"].high) == pytest.approx((16.8, 17.2))
    assert known_in('format = "steerkit vehicle 1"\nestimates = 3') == {}
    assert known_in('format = "steerkit vehicle 1"\n[estimates]\nlag = 3') == {}
    with pytest.raises(ValueError, match="mine: not TOML"):
        known_in("[", "mine")
