"""Who drives: peers that are not installed are a row of their own, do-mpc drives."""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.entries import controller
from benchmarks.scenarios import scene

STEP = scene(name="step", course="curvature-step", v_min=7.0, v_max=7.0)


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
