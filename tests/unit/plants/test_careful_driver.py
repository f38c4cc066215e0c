"""A careful driver keeps both accelerations."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.courses import course
from steerkit.plants.careful_driver import CarefulDriver
from steerkit.plants.human_driver import HumanDriver


def test_a_careful_driver_keeps_both_accelerations() -> None:
    path = course("paper")
    driver = CarefulDriver(path=path, driver=HumanDriver(v_min=7.5, v_max=7.5))
    s = np.linspace(0.0, path.length, 8000)
    v = driver.output(0.0, driver.init((len(s),)), driver.D(s)).v
    assert (v**2 * np.abs(path.kappa(s))).max() < 3.1
    assert np.abs(np.diff(v**2) / (2.0 * np.diff(s))).max() < 1.6
    assert v.max() > 6.9
    assert v.min() == pytest.approx(np.sqrt(3.0 / np.abs(path.samples.kappa).max()), rel=0.02)


def test_a_careful_driver_on_an_open_course_does_not_brake_for_its_own_start() -> None:
    path = course("genesis-rfs")
    driver = CarefulDriver(path=path, driver=HumanDriver(v_min=7.0, v_max=7.5), a_y_max=3.0)
    bend = float(path.samples.s[np.abs(path.samples.kappa).argmax()])
    fast, slow = (driver.output(0.0, driver.init(), driver.D(s)).v for s in (path.length, bend))
    assert fast > 7.0 > 6.95
    assert slow < 7.5
    with pytest.raises(ValueError, match="a_y_max"):
        CarefulDriver(path=path, driver=HumanDriver(), a_y_max=0.0)
