"""The torque car answers as what it is made from: `TorqueCar` has the measured figures."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from benchmarks.plants.torque_car import TorqueCar
from steerkit.scenario import Scenario
from steerkit.scenario.drive import assembled, controller

CARS = [(seed, v) for seed in range(3) for v in (8.0, 16.0, 30.0)]


def answer(car: TorqueCar, v: float, seconds: float, command: Callable[[float], float]) -> np.ndarray:
    """a_y [m/s^2] at 100 Hz for a command in lateral acceleration [m/s^2] over time [s]."""
    p, x, seen = car.vehicle, car.init(), []
    per_a = (p.l_f + p.l_r) / v**2 + p.understeer_gradient
    for k in range(round(seconds / car.dt)):
        y = car.output(0.0, x, ())
        seen.append(y.a_y)
        x = car.update(0.0, x, car.U(p.steer_ratio * math.atan(per_a * command(k * car.dt)), v), y)
    return np.array(seen)


@pytest.mark.parametrize(("seed", "v"), CARS)
def test_a_step_is_answered_late_and_with_a_gain_that_depends_on_its_size(seed: int, v: float) -> None:
    car, gains = TorqueCar(seed=seed, v0=v, wander=0.0), []
    for size in (0.4, 0.7, 1.0):
        a = answer(car, v, 25.0, lambda t, size=size: size)
        tenth, half = (0.01 * np.argmax(a >= share * a[-1]) for share in (0.1, 0.5))
        assert 0.5 < tenth <= 0.55, "0.51 s where the slew does not count yet"
        assert 0.55 <= half <= 0.76
        assert np.diff(a).max() < 0.0501, "5 m/s^3"
        gains.append(a[-1] / size)
    assert all(1.3 <= gain <= 2.3 for gain in gains)
    assert max(gains) > 1.01 * min(gains)
    assert answer(car, v, 5.0, lambda t: -4.0).min() == -3.0


def test_large_steps_creep_to_their_end_for_seconds_and_small_ones_do_not() -> None:
    for size, least, most in ((1.3, 1.0, 5.0), (0.3, 0.0, 0.3)):
        for seed in range(4):
            a = answer(TorqueCar(seed=seed, v0=12.0, wander=0.0), 12.0, 25.0, lambda t, size=size: size)
            assert least < 0.01 * np.argmax(a >= 0.9 * a[-1]) - 0.5 < most


@pytest.mark.parametrize(("seed", "v"), CARS)
def test_sines_come_as_late_as_measured_at_either_frequency(seed: int, v: float) -> None:
    for hertz, expected in ((0.2, 0.3), (0.8, 0.57)):
        w = 2.0 * math.pi * hertz
        a = answer(TorqueCar(seed=seed, v0=v, wander=0.0), v, 30.0, lambda t, w=w: 0.15 * math.sin(w * t))
        t = 0.01 * np.arange(len(a))
        late = t >= 20.0
        phase = np.angle(2j * np.mean(a[late] * np.exp(-1j * w * t[late])))
        assert -phase / w == pytest.approx(expected, abs=0.02)


def test_without_a_command_it_wanders_more_the_faster_it_is() -> None:
    for v, deviation in ((8.0, 0.04), (30.0, 0.18)):
        a = answer(TorqueCar(seed=5, v0=v), v, 450.0, lambda t: 0.0)[100:]
        assert a.std() == pytest.approx(deviation, rel=0.15)
        shared = [np.corrcoef(a[:-lag], a[lag:])[0, 1] for lag in (100, 200)]
        assert shared[0] > math.exp(-1.0) > shared[1], "correlated over 1 to 2 s"


def test_it_turns_as_its_lateral_acceleration_says_and_its_seed_is_the_drives() -> None:
    car = TorqueCar(v0=10.0, wander=0.0)
    x = car.init()
    for _ in range(2000):
        y = car.output(0.0, x, ())
        x = car.update(0.0, x, car.U(0.1, 10.0), y)
    assert y.r * y.v == pytest.approx(y.a_y, rel=1e-9)
    assert math.isnan(car.update(0.0, x, car.U(math.nan, 10.0), y)[-1])
    scenario = Scenario(
        vehicle={"plant": "benchmarks.plants.torque_car:TorqueCar"},
        steering={"command": "torque", "delay": 0.5},
        driver={"v_min": 8.0, "v_max": 8.0},
    )
    loop = assembled(scenario, controller("stanley", scenario), seed=3)
    assert loop.blocks["car"].seed == 3
    assert scenario.random
    assert "actuator" not in loop.blocks, "it has its own"
