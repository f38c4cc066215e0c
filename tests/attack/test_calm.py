"""No false alarm; 60 minutes of it, and both laps five times: `python -m tests.attack.calm`."""

import math

import pytest

from tests.attack import calm
from tests.attack.calm import Playback, busy_drive


@pytest.mark.parametrize("speed", [2.0, 7.0])
def test_hard_sensors_and_a_computer_that_is_held_up_are_no_fault(speed: float) -> None:
    drive = busy_drive(speed, 0, 12.0)
    assert drive.engaged_at_onset()
    assert math.isinf(drive.ended()), drive.cause()
    assert drive.excess() < 0.25


def test_a_computer_that_stands_still_for_longer_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calm, "HELD", 0.12)
    drive = busy_drive(5.0, 0, 5.0)
    (cause,) = [cause for _, mode, cause in drive.modes if mode == "FAULT"]
    assert cause.split(":")[0] in ("server late", "report stale", "missed deadlines")


@pytest.mark.parametrize(("name", "seconds"), [("genesis-rfs", 20.0), ("genesis", 12.0)])
def test_a_real_car_s_lap_is_believed(name: str, seconds: float) -> None:
    played = Playback(name, seed=1).run(until=seconds)
    assert played.alarms == []
    assert played.engaged > 0.98 * seconds


def test_a_heading_that_is_askew_by_more_than_is_borne_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the sensor was mounted, the real lap is at the edge of what is believed; twice as much is beyond it."""
    rows = calm.lap("genesis-rfs")
    monkeypatch.setattr(calm, "lap", lambda name: {**rows, "psi": rows["psi"] + 0.02})
    played = Playback("genesis-rfs", seed=1).run(until=20.0)
    assert "the heading's zero would be" in played.alarms[0][1]
