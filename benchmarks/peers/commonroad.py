"""CommonRoad's multi-body car as a plant."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from steerkit._support.errors import require
from steerkit.diagram.block import State
from steerkit.diagram.maths import rk4
from steerkit.plants.single_track import IntegratedCar
from steerkit.vehicles import BMW_320I, FORD_ESCORT, G, Vehicle, vehicle_text

_VANAGON = (1478.8979637767998, 1.1507916024, 1.3211363976000001)  # kg, m, m
VW_VANAGON = replace(
    BMW_320I,
    name="vw-vanagon",
    m=_VANAGON[0],
    i_z=2473.1176915564442,
    l_f=_VANAGON[1],
    l_r=_VANAGON[2],
    c_f=21.92 * G * _VANAGON[0] * _VANAGON[2] / (_VANAGON[1] + _VANAGON[2]),
    c_r=21.92 * G * _VANAGON[0] * _VANAGON[1] / (_VANAGON[1] + _VANAGON[2]),
)
"""VW Vanagon of CommonRoad (vehicle 3), as `steerkit.vehicles` has the others; `VANAGON_FILE` is its vehicle file."""
VANAGON_FILE = {"name": "vw-vanagon.toml", "text": vehicle_text(VW_VANAGON)}
CARS = (BMW_320I, FORD_ESCORT, VW_VANAGON)
_FORWARD = 2.0  # 1/s: how fast the multi-body car's speed control closes a gap in speed
_PEDALS = 3.0  # m/s^2: with how much at most; more spins its wheels


@dataclass(frozen=True, eq=False, kw_only=True)
class CommonRoadMultiBody(IntegratedCar):
    """CommonRoad's multi-body car (29 states: suspension, wheels, Magic Formula tyres) as a plant that is not ours.

    x' = vehicle_dynamics_mb(x, (0, a_x)), `substeps` Runge-Kutta steps a sample, with the road-wheel angle put to
    delta_sw_cmd/steer_ratio (held) and a_x = 2/s (v_cmd - v_x) within +-3 m/s^2; a_y = v_y' + v_x r.

    Ports: those of `SingleTrack`, whose docstring has their units. State: the model's 29, the last delta_sw [rad] and
    the last v_cmd [m/s]. Interpreted floats only: the model cannot be traced or batched. Valid above 0.1 m/s.
    Raises ValueError for a car that CommonRoad has not, ImportError without commonroad-vehicle-models.
    Source: Althoff, Wuersching 2020, section 9; commonroad-vehicle-models 3.
    """

    pure = False  # its functions branch on their values

    vehicle: Vehicle = BMW_320I
    """`bmw-320i`, `ford-escort` or `vw-vanagon`, as they are: the model has no other tyres, masses and springs."""
    v0: float = 5.0
    """Start speed [m/s]."""
    substeps: int = 4
    """Integration steps a sample: its fastest mode is near -840/s, and Runge-Kutta stable to
    2.78/840 s, and exact to 1e-5 at 2.5 ms."""

    def __post_init__(self) -> None:
        super().__post_init__()
        valid = f"valid: {', '.join(car.name for car in CARS)}, with no other tyres, friction or ratio"
        require(self.vehicle in CARS, "CommonRoadMultiBody", f"car {self.vehicle.name!r}; {valid}")
        require(self.v0 > 0.1, "CommonRoadMultiBody", f"v0 = {self.v0} [m/s], expected > 0.1")

    @cached_property
    def _model(self) -> tuple[Any, Any, Any]:
        """The right-hand side, the initialiser, the parameters."""
        from vehiclemodels.init_mb import init_mb
        from vehiclemodels.parameters_vehicle1 import parameters_vehicle1
        from vehiclemodels.parameters_vehicle2 import parameters_vehicle2
        from vehiclemodels.parameters_vehicle3 import parameters_vehicle3
        from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

        kinds = {FORD_ESCORT: parameters_vehicle1, BMW_320I: parameters_vehicle2, VW_VANAGON: parameters_vehicle3}
        return vehicle_dynamics_mb, init_mb, kinds[self.vehicle]()

    def init(self, batch: tuple[int, ...] = ()) -> State:
        require(not batch, "CommonRoadMultiBody", "one car at a time: it cannot be batched")
        _, init_mb, parameters = self._model
        start = init_mb([self.x0, self.y0, 0.0, self.v0, self.psi0, 0.0, 0.0], parameters)
        return (*[float(value) for value in start], 0.0, self.v0)

    def output(self, t: Any, x: State, u: Any) -> Any:
        v_x, r, v_y = x[3], x[5], x[10]
        a_y = self._slope(x[:29], x[30])[10] + v_x * r
        return self.Y(x[0], x[1], x[4], math.hypot(v_x, v_y), math.atan2(v_y, v_x), r, float(a_y), x[29])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        p = self.vehicle
        delta_sw = min(max(u.delta_sw_cmd, -p.delta_sw_max), p.delta_sw_max)
        z: Sequence[float] = (*x[:2], delta_sw / float(p.steer_ratio), *x[3:29])
        for _ in range(self.substeps):
            z = rk4(lambda state: self._slope(state, u.v_cmd), z, self.dt / self.substeps)
        return (*z, delta_sw, u.v_cmd)

    def _slope(self, z: Sequence[float], v: float) -> Sequence[float]:
        if not all(map(math.isfinite, z)):  # the model's own functions raise on NaN, blocks hand it on
            return [math.nan] * 29
        rhs, _, parameters = self._model
        a_x = min(max(_FORWARD * (v - z[3]), -_PEDALS), _PEDALS)
        return rhs(list(z), [0.0, a_x], parameters)
