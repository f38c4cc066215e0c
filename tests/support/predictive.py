"""What the tests of predictive steering share: a car, its motor, and a block driven without a loop."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.mpc.block import MPC, NonlinearMPC, PredictiveSteering
from steerkit.controllers.mpc.programme import PREDICTION, Programme
from steerkit.plants.single_track import NonlinearSingleTrack
from steerkit.plants.steering_actuator import SteeringActuator
from steerkit.vehicles import vehicle

CAR = NonlinearSingleTrack(vehicle=vehicle("vw-passat"), v0=5.0)
MOTOR = SteeringActuator(delay=0.1, lag=0.1)
STEERING = {"delay": MOTOR.delay + 0.5 * MOTOR.dt, "lag": MOTOR.lag}
"""Of the motor, which holds its angle for its dt."""
KINDS = (MPC, NonlinearMPC)
kinds = pytest.mark.parametrize("kind", KINDS)
ZEROS = {"e": 0.0, "psi_e": 0.0, "v": 5.0, "beta": 0.0, "r": 0.0, "delta_sw_meas": 0.0}


@cache
def controller(kind: type[PredictiveSteering] = MPC, **fields: Any) -> PredictiveSteering:
    return kind.of(CAR, **(STEERING | {"clock": None, "horizon": 10} | fields))


def own(kind: type[PredictiveSteering] = MPC, **fields: Any) -> PredictiveSteering:
    """One that nobody shares, as a test needs that writes into its programme; only the model is that of all others."""
    shared = controller(kind, **fields)
    block = replace(shared)
    vars(block)["model"] = shared.model
    return block


def inputs(block: PredictiveSteering, *, kappa: float = 0.01, **values: float) -> Any:
    return block.D(**(ZEROS | values), preview=(kappa,) * block.preview_points)


def driven(block: PredictiveSteering, samples: list[Any]) -> list[Any]:
    """The outputs for inputs one after the other, from rest."""
    x, found = block.settle(0.0, block.init(), samples[0]), []
    for u in samples:
        found.append(block.output(0.0, x, u))
        x = block.update(0.0, x, u, found[-1])
    return found


def ahead(block: PredictiveSteering, u: Any, state: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """x (6,) when the commands on their way have acted; steady bends and curvature at the programme's times (n, 7)."""
    state = state or block.X((0.0,) * block.waiting, (0.0,) * block.horizon, 0.0)
    block.programme(*block._asked(state, u, PREDICTION))
    return block.programme.found["ahead"][:6].copy(), block.programme.found["then"].reshape(-1, 7).copy()


def table(block: PredictiveSteering, v: float) -> list[np.ndarray]:
    """A (6, 6), B (6,), row of a_y (6,) and P (6, 6) at a speed."""
    return [np.squeeze(matrix.full()) for matrix in block.model.schedule(casadi.DM(v))]


def steady(block: PredictiveSteering, v: float, kappa: Any) -> np.ndarray:
    """Steady cornering (n, 7) at these curvatures."""
    return np.array(block.model.cornering(casadi.DM(v), casadi.DM(kappa))).T


def unsolved(monkeypatch: pytest.MonkeyPatch, **wrong: float) -> None:
    """From now on programmes report this `success` and `residual` instead of the true ones."""
    true = Programme.__call__

    def reported(programme: Programme, *values: float) -> Any:
        success, iterations, residual, *rest = true(programme, *values)
        return (wrong.get("success", success), iterations, wrong.get("residual", residual), *rest)

    monkeypatch.setattr(Programme, "__call__", reported)


def checked(block: PredictiveSteering, outputs: list[Any], last: float = 0.0) -> None:
    """All commands are numbers within the limits, angle and rate."""
    for y in outputs:
        assert math.isfinite(y.delta_sw)
        assert abs(y.delta_sw) <= block.limit + 1e-12
        assert abs(y.delta_sw - last) <= block.rate_limit * block.dt + 1e-12
        last = y.delta_sw
