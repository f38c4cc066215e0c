"""The public names of steerkit: the one list, read by type checkers and by `steerkit/__init__.py`."""

from ._support.errors import WiringError as WiringError
from .analysis import linearise as linearise
from .compiled import compile as compile
from .controllers.delay import DelayPredictor as DelayPredictor
from .controllers.delay import delayed_stanley as delayed_stanley
from .controllers.lqr import Lqr as Lqr
from .controllers.mpc.block import MPC as MPC
from .controllers.mpc.block import NonlinearMPC as NonlinearMPC
from .controllers.nfq_policy import NfqPolicy as NfqPolicy
from .controllers.pure_pursuit import PurePursuit as PurePursuit
from .controllers.safety_filter import SafetyFilter as SafetyFilter
from .controllers.stanley import Stanley as Stanley
from .controllers.supervisor import ExceptionGuard as ExceptionGuard
from .controllers.supervisor import Supervisor as Supervisor
from .diagram.block import Block as Block
from .diagram.block import In as In
from .diagram.block import Out as Out
from .diagram.loop import Loop as Loop
from .diagram.loop import LoopState as LoopState
from .diagram.simulation import Log as Log
from .diagram.simulation import simulate as simulate
from .doe import Integrator as Integrator
from .doe import LowPass as LowPass
from .doe import PlainAngle as PlainAngle
from .learning.experiment import Experiment as Experiment
from .learning.learn import learn as learn
from .paths.courses import course as course
from .paths.path import Path as Path
from .paths.tracker import PathTracker as PathTracker
from .plants.sensors import Sensors as Sensors
from .plants.single_track import LinearSingleTrack as LinearSingleTrack
from .plants.single_track import NonlinearSingleTrack as NonlinearSingleTrack
from .plants.speed_driver import ConstantSpeed as ConstantSpeed
from .plants.speed_driver import SpeedDriver as SpeedDriver
from .plants.steering_actuator import SteeringActuator as SteeringActuator
from .scenario import Scenario as Scenario
from .scenario.assembly import placed as placed
from .scenario.assembly import steering_loop as steering_loop
from .scenario.drive import comparison as comparison
from .scenario.drive import drive as drive
from .scenario.drive import sweep as sweep
from .vehicles import Vehicle as Vehicle
from .vehicles import vehicle as vehicle

__version__: str
