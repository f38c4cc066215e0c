"""Five lines: Stanley on a recorded lap.

The course is a recorded drive of 3.7 km, the car a nonlinear single track at 6 m/s; the first two minutes.
"""

from steerkit import ConstantSpeed, NonlinearSingleTrack, Stanley, SteeringActuator
from steerkit import course, placed, simulate, steering_loop, vehicle

path, passat = course("genesis"), vehicle("vw-passat")
car = placed(NonlinearSingleTrack(vehicle=passat, v0=6.0), path)
speed, motor, stanley = ConstantSpeed(speed=6.0), SteeringActuator(lag=0.12), Stanley.of(passat)
loop = steering_loop(car=car, path=path, driver=speed, actuator=motor, controller=stanley, reference=passat.l_f)
log = simulate(loop, 120.0)
log.plot("path.e", "car.delta_sw", "car.a_y").savefig("five_lines.png")

print(f"max |e| {abs(log['path.e']).max():.3f} m at the front axle, max |a_y| {abs(log['car.a_y']).max():.2f} m/s^2")
