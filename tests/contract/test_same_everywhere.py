"""One loop, one trajectory: interpreted, batched, generated Python, C and exported C agree.

Bound: |a - b| <= 1e-12*(1 + largest |a|) of each signal. Rounding differs: NumPy, libm and libmvec each have their
last digits, and a batch is summed in another order.
"""

import re
import subprocess
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit._support import native
from steerkit.compiled import compile
from steerkit.controllers.adaptive import Adaptive
from steerkit.controllers.delay import delayed_stanley
from steerkit.controllers.delay_compensator import PREVIEW, DelayCompensator
from steerkit.controllers.nfq_policy import NfqPolicy
from steerkit.controllers.offset_free import CommandCompensation, OffsetFree
from steerkit.controllers.stanley import Stanley
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from steerkit.doe import Integrator, LowPass
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import YawDelay
from steerkit.export.c import export_c
from steerkit.paths.courses import course, figure_eight
from steerkit.plants.sensors import Sensors
from steerkit.plants.single_track import LinearSingleTrack, NonlinearSingleTrack
from steerkit.plants.speed_driver import ConstantSpeed, CurveSpeedDriver, SpeedDriver, SpeedProfile
from steerkit.plants.steering_actuator import SteeringActuator, SteeringColumn, SteeringLink, TorqueSteering
from steerkit.scenario.assembly import placed, steering_loop
from steerkit.vehicles import VW_PASSAT as CAR
from tests.support.compilers import optimising
from tests.support.straight_road import recorded_speed

PAPER = course("paper")
SECONDS = 1.5
CARS = 5
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")


def driven(driver: Block, plant: type[Any], rng: np.random.Generator, *, dt: float, **parts: Any) -> Loop:
    path = figure_eight() if rng.random() < 0.3 else PAPER
    s, e, psi_e = rng.uniform(0.0, path.length), rng.uniform(-0.4, 0.4), rng.uniform(-0.1, 0.1)
    substeps = 5 if dt > 0.01 else 1
    car = placed(plant(vehicle=CAR, dt=dt, substeps=substeps, v0=5.0), path, s=s, e=e, psi_e=psi_e)
    stanley = {"recovery" if "doe" in parts else "controller": Stanley.of(CAR)}
    return steering_loop(car=car, path=path, driver=driver, **stanley, **parts)


def policy(rng: np.random.Generator) -> NfqPolicy:
    shapes = ((10, 7), (10,), (10, 10), (10,), (1, 10), (1,))
    return NfqPolicy(nets=tuple(tuple(rng.uniform(-0.5, 0.5, shape) for shape in shapes) for _ in range(2)))


def linear_at_constant_speed(seed: int, rng: np.random.Generator) -> Loop:
    driver = ConstantSpeed(speed=rng.uniform(0.5, 9.0))
    return driven(driver, LinearSingleTrack, rng, dt=0.05, actuator=SteeringActuator(delay=0.1, dt=0.05))


def linear_with_a_human(seed: int, rng: np.random.Generator) -> Loop:
    return driven(
        SpeedDriver(v_min=0.0, v_max=9.0, seed=seed),
        LinearSingleTrack,
        rng,
        dt=0.01,
        actuator=SteeringActuator(gain=rng.uniform(0.9, 1.1)),
        sensors=Sensors.hard(seed),
    )


def nonlinear_with_a_record(seed: int, rng: np.random.Generator) -> Loop:
    driver = recorded_speed(rng.uniform(4.0, 7.5, 9), spacing=0.5)
    return driven(driver, NonlinearSingleTrack, rng, dt=0.05)


def nonlinear_with_a_profile(seed: int, rng: np.random.Generator) -> Loop:
    driver = SpeedProfile(speeds=tuple(rng.uniform(4.0, 7.5, 400)), spacing=2.0, repeat=True)
    return driven(driver, NonlinearSingleTrack, rng, dt=0.01, actuator=SteeringActuator())


def learner_with_recovery(seed: int, rng: np.random.Generator) -> Loop:
    driver = CurveSpeedDriver(path=PAPER, driver=SpeedDriver(seed=seed))
    doe = Integrator() if seed % 2 else LowPass()
    car = placed(NonlinearSingleTrack(vehicle=CAR, v0=5.0), PAPER, s=rng.uniform(0.0, PAPER.length), e=0.05)
    return steering_loop(
        car=car,
        path=PAPER,
        driver=driver,
        controller=policy(rng),
        doe=doe,
        sensors=Sensors.hard(seed),
        recovery=Stanley.of(CAR),
        actuator=SteeringActuator(delay=0.05),
    )


def learner_that_forecasts(seed: int, rng: np.random.Generator) -> Loop:
    car = placed(NonlinearSingleTrack(vehicle=CAR, v0=5.0), PAPER, s=rng.uniform(0.0, PAPER.length), e=0.05)
    answer = {"now": 0.006, "before": 0.005, "earlier": 0.002, "back": 0.2, "slip": 4e-4, "yaw": 0.38}
    ahead = DelayCompensator(samples=int(rng.integers(0, 9)), trust=0.25, straight=0.02, **answer)
    nets = tuple(tuple(4.0 * p for p in net) for net in policy(rng).nets or ())  # flatter ones magnify rounding
    return steering_loop(
        car=car,
        path=PAPER,
        driver=CurveSpeedDriver(path=PAPER, driver=SpeedDriver(seed=seed)),
        controller=replace(policy(rng), nets=nets, preview_points=PREVIEW, forecast=ahead, continuous=True),
        doe=Integrator(),
        sensors=Sensors.hard(seed),
        recovery=Stanley.of(CAR),
        actuator=SteeringActuator(delay=0.2),
    )


def worn_steering_and_poor_sensors(seed: int, rng: np.random.Generator) -> Loop:
    return driven(
        SpeedDriver(seed=seed),
        NonlinearSingleTrack,
        rng,
        dt=0.01,
        link=SteeringLink(quantum=rng.uniform(0.001, 0.01), dead_band=0.012, jitter=0.04, seed=seed),
        actuator=SteeringActuator(delay=0.05),
        column=SteeringColumn(friction=0.01, play=0.03),
        sensors=Sensors.real(CAR, seed, 3.0),
    )


def steered_by_torque(seed: int, rng: np.random.Generator) -> Loop:
    stanley = delayed_stanley(CAR, delay=0.1, lag=0.0, slew=5.0, a_y_limit=3.0)
    motor = TorqueSteering.of(CAR, delay=0.1, gain=rng.uniform(0.8, 1.2))
    return steering_loop(
        car=placed(NonlinearSingleTrack(vehicle=CAR, v0=5.0), PAPER, s=rng.uniform(0.0, PAPER.length), e=0.5),
        path=PAPER,
        driver=SpeedDriver(seed=seed),
        controller=OffsetFree(block=CommandCompensation(block=stanley, offset=0.02, gain=1.1)),
        link=SteeringLink(quantum=0.01),
        actuator=motor,
        column=SteeringColumn(play=0.03),
    )


def one_that_adapts(seed: int, rng: np.random.Generator) -> Loop:
    delays, prior = (0.0, 0.1), rng.uniform(0.02, 0.08)
    adaptive = Adaptive(
        blocks=tuple(OffsetFree.around(delayed_stanley(CAR, delay=d, lag=0.1), CAR, delay=d) for d in delays),
        delays=delays,
        delay=YawDelay(vehicle=CAR, prior_delay=prior, prior_lag=0.1, longest=0.2),
        steering=SingleTrackFilter(vehicle=CAR),
        prior_delay=prior,
    )
    return steering_loop(
        car=placed(NonlinearSingleTrack(vehicle=CAR, v0=5.0), PAPER, s=rng.uniform(0.0, PAPER.length), e=0.2),
        path=PAPER,
        driver=SpeedDriver(seed=seed),
        controller=adaptive,
        actuator=SteeringActuator(lag=0.1),
    )


LOOPS: list[Callable[[int, np.random.Generator], Loop]] = [
    linear_at_constant_speed,
    linear_with_a_human,
    nonlinear_with_a_record,
    nonlinear_with_a_profile,
    learner_with_recovery,
    learner_that_forecasts,
    worn_steering_and_poor_sensors,
    steered_by_torque,
    one_that_adapts,
]


def require_same(log: Log, reference: Log, what: str, bound: float = 1e-12) -> None:
    assert list(log) == list(reference)
    np.testing.assert_array_equal(log.t, reference.t)
    for name, values in reference.signals.items():
        if values.size:
            ours, per_car = log[name], log[name].ndim - values.ndim  # what is equal for all cars may be one column
            error = float(np.abs(ours - values.reshape(values.shape + (1,) * per_car)).max())
            allowed = bound * (1.0 + float(np.abs(values).max()))
            if name.endswith(".rate"):  # a difference of two angles over the base step of 0.01 s
                allowed *= 100.0
            assert error <= allowed, f"{what}: {name} differs by {error:.2e}, allowed {allowed:.2e}"


every_loop = pytest.mark.parametrize("make", LOOPS, ids=lambda make: make.__name__)


LONG = (learner_with_recovery, learner_that_forecasts, steered_by_torque, one_that_adapts)
"""What a compiler optimises for seconds; the others are enough to see that optimised code gives the same."""


@pytest.mark.parametrize("backend", ["python", pytest.param("c", marks=needs_compiler)])
@every_loop
def test_one_car_and_each_of_a_batch(backend: Any, make: Callable[..., Loop], monkeypatch: pytest.MonkeyPatch) -> None:
    if make not in LONG:
        monkeypatch.setenv("CC", optimising())
    for seed in (3, 4) if backend == "python" else (3,):
        loop = make(seed, np.random.default_rng(seed))
        compiled = compile(loop, backend=backend)
        for start in (loop.init(), loop.init(batch=CARS)):
            require_same(compiled.run(SECONDS, state=start), simulate(loop, SECONDS, state=start), backend)


@needs_compiler
@pytest.mark.parametrize("make", [linear_with_a_human, learner_with_recovery], ids=lambda make: make.__name__)
def test_exported_controllers_give_the_recorded_commands(make: Callable[..., Loop], tmp_path: Path) -> None:
    loop = make(1, np.random.default_rng(1))
    blocks = [n for n in loop.names if n not in ("driver", "car", "actuator", "sensors", "path", "seen")]
    export_c(loop, tmp_path, blocks=blocks)
    program = tmp_path / "replay"
    sources = [tmp_path / "controller.c", tmp_path / "controller_test.c"]
    command = [*(native.compiler() or []), "-std=c99", "-O2", "-ffp-contract=off", *sources, "-o", program, "-lm"]
    subprocess.run([str(part) for part in command], check=True)
    done = subprocess.run([str(program)], capture_output=True, text=True, check=True)
    match = re.search(r"largest difference (\S+)", done.stdout)
    assert match is not None
    assert float(match[1]) <= 1e-12
