"""Five lines: Stanley on a real lap.

The course is a recorded drive of 3.7 km, the car a nonlinear single track; the first two minutes of it.
"""

from steerkit import SpeedDriver, NonlinearSingleTrack, Stanley, SteeringActuator
from steerkit import course, placed, simulate, steering_loop, vehicle

path, passat, driver, motor = course("genesis"), vehicle("vw-passat"), SpeedDriver(seed=1), SteeringActuator()
car, stanley = placed(NonlinearSingleTrack(vehicle=passat, v0=5.0), path), Stanley.of(passat)
loop = steering_loop(car=car, path=path, driver=driver, actuator=motor, controller=stanley, reference=passat.l_f)
log = simulate(loop, 120.0, every=5)
log.plot("path.e", "car.v", "car.delta_sw", "car.a_y").savefig("five_lines.png")

print(f"max |e| {abs(log['path.e']).max():.3f} m at the front axle, max |a_y| {abs(log['car.a_y']).max():.2f} m/s^2")
