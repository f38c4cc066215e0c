"""A car steered by torque, made from what a plant learned from real drives of a production car answered."""

from dataclasses import dataclass
from typing import Any, ClassVar

from steerkit._support.errors import number
from steerkit._support.random import normals, seed_state, uniform
from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.maths import Scalar
from steerkit.plants.single_track import IntegratedCar
from steerkit.vehicles import VW_PASSAT, Vehicle

_TICK = 0.1  # s: inside, the car lives in steps of 10 Hz
_DEAD = 5  # ticks: an answer begins 0.5 s after the command was sampled, as a line to the answer of the tick after
_SLEW = 5.0  # m/s^3
_LIMIT = 3.0  # m/s^2
_GAINS = 1.3, 2.3  # steady gain, between these; how it depends on amplitude and speed is the seed's
_SLOW, _FAST = 8.0, 30.0  # m/s: between them gain and wander grow
_LEAD, _LEAD_TIME, _LEAD_LIMIT = 1.2, 0.7, 0.3  # 1, s, m/s^2: a small change overshoots: phase at 0.2 Hz
_CREEP, _CREEP_TIME, _CREEP_FULL = 0.4, 3.0, 2.0  # 1, s, m/s^2: of a large change this share comes late
_WANDER = 0.04, 0.18  # m/s^2, standard deviations at _SLOW and _FAST
_WANDER_TIME = 1.5  # s
_STREAM = 36


@dataclass(frozen=True, eq=False, kw_only=True)
class TorqueCar(IntegratedCar):
    """A car whose lateral acceleration follows a command as a learned plant's did, dead time and all its moods.

    The commanded angle means a_c = tan(delta_sw_cmd/steer_ratio)/C(v), C(v) = (L + K v^2)/v^2, of the data sheet, as
    for `TorqueSteering`, of which nothing else is used. Every 0.1 s that is sampled; 0.5 s later, c being that sample:

        s = g(c, v) c,  g = g_0(v) + (g_1(v) - g_0(v)) c^2/(0.5 + c^2),
        l+ = l + (1 - exp(-0.1/0.7)) (s - l),   lead = sat(1.2 (s - l), +-0.3 m/s^2),
        k+ = k + (1 - exp(-0.1/3)) (s - k),     creep = 0.4 min(1, |s|/2) (s - k),
        q+ = q + sat(sat(s + lead - creep, +-3 m/s^2) - q, +-0.5 m/s^2),
        d+ = exp(-0.1/1.5) d + sqrt(1 - exp(-0.2/1.5)) sigma(v) n,   sigma: 0.04 at 8 m/s to 0.18 at 30 m/s,

    and a goes on a straight line to sat(q+ + d+, +-3 m/s^2), where it is after 0.1 s more. g_0 and g_1, the steady
    gains of small and large commands, are linear in v from 8 to 30 m/s, between gains that the seed draws, each uniform
    in 1.3 to 2.3. The car moves in the plane: r = a/v, beta = (l_r/v^2 - m l_f/(L c_r)) a, v as commanded. delta_sw is
    the angle that goes with a: steer_ratio atan(C(v) a). Below 1 m/s it turns as at 1 m/s. Car i of a batch has seed +
    i.

    A scenario's steering in front of it is left out (`own_steering`) and says only what controllers are told.
    state: x, y, psi, v; the four gains; the last answer, the next and the samples since; l, k, q, d; the generator's
    six numbers; the commands on their way, oldest first. valid: 8 to 30 m/s, dt = 0.01 s. NaN in an input gives NaN for
    good.
    source: answers to steps and sines, measured; an overshoot of small changes alone reconciles the phases at 0.2 Hz
    (as 0.3 s) and 0.8 Hz (as 0.57 s) with a dead time of 0.5 s; large changes creep.
    """

    own_steering: ClassVar[bool] = True

    vehicle: Vehicle = VW_PASSAT
    """The car of the data sheet that commands are meant for; its geometry and rear tyres."""
    seed: int = 0
    """Seed of its gains and its wander."""
    wander: Scalar = number(1.0, "1", low=0.0, high=10.0)
    """Wander over that measured [1]."""

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        random = seed_state(self.seed, batch, stream=_STREAM)
        gains = list[Scalar]()
        for _ in range(4):
            drawn, random = uniform(random)
            gains.append(_GAINS[0] + (_GAINS[1] - _GAINS[0]) * drawn)
        start = (m.filled(value, batch) for value in (self.x0, self.y0, self.psi0, self.v0))
        return (*start, *gains, *(zero,) * 7, *random, *(zero,) * _DEAD)

    def output(self, t: Any, x: State, u: Any) -> Any:
        before, after, since = x[8:11]
        v, a = m.maximum(x[3], 1.0), before + (after - before) * m.where(since < 0.5, 1.0, since * (self.dt / _TICK))
        p = self.vehicle
        beta = (p.l_r / (v * v) - p.m * p.l_f / ((p.l_f + p.l_r) * p.c_r)) * a
        angle = p.steer_ratio * m.atan(self._per_a(v) * a)
        return self.Y(x[0], x[1], x[2], x[3], beta, a / v * m.minimum(x[3], 1.0), a, angle)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        px, py, psi, _, *gains = x[:8]
        before, after, since, *memory = x[8:]
        lead, creep, reached, wander = memory[:4]
        random, waiting = tuple(memory[4:10]), memory[10:]
        v = m.maximum(u.v_cmd, 1.0)
        stop = self.vehicle.delta_sw_max
        wanted = m.tan(m.clip(u.delta_sw_cmd, -stop, stop) / self.vehicle.steer_ratio) / self._per_a(v)
        fast = m.clip((v - _SLOW) / (_FAST - _SLOW), 0.0, 1.0)
        c = waiting[0]
        small, large = gains[0] + (gains[1] - gains[0]) * fast, gains[2] + (gains[3] - gains[2]) * fast
        s = (small + (large - small) * c * c / (0.5 + c * c)) * c
        late = _CREEP * m.minimum(m.absolute(s) / _CREEP_FULL, 1.0) * (s - creep)
        aim = m.clip(s + m.clip(_LEAD * (s - lead), -_LEAD_LIMIT, _LEAD_LIMIT) - late, -_LIMIT, _LIMIT)
        drawn, _, fresh = normals(random)
        kept = _kept(_WANDER_TIME)
        sigma = self.wander * (_WANDER[0] + (_WANDER[1] - _WANDER[0]) * fast)
        moved = reached + m.clip(aim - reached, -_SLEW * _TICK, _SLEW * _TICK)
        drift = kept * wander + m.sqrt(1.0 - kept * kept) * sigma * drawn
        ticked = (
            after,
            m.clip(moved + drift, -_LIMIT, _LIMIT),
            0.0 * since,
            lead + (1.0 - _kept(_LEAD_TIME)) * (s - lead),
            creep + (1.0 - _kept(_CREEP_TIME)) * (s - creep),
            moved,
            drift,
            *fresh,
            *waiting[1:],
            wanted,
        )
        old = (before, after, since, *memory)
        now = m.chosen(since < 0.5, ticked, old)
        due = now[2] + 1.0 > round(_TICK / self.dt) - 0.5
        course = psi + y.beta
        return (
            px + self.dt * u.v_cmd * m.cos(course),
            py + self.dt * u.v_cmd * m.sin(course),
            psi + self.dt * y.r,
            u.v_cmd,
            *gains,
            *now[:2],
            m.where(due, 0.0, now[2] + 1.0),
            *now[3:],
        )

    def _per_a(self, v: Scalar) -> Scalar:
        """tan of the road-wheel angle over the lateral acceleration, by the data sheet [s^2/m]."""
        return (self.vehicle.l_f + self.vehicle.l_r) / (v * v) + self.vehicle.understeer_gradient


def _kept(time: float) -> float:
    return float(m.exp(-_TICK / time))
