"""One loop, one trajectory: interpreted, batched, generated Python, C and exported C agree.

Bound: |a - b| <= 1e-12*(1 + largest |a|) of each signal. Rounding differs: NumPy, libm and libmvec each have their
last digits, and a batch is summed in another order.
"""

import re
import subprocess
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
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import Log, simulate
from steerkit.doe import Integrator, LowPass
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import YawDelay
from steerkit.export.c import export_c
from steerkit.scenario import Scenario
from steerkit.scenario.drive import assembled
from steerkit.vehicles import VW_PASSAT as CAR
from tests.support.compilers import optimising

SECONDS = 1.5
CARS = 5
needs_compiler = pytest.mark.skipif(native.compiler() is None, reason="C needs a compiler")

WORN = {
    "delay": 0.05,
    "quantum_deg": 0.3,
    "dead_band_deg": 0.7,
    "delay_jitter": 0.04,
    "friction_deg": 0.6,
    "play_deg": 1.7,
}
STANLEY, LATE = Stanley.of(CAR), delayed_stanley(CAR, delay=0.1, lag=0.0, slew=5.0, a_y_limit=3.0)
ADAPTIVE = Adaptive(
    blocks=tuple(OffsetFree.around(delayed_stanley(CAR, delay=d, lag=0.1), CAR, delay=d) for d in (0.0, 0.1)),
    delays=(0.0, 0.1),
    delay=YawDelay(vehicle=CAR, prior_delay=0.05, prior_lag=0.1, longest=0.2),
    steering=SingleTrackFilter(vehicle=CAR),
    prior_delay=0.05,
)
_rng = np.random.default_rng(3)
NETS = tuple(
    tuple(_rng.uniform(-0.5, 0.5, shape) for shape in ((10, 7), (10,), (10, 10), (10,), (1, 10), (1,)))
    for _ in range(2)
)
ANSWER = {"now": 0.006, "before": 0.005, "earlier": 0.002, "back": 0.2, "slip": 4e-4, "yaw": 0.38}
FORECASTS = NfqPolicy(
    nets=tuple(tuple(4.0 * p for p in net) for net in NETS),  # flatter ones magnify rounding
    preview_points=PREVIEW,
    forecast=DelayCompensator(samples=5, trust=0.25, straight=0.02, **ANSWER),
    continuous=True,
)
LOOPS: dict[str, tuple[Scenario, dict[str, Any]]] = {
    "linear": (
        Scenario.under("hard", course="figure-eight", vehicle={"plant": "linear"}, steering={"gain": 1.1}),
        {"controller": STANLEY},
    ),
    "recorded speed": (
        Scenario(course="genesis", driver={"speed": "recorded", "v_max": 20.0}),
        {"controller": STANLEY},
    ),
    "gusts": (Scenario(disturbances={"wind": 0.2, "gust": 0.3, "bank_deg": 2.0}), {"controller": STANLEY}),
    "worn": (Scenario.under("real", steering=WORN), {"controller": STANLEY}),
    "learner": (
        Scenario.under("hard", steering={"delay": 0.05}),
        {"controller": NfqPolicy(nets=NETS), "doe": Integrator(), "recovery": STANLEY},
    ),
    "learner that forecasts": (
        Scenario.under("hard", steering={"delay": 0.2}),
        {"controller": FORECASTS, "doe": LowPass(), "recovery": STANLEY},
    ),
    "torque": (
        Scenario(steering={"command": "torque", "delay": 0.1, "gain": 1.2, "quantum_deg": 0.6, "play_deg": 1.7}),
        {"controller": OffsetFree(block=CommandCompensation(block=LATE, offset=0.02, gain=1.1))},
    ),
    "adaptive": (Scenario(steering={"lag": 0.1}), {"controller": ADAPTIVE}),
}
LONG = ("learner", "learner that forecasts", "torque", "adaptive")
"""What a compiler optimises for seconds; the others are enough to see that optimised code gives the same."""


def loop_of(name: str, seed: int) -> Loop:
    """Somewhere on its course, as the seed has it."""
    scenario, parts = LOOPS[name]
    return assembled(scenario.with_(course={"start": 37.0 * seed}), **parts, seed=seed)


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


@pytest.mark.parametrize("backend", ["python", pytest.param("c", marks=needs_compiler)])
@pytest.mark.parametrize("name", LOOPS)
def test_one_car_and_each_of_a_batch(backend: Any, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    if name not in LONG:
        monkeypatch.setenv("CC", optimising())
    for seed in (3, 4) if backend == "python" else (3,):
        loop = loop_of(name, seed)
        compiled = compile(loop, backend=backend)
        for start in (loop.init(), loop.init(batch=CARS)):
            require_same(compiled.run(SECONDS, state=start), simulate(loop, SECONDS, state=start), backend)


@needs_compiler
@pytest.mark.parametrize("name", ["linear", "learner"])
def test_exported_controllers_give_the_recorded_commands(name: str, tmp_path: Path) -> None:
    loop = loop_of(name, 1)
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
