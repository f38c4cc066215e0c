"""The sign of an answer: closed forms, noise, dead times that nobody knows; and which of three signs is wrong."""

import itertools
import math

import numpy as np
import pytest

from steerkit.estimators.steering_sign import CLEAR, DOUBTED, SignTest, SteeringSigns
from steerkit.vehicles import VW_PASSAT
from steerkit.vehicles.rollout import Rollout

DT = 0.05
RNG = np.random.default_rng(0)


def evidences(x: np.ndarray, y: np.ndarray, longest: float = 1.0) -> np.ndarray:
    test, found = SignTest(longest, DT), []
    for pair in zip(x, y):
        test.add(*pair)
        found.append(test.evidence)
    return np.array(found)


def late(x: np.ndarray, dead: float) -> np.ndarray:
    n = round(dead / DT)
    return np.concatenate([np.full(n, x[0]), x])[: len(x)]


@pytest.mark.parametrize("gain", [0.5, 1.0, 2.3])
@pytest.mark.parametrize("dead", [0.0, 0.3, 1.0])
def test_an_exact_answer_leaves_only_what_the_other_sign_leaves(gain: float, dead: float) -> None:
    """x grows e-fold in a third of a second, and then stands."""
    x = 0.05 * np.minimum(np.exp(3.0 * np.arange(0.0, 2.0, DT)), 8.0)
    right, wrong = (evidences(x, sign * gain * late(x, dead) + 0.05)[-1] for sign in (1.0, -1.0))
    assert right < -CLEAR
    assert wrong > CLEAR
    if dead == 0.0:  # -1 leaves nothing; +1 all of y for the longest delays, and less than with the least gain at once
        age = DT * np.arange(len(x))[::-1]
        weight = DT * np.exp(-age / 1.5)
        spread = float(weight @ (x - weight @ x / weight.sum()) ** 2)
        least = 0.05 * gain**2 * spread + 0.006**2 * 1.5
        assert 0.5 * gain**2 * spread / least < wrong <= (gain + 0.4) ** 2 * spread / least * (1.0 + 1e-9)


@pytest.mark.parametrize("period", [0.55, 1.0, 1.6])
@pytest.mark.parametrize("dead", [0.0, 0.4, 0.8, 0.95])
def test_a_swing_tells_no_sign_whatever_the_dead_time(period: float, dead: float) -> None:
    x = 0.3 * np.sin(2.0 * math.pi / period * np.arange(0.0, 12.0, DT))
    assert evidences(x, late(x, dead))[-100:].max() < DOUBTED
    assert evidences(x, -late(x, dead))[-100:].min() > -DOUBTED


def test_noise_offsets_and_what_does_not_answer_tell_nothing() -> None:
    noise = RNG.normal(0.0, 0.0035, (2, 2000))
    assert np.abs(evidences(*noise)).max() < DOUBTED
    assert np.abs(evidences(noise[0], 0.1 + 0.0 * noise[1])).max() < DOUBTED
    assert SignTest(1.0).evidence == 0.0


SIGNS = {  # command, wheel's sensor, yaw rate
    (1, 1, 1): "",
    (-1, 1, 1): "sign of the command (delta_sw_cmd)",
    (1, -1, 1): "sign of its sensor (delta_sw)",
    (1, 1, -1): "sign of the yaw rate (r)",
    (-1, -1, 1): "sign of the wheel (delta_sw) and of the command (delta_sw_cmd), or of the whole pose",
}


@pytest.mark.parametrize("v", [2.0, 5.0, 20.0])
@pytest.mark.parametrize("signs", list(itertools.islice(SIGNS, 5)))
def test_the_wrong_sign_of_three_is_named(signs: tuple[int, int, int], v: float) -> None:
    """The wheel follows 0.1 s behind the command, the car rolls where its wheels point."""
    found = SteeringSigns(Rollout.of(VW_PASSAT))
    commanded, sensed, gyro = signs
    p, wheel, psi, said = VW_PASSAT, 0.0, 0.0, ""
    for t in np.arange(0.0, 3.0, DT):
        asked = min(3.0, 120.0 / v**2) * math.sin(1.5 * t)
        wheel += (commanded * asked - wheel) * DT / 0.1
        r = v * math.tan(wheel / p.steer_ratio) / (p.wheelbase + p.understeer_gradient * v * v)
        psi += DT * r
        found.add(t, command=asked, wheel=sensed * wheel, v=v, r=gyro * r, psi=psi)
        said = said or found.wrong()
    assert (SIGNS[signs] in said) == (said != "" or SIGNS[signs] == "")
    assert (said == "") == (signs == (1, 1, 1))


def test_what_was_certain_stays_until_the_contrary_is_or_it_is_forgotten() -> None:
    found = SteeringSigns(Rollout.of(VW_PASSAT))

    def driven(start: float, seconds: float, sign: float, *, wave: float = 1.0) -> None:
        for t in np.arange(start, start + seconds, DT):
            asked = wave * math.sin(1.5 * t)
            rate = 5.0 * math.tan(asked / 15.6) / (2.71 + VW_PASSAT.understeer_gradient * 25.0)
            found.add(t, command=asked, wheel=sign * asked, v=5.0, r=rate, psi=-rate / 1.5)

    driven(0.0, 3.0, -1.0)
    assert "sensor" in found.wrong()
    driven(3.0, 20.0, -1.0, wave=0.0)
    assert max(found.evidence[:2]) < DOUBTED
    assert "wheel" in found.wrong()
    found.forget()  # of the motor only
    assert "car turns against its wheel" in found.wrong()
    driven(23.0, 4.0, 1.0)
    assert "wheel" not in found.wrong().split(":")[0]


def test_a_pause_a_standstill_and_nan_are_no_evidence() -> None:
    found = SteeringSigns(Rollout.of(VW_PASSAT))
    for k in range(200):
        t, jump = DT * k, 0.1 * math.sin(0.2 * k)
        v, psi = (0.3, 0.0) if k < 100 else (5.0, math.nan)
        found.add(t, command=-3.0 * jump, wheel=3.0 * jump, v=v, r=-jump, psi=psi)
        found.add(t + 0.01, command=9.0, wheel=-9.0, v=5.0, r=1.0, psi=0.0)  # sooner than the next sample
    assert found.evidence == [0.0, 0.0, 0.0]
    assert found.wrong(DOUBTED) == ""
