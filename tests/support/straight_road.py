"""A car steered along a straight road, with a slow actuator."""

from typing import Any

from steerkit.controllers.delay import delayed_stanley
from steerkit.diagram.loop import Loop
from steerkit.paths.courses import straight
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.vehicles import vehicle

PASSAT = vehicle("vw-passat")
ROAD = straight(400.0)


def steered(v: float = 6.0, controller: Any = None, delay: float = 0.2, driver: Any = None, **parts: Any) -> Loop:
    car = placed(LinearSingleTrack(vehicle=PASSAT, v0=v), ROAD, s=20.0)
    return steering_loop(
        car=car,
        path=ROAD,
        driver=driver or ConstantSpeed(speed=v),
        reference=PASSAT.l_f,
        controller=controller or delayed_stanley(PASSAT, delay=delay, lag=0.1),
        actuator=SteeringActuator(delay=delay, lag=0.1),
        **parts,
    )
