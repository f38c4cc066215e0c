"""Tyre saturation: the linear and the nonlinear car, while the steering wheel turns slowly further at 12 m/s.

The linear tyre's force grows without end; the Fiala tyre slides at mu times its load.
"""

from dataclasses import dataclass, replace
from typing import Any

from steerkit import Block, LinearSingleTrack, Loop, NonlinearSingleTrack, Out, simulate, vehicle
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.plots.style import COLOURS, new_figure
from steerkit.diagram.units import degrees_of


@dataclass(frozen=True, eq=False, kw_only=True)
class SlowTurn(Block):
    """A wheel that turns to the left at 0.1 rad/s. Output: delta_sw [rad]."""

    delta_sw = Out("rad", direct=())

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(0.1 * t)


passat = vehicle("vw-passat")
cars = {
    "linear": LinearSingleTrack(vehicle=passat, v0=12.0),
    "nonlinear, mu 0.9": NonlinearSingleTrack(vehicle=passat, v0=12.0),
    "nonlinear, mu 0.3": NonlinearSingleTrack(vehicle=replace(passat, mu=0.3), v0=12.0),
}
figure, (axes,) = new_figure(title="Lateral acceleration over the steering wheel, 12 m/s")
for (name, car), colour in zip(cars.items(), ("muted", "learned", "analytic"), strict=True):
    wheel, driver = SlowTurn(), ConstantSpeed(speed=12.0)
    log = simulate(
        Loop(
            blocks={"wheel": wheel, "driver": driver, "car": car},
            wires=[(wheel.delta_sw, car.delta_sw_cmd), (driver.v, car.v_cmd)],
        ),
        40.0,
    )
    axes.plot(degrees_of(log["car.delta_sw"]), log["car.a_y"], color=COLOURS[colour], label=name)
    print(f"{name}: {log['car.a_y'].max():.1f} m/s^2 at most")
axes.set(xlabel="steering wheel [deg]", ylabel="a_y [m/s²]", ylim=(0.0, 14.0), xlim=(0.0, 230.0))
axes.legend(loc="upper left", frameon=False, fontsize=8)
figure.savefig("tyre_saturation.png")
