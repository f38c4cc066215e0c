"""A controller that is told of an offset and a gain drives as one without them on a steering without them."""

from __future__ import annotations

import numpy as np
import pytest

from steerkit.controllers.command_compensation import CommandCompensation
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.units import radians_of
from steerkit.doe import Integrator
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario import Scenario
from steerkit.scenario.catalogue import CONTROLLERS
from steerkit.scenario.drive import controller, drive
from steerkit.vehicles import vehicle

PASSAT = vehicle("vw-passat")
STEADY = Scenario(course="slalom", driver={"v_min": 6.0, "v_max": 6.0})


def test_offset_and_gain() -> None:
    block = CommandCompensation(block=Stanley.of(PASSAT), offset=0.1, gain=1.25)
    u = dict(e=0.2, psi_e=0.01, kappa=0.0, v=6.0, r=0.0, delta_sw_meas=0.0)
    inner = block.block.output(0.0, block.init(), block.D(**u)).delta_sw
    y = block.output(0.0, block.init(), block.D(**u))
    assert 1.25 * y.delta_sw + 0.1 == pytest.approx(inner)
    assert block.update(0.0, block.init(), block.U(**u), y) == pytest.approx(
        block.block.update(0.0, block.init(), block.U(**u), block.Y(inner))
    )


@pytest.mark.parametrize("name", [name for name in CONTROLLERS if name not in ("mpc", "nonlinear-mpc")])
def test_who_is_told_of_the_offset_drives_as_if_there_were_none(name: str) -> None:
    off = STEADY.with_(steering={"offset_deg": 5.0})
    without, untold, told = (
        drive(scenario, controller(name, scenario), rounds=0.5)["path.e"]
        for scenario in (STEADY, off, off.with_(knowledge={"oracle": True}))
    )
    settled = slice(100, None)  # it starts straight, which with an offset is not where it stands
    apart = [float(np.sqrt(np.mean((e - without)[settled] ** 2))) for e in (untold, told)]
    assert apart[1] < 0.1 * apart[0]


def test_what_it_is_not_made_for() -> None:
    with pytest.raises(ValueError, match=r"gain = 0.0 \[1\], expected > 0"):
        CommandCompensation(block=Stanley.of(PASSAT), gain=0.0)
    with pytest.raises(ValueError, match="expected delta_sw among them"):
        CommandCompensation(block=ConstantSpeed())
    assert CommandCompensation(block=Integrator()).delta_sw.spec.unit == "rad"
    assert CommandCompensation(block=Stanley.of(PASSAT)).dt == 0.05
    assert radians_of(5.0) == Scenario(steering={"offset_deg": 5.0}, knowledge={"oracle": True}).design_model().offset
