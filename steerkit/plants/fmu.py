"""A car from elsewhere: an FMU for model exchange (FMI 2.0) as a plant, through FMPy (extra `export`)."""

import ctypes
import shutil
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from steerkit._support.errors import require
from steerkit.diagram import maths as m
from steerkit.diagram.block import State
from steerkit.diagram.maths import Scalar
from steerkit.plants.single_track import IntegratedCar

try:
    import fmpy
    from fmpy.simulation import instantiate_fmu
except ImportError as why:
    raise ImportError("FmuPlant needs FMPy: pip install 'steerkit-control[export]'") from why

_NEEDED = ("delta_sw_cmd", "v_cmd", "x", "y", "psi", "beta", "r", "a_y")


@dataclass(frozen=True, eq=False, kw_only=True)
class FmuPlant(IntegratedCar):
    """A car whose equations x' = f(x, delta_sw, v) come out of an FMU; their state stays in the loop.

    The FMU's continuous states are this block's state; `substeps` Runge-Kutta steps (order 4) a sample integrate them
    with the inputs held, as in `SingleTrack`. The FMU is asked with state, inputs and time each time, so that the block
    is pure: it can be saved, restored and batched (car by car), but not traced or compiled. The car is put at (x0, y0,
    psi0) by turning its plane: what it does must not depend on where it stands.

    v is the speed last applied. state: the FMU's, then v and delta_sw last applied.
    errors: ValueError for a file that is no FMU, an FMU for co-simulation only (its state stays inside), one with
    events or of another FMI version, and for variables that it does not have; ImportError without FMPy.
    source: FMI 2.0.4, chapter 3 (model exchange).
    """

    file: str
    """The FMU."""
    variables: Mapping[str, str] = field(default_factory=dict)
    """The FMU's names of delta_sw_cmd, v_cmd, x, y, psi, beta, r, a_y, where they differ; in the units above."""
    parameters: Mapping[str, float] = field(default_factory=dict)
    """Start values of the FMU's parameters, and of its states."""

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"FmuPlant '{Path(self.file).name}'"
        about = self._about
        require(about.fmiVersion.startswith("2."), where, f"of FMI {about.fmiVersion}, expected FMI 2.0")
        kind = "is for co-simulation only: its state stays inside, where no loop can save, restore or batch it"
        require(about.modelExchange is not None, where, f"{kind}; export it for model exchange")
        events = f"has {about.numberOfEventIndicators} event indicators, expected a model without events"
        require(not about.numberOfEventIndicators, where, events)
        known = {variable.name for variable in about.modelVariables}
        strange = [port for port in self.variables if port not in _NEEDED]
        require(not strange, where, f"variables: no port {strange[:1]}; valid: {', '.join(_NEEDED)}")
        wanted = [*(self.variables.get(port, port) for port in _NEEDED), *self.parameters]
        missing = [name for name in wanted if name not in known]
        require(not missing, where, f"has no variable {missing[:1]}; it has: {', '.join(sorted(known)[:40])}")

    @cached_property
    def _about(self) -> Any:
        """The FMU's model description."""
        require(Path(self.file).exists(), "FmuPlant", f"{self.file}: there is no such file, expected an FMU")
        try:
            return fmpy.read_model_description(str(self.file))
        except Exception as why:
            raise ValueError(f"FmuPlant: {self.file} is no FMU that can be read ({why})") from why

    @cached_property
    def _fmu(self) -> "_Equations":
        numbers = {variable.name: variable.valueReference for variable in self._about.modelVariables}
        at = [numbers[self.variables.get(port, port)] for port in _NEEDED]
        start = {numbers[name]: float(value) for name, value in self.parameters.items()}
        return _Equations(self._about, str(self.file), at[:2], at[2:], start)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return (*[m.filled(value, batch) for value in self._fmu.start], m.filled(self.v0, batch), m.filled(0.0, batch))

    def output(self, t: Any, x: State, u: Any) -> Any:
        px, py, psi, beta, r, a_y = self._each(self._fmu.outputs, t, x[:-2], x[-1], x[-2])
        c, s = m.cos(self.psi0), m.sin(self.psi0)
        return self.Y(self.x0 + c * px - s * py, self.y0 + s * px + c * py, self.psi0 + psi, x[-2], beta, r, a_y, x[-1])

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        h, motion = self.dt / self.substeps, tuple(x[:-2])

        def rhs(states: Sequence[Scalar]) -> tuple[Scalar, ...]:
            return self._each(self._fmu.derivatives, t, states, u.delta_sw_cmd, u.v_cmd)

        for _ in range(self.substeps):
            motion = m.rk4(rhs, motion, h)
        return (*motion, u.v_cmd, u.delta_sw_cmd)

    def _each(self, function: Any, t: Any, x: Sequence[Scalar], delta_sw: Scalar, v: Scalar) -> tuple[Scalar, ...]:
        """`function` of one car, or of each car of a batch."""
        values = (t, *x, delta_sw, v)
        if any(map(m.is_symbol, values)):
            raise TypeError("an FMU is machine code: it cannot be traced or compiled, only run (simulate)")
        if not any(map(np.ndim, values)):
            return function(*values)
        cars = np.broadcast_arrays(*values)
        return tuple(np.array([function(*car) for car in zip(*(c.tolist() for c in cars))]).T)


class _Equations:
    """One instance of the FMU, used as a calculator: each call brings state, inputs and time along."""

    def __init__(self, about: Any, file: str, inputs: list[int], outputs: list[int], start: Mapping[int, float]):
        folder = fmpy.extract(file)
        model = instantiate_fmu(folder, about, "ModelExchange")
        weakref.finalize(self, _released, model, folder)
        self._model, self._inputs, self._outputs = model, inputs, outputs
        n = about.numberOfContinuousStates
        self._x, self._dx, self._n = (ctypes.c_double * n)(), (ctypes.c_double * n)(), n
        model.setupExperiment(startTime=0.0)
        if start:
            model.setReal(list(start), list(start.values()))
        model.enterInitializationMode()
        model.exitInitializationMode()
        while model.newDiscreteStates()[0]:
            pass
        model.enterContinuousTimeMode()
        model.getContinuousStates(self._x, n)
        self.start = tuple(self._x)

    def outputs(self, t: float, *values: float) -> tuple[float, ...]:
        """x, y, psi, beta, r, a_y for the states, delta_sw and v."""
        self._set(t, values)
        return tuple(self._model.getReal(self._outputs))

    def derivatives(self, t: float, *values: float) -> tuple[float, ...]:
        """The states' derivatives."""
        self._set(t, values)
        self._model.getDerivatives(self._dx, self._n)
        return tuple(self._dx)

    def _set(self, t: float, values: Sequence[float]) -> None:
        self._model.setTime(t)
        self._x[:] = values[:-2]
        self._model.setContinuousStates(self._x, self._n)
        self._model.setReal(self._inputs, list(values[-2:]))


def _released(model: Any, folder: str) -> None:
    """Free the instance and its unpacked files."""
    model.terminate()
    model.freeInstance()
    shutil.rmtree(folder, ignore_errors=True)
