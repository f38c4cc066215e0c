"""Recovery: a learner that turns the wheel to the left from 8 s on, and answers NaN from 60 s on.

The supervisor gives the wheel to Stanley when |e| > 0.5 m or at a fault, and hands it back when |e| < 0.1 m.
"""

import math
from dataclasses import dataclass
from typing import Any

from steerkit import Block, Integrator, NonlinearSingleTrack, Out, Stanley, SteeringActuator
from steerkit import course, placed, simulate, steering_loop, vehicle
from steerkit.plots.drive import learning
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.diagram.units import radians_of


@dataclass(frozen=True, eq=False, kw_only=True)
class FaultyLearner(Block):
    """Turns the wheel further left each sample, and answers NaN from 60 s on. Outputs: action [rad], ready [1]."""

    action = Out("rad", direct=())
    ready = Out("1", direct=())

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(math.nan if t > 60.0 else radians_of(2.0), float(t > 8.0))


path, passat = course("circle"), vehicle("vw-passat")
loop = steering_loop(
    car=placed(NonlinearSingleTrack(vehicle=passat, v0=5.0), path),
    path=path,
    driver=ConstantSpeed(speed=5.0),
    controller=FaultyLearner(),
    doe=Integrator(),
    recovery=Stanley.of(passat),
    actuator=SteeringActuator(lag=0.12),
    reference=passat.l_f,
)
log = simulate(loop, 90.0, every=5, allow_nonfinite=True)
takeovers = int((log["supervisor.tripped"] > 0.5).sum())
print(f"taken over {takeovers} times by |e| and once by NaN; max |e| {abs(log['path.e']).max():.2f} m")
learning(log, title="A faulty learner and its recovery controller", seconds=90.0).savefig("recovery.png")
