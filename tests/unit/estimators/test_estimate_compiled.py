"""Estimators compile like any block, and go on exactly from a state that was saved."""

from __future__ import annotations

import json
from typing import Any, Literal

import numpy as np
import pytest

from benchmarks.studies.calibration import Made
from steerkit.compiled import compile
from steerkit.diagram.block import Block
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import WheelDelay, YawDelay
from steerkit.estimators.steering_hysteresis import SteeringFriction, SteeringPlay
from tests.support.steered_car import PASSAT, answered, driven, steered

ALL: dict[str, Any] = {
    "wheel": WheelDelay(longest=0.3),
    "yaw": YawDelay(vehicle=PASSAT, longest=0.3),
    "filter": SingleTrackFilter(vehicle=PASSAT),
    "friction": SteeringFriction(longest=0.2),
    "play": SteeringPlay(vehicle=PASSAT, longest=0.2),
}


def together() -> Loop:
    """All estimators behind signals that are made up, the delays' estimates wired on."""
    made = Made()
    wires: list[Any] = []
    for name, block in ALL.items():
        delays = ALL["wheel"] if name == "friction" else ALL["yaw"]
        for port in block.inputs:
            own = {"angle": made.delta_sw_cmd, "delta_sw": made.delta_sw_cmd}
            own |= {"delay": delays.delay, "lag": delays.lag}
            own |= {"delay_deviation": delays.delay_lag_deviation, "lag_deviation": delays.lag_deviation}
            wires.append((own.get(port.name) or getattr(made, port.name), getattr(block, port.name)))
    return Loop(blocks={"made": made, **ALL}, wires=wires)


@pytest.mark.parametrize("backend", ["python", "c"])
def test_compiled_they_say_the_same(backend: Literal["python", "c"]) -> None:
    loop = together()
    expected, got = simulate(loop, 12.0), compile(loop, backend=backend).run(12.0)
    assert expected["wheel.delay_lag_deviation"][-1] < 0.1  # they have begun to learn
    for name in expected.columns():
        np.testing.assert_allclose(
            got[name] if name != "t" else got.t,
            expected[name] if name != "t" else expected.t,
            rtol=1e-9,
            atol=1e-12,
            err_msg=name,
        )


@pytest.mark.parametrize("name", sorted(ALL))
def test_it_goes_on_from_a_saved_state_to_the_last_bit(name: str) -> None:
    block: Block = ALL[name]
    signals = answered(steered(12.0), delay=0.1, lag=0.2)
    signals["angle"] = signals["delta_sw_cmd"]
    parts = [{key: values[part] for key, values in signals.items()} for part in (slice(0, 130), slice(130, None))]
    x = driven(block, parts[0])
    read = tuple(json.loads(json.dumps(list(x))))
    assert driven(block, parts[1], read) == driven(block, parts[1], x) == driven(block, signals)
