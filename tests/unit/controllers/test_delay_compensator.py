"""A forecast is where the car will be: against a car that is moved by the same numbers, and in every backend."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from steerkit.controllers.delay_compensator import LENGTH, LONGEST, PREVIEW, CourseMotion, DelayCompensator, felt, moved
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.learning.nfq.rprop import new_net
from steerkit.task import DT

CAR = DelayCompensator(samples=5, now=0.004, before=0.005, earlier=0.003, back=0.2, slip=4e-4, yaw=0.38, straight=0.05)
FAST = replace(CAR, slip=0.0, loss=1.2e-3, yaw=1.0 / LENGTH, nose=0.9, tail=2e-3, fast=1.0)
TORQUE = replace(FAST, lead=1.2, fade=0.5, most=4.0, slew=7.0)
"""One whose steering overshoots and is slow."""


def driven(car: DelayCompensator, n: int = 80) -> tuple[list[Any], list[CourseMotion]]:
    """What is seen of a car of these numbers at n samples, and its motion; steered at random through its dead time."""
    rng, speed = np.random.default_rng(0), 5.0
    doe = np.concatenate((np.zeros(20), 0.2 * np.cumsum(rng.normal(size=n + 20))))  # doe[k + 20]: known at sample k
    doe[20] = 0.0
    u, slow = doe.copy(), 0.0
    for k in range(1, len(u)):
        wanted = doe[k] + np.clip(car.lead * (doe[k] - slow), -car.most / speed**2, car.most / speed**2)
        u[k] = np.clip(wanted, u[k - 1] - car.slew / speed**2, u[k - 1] + car.slew / speed**2)
        slow += car.fade * (doe[k] - slow)
    kappa = 0.02 * np.sin(0.1 * np.arange(n + 40))
    x, motions = CourseMotion(0.1, 0.02, -0.03, 0.01), []
    if car.fast:
        x = x._replace(psi_e=x.c - LENGTH * (x.r_e + speed * kappa[0]) / speed)
    for k in range(n + LONGEST):
        motions.append(x)
        acting = [u[k + 20 + 1 - car.samples - i] - car.straight for i in range(3)]
        x = moved(car, x, speed, acting, speed * (kappa[k + 1] - kappa[k]))
    seen = [
        SimpleNamespace(
            e=x.e, e_dot=speed * x.c, v=speed, psi_e=0.0 if car.fast else x.psi_e, r_e=x.r_e, doe=doe[k + 20],
            preview=tuple(kappa[k : k + PREVIEW]),
        )
        for k, x in enumerate(motions[:n])
    ]  # fmt: skip
    return seen, motions


@pytest.mark.parametrize("samples", [0, 1, 5, LONGEST])
@pytest.mark.parametrize("trust", [1.0, 0.25])
@pytest.mark.parametrize("kind", [CAR, FAST, TORQUE], ids=["slow", "fast", "torque"])
def test_the_forecast_is_where_the_car_will_be(kind: DelayCompensator, samples: int, trust: float) -> None:
    car = replace(kind, samples=samples, trust=trust, trust_course=min(1.0, 2.4 * trust))
    seen, motions = driven(car)
    x = car.at_first(seen[0])
    for k, u in enumerate(seen):
        if k > 40:  # what was steered before the first sample is forgotten
            e, e_dot, v, psi_e, r_e, doe = car.ahead(x, u)
            np.testing.assert_allclose((e, e_dot / v, psi_e, r_e), motions[k + samples], atol=1e-9)
            assert (v, doe) == (u.v, u.doe - car.straight)
        x = car.remember(x, u)


def test_a_filtered_motion_begins_as_it_is_measured() -> None:
    """In a steady bend, in which the sample before is known: the car has come from there."""
    car, v, w = replace(FAST, samples=0, trust=0.3, trust_course=0.1, straight=0.0), 15.0, 0.02
    doe = car.back * w * (1.0 + car.loss * v * v) / (car.now + car.before + car.earlier)
    u = SimpleNamespace(e=0.2, e_dot=v * 0.03, v=v, psi_e=0.0, r_e=v * w / LENGTH, doe=doe, preview=(0.0,) * PREVIEW)
    e, e_dot, _, psi_e, r_e, _ = car.ahead(car.at_first(u), u)
    assert (e, e_dot, psi_e, r_e) == pytest.approx((u.e, u.e_dot, 0.03 - w, u.r_e), abs=1e-12)


def test_a_step_overshoots_comes_back_and_takes_its_time() -> None:
    car, v = replace(CAR, lead=0.5, fade=0.1), 2.0
    u, slow, seen = 0.0, 0.0, []
    for _ in range(20):
        u, slow = felt(car, 1.0, slow, u, v)
        seen.append(u)
    np.testing.assert_allclose(seen, 1.0 + 0.5 * 0.9 ** np.arange(20), rtol=1e-12)
    assert felt(replace(car, most=0.8), 1.0, 0.0, 0.0, v) == (pytest.approx(1.2), pytest.approx(0.1))
    assert felt(replace(car, slew=0.8), 1.0, 0.0, 0.3, v)[0] == pytest.approx(0.5)
    assert felt(replace(car, slew=0.8), -1.0, 0.0, 0.3, v)[0] == pytest.approx(0.1)
    assert felt(CAR, 0.123, 9.0, 9.0, v) == (0.123, 9.0), "a car without feels the wheel's angle, to the last bit"
    assert felt(car, 0.3, float("nan"), float("nan"), v) == (0.3, 0.3)


@pytest.mark.parametrize("v", [6.0, 20.0, 40.0])
def test_in_a_steady_bend_a_fast_car_turns_as_its_wheel_says_and_soft_tyres_take_of_the_course(v: float) -> None:
    x = CourseMotion(0.0, 0.0, 0.0, 0.0)
    for _ in range(200):
        x = moved(FAST, x, v, (0.1, 0.1, 0.1))
    w = 0.1 * 0.012 / 0.2 / (1.0 + 1.2e-3 * v * v)
    assert x.c - x.psi_e == pytest.approx(w, rel=1e-9)
    assert x.r_e == pytest.approx(v * w / LENGTH, rel=1e-9)
    first = moved(FAST, CourseMotion(0.0, 0.0, 0.0, 0.0), v, (0.1, 0.1, 0.1))
    p = first.c - first.psi_e
    assert first.c == pytest.approx((0.9 - 2e-3 * v * v) * p + 0.5 * DT * first.r_e, rel=1e-9)


@pytest.mark.parametrize("broken", ["e", "e_dot", "r_e"])
@pytest.mark.parametrize("kind", [CAR, FAST], ids=["slow", "fast"])
def test_noise_is_filtered_and_a_nan_is_forgotten(kind: DelayCompensator, broken: str) -> None:
    car = replace(kind, samples=0, trust=0.25, trust_course=0.1)
    seen, motions = driven(car)
    rng, errors, x = np.random.default_rng(1), [], car.at_first(seen[0])
    for k, u in enumerate(seen):
        values = {name: getattr(u, name) + rng.normal(0.0, 0.01) for name in ("e", "e_dot", "r_e")}
        u = SimpleNamespace(**{**vars(u), **values})
        if k == 30:
            setattr(u, broken, float("nan"))
        if k > 50:
            e, e_dot, v, _, r_e, _ = car.ahead(x, u)
            errors.append((e - motions[k].e, e_dot - v * motions[k].c, r_e - motions[k].r_e))
        x = car.remember(x, u)
        assert np.isfinite(x).all() or 30 <= k < 33
    assert (np.std(errors, axis=0) > 0.0).all()
    assert (np.std(errors, axis=0) < 0.006).all()  # of 0.01


def test_a_policy_with_a_forecast_comes_back_bit_for_bit(tmp_path: Path) -> None:
    policy = NfqPolicy(nets=(new_net(seed=1),), preview_points=PREVIEW, forecast=TORQUE, continuous=True)
    policy.save(tmp_path / "p.npz")
    again = NfqPolicy.load(tmp_path / "p.npz")
    assert (again.forecast, again.continuous, again.preview_points) == (TORQUE, True, PREVIEW)
    kept = dict(np.load(tmp_path / "p.npz")) | {"forecast": np.zeros(12)}
    np.savez(tmp_path / "p.npz", **kept)
    with pytest.raises(ValueError, match="12 numbers, expected 17"):
        NfqPolicy.load(tmp_path / "p.npz")


def test_the_action_between_is_the_lowest_point_of_the_parabola() -> None:
    policy = NfqPolicy(nets=(new_net(seed=1),), actions=(-0.5, -0.1, 0.0, 0.2, 0.5), continuous=True)
    for lowest in np.linspace(-0.29, 0.34, 33):
        values = [(a - lowest) ** 2 for a in policy._order]
        best = policy._order[int(np.argmin(values))]
        assert policy._between(values, best) == pytest.approx(lowest, abs=1e-12)
    assert policy._between([1.0] * 5, 0.0) == 0.0  # flat: the action itself
    assert policy._between([5.0, 4.0, 3.0, 2.0, 1.0], policy._order[-1]) == policy._order[-1]  # at the end of the set


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("back", 1e300), ("straight", 1e12), ("slip", -10.1), ("now", float("nan"))),
        *(("lead", -1.1), ("fade", 1.1), ("most", -1.0), ("slew", float("nan"))),
    ],
)
def test_a_file_with_numbers_that_no_car_has_is_refused(name: str, value: float, tmp_path: Path) -> None:
    policy = NfqPolicy(nets=(new_net(seed=1),), preview_points=PREVIEW, forecast=replace(CAR, **{name: value}))
    policy.save(tmp_path / "p.npz")
    with pytest.raises(ValueError, match=f"{name} = "):
        NfqPolicy.load(tmp_path / "p.npz")
