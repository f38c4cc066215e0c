"""Some cars by name, and where their numbers come from."""

from __future__ import annotations

from steerkit.vehicles.parameters import G, Vehicle


def _commonroad(name: str, m: float, i_z: float, l_f: float, l_r: float) -> Vehicle:
    """A car of CommonRoad with c_f = mu C m g l_r/L, c_r = mu C m g l_f/L; mu C = 21.92, the tyre's p_ky1."""
    per_metre = 21.92 * m * G / (l_f + l_r)
    return Vehicle(
        name=name, m=m, i_z=i_z, l_f=l_f, l_r=l_r, c_f=per_metre * l_r, c_r=per_metre * l_f, mu=1.0489, steer_ratio=16.0
    )


def scaled(name: str, m: float, wheelbase: float, steer_ratio: float = 15.6, mu: float = 0.9) -> Vehicle:
    """A car scaled from a measured one (m 1462, L 2.7, l_f 0.4 L, c_f 192150, c_r 202500, i_z 2500), l_f = 0.45 L.

    m [kg], wheelbase [m]. For a car of which little more is known; the way of opendbc.
    """
    size = m / 1462.0
    return Vehicle(
        name=name,
        m=m,
        i_z=2500.0 * size * (wheelbase / 2.7) ** 2,
        l_f=0.45 * wheelbase,
        l_r=0.55 * wheelbase,
        c_f=192150.0 * size * (0.55 / 0.6),
        c_r=202500.0 * size * (0.45 / 0.4),
        mu=mu,
        steer_ratio=steer_ratio,
    )


VW_PASSAT = scaled("vw-passat", m=1503.0 + 136.0, wheelbase=2.71, steer_ratio=15.6, mu=0.9)
"""VW Passat (B6), the paper's car: no value of it was published; none of these is measured on it.

wheelbase 2.71 m: manufacturer. m = 1503 kg + 136 kg of load, steer_ratio 15.6, centre of gravity at 0.45 of the
wheelbase: opendbc, `car/volkswagen/values.py` (Passat NMS). c_f = 197 kN/rad, c_r = 255 kN/rad, i_z = 2824 kg m^2:
scaled by mass and wheelbase from another car, as opendbc does (`car/interfaces.py`, `scale_rot_inertia`,
`scale_tire_stiffness`). mu = 0.9: assumed, dry asphalt.
"""

BMW_320I = _commonroad("bmw-320i", m=1093.2952334674046, i_z=1791.5995300122856, l_f=1.1561957064, l_r=1.4227170936)
"""BMW 320i of CommonRoad (vehicle 2): Althoff, Wuersching 2020, table 6; tyre of table 7.

The steer_ratio of 16 is assumed (CommonRoad steers the road wheels); all other values are theirs.
"""

FORD_ESCORT = _commonroad("ford-escort", m=1225.8878467253344, i_z=1538.8533713561394, l_f=0.88392, l_r=1.50876)
"""Ford Escort of CommonRoad (vehicle 1): Althoff, Wuersching 2020, table 6; tyre of table 7.

The steer_ratio of 16 is assumed (CommonRoad steers the road wheels); all other values are theirs.
"""

VEHICLES = {car.name: car for car in (VW_PASSAT, BMW_320I, FORD_ESCORT)}
"""The named cars."""
