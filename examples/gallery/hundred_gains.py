"""A hundred cars, a hundred gains: one sweep shows where Stanley's gain is too small and too large.

The parameter has a value a car; the equations are those of one car. The steering has 0.2 s of delay.
"""

from dataclasses import replace

import numpy as np

from steerkit import NonlinearSingleTrack, Stanley, SteeringActuator, course, placed, steering_loop, sweep, vehicle
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plots.style import COLOURS, new_figure

gains = np.geomspace(0.3, 12.0, 100)
path, passat = course("paper"), vehicle("vw-passat")
figure, (axes,) = new_figure(title="Stanley on the 800 m course, 0.2 s delay and 0.1 s lag: 40 s, 100 cars a line")
for label, damping, colour in (("with damping", 1.0, "learned"), ("without", 0.0, "analytic")):
    stanley = Stanley.of(passat)
    stanley = replace(stanley, k_d_yaw=damping * stanley.k_d_yaw, k_d_steer=damping * stanley.k_d_steer)
    loop = steering_loop(
        car=placed(NonlinearSingleTrack(vehicle=passat, v0=6.0, dt=0.05, substeps=5), path),
        path=path,
        driver=ConstantSpeed(speed=6.0),
        controller=stanley,
        actuator=SteeringActuator(delay=0.2, dt=0.05),
        reference=passat.l_f,
    )
    found = sweep(loop, {"controller.k": gains}, 40.0, ["rms_e"])
    axes.loglog(gains, found["rms_e"], color=COLOURS[colour], label=label)
    best = found.best("rms_e")
    print(f"{label}: best k = {best['controller.k']:.1f}, RMS e {best['rms_e']:.3f} m")
axes.axhline(0.5, color=COLOURS["limit"], lw=0.8, ls="--", label="0.5 m")
axes.set(xlabel="cross-track gain k [1/s]", ylabel="RMS e [m]", ylim=(0.02, 3.0))
axes.legend(loc="upper left", frameon=False, fontsize=8)
figure.savefig("hundred_gains.png")
