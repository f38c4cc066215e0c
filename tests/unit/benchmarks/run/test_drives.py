"""One drive of a benchmark: compiled as interpreted, judged where it says."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.entries import controller
from benchmarks.run.drives import drive
from benchmarks.scenarios import scene, suite_loop
from steerkit.vehicles import vehicle

STEP = scene(name="step", course="curvature-step", v_min=7.0, v_max=7.0)


PASSAT = vehicle("vw-passat")


def test_compiled_with_open_parameters_is_the_interpreted_drive() -> None:
    from steerkit.simulation import simulate

    scenario = replace(STEP, tyres=0.8, offset_deg=1.0, wind=0.2, gust=0.1, noise=1.0, latency=0.05)
    block = controller("stanley").make(scenario)  # type: ignore[misc]
    driven = drive(scenario, "stanley", seed=3)
    log = simulate(suite_loop(scenario, block, seed=3), 15.0, record=["path.e", "car.a_y"], every=5)
    e = driven.trajectory["e"][:300]
    assert np.abs(e - log["path.e"][:300]).max() < 1e-9
    assert driven.metrics["max_e"] == pytest.approx(np.abs(driven.trajectory["e"]).max(), rel=1e-12)
    assert driven.metrics["held"] == 1.0


def test_a_drive_that_leaves_the_road_says_how_far_it_came() -> None:
    driven = drive(replace(STEP, friction=0.12), "pure-pursuit")
    assert driven.metrics["held"] == 0.0
    assert 0.1 < driven.metrics["rounds"] < 0.9
    assert np.abs(driven.trajectory["e"]).max() <= 3.0
    assert driven.metrics["max_e"] > 0.5


def test_errors_are_judged_at_the_own_point_and_at_the_front_axle() -> None:
    front = drive(STEP, "stanley").metrics
    assert front["rms_e_front"] == front["rms_e"]
    rear = drive(STEP, "pure-pursuit", timed_steps=50).metrics
    # with the rear axle on an arc, the front one runs sqrt(R^2 + L^2) - R outside it
    outside = math.hypot(27.0, PASSAT.wheelbase) - 27.0
    assert rear["max_e_front"] == pytest.approx(outside + rear["rms_e"], abs=0.08)
    assert rear["max_e"] < 0.1
    assert 0.0 < rear["step_p50_us"] <= rear["step_p99_us"]


def test_a_learned_controller_needs_its_training() -> None:
    with pytest.raises(ValueError, match="give the policy of a training"):
        drive(STEP, "nfq-idoe")
