"""A car that crosswind and the bank of the road push aside."""

import math
from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number, require
from steerkit._support.random import normals, seed_state
from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.maths import Scalar
from steerkit.plants.single_track import V_DYNAMIC, Car, NonlinearSingleTrack, SingleTrack, SingleTrackState

_STREAM = 11  # of `seed_state`: the gusts'
GUST_STATES = 7
"""How many numbers of a pushed car's state, the last ones, are the gusts': g and the generator's six."""


@dataclass(frozen=True, eq=False, kw_only=True)
class DisturbedPlant(Car):
    """A single-track car that crosswind and the bank of the road push aside.

    a_w(t) = wind + gust g(t),  g(t + dt) = f g(t) + sqrt(1 - f^2) n,  f = exp(-dt/gust_time),  n standard normal;
    before and after every step of the car, with a = a_w + bank:
    v_y += dt/2 a  (beta += dt/2 a/v),  r += dt/2 m a_w arm/i_z;  a_y += a.

    The push and the car's motion are integrated in turn (Strang splitting, second order in dt). A crosswind of speed w
    makes a_w = rho c_y A w^2/(2 m) (15 m/s on 1.6 m^2 of c_y A: 0.13 m/s^2), a road banked by phi makes bank = g
    sin(phi) to the low side. Ports: those of the car. State: the car's, g, the generator's six numbers. Valid from
    3 m/s on. Source: Rajamani 2012, section 2.3 (bank); Trevino 1997 (Gauss-Markov gusts); Strang 1968 (splitting).
    """

    block: SingleTrack
    """The car."""
    wind: Scalar = number(0.0, "m/s^2")
    """Lateral acceleration by steady wind [m/s^2], + = to the left."""
    gust: Scalar = number(0.0, "m/s^2", low=0.0)
    """Standard deviation of that by gusts [m/s^2]."""
    bank: Scalar = number(0.0, "m/s^2")
    """Lateral acceleration by the bank of the road [m/s^2]."""
    gust_time: float = number(1.0, "s", above=0.0)
    """Correlation time of the gusts [s]."""
    arm: Scalar = number(0.3, "m")
    """How far ahead of the centre of gravity the wind acts [m]."""
    seed: int = 0
    """Seed of the gusts."""
    dt: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        require(self.dt == self.block.dt, "DisturbedPlant", f"dt = {self.dt} s, but its car has {self.block.dt} s")

    def init(self, batch: tuple[int, ...] = ()) -> State:
        g, _, random = normals(seed_state(self.seed, batch, stream=_STREAM))
        return (*self.block.init(batch), g, *random)

    def output(self, t: Any, x: State, u: Any) -> Any:
        *motion, a_y, delta_sw = self.block.output(t, self._car(x), ())
        return self.Y(*motion, a_y + self._wind(x) + self.bank, delta_sw)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        car = self.block.update(t, self._kicked(self._car(x), x), self.block.U(u.delta_sw_cmd, u.v_cmd), ())
        car = self._kicked(car, x)
        keep = math.exp(-self.dt / self.gust_time)
        n, _, random = normals(tuple(x[-6:]))
        return (*car, keep * x[-GUST_STATES] + math.sqrt(1.0 - keep * keep) * n, *random)

    def _car(self, x: State) -> Any:
        return SingleTrackState(*x[:-GUST_STATES])

    def _kicked(self, car: SingleTrackState, x: State) -> SingleTrackState:
        """The car's state after half a step of the push alone."""
        wind, p = self._wind(x), self.block.vehicle
        a = wind + self.bank
        sideways = a if isinstance(self.block, NonlinearSingleTrack) else a / m.maximum(car.v, V_DYNAMIC)
        turn = p.m * wind * self.arm / p.i_z
        return car._replace(sway=car.sway + 0.5 * self.dt * sideways, r=car.r + 0.5 * self.dt * turn)

    def _wind(self, x: State) -> Scalar:
        return self.wind + self.gust * x[-GUST_STATES]
