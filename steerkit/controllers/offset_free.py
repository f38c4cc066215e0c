"""Offsets of the steering: one that is known is compensated, any other is found by integral action."""

from dataclasses import dataclass
from typing import Any

from steerkit._support.errors import number
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, State, Wrapper
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import STOP, TRIP
from steerkit.vehicles import Vehicle, require_vehicle

_SHARE = 0.5
"""Of the time for which z has moved, in tau: what is left of a first error falls with its square [1]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class OffsetFree(Wrapper):
    """Wraps a steering controller so that no constant offset, bank, wind or wrong ratio leaves an error e behind.

        delta_sw = sat(delta_sw of `block` + z),   z' = -n/(v T tau) (e + T e'),   sat to +-limit,   |z| <= most

    T is the time constant with which `block` brings e to 0, tau that of the estimate z. For a law that drives
    e' = -e/T, a wheel that stands d beside its command adds v d/n to e' at the front axle, so that

        e' = -e/T + v (z + d)/n,   z' = -(z + d)/tau:

    z is an observer of the disturbance d, independent of the first error. A car that returns to its path as designed
    has e + T e' = 0, so nothing winds up; and where e stays constant, z stays only if e = 0. No model of the
    disturbance or of `block` is needed: the same lines serve Stanley, LQR and MPC, where a disturbance model would be
    another one in each, and none in Stanley.

    z is held while |e| > reach, below v_least, while the command is at its limit or at its fastest, and where e or v is
    not finite. Ports, units and sample time are those of `block`, which goes on from its own angle. State: that
    of `block`, then z [rad], the time for which it has moved [s], the mean of e + T e' [m], the last e [m] and the last
    command [rad]. Valid where `block` by itself is stable. Raises ValueError for a block without the inputs e and v and
    the output delta_sw.

    Source: Astrom, Hagglund 2006, section 3.5 and ch. 6 (conditional integration, cancelled pole); Pannocchia, Rawlings
    2003 and Maeder, Borrelli, Morari 2009 (what a model of the disturbance gives an MPC).
    """

    needs = ("e", "v")
    changes = ("delta_sw",)

    steer_ratio: Scalar = number(15.6, "1", low=1.0, high=100.0)
    """n, steering-wheel angle over road-wheel angle [1]."""
    approach: Scalar = number(0.5, "s", low=0.05, high=60.0)
    """T [s]; of the controllers of the catalogue 0.43 to 0.57 from 3 to 15 m/s, and the delay more."""
    time: Scalar = number(3.0, "s", low=0.1, high=1e4)
    """tau [s]."""
    time_late: Scalar = number(0.0, "s", low=0.0, high=1e4)
    """Up to which tau grows, to half of the time that z has moved, as a constant comes to be known [s]; 0: never."""
    surprise: Scalar = number(0.015, "m", low=1e-4, high=1e3)
    """Mean of e + T e' over `time`, each counted up to twice this, beyond which d is another one [m]: tau is `time`
    again, and grows anew."""
    v_full: Scalar | None = number(None, "m/s", above=0.0)
    """Speed above which `block` is slower, by v/v_full, and T and tau are longer [m/s]; None: nowhere."""
    most: Scalar = number(radians_of(60.0), "rad", low=0.0, high=30.0)
    """Largest |z| [rad]."""
    reach: Scalar = number(TRIP, "m", low=1e-3, high=1e3)
    """|e| beyond which the car is on its way back, and z is held [m]."""
    v_least: Scalar = number(1.0, "m/s", low=0.1, high=100.0)
    """Speed below which z is held [m/s]."""
    limit: Scalar = number(STOP, "rad", low=1e-3, high=30.0)
    """Largest |delta_sw| [rad]."""
    rate_limit: Scalar = number(radians_of(550.0), "rad/s", low=1e-3, high=200.0)
    """Fastest command of `block` [rad/s]; z is held from 99 % of it on."""

    @classmethod
    def around(cls, block: Block, vehicle: Vehicle, *, delay: float = 0.0, **settings: float) -> "OffsetFree":
        """`block` with ratio and stops of a `Vehicle`, for a steering with that delay [s].

        settings: any other fields.
        """
        require_vehicle(vehicle, "OffsetFree.around")
        known = dict(steer_ratio=vehicle.steer_ratio, limit=vehicle.delta_sw_max, approach=cls.approach + delay)
        known["rate_limit"] = getattr(block, "rate_limit", cls.rate_limit)
        return cls(block=block, **(known | settings))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*self.block.init(batch), *[m.filled(0.0, batch)] * 5)

    def settle(self, t: float, x: State, u: Any) -> State:
        inner = self.block.settle(t, self.inner(x), u)
        angle = u.delta_sw_meas if "delta_sw_meas" in u._fields else 0.0 * u.e
        return (*inner, *x[-5:-2], u.e + 0.0, angle + 0.0)

    def kept(self, x: State, after: State, steers: Scalar) -> State:
        """The state `after` that follows x, but with the z of x where another controller steers: e is not its own."""
        z_clock_usual = [m.where(steers, moved, held) for moved, held in zip(after[-5:-2], x[-5:-2])]
        return (*after[:-5], *z_clock_usual, *after[-2:])

    def output(self, t: Any, x: State, u: Any) -> Any:
        y = self.inner_output(t, x, u)
        return y._replace(delta_sw=m.clip(y.delta_sw + x[-5], -self.limit, self.limit))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        z, clock, usual, e_before, before = x[-5:]
        inner = self.block.update(t, self.inner(x), u, y._replace(delta_sw=y.delta_sw - z))
        v = m.maximum(u.v, self.v_least)
        slower = 1.0 if self.v_full is None else m.maximum(v / self.v_full, 1.0)
        approach = self.approach * slower
        beyond = self.dt * u.e + approach * (u.e - e_before)  # (e + T e') dt
        time = slower * m.maximum(self.time, m.minimum(_SHARE * clock, self.time_late))
        change = -self.steer_ratio / (v * approach * time) * beyond
        on_path = m.both(m.absolute(u.e) <= self.reach, u.v >= self.v_least)
        fastest = 0.99 * self.rate_limit * self.dt
        free = m.both(m.absolute(y.delta_sw) < self.limit, m.absolute(y.delta_sw - before) < fastest)
        moves = m.every(on_path, free, m.is_finite(change))
        z = m.clip(z + m.where(moves, change, 0.0), -self.most, self.most)
        counted = m.clip(beyond / self.dt, -2.0 * self.surprise, 2.0 * self.surprise)  # a tight bend is no constant
        usual = usual + m.where(moves, self.dt / self.time * (counted - usual), 0.0)
        clock = m.where(m.absolute(usual) > self.surprise, 0.0, clock + m.where(moves, self.dt, 0.0))
        return (*inner, z, clock, usual, u.e + 0.0, y.delta_sw + 0.0)


@dataclass(frozen=True, eq=False, kw_only=True)
class CommandCompensation(Wrapper):
    """Wraps a controller of a steering with a known offset and gain, and compensates its commands for both.

        delta_sw = (delta_sw of `block` - offset)/gain

    makes a steering that turns the wheel to gain*command + offset reach the angle that `block` asks for. Ports, units,
    state and sample time are those of `block`, which goes on from its own angle. It sees the measured angle as it is,
    with offset and gain in it, and what another controller commanded (doe) as the angle that this reaches.

    Raises ValueError for a gain that is not positive and for a block without an output delta_sw.
    """

    changes = ("delta_sw",)

    offset: float = 0.0
    """Offset of the angle reached [rad]."""
    gain: float = number(1.0, "1", above=0.0)
    """Angle reached over angle commanded [1]."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        y = self.inner_output(t, x, u)
        return y._replace(delta_sw=(y.delta_sw - self.offset) / self.gain)

    def seen(self, u: Any) -> Any:
        return u._replace(doe=self.gain * u.doe + self.offset) if "doe" in u._fields else u

    def update(self, t: Any, x: Any, u: Any, y: Any) -> State:
        return super().update(t, x, u, y._replace(delta_sw=self.gain * y.delta_sw + self.offset))
