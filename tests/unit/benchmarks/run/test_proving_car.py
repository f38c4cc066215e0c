"""The study of manoeuvres on cars: can its judge of commands find one that is wrong?"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("opendbc")

from benchmarks.run.proving_car import KIT, ProvingWorld, config_on, fitting, oval
from steerkit.car.prove import check, runs_in


def test_commands_that_a_tighter_gate_would_not_have_let_through_are_counted(tmp_path: Path) -> None:
    config = config_on(oval(), tmp_path)
    wanted = replace(fitting("openpilot-sine-20", config, 8.0), repeats=1)
    file = tmp_path / "drive.mcap"
    world = ProvingWorld(wanted, config, file=file)
    run = world.begin()
    world.drive(1.0)
    assert world.beyond_gate == 0
    tighter: dict[str, Any] = {"jerk_max": 1.0}
    world.config = replace(config, gate=replace(config.gate, **tighter))  # the judge's; the core has the car's
    world.drive(3.0, lambda: run["end"] is not None)
    assert world.beyond_gate > 5
    world.close()
    (told,) = runs_in(file)
    assert (told["cause"], told["side"]) == ("", "left")


@pytest.mark.parametrize("name", ["step-steer", "pulse-steer", "openpilot-step-30", "lane-change-1"])
def test_a_fitting_manoeuvre_is_none_that_is_refused(name: str, tmp_path: Path) -> None:
    config = config_on(oval(), tmp_path, KIT)
    check(fitting(name, config, 8.0), config)
