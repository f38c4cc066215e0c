"""What a controller sees of the car: noise, drift, bias and latency; late and lost samples, jumps, no sideslip."""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from steerkit._support.errors import number, require_within, whole_samples
from steerkit._support.random import RandomState, normals, seed_state, uniform
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.vehicles import Vehicle

_STREAM, _STREAM_FAULTS = 2, 13  # of `seed_state`: the noise, and what goes wrong
_SLOWEST = 1.0  # m/s, for the estimate of sideslip
_ERRORS, _DRIFTS, _RANDOM, _NOISE = slice(0, 6), slice(6, 9), slice(9, 15), slice(0, 15)
_SEEN, _TRUE, _SHARE, _LOST, _OFF, _DRAWN = slice(15, 22), slice(22, 28), 28, 29, slice(30, 33), slice(30, 39)
_FAULTS, _ON_WAY, _SAMPLE = slice(15, 39), 39, 7
"""Places in the state: of the noise, of what goes wrong, of samples on their way; and the numbers of one of those."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensors(Block):
    """Measured pose and motion: the truth with bias, noise and drift, `latency` late; and what goes wrong with it.

    measured(t) = truth(t) + bias + noise n(t) + drift d(t),  seen(t) = measured(t - latency),
    d(t + dt) = f d(t) + sqrt(1 - f^2) n'(t),  f = exp(-dt/drift_time)   (Gauss-Markov, of the given deviation),

    n and n' standard normal, new for every sample and channel. By default all is zero: seen = truth. Each channel has a
    bias, x_bias, y_bias, psi_bias, v_bias, beta_bias, r_bias, and the standard deviations of noise and drift are
    position_noise and position_drift, of x and of y, psi_noise and psi_drift, v_noise, beta_noise, r_noise.

    A car in series sees worse, for judging controllers by what they will really see. With g' standard normal, new each
    sample, and for the truth in measured(t)

    older(t) = truth(t) + a (truth(t - dt) - truth(t)),  a dt uniform in 0 ... age_jitter, new each sample:
    x, y += o(t),  o(t + dt) = jump g' with probability dt/jump_time, else o(t),
    psi += b(t),  b(t + dt) = f b(t) + heading_drift sqrt(1 - f^2) g',  f = exp(-dt/heading_time),
    beta = rear r/max(v, 1 m/s)  where `rear` is given,
    seen(t) = seen(t - dt)  with the probability `lost`, else all of this.

    A position jumps when satellites are lost and found; the heading of an inertial unit wanders over minutes; and no
    car in series measures sideslip, so it is taken to be that of a rear axle that does not slide.

    inputs: x_in, y_in [m], psi_in [rad], v_in [m/s], beta_in [rad], r_in [rad/s], the truth. outputs: x, y, psi, v,
    beta, r, seen; age [s] of these, as a receiver stamps it: the latency, a dt and, held, dt after dt more. state: six
    errors of the present sample, three drifts, the generator's six numbers; the seven seen and the six true ones of the
    sample before, the share a, whether this sample is lost, o (two), b, six numbers of a second generator; then the
    latency/dt samples on their way (six numbers and their share, oldest first), all equal to the first sample at the
    start. In a batch, car i draws as sensors of seed + i do; deviations and biases may be `(N,)` arrays.
    errors: ValueError for a latency that is no multiple of dt. source: Gelb 1974 (Gauss-Markov); Nilsson 1998 (jitter);
    Misra, Enge 2011, ch. 5 and 7 (jumps of a position); Titterton, Weston 2004, ch. 12 (drift of a heading); Rajamani
    2012, eq. 2.12.
    """

    x_in = In("m")
    y_in = In("m")
    psi_in = In("rad")
    v_in = In("m/s")
    beta_in = In("rad")
    r_in = In("rad/s")
    x = Out("m", direct=(x_in,))
    y = Out("m", direct=(y_in,))
    psi = Out("rad", direct=(psi_in,))
    v = Out("m/s", direct=(v_in,))
    beta = Out("rad", direct=(v_in, beta_in, r_in))  # of v and r, where `rear` is given
    r = Out("rad/s", direct=(r_in,))
    age = Out("s", direct=())

    position_noise: Scalar = number(0.0, "m", low=0.0, high=10.0)
    psi_noise: Scalar = number(0.0, "rad", low=0.0, high=1.0)
    v_noise: Scalar = number(0.0, "m/s", low=0.0, high=1.0)
    beta_noise: Scalar = number(0.0, "rad", low=0.0, high=1.0)
    r_noise: Scalar = number(0.0, "rad/s", low=0.0, high=1.0)
    position_drift: Scalar = number(0.0, "m", low=0.0, high=10.0)
    psi_drift: Scalar = number(0.0, "rad", low=0.0, high=1.0)
    drift_time: float = number(10.0, "s", above=0.0, high=1e5)
    """Correlation time of the drift [s]."""
    x_bias: Scalar = number(0.0, "m", low=-10.0, high=10.0)
    y_bias: Scalar = number(0.0, "m", low=-10.0, high=10.0)
    psi_bias: Scalar = number(0.0, "rad", low=-10.0, high=10.0)
    v_bias: Scalar = number(0.0, "m/s", low=-10.0, high=10.0)
    beta_bias: Scalar = number(0.0, "rad", low=-10.0, high=10.0)
    r_bias: Scalar = number(0.0, "rad/s", low=-10.0, high=10.0)
    latency: float = 0.0
    """Age of what is seen [s], a multiple of dt."""
    age_jitter: float = 0.0
    """Longest age beyond the latency [s], at most dt."""
    lost: float = number(0.0, "1", low=0.0, high=0.9)
    """Share of samples that do not arrive [1]: the one before is held."""
    jump: Scalar = number(0.0, "m", low=0.0, high=10.0)
    """Standard deviation of the offset that x and y have from jump to jump [m]."""
    jump_time: float = number(20.0, "s", above=0.0, high=1e5)
    """Mean time between jumps [s]."""
    heading_drift: Scalar = number(0.0, "rad", low=0.0, high=1.0)
    """Standard deviation of the slow error of psi [rad]."""
    heading_time: float = number(60.0, "s", above=0.0, high=1e5)
    """Its correlation time [s]."""
    rear: Scalar | None = number(None, "m", low=0.02, high=20.0)
    """Centre of gravity to rear axle [m], for the estimate of beta; None: beta is measured."""
    seed: int = 0
    """Seed of the random numbers."""

    @classmethod
    def hard(cls, seed: int = 0, size: float = 1.0) -> Self:
        """A demanding but ordinary set: RTK position drifting by 1 cm, heading by 0.1 deg, gyro noise, 50 ms late.

        size: factor on noise and drift [1].
        """
        drifts: Any = dict(position_drift=size * 0.01, psi_drift=size * radians_of(0.1), drift_time=2.0)
        return cls(**drifts, r_noise=size * radians_of(0.2), latency=0.05, seed=seed)

    @classmethod
    def real(cls, vehicle: Vehicle, seed: int = 0, size: float = 1.0) -> Self:
        """A production car with a good satellite receiver: `hard` with 0.05 m/s of noise on the wheels' speed, up to
        20 ms of jitter, one sample in a hundred lost, jumps of 2 cm every 20 s, a heading that wanders by 0.2 degrees
        within minutes, sideslip unknown. size: factor on all errors but the age, of lost ones up to a half."""
        faults: Any = dict(age_jitter=0.02, lost=min(0.5, size * 0.01), jump=size * 0.02)
        drift = size * radians_of(0.2)
        return replace(cls.hard(seed, size), v_noise=size * 0.05, heading_drift=drift, rear=vehicle.l_r, **faults)

    def __post_init__(self) -> None:
        super().__post_init__()
        whole_samples("Sensors", "latency", self.latency, self.dt)
        require_within("Sensors", "age_jitter", self.age_jitter, "s", 0.0, self.dt, "at most dt")
        seed_state(self.seed)

    @cached_property
    def _noise(self) -> tuple[Scalar, ...]:
        pose = self.position_noise, self.position_noise, self.psi_noise
        return (*pose, self.v_noise, self.beta_noise, self.r_noise)

    @cached_property
    def _drift(self) -> tuple[Scalar, ...]:
        return self.position_drift, self.position_drift, self.psi_drift

    @cached_property
    def _exact(self) -> bool:
        """Are there no random errors to draw?"""
        return not any(np.any(deviation) for deviation in (*self._noise, *self._drift))

    @cached_property
    def _faultless(self) -> bool:
        """Does nothing go wrong from sample to sample?"""
        return not any(np.any(size) for size in (self.age_jitter, self.lost, self.jump, self.heading_drift))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        errors = self._drawn((zero,) * 3, seed_state(self.seed, batch, stream=_STREAM), kept=0.0)
        g1, g2, random = normals(seed_state(self.seed, batch, stream=_STREAM_FAULTS))
        g3, _, random = normals(random)
        faults = (*(zero,) * 15, self.jump * g1, self.jump * g2, self.heading_drift * g3, *random)
        return (*errors, *faults, *(zero,) * (_SAMPLE * round(self.latency / self.dt)))

    def settle(self, t: float, x: State, u: Any) -> State:
        return (*x[:_ON_WAY], *self._measured(x, u) * (len(x[_ON_WAY:]) // _SAMPLE))

    def output(self, t: Any, x: State, u: Any) -> Any:
        px, py, psi, v, beta, r, share = x[_ON_WAY : _ON_WAY + _SAMPLE] or self._measured(x, u)
        if self.rear is not None:
            beta = self.rear * r / m.maximum(v, _SLOWEST)
        if self._faultless:
            return self.Y(px, py, psi, v, beta, r, self.latency)
        o_x, o_y, b = x[_OFF]
        now = (px + o_x, py + o_y, psi + b, v, beta, r, self.latency + share * self.dt)
        *held, age = x[_SEEN]
        return self.Y(*[m.where(x[_LOST] > 0.5, old, new) for old, new in zip((*held, age + self.dt), now)])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        kept = float(np.exp(-self.dt / self.drift_time))
        errors = x[_NOISE] if self._exact else self._drawn(x[_DRIFTS], x[_RANDOM], kept=kept)
        faults = x[_FAULTS] if self._faultless else (*y, *[truth + 0.0 for truth in u], *self._faults(x[_DRAWN]))
        on_way = (*x[_ON_WAY + _SAMPLE :], *self._measured(x, u)) if x[_ON_WAY:] else ()
        return (*errors, *faults, *on_way)

    def _measured(self, x: State, u: Any) -> State:
        """What is measured now, and the share of a sample by which it is older."""
        share = x[_SHARE]
        if not self._faultless:
            u = [now + share * (before - now) for now, before in zip(u, x[_TRUE])]
        return (*[truth + error for truth, error in zip(u, x[_ERRORS])], share)

    def _drawn(self, drift: State, random: RandomState, kept: float) -> State:
        """Errors, drifts and generator for the next sample; `kept` is the drift's share f that stays."""
        n: list[Scalar] = []
        for _ in range(5):
            n1, n2, random = normals(random)
            n += (n1, n2)
        fresh = (1.0 - kept * kept) ** 0.5
        drift = tuple([kept * d + fresh * s * g for d, s, g in zip(drift, self._drift, n[6:9])])
        biases = (self.x_bias, self.y_bias, self.psi_bias, self.v_bias, self.beta_bias, self.r_bias)
        errors = [b + s * g for b, s, g in zip(biases, self._noise, n[:6])]
        return (*[e + d for e, d in zip(errors[:3], drift)], *errors[3:], *drift, *random)

    def _faults(self, x: State) -> State:
        """Share a, whether it is lost, o, b and generator for the next sample."""
        o_x, o_y, b, *state = x
        w_age, random = uniform(tuple(state))
        w_lost, random = uniform(random)
        w_jump, random = uniform(random)
        g1, g2, random = normals(random)
        g3, _, random = normals(random)
        jumps = w_jump < self.dt / self.jump_time
        o_x, o_y = (m.where(jumps, self.jump * g, before) for g, before in ((g1, o_x), (g2, o_y)))
        keep = math.exp(-self.dt / self.heading_time)
        b = keep * b + (1.0 - keep * keep) ** 0.5 * self.heading_drift * g3
        share, gone = w_age * (self.age_jitter / self.dt), m.where(w_lost < self.lost, 1.0, 0.0)
        return (share, gone, o_x, o_y, b, *random)
