"""The table of examples that every shipped block is in; the rules: tests/contract/test_blocks.py."""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import control
import numpy as np

from steerkit.analysis import FromControl, Tap
from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.delay import DelayPredictor, delayed_stanley
from steerkit.controllers.delay_compensator import PREVIEW, DelayCompensator
from steerkit.controllers.excursion_predictor import ExcursionPredictor
from steerkit.controllers.fail_safe import FailSafe
from steerkit.controllers.lqr import Lqr
from steerkit.controllers.network_policy import Network, PolicyBlock
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.offset_free import CommandCompensation, OffsetFree
from steerkit.controllers.pure_pursuit import PurePursuit
from steerkit.controllers.safety_filter import SafetyFilter
from steerkit.controllers.stanley import Stanley
from steerkit.controllers.supervisor import ExceptionGuard, Supervisor, SupervisorState
from steerkit.controllers.target_shift import TargetShift
from steerkit.controllers.with_excitation import WithExcitation
from steerkit.diagram.block import Block
from steerkit.diagram.wrapper import Wrapper
from steerkit.doe import Corrected, Integrator, LowPass, PlainAngle
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import WheelDelay, YawDelay
from steerkit.estimators.steering_hysteresis import SteeringFriction, SteeringPlay
from steerkit.estimators.vehicle_state import VehicleState
from steerkit.gym.task import Agent
from steerkit.learning.exploration import Exploring
from steerkit.paths.path import Path
from steerkit.paths.tracker import PathTracker
from steerkit.plants.disturbed_plant import DisturbedPlant
from steerkit.plants.linear_single_track import LinearSingleTrack
from steerkit.plants.nonlinear_single_track import NonlinearSingleTrack
from steerkit.plants.sensors import DegradedSensors, Sensors
from steerkit.plants.speed_driver import (
    ConstantSpeed,
    CurveSpeedDriver,
    Playback,
    RecordedSpeed,
    SpeedDriver,
    SpeedProfile,
)
from steerkit.plants.steering_actuator import SteeringActuator, SteeringColumn, SteeringLink, TorqueSteering
from steerkit.vehicles import VW_PASSAT as PASSAT
from steerkit.vehicles.rollout import GateLimits, GateModel

_round = np.linspace(0.0, 2.0 * np.pi, 40, endpoint=False)
OVAL = Path.from_waypoints(np.column_stack((25 * np.cos(_round), 15 * np.sin(_round))), closed=True, spacing=3.0)
_rng = np.random.default_rng(0)
AT_ONCE = dict(now=0.004, before=0.005, earlier=0.003)
LATE = DelayCompensator(samples=3, back=0.2, slip=4e-4, yaw=0.38, straight=0.05, loss=1e-3, tail=1e-3, **AT_ONCE)
FAST = dataclasses.replace(LATE, fast=1.0, trust=0.5)
NETS = tuple(tuple(_rng.normal(size=size) for size in ((5, 7), 5, (3, 5), 3, (1, 3), 1)) for _ in range(3))
LAYERS = ((_rng.normal(size=(5, 6)), _rng.normal(size=5)), (_rng.normal(size=(3, 5)), _rng.normal(size=3)))


@dataclass(frozen=True)
class Example:
    """One block to try.

    single(block, i): the block that car i of a batch is; state: where to start instead of init; blind: inputs that it
    rightly does not look at in this state.
    """

    block: Block
    single: Callable[[Any, int], Block] = lambda block, i: block
    state: tuple[float, ...] | None = None
    blind: tuple[str, ...] = ()

    def __str__(self) -> str:
        inner = getattr(self.block, "block", None)
        return type(self.block).__name__ + (f"-{type(inner).__name__}" if inner is not None else "")


def _seeded(block: Any, i: int) -> Block:
    return dataclasses.replace(block, seed=block.seed + i)


def _sensed(block: Any, i: int) -> Block:
    return dataclasses.replace(block, block=_seeded(block.block, i))


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Silent(Wrapper):
    """A filter that has no answer."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        y = self.inner_output(t, x, u)
        return y._replace(delta_sw=y.delta_sw * math.nan)


def _pendulum(t: float, x: Any, u: Any, params: Any) -> Any:
    return [x[1], u[0] - 2.0 * x[1] - 3.0 * x[0] - 0.3 * x[0] * x[0]]


def _careful(block: Any, i: int) -> Block:
    return dataclasses.replace(block, driver=_seeded(block.driver, i))


EXAMPLES = [
    *map(Example, (Integrator(), LowPass(), PlainAngle(), WheelDelay(prior_delay=0.05, longest=0.1, prior_lag=0.02))),
    *map(Example, (YawDelay(vehicle=PASSAT), SteeringFriction(longest=0.2), SteeringPlay(vehicle=PASSAT))),
    Example(SingleTrackFilter(vehicle=PASSAT), blind=("psi",)),
    *map(Example, (Corrected(), Corrected(element=LowPass()), ExcursionPredictor(), Stanley.of(PASSAT))),
    *map(Example, (Stanley.textbook(PASSAT), delayed_stanley(PASSAT, delay=0.13, lag=0.1))),
    Example(DelayPredictor(block=Stanley.of(PASSAT))),
    Example(Lqr.of(PASSAT, LinearSingleTrack(vehicle=PASSAT).matrices, delay=0.13, preview_points=5, v_step=3.0)),
    Example(dataclasses.replace(Stanley.of(PASSAT), slew=5.0, a_y_limit=3.0)),
    Example(delayed_stanley(PASSAT, delay=0.13, lag=0.1, slew=20.0, a_y_limit=3.0)),
    Example(Lqr.of(PASSAT, LinearSingleTrack(vehicle=PASSAT).matrices, preview_points=5, v_step=3.0, slew=5.0)),
    Example(CommandCompensation(block=Stanley.of(PASSAT), offset=0.05, gain=1.1)),
    Example(WithExcitation(block=Stanley.of(PASSAT), vehicle=PASSAT, amplitude=0.6, steepness=2.0)),
    Example(
        Adaptive(
            blocks=tuple(dataclasses.replace(Stanley.of(PASSAT), k=k) for k in (2.0, 3.0, 5.0)),
            delays=(0.02, 0.06, 0.1),
            prior_delay=0.05,
            delay=YawDelay(vehicle=PASSAT, prior_delay=0.05, longest=0.1),
            steering=SingleTrackFilter(vehicle=PASSAT, longest=0.2),
        )
    ),
    Example(
        Adaptive(
            blocks=(Stanley.of(PASSAT),) * 2,
            delays=(0.0, 0.1),
            delay=YawDelay(vehicle=PASSAT, prior_delay=0.05, longest=0.1),
            steering=SingleTrackFilter(vehicle=PASSAT, longest=0.2),
            takes_turns=True,
        ),
        blind=("doe",),
    ),
    *map(Example, (OffsetFree.around(Stanley.of(PASSAT), PASSAT), PurePursuit.of(PASSAT, OVAL))),
    Example(SafetyFilter.of(PASSAT, delay=0.05, horizon=0.35, hold=1, halvings=2)),
    Example(SafetyFilter.of(PASSAT, delay=0.07, horizon=0.5, hold=3, halvings=1, bound=3.0, yaw_doubt_least=0.002)),
    Example(SafetyFilter.of(PASSAT, horizon=0.4, hold=2, halvings=1, gate=GateModel(limits=GateLimits(jerk_max=30.0)))),
    Example(
        FailSafe(block=Silent(block=SafetyFilter.of(PASSAT, horizon=0.35, hold=1, halvings=1))), blind=("command",)
    ),
    Example(FromControl(system=control.ss([[0.5, 0.1], [0.0, 0.9]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.3]], 0.05))),
    Example(FromControl(system=control.nlsys(_pendulum, None, states=2, inputs=1, outputs=2), units={"u_0": "rad"})),
    Example(Tap(unit="rad")),
    Example(Tap(unit="rad", cut=True), blind=("u",)),
    Example(Supervisor(), blind=("e", "ready")),
    Example(Supervisor(), state=SupervisorState(1.0, 0.0), blind=("recovery",)),
    *map(Example, (ExceptionGuard(block=Integrator()), ExceptionGuard(block=PathTracker(path=OVAL, preview_points=2)))),
    *map(Example, (NfqPolicy(nets=NETS), NfqPolicy(nets=NETS, combine="max", ready_from=0.1))),
    Example(NfqPolicy(nets=NETS, combine="disagreement")),
    Example(NfqPolicy(nets=NETS, preview_points=PREVIEW, forecast=LATE, continuous=True)),
    Example(NfqPolicy(nets=NETS, preview_points=PREVIEW, forecast=FAST), blind=("psi_e",)),
    Example(Exploring(block=NfqPolicy(nets=NETS), share=0.5, seed=3), single=_seeded),
    *map(Example, (TargetShift(), PolicyBlock(policy=Network(layers=LAYERS), actions=(-0.1, 0.0, 0.1)))),
    Example(PolicyBlock(policy=Network(layers=(LAYERS[0], (LAYERS[1][0][:1], LAYERS[1][1][:1])), head="tanh"))),
    *map(Example, (Agent(), PathTracker(path=OVAL), PathTracker(path=OVAL, reference=1.2, preview_points=3))),
    *map(Example, (LinearSingleTrack(vehicle=PASSAT, v0=5.0), NonlinearSingleTrack(vehicle=PASSAT, v0=5.0))),
    Example(
        DisturbedPlant(block=NonlinearSingleTrack(vehicle=PASSAT, v0=5.0), wind=0.3, gust=0.2, seed=3), single=_seeded
    ),
    Example(DisturbedPlant(block=LinearSingleTrack(vehicle=PASSAT, v0=5.0), bank=0.2), single=_seeded),
    *map(Example, (SteeringActuator(lag=0.1), SteeringActuator(lag=0.0, delay=0.03, gain=1.05, offset=0.02))),
    Example(TorqueSteering(delay=0.03)),
    *map(Example, (TorqueSteering.of(PASSAT, delay=0.02, lag=0.1, slew=50.0, gain=1.2, offset=0.02), SteeringColumn())),
    *map(Example, (SteeringColumn(friction=0.03, play=0.05), SteeringLink())),
    Example(SteeringLink(quantum=0.01, dead_band=0.02, jitter=0.03, seed=3), single=_seeded),
    Example(Sensors(), single=_seeded),
    Example(DegradedSensors(block=Sensors(seed=3)), single=_sensed),
    Example(
        DegradedSensors(block=Sensors.hard(seed=3), age_jitter=0.05, lost=0.3, jump=0.1, jump_time=0.1), single=_sensed
    ),
    Example(DegradedSensors.real(PASSAT, seed=3), single=_sensed, blind=("beta_in",)),
    Example(VehicleState.of(NonlinearSingleTrack(vehicle=PASSAT))),
    Example(VehicleState.of(LinearSingleTrack(vehicle=PASSAT), horizon=0.0)),
    Example(
        VehicleState.of(
            NonlinearSingleTrack(vehicle=PASSAT), steering=SingleTrackFilter(vehicle=PASSAT, held=False, longest=0.2)
        )
    ),
    Example(Sensors.hard(seed=3), single=_seeded),
    Example(SpeedDriver(seed=3), single=_seeded),
    *map(Example, (ConstantSpeed(), RecordedSpeed(speeds=(4.0, 5.0, 7.0, 6.0), spacing=0.1))),
    Example(Playback(angles=(0.0, 0.5, 0.4, -0.2), speeds=(4.0, 5.0, 7.0, 6.0), delay=0.013)),
    Example(SpeedProfile(speeds=(4.0, 5.0, 7.0, 4.0), spacing=0.5, repeat=True)),
    Example(CurveSpeedDriver(path=OVAL, driver=SpeedDriver(seed=3)), single=_careful),
]
