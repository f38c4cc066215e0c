"""What a controller sees of the car: noise, drift, bias and latency."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np

from steerkit._support.errors import require_within, whole_samples
from steerkit._support.random import RandomState, normals, seed_state
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.diagram.maths import Scalar
from steerkit.diagram.units import radians_of
from steerkit.task import DT

_STREAM = 2  # of `seed_state`: the sensors'
_CHANNELS = (("x", "m"), ("y", "m"), ("psi", "rad"), ("v", "m/s"), ("beta", "rad"), ("r", "rad/s"))


@dataclass(frozen=True, eq=False, kw_only=True)
class Sensors(Block):
    """Measured pose and motion: the truth plus bias, white noise and, on the pose, slow drift, `latency` late.

    measured(t) = truth(t) + bias + noise n(t) + drift d(t),  seen(t) = measured(t - latency),
    d(t + dt) = f d(t) + sqrt(1 - f^2) n'(t),  f = exp(-dt/drift_time)   (Gauss-Markov, of the given deviation),

    n and n' standard normal, new for every sample and channel. By default all is zero: seen = truth.

    inputs: x_in, y_in [m], psi_in [rad], v_in [m/s], beta_in [rad], r_in [rad/s], the truth. outputs: x, y, psi, v,
    beta, r, seen; age [s] of these, the latency. state: six errors of the present sample, three drifts, the generator's
    six numbers, then the latency/dt samples on their way (six numbers each, oldest first), all equal to the first
    sample at the start. In a batch, car i draws as sensors of seed + i do; deviations and biases may be `(N,)` arrays.
    errors: ValueError for parameters out of range, or a latency that is no multiple of dt. source: Gelb 1974 (Gauss-
    Markov).
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
    beta = Out("rad", direct=(beta_in,))
    r = Out("rad/s", direct=(r_in,))
    age = Out("s", direct=())

    position_noise: Scalar = 0.0
    """Standard deviation of the white noise on x and on y [m]."""
    psi_noise: Scalar = 0.0
    """Standard deviation of the white noise on psi [rad]."""
    v_noise: Scalar = 0.0
    """Standard deviation of the white noise on v [m/s]."""
    beta_noise: Scalar = 0.0
    """Standard deviation of the white noise on beta [rad]."""
    r_noise: Scalar = 0.0
    """Standard deviation of the white noise on r [rad/s]."""
    position_drift: Scalar = 0.0
    """Standard deviation of the drift of x and of y [m]."""
    psi_drift: Scalar = 0.0
    """Standard deviation of the drift of psi [rad]."""
    drift_time: float = 10.0
    """Correlation time of the drift [s]."""
    x_bias: Scalar = 0.0
    """Constant error of x [m]."""
    y_bias: Scalar = 0.0
    """Constant error of y [m]."""
    psi_bias: Scalar = 0.0
    """Constant error of psi [rad]."""
    v_bias: Scalar = 0.0
    """Constant error of v [m/s]."""
    beta_bias: Scalar = 0.0
    """Constant error of beta [rad]."""
    r_bias: Scalar = 0.0
    """Constant error of r [rad/s]."""
    latency: float = 0.0
    """Age of what is seen [s], a multiple of dt."""
    seed: int = 0
    """Seed of the random numbers."""
    dt: float = DT

    @classmethod
    def hard(cls, seed: int = 0, *, dt: float = DT) -> Self:
        """A demanding but ordinary set: RTK position drifting by 1 cm, heading by 0.1 deg, gyro noise, 50 ms late."""
        return cls(
            position_drift=0.01,
            psi_drift=radians_of(0.1),
            drift_time=2.0,
            r_noise=radians_of(0.2),
            latency=0.05,
            seed=seed,
            dt=dt,
        )

    @classmethod
    def real(cls, seed: int = 0, *, dt: float = DT) -> Self:
        """As `hard`, and what a car in series has: a speed from its wheels with 0.05 m/s of noise.
        `DegradedSensors.real` adds what goes wrong on the way, and has no sideslip."""
        full = cls.hard(seed, dt=dt)
        return dataclasses.replace(full, v_noise=0.05)

    def __post_init__(self) -> None:
        where = "Sensors"
        require_within(where, "dt", self.dt, "s", 1e-6, 1.0)
        limits = {"position_noise": ("m", 10.0), "position_drift": ("m", 10.0), "psi_drift": ("rad", 1.0)}
        limits |= {f"{name}_noise": (unit, 1.0) for name, unit in _CHANNELS[2:]}
        for name, (unit, high) in limits.items():
            require_within(where, name, getattr(self, name), unit, 0.0, high, "a standard deviation")
        for name, unit in _CHANNELS:
            require_within(where, f"{name}_bias", getattr(self, f"{name}_bias"), unit, -10.0, 10.0)
        require_within(where, "drift_time", self.drift_time, "s", self.dt, 1e5, "at least dt")
        whole_samples(where, "latency", self.latency, self.dt)
        seed_state(self.seed)

    @cached_property
    def _noise(self) -> tuple[Scalar, ...]:
        pose = self.position_noise, self.position_noise, self.psi_noise
        return (*pose, self.v_noise, self.beta_noise, self.r_noise)

    @cached_property
    def _drift(self) -> tuple[Scalar, ...]:
        return self.position_drift, self.position_drift, self.psi_drift

    @cached_property
    def _bias(self) -> tuple[Scalar, ...]:
        return tuple(getattr(self, f"{name}_bias") for name, _ in _CHANNELS)

    @cached_property
    def _exact(self) -> bool:
        """Are there no random errors to draw?"""
        return not any(np.any(deviation) for deviation in (*self._noise, *self._drift))

    def init(self, batch: tuple[int, ...] = ()) -> State:
        zero = m.filled(0.0, batch)
        random = seed_state(self.seed, batch, stream=_STREAM)
        waiting = (zero,) * (6 * whole_samples("Sensors", "latency", self.latency, self.dt))
        return (*self._drawn((zero,) * 3, random, kept=0.0), *waiting)

    def settle(self, t: float, x: State, u: Any) -> State:
        return (*x[:15], *self._measured(x, u) * (len(x[15:]) // 6))

    def output(self, t: Any, x: State, u: Any) -> Any:
        return self.Y(*(x[15:21] or self._measured(x, u)), self.latency)

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        errors = x[:15] if self._exact else self._drawn(x[6:9], x[9:15], kept=float(np.exp(-self.dt / self.drift_time)))
        return (*errors, *x[21:], *self._measured(x, u)) if x[15:] else errors

    def _measured(self, x: State, u: Any) -> State:
        return tuple([truth + error for truth, error in zip(u, x[:6])])

    def _drawn(self, drift: State, random: RandomState, kept: float) -> State:
        """Errors, drifts and generator for the next sample; `kept` is the drift's share f that stays."""
        n: list[Scalar] = []
        for _ in range(5):
            n1, n2, random = normals(random)
            n += (n1, n2)
        fresh = (1.0 - kept * kept) ** 0.5
        drift = tuple([kept * d + fresh * s * g for d, s, g in zip(drift, self._drift, n[6:9])])
        errors = [b + s * g for b, s, g in zip(self._bias, self._noise, n[:6])]
        return (*[e + d for e, d in zip(errors[:3], drift)], *errors[3:], *drift, *random)
