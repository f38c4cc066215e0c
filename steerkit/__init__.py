"""steerkit: blocks, loops, cars and controllers for steering along a path, analytic and learned.

The names below are loaded when they are first used, so that `import steerkit` stays fast and light.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from steerkit.analysis import linearise
    from steerkit.assembly import placed, steering_loop
    from steerkit.block import Block, In, Out
    from steerkit.compiled import compile
    from steerkit.controllers.delay import Predicted, delayed_stanley
    from steerkit.controllers.lqr import Lqr
    from steerkit.controllers.mpc.linear import MPC
    from steerkit.controllers.mpc.nonlinear import NonlinearMPC
    from steerkit.controllers.nfq_policy import NfqPolicy
    from steerkit.controllers.pure_pursuit import PurePursuit
    from steerkit.controllers.safety_filter import SafetyFilter
    from steerkit.controllers.stanley import Stanley
    from steerkit.controllers.supervisor import Guarded, Supervisor
    from steerkit.courses import course
    from steerkit.doe import Integrator, LowPass, PlainAngle
    from steerkit.errors import WiringError
    from steerkit.learning.experiment import Experiment
    from steerkit.learning.learn import learn
    from steerkit.learning.report import comparison
    from steerkit.loop import Loop, LoopState
    from steerkit.path import Path
    from steerkit.plants.human import ConstantSpeed, Human
    from steerkit.plants.linear_single_track import LinearSingleTrack
    from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
    from steerkit.plants.sensors import Sensors
    from steerkit.plants.steering_actuator import SteeringActuator
    from steerkit.scenario import Scenario
    from steerkit.scenario.drive import drive
    from steerkit.simulation import Log, simulate
    from steerkit.tracker import PathTracker
    from steerkit.vehicles import Vehicle, vehicle

_HOME = {
    "linearise": "analysis",
    "placed": "assembly",
    "steering_loop": "assembly",
    "Block": "block",
    "In": "block",
    "Out": "block",
    "WiringError": "errors",
    "compile": "compiled",
    "Predicted": "controllers.delay",
    "delayed_stanley": "controllers.delay",
    "Lqr": "controllers.lqr",
    "MPC": "controllers.mpc.linear",
    "NfqPolicy": "controllers.nfq_policy",
    "NonlinearMPC": "controllers.mpc.nonlinear",
    "PurePursuit": "controllers.pure_pursuit",
    "Guarded": "controllers.supervisor",
    "Supervisor": "controllers.supervisor",
    "SafetyFilter": "controllers.safety_filter",
    "Stanley": "controllers.stanley",
    "course": "courses",
    "PlainAngle": "doe",
    "Integrator": "doe",
    "LowPass": "doe",
    "Experiment": "learning.experiment",
    "learn": "learning.learn",
    "comparison": "learning.report",
    "Loop": "loop",
    "LoopState": "loop",
    "Path": "path",
    "ConstantSpeed": "plants.human",
    "Human": "plants.human",
    "LinearSingleTrack": "plants.linear_single_track",
    "NonlinearSingleTrack": "plants.nonlinear_single_track",
    "Sensors": "plants.sensors",
    "SteeringActuator": "plants.steering_actuator",
    "Scenario": "scenario",
    "drive": "scenario.drive",
    "Vehicle": "vehicles",
    "vehicle": "vehicles",
    "Log": "simulation",
    "simulate": "simulation",
    "PathTracker": "tracker",
}

__all__ = [
    "MPC",
    "Block",
    "ConstantSpeed",
    "Experiment",
    "Guarded",
    "Human",
    "In",
    "Integrator",
    "LinearSingleTrack",
    "Log",
    "Loop",
    "LoopState",
    "LowPass",
    "Lqr",
    "NfqPolicy",
    "NonlinearMPC",
    "NonlinearSingleTrack",
    "Out",
    "Path",
    "PathTracker",
    "PlainAngle",
    "Predicted",
    "PurePursuit",
    "SafetyFilter",
    "Scenario",
    "Sensors",
    "Stanley",
    "SteeringActuator",
    "Supervisor",
    "Vehicle",
    "WiringError",
    "comparison",
    "compile",
    "course",
    "delayed_stanley",
    "drive",
    "learn",
    "linearise",
    "placed",
    "simulate",
    "steering_loop",
    "vehicle",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return _version()
    if name not in _HOME:
        raise AttributeError(f"module 'steerkit' has no attribute '{name}'; it offers: {', '.join(__all__)}")
    return getattr(import_module(f"steerkit.{_HOME[name]}"), name)


@cache
def _version() -> str:
    """Of the installed package; asked for when it is wanted, as looking it up takes longer than all else here."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("steerkit-control")
    except PackageNotFoundError:  # run from a source tree that was never installed
        return "0+unknown"


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
