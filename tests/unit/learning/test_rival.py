"""The model-based rival."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from steerkit.learning.experiment import Experiment
from steerkit.learning.rival import BeforeState, ModelPolicy, model_based
from steerkit.learning.settings import DEFAULT
from tests.support.modelled_car import CAR


def test_the_optimal_gain_brings_the_modelled_car_onto_the_path_at_any_speed() -> None:
    policy = ModelPolicy(model=CAR)
    for v in (2.0, 4.5, 9.0, 14.0):
        s = np.array([[0.1, 0.0, v, 0.05, 0.0, 0.5]])
        x, earlier = BeforeState(0.5), s[:, 5]
        for _ in range(200):
            u = policy.U(*map(float, s[0]))
            y = policy.output(0.0, x, u)
            x = policy.update(0.0, x, u, y)
            s, earlier = CAR.step(s, np.array([y.action]), earlier), s[:, 5]
        np.testing.assert_allclose(s[0, [0, 1, 4]], 0.0, atol=1e-3)


def test_a_car_that_does_not_answer_the_wheel_is_refused() -> None:
    dead = replace(CAR, now=0.0, before=0.0, earlier=0.0)
    with pytest.raises(ValueError, match="cannot be steered"):
        ModelPolicy(model=dead)


def test_the_rival_drives_after_its_first_failure() -> None:
    run = model_based(Experiment(setting=DEFAULT, minutes=0.5))
    while not run.done():
        run.drive()
    assert run.counts.failures == 1
    assert run.counts.episodes[-1].distance > 100.0
    assert run.counts.episodes[-1].rms_e < 0.05


def test_the_gain_changes_with_the_speed_without_jumps() -> None:
    policy = ModelPolicy(model=CAR, limit=1e3)
    speeds = np.linspace(1.0, 15.0, 281)
    u = policy.U(*np.broadcast_arrays(0.1, 0.2 * speeds / 5.0, speeds, 0.05, 0.02, 0.5))
    action = policy.output(0.0, BeforeState(0.4), u).action
    exact = [action[20 * k] for k in range(15)]
    steps = np.abs(np.diff(action))
    assert steps.max() < 0.1 * np.ptp(exact)  # twenty samples from one tabled speed to the next
    between = action[10::20]
    assert all(min(a, b) - 1e-9 <= x <= max(a, b) + 1e-9 for a, b, x in zip(exact, exact[1:], between))


def test_the_rival_is_charged_for_its_training() -> None:
    run = model_based(Experiment(setting=replace(DEFAULT, fit_seconds=2.0), minutes=0.3))
    while not run.counts.failures:
        run.drive()
    failed = run.t
    while len(run.counts.episodes) == 1:
        run.drive()
    assert run.counts.episodes[1].began >= failed + 2.0 - 0.051
