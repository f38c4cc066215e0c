"""Does a steering law hold on a car that is not quite as believed? The damping of its loop at a steady speed."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from steerkit._support.errors import require
from steerkit.controllers.lqr import LqrDesign, Matrices
from steerkit.diagram.block import Block, entries_of
from steerkit.diagram.maths import Array
from steerkit.vehicles import Vehicle

_SEEN = ("e", "e_dot", "psi_e", "beta", "r", "delta_sw_meas")
_SMALL = 1e-5  # m, rad, ...: step of the differences; no limit of a law acts that close to a straight path


class Doubt(NamedTuple):
    """By how much a car may differ from what is believed of it."""

    gain: float = 1.25
    """Angle reached over angle believed, or its inverse [1]."""
    delay: float = 0.05
    """Error of the sum of dead time and lag, to either side [s]."""


class Law(NamedTuple):
    """A law about a straight path: x+ = A x + B u, delta_sw = C x + D u, u the `inputs` among e, e_dot, psi_e, ..."""

    a: Array
    b: Array
    c: Array
    d: Array
    inputs: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class SteeredCar:
    """A car whose steering has that dead time, lag and gain: what a law is tried on. See `LqrDesign.model`."""

    vehicle: Vehicle
    matrices: Matrices
    """Its lateral model."""
    delay: float
    """Dead time of the steering [s]."""
    lag: float
    """Its lag [s]."""
    gain: float = 1.0
    """Angle reached over angle commanded [1]."""

    def corners(self, doubt: Doubt) -> "list[SteeredCar]":
        """The cars at the corners of a doubt about this one."""
        gains, errors = {doubt.gain, 1.0 / doubt.gain}, {doubt.delay, -doubt.delay}
        return [
            replace(self, gain=self.gain * gain, delay=max(0.0, self.delay + error))
            for gain, error in product(sorted(gains), sorted(errors))
        ]

    def system(self, v: float, dt: float) -> tuple[Array, Array, dict[str, Array]]:
        """A, B of x+ = A x + B delta_sw at v [m/s], and the rows that make of x what a law sees."""
        reference = self.vehicle.l_f
        design = LqrDesign(matrices=self.matrices, reference=reference, delay=self.delay, lag=self.lag, dt=dt)
        a, b, _ = design.model(v)
        a = a.copy()
        a[:, -1] -= b  # LqrDesign's input is the step from the last command
        rows = dict(zip(("e", "psi_e", "beta", "r", "delta_sw_meas"), np.eye(len(a))))
        rows["delta_sw_meas"] = self.vehicle.steer_ratio * rows["delta_sw_meas"]
        rows["e_dot"] = v * (rows["psi_e"] + rows["beta"]) + reference * rows["r"]
        return a, self.gain / self.vehicle.steer_ratio * b, rows


def linearised(block: Block, v: float) -> Law:
    """The law of a controller about a straight path at v [m/s], by central differences, all in one batch.

    block: any with inputs among e, e_dot, psi_e, beta, r, delta_sw_meas, kappa, preview and v, and the output delta_sw,
    that computes batches. Raises ValueError for another input.
    """
    make, n = entries_of(block)
    names = [port.name for port in block.inputs]
    stray = set(names) - {*_SEEN, "kappa", "preview", "v"}
    require(
        not stray, "linearised", f"{type(block).__name__} needs {', '.join(sorted(stray))}, which has no model here"
    )
    inputs = tuple([name for name in _SEEN if name in names])
    count = n + len(inputs)
    steps = _SMALL * np.kron(np.eye(count), [1.0, -1.0])
    still = np.zeros(2 * count)
    values = dict.fromkeys(names, still) | dict(zip(inputs, steps[n:])) | {"v": still + v}
    if "preview" in names:
        values["preview"] = (still,) * int(block.preview_points)  # type: ignore[attr-defined]

    def seen(ports: Any) -> Any:
        return ports(**{name: values[name] for name in ports._fields})

    at_rest = [np.broadcast_to(entry, still.shape) for entry in block.init((1,))]
    x = make(tuple([entry + step for entry, step in zip(at_rest, steps[:n])]))
    y = block.output(0.0, x, seen(block.D))
    after = [
        np.broadcast_to(np.asarray(entry, dtype=float), still.shape) for entry in block.update(0.0, x, seen(block.U), y)
    ]
    rows = np.array([*after, np.broadcast_to(y.delta_sw, still.shape)])
    slopes = (rows[:, 0::2] - rows[:, 1::2]) / (2.0 * _SMALL)
    return Law(slopes[:n, :n], slopes[:n, n:], slopes[n, :n], slopes[n, n:], inputs)


def damping(law: Law, car: SteeredCar, v: float, dt: float) -> float:
    """Damping ratio of the loop's least damped motion at v [m/s]; negative for one that grows.

    -Re(s)/|s|, s = log(z)/dt over the poles z: with 0.1 a swing falls to about half within its period.
    """
    a, b, rows = car.system(v, dt)
    seen = np.array([rows[name] for name in law.inputs])
    loop = np.block([[a + np.outer(b, law.d @ seen), np.outer(b, law.c)], [law.b @ seen, law.a]])
    z = np.linalg.eigvals(loop)
    s = np.log(
        z[(np.abs(z - 1.0) > 1e-9) & (np.abs(z) > 1e-9)].astype(complex)
    )  # 1: a constant on which nothing depends
    return float(np.min(-s.real / np.abs(s)))


def least_damping(block: Block, car: SteeredCar, doubt: Doubt, speeds: Sequence[float]) -> float:
    """The least `damping` of a controller on the cars at the corners of a doubt about `car`, at those speeds [m/s]."""
    laws = [(v, linearised(block, v)) for v in speeds]
    return min(damping(law, corner, v, block.dt) for v, law in laws for corner in car.corners(doubt))
