"""What holds for every estimator of a car: compiled, saved, at a standstill, with samples lost, out of range."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pytest

from steerkit.compiled import compile
from steerkit.diagram.block import Block, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.maths import sin
from steerkit.diagram.simulation import simulate
from steerkit.estimators.estimate import estimated
from steerkit.estimators.single_track_filter import SingleTrackFilter
from steerkit.estimators.steering_delay import WheelDelay, YawDelay
from steerkit.estimators.steering_hysteresis import SteeringFriction, SteeringPlay
from tests.support.steered_car import PASSAT, answered, driven, driven_fast, quantities, steered

ALL: dict[str, Any] = {
    "wheel": WheelDelay(longest=0.3),
    "yaw": YawDelay(vehicle=PASSAT, longest=0.3),
    "filter": SingleTrackFilter(vehicle=PASSAT),
    "friction": SteeringFriction(longest=0.2),
    "play": SteeringPlay(vehicle=PASSAT, longest=0.2),
}


@dataclass(frozen=True, eq=False, kw_only=True)
class Made(Block):
    """Signals that excite all estimators, made up."""

    delta_sw_cmd = Out("rad", direct=())
    delta_sw_meas = Out("rad", direct=())
    v = Out("m/s", direct=())
    r = Out("rad/s", direct=())
    psi = Out("rad", direct=())
    active = Out("1", direct=())

    def output(self, t: Any, x: Any, u: Any) -> Any:
        angle = sin(t) + 0.3 * sin(3.1 * t)
        return self.Y(angle, 0.9 * angle, 8.0 + sin(0.1 * t), 0.2 * angle, 0.2 * sin(t), 1.0 + 0.0 * angle)


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


@pytest.mark.parametrize("name", sorted(ALL.keys() - {"yaw"}))  # whose deviation depends on the speed
def test_at_a_standstill_nothing_is_learned_or_forgotten(name: str) -> None:
    block: Block = ALL[name]
    signals = answered(steered(20.0), delay=0.1, lag=0.2)
    x = driven_fast(block, signals | {"angle": signals["delta_sw_cmd"]})
    stands = {port.name: np.zeros(2000) for port in block.inputs} | {"active": np.ones(2000)}
    stands |= {"delay": np.full(2000, 0.1), "lag": np.full(2000, 0.2), "psi": np.full(2000, math.nan)}
    stands["r"] = np.full(2000, math.nan if name == "filter" else 0.0)  # a gyro at rest is its zero
    before = block.output(0.0, x, ())
    after = block.output(0.0, driven_fast(block, stands, x), ())
    for quantity in quantities(block):
        assert estimated(after, quantity) == estimated(before, quantity)


@pytest.mark.parametrize(
    ("name", "port"), [(name, port.name) for name in sorted(ALL) for port in ALL[name].inputs if port.name != "psi"]
)
def test_a_sample_that_cannot_be_read_is_reported(name: str, port: str) -> None:
    block: Block = ALL[name]
    u = {one.name: 8.0 if one.name == "v" else 0.1 for one in block.inputs}

    def missing(value: float) -> Any:
        after = block.update(0.0, block.init(), block.U(**u | {port: value}), None)
        return block.output(0.0, after, ()).missing

    assert [missing(u[port]), missing(math.nan), missing(-math.inf)] == [0.0, 1.0, 1.0]


@pytest.mark.parametrize(
    ("kind", "wrong", "message"),
    [
        (WheelDelay, dict(longest=0.52), r"WheelDelay: longest = 0.52 \[s\], expected a multiple of dt"),
        (WheelDelay, dict(longest=6.0), r"longest = 6.0 \[s\], expected 2 to 100 samples of 0.05 s"),
        (WheelDelay, dict(prior_delay=0.9), r"prior_delay = 0.9 \[s\], expected 0 to 0.75"),
        (YawDelay, dict(vehicle="vw-passat"), "YawDelay: .*expected a Vehicle"),
        (YawDelay, dict(vehicle=PASSAT, yaw_unknown=2.0), r"yaw_unknown = 2.0 \[1\], expected 0 to 1"),
        (SteeringFriction, dict(prior=0.1), r"SteeringFriction: prior = 0.1 \[rad\], expected 0 to 0.0279253"),
        (SingleTrackFilter, dict(vehicle="vw-passat"), "expected a Vehicle"),
        (SingleTrackFilter, dict(vehicle=PASSAT, longest=0.52), r"longest = 0.52 \[s\], expected a multiple of dt"),
        (SingleTrackFilter, dict(vehicle=PASSAT, ratio_prior=2.0), r"ratio_prior = 2.0 \[1\], expected 0.0001 to 0.5"),
    ],
)
def test_parameters_out_of_range(kind: type[Block], wrong: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        kind(**wrong)
