"""Loops to be drawn."""

from typing import Any

import pytest

from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.loop import Loop
from steerkit.doe import Integrator
from steerkit.paths.courses import circle
from steerkit.plants.sensors import Sensors
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.plants.speed_driver import SpeedDriver
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.vehicles import VW_PASSAT as PASSAT
from tests.support.parts import Angle, Count, Delay, Gain, Pair, Sum, Wave


def small() -> Loop:
    wave, gain, angle, pair, late = Wave(), Gain(), Angle(), Pair(), Delay(dt=0.1)
    wires = [(wave.v, gain.u), (gain.y, angle.u), (gain.y, pair.u), (gain.y, late.u)]
    return Loop(blocks={"wave": wave, "gain": gain, "angle": angle, "pair": pair, "late": late}, wires=wires)


def learning(sensors: Any = None) -> Loop:
    return steering_loop(
        car=placed(LinearSingleTrack(vehicle=PASSAT, v0=5.0), circle()),
        path=circle(),
        driver=SpeedDriver(),
        controller=NfqPolicy(),
        doe=Integrator(),
        recovery=Stanley.of(PASSAT),
        actuator=SteeringActuator(),
        sensors=sensors,
    )


def backward() -> Loop:
    """Feedback only: every block feeds one before it."""
    a, b, c = Delay(), Delay(), Sum()
    return Loop(blocks={"a": a, "b": b, "c": c}, wires=[(b.y, a.u), (c.total, b.u), (a.y, c.u)])


LOOPS = {
    "one": lambda: Loop(blocks={"count": Count()}, wires=[]),
    "itself": lambda: (lambda total: Loop(blocks={"total": total}, wires=[(total.total, total.u)]))(Sum()),
    "small": small,
    "backward": backward,
    "learning": learning,
    "sensors": lambda: learning(Sensors()),
}
loops = pytest.mark.parametrize("name", LOOPS)
