"""Who drives: peers that are not installed are a row of their own, do-mpc drives."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.entries import controller
from benchmarks.scenarios import scene

STEP = scene(name="step", course="curvature-step", driver={"v_min": 7.0, "v_max": 7.0})


def test_one_that_is_told_the_truth_knows_what_the_scenario_hides() -> None:
    hidden = STEP.with_(
        vehicle={"ratio": 1.25},
        steering={"offset_deg": 2.0, "delay": 0.2, "lag": 0.3},
        knowledge={"delay": 0.0, "lag": 0.0},
    )
    seen = controller("lqr-oracle").as_believed(hidden).design_model()
    assert (seen.delay, seen.lag, seen.offset) == (0.2, 0.3, pytest.approx(np.deg2rad(2.0)))
    assert seen.vehicle.steer_ratio == pytest.approx(1.25 * STEP.nominal.steer_ratio)
    assert controller("lqr").as_believed(hidden) == hidden
    wrong = controller("lqr-told-wrong").as_believed(hidden).design_model()
    assert (wrong.delay, wrong.lag, wrong.offset) == (pytest.approx(0.3), 0.3, 0.0)


def test_a_missing_peer_is_a_row_of_its_own(monkeypatch: pytest.MonkeyPatch, tmp_path) -> None:
    from benchmarks import entries as controllers
    from benchmarks.run import runner
    from benchmarks.suites import Suite

    absent = replace(controller("do-mpc"), needs="no_such_package")
    monkeypatch.setitem(controllers.CONTROLLERS, "do-mpc", absent)  # type: ignore[arg-type]
    one = Suite(name="golden", about="", scenarios=(STEP,), controllers=("do-mpc",))
    (case,) = runner.run([one], tmp_path / "x", workers=1, quiet=True).cases
    assert case.status == "not installed"
    assert case.error == "no-such-package is not installed: pip install 'steerkit-control[peers]'"
