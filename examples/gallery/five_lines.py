"""Five lines: Stanley on a real lap.

The course is a recorded drive of 3.7 km, the car a nonlinear single track; the first two minutes of it.
"""

from steerkit import NonlinearSingleTrack, Stanley, course, placed, simulate, steering_loop, vehicle
from steerkit.plants.human_driver import ConstantSpeed

path, passat = course("genesis"), vehicle("vw-passat")
car = placed(NonlinearSingleTrack(vehicle=passat, v0=6.0), path)
loop = steering_loop(car=car, path=path, driver=ConstantSpeed(speed=6.0), controller=Stanley.of(passat))
log = simulate(loop, 120.0)
log.plot("path.e", "car.delta_sw", "car.a_y").savefig("five_lines.png")

print(f"max |e| {abs(log['path.e']).max():.3f} m , max |a_y| {abs(log['car.a_y']).max():.2f} m/s^2")
