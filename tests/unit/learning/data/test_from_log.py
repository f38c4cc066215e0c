"""Recorded drives as transitions: the geometry in closed form, the car behind them, and what shows too little of it."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from steerkit.doe import Integrator
from steerkit.learning.data.from_log import Array, Excitation, as_driven, transitions_of
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.dead_time import lateness, process_of
from steerkit.learning.settings import DEFAULT
from steerkit.vehicles import vehicle

CAR = vehicle("vw-passat")
LARGEST = max(DEFAULT.actions)
T = np.arange(2400) * 0.05
DESCRIPTION = DEFAULT.description()


@dataclass(frozen=True, kw_only=True)
class Recording:
    """A drive on a clock of its own."""

    delta_sw: Array
    v: Array
    r: Array
    name: str = "made up"
    dt: float = 0.05

    @property
    def driving(self) -> Array:
        return self.v >= 3.0


def steered(wheel: Array, *, late: float = 0.15, offset: float = 0.0, noise: float = 0.0) -> Recording:
    """What a car on rails does that answers its wheel `late` after it."""
    t = np.arange(len(wheel)) * 0.05
    speed = 6.0 + 0.5 * np.sin(0.1 * t)
    road = (np.interp(t - late, t, wheel) + offset) / float(CAR.steer_ratio)
    r = speed * road / float(CAR.wheelbase) + noise * np.random.default_rng(1).standard_normal(len(t))
    return Recording(delta_sw=wheel, v=speed, r=r)


def slalom(t: Array = T) -> Array:
    """A wheel that is turned to and fro, at changing pace."""
    return np.asarray(1.5 * np.sin(t + 3.0 * np.sin(0.15 * t)))


def recorded(drive: Recording, **late: float) -> Transitions:
    return transitions_of(drive, CAR, Integrator(), LARGEST, **late)[0]


def excitation(drive: Recording) -> Excitation:
    return Excitation.of(recorded(drive), DESCRIPTION, 0.6)


def test_a_circle_is_its_own_path() -> None:
    v, r = 5.0, 0.25
    ones = np.ones(400)
    log = as_driven(Recording(delta_sw=2.0 * ones, v=v * ones, r=r * ones), CAR)
    slip = CAR.l_r - CAR.m * CAR.l_f * v * v / (CAR.wheelbase * CAR.c_r)
    beta = np.arctan(slip * r / v)
    w = np.arctan2(v * np.sin(beta) + CAR.l_f * r, v * np.cos(beta))  # of the front axle's course to the car's axis
    inside = slice(50, -50)
    along = np.hypot(v * np.cos(beta), v * np.sin(beta) + CAR.l_f * r)
    np.testing.assert_allclose(log["path.kappa"][inside], r / along, rtol=5e-3)
    np.testing.assert_allclose(log["path.psi_e"][inside], -w, atol=2e-4)
    for name in ("path.e", "path.e_dot"):
        np.testing.assert_allclose(log[name][inside], 0.0, atol=2e-3)
    radius = np.hypot(log["car.x"] - log["car.x"].mean(), log["car.y"] - log["car.y"].mean())
    assert np.ptp(np.diff(log["path.progress"])[inside]) < 1e-3 < radius.max()


def test_state_action_and_next_state_fit_together() -> None:
    record, log = transitions_of(steered(slalom()), CAR, Integrator(), LARGEST)
    np.testing.assert_allclose(record.s[:, 5] + record.a, record.s_next[:, 5], atol=1e-12)
    assert not record.own.any()
    np.testing.assert_array_equal(record.s[:5, 2], log["car.v"][1:6])
    assert record.s[0, 5] == slalom()[0]  # the command of the sample before


def test_the_car_is_found_in_a_log() -> None:
    process = process_of(recorded(steered(slalom(), late=0.35, offset=0.05)), DESCRIPTION, 0.6)
    ratio = float(process.model.ratio(np.array([6.0]))[0])
    believed = (CAR.wheelbase - CAR.m * CAR.l_f * 36.0 / (CAR.wheelbase * CAR.c_r)) / CAR.wheelbase / CAR.steer_ratio
    assert ratio == pytest.approx(believed, rel=0.02)
    assert process.model.straight == pytest.approx(-0.05, abs=0.01)


@pytest.mark.parametrize("late", [0.05, 0.2, 0.4])
def test_the_wheel_is_late_by_what_it_is(late: float) -> None:
    found = lateness(recorded(steered(slalom(0.5 * T), late=late, noise=2e-3)))
    assert found == pytest.approx(late - 0.05, abs=0.005)  # a command can show in the next sample at the earliest


def test_a_smooth_driver_does_not_pass_lag_off_as_dead_time() -> None:
    record = recorded(steered(slalom(0.3 * T), late=0.3, noise=5e-3))
    assert process_of(record, DESCRIPTION, 0.6).forecast.samples <= 4


def test_a_late_wheel_gives_the_transitions_of_its_command() -> None:
    command = slalom()
    told = recorded(replace(steered(command, late=0.3), delta_sw=np.interp(T - 0.2, T, command)), delay=0.2)
    truth = recorded(steered(command, late=0.3))
    n = len(told) - 20
    np.testing.assert_allclose(told.s[10:n, 5], truth.s[10:n, 5], atol=1e-9)
    behind = np.copy(command)
    for k in range(1, len(T)):
        behind[k] = behind[k - 1] + (1.0 - np.exp(-0.05 / 0.2)) * (command[k] - behind[k - 1])
    told = recorded(replace(steered(command), delta_sw=behind), lag=0.2)
    apart = told.s[100:n, 5] - truth.s[100:n, 5]
    assert np.abs(apart).max() < 0.3 * np.abs(behind - command).max()


def test_gaps_and_standing_end_episodes() -> None:
    drive = steered(slalom())
    v = drive.v.copy()
    v[1000:1100] = 0.5
    record = recorded(replace(drive, v=v))
    assert set(record.episode) == {0, 1}
    assert len(record) == 2399 - 1 - 101
    assert record.s[:, 2].min() >= 3.0


@pytest.mark.parametrize(
    ("wheel", "why"),
    [
        (0.002 * slalom(), "wheel"),
        (np.full(2400, 1.0), "wheel"),
        (slalom(T[:500]), "s of driving"),
        (0.05 * slalom(), "wheel"),
    ],
)
def test_too_little_is_refused_with_what_to_drive(wheel: Array, why: str) -> None:
    with pytest.raises(
        ValueError, match=f"made up: shows too little of the car to learn from: .*{why}.*expected.*drive"
    ):
        excitation(steered(wheel, noise=3e-3)).require_enough("made up")


def test_a_slalom_is_enough_and_its_deviations_are_honest() -> None:
    found = excitation(steered(slalom(), noise=3e-3))
    found.require_enough("made up")
    assert found.seconds == pytest.approx(119.9, abs=0.2)
    assert found.wheel_deg == pytest.approx(86.0, abs=2.0)
    noisier = excitation(steered(slalom(), noise=3e-2))
    for name in ("gain_percent", "delay_ms", "straight_deg"):
        assert getattr(noisier, name) > 2.0 * getattr(found, name) > 0.0
    assert "deviations" in str(found)


def test_nonsense_is_refused() -> None:
    drive = steered(slalom())
    with pytest.raises(ValueError, match=r"a clock of 0[.]01 s"):
        as_driven(replace(drive, dt=0.01), CAR)
    with pytest.raises(ValueError, match="delay"):
        as_driven(drive, CAR, delay=2.0)
    with pytest.raises(ValueError, match="samples, expected more"):
        as_driven(steered(slalom(T[:20])), CAR)
