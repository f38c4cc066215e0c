"""What is wired to what: every loop draws itself.

Ports with units, sample rates, and which inputs break a loop of wires (hollow). A wire between two units is an error.
"""

from steerkit import SpeedDriver, NonlinearSingleTrack, Sensors, Stanley, SteeringActuator, WiringError
from steerkit import course, placed, steering_loop, vehicle

path, passat = course("paper"), vehicle("vw-passat")
car = placed(NonlinearSingleTrack(vehicle=passat, v0=5.0), path)
stanley = Stanley.of(passat)
loop = steering_loop(
    car=car,
    path=path,
    driver=SpeedDriver(seed=1),
    actuator=SteeringActuator(lag=0.12),
    sensors=Sensors.hard(seed=1),
    controller=stanley,
)
loop.plot().savefig("what_is_wired.png")
print(loop)

try:
    type(loop)(blocks=loop.blocks, wires=[*loop.wires, (car.psi, stanley.e)])
except WiringError as error:
    print(error)
