"""Tracing: what cannot be traced is named with the way out."""

import math
from typing import Any

import numpy as np
import pytest

from steerkit.compiled import TraceError, compile
from steerkit.compiled.trace import with_parameters
from steerkit.diagram.loop import Loop
from steerkit.plants.speed_driver import SpeedDriver
from tests.support.traced_blocks import Decay, Derived, Hardware, decay_loop


def hardware_loop() -> Loop:
    block, decay = Hardware(), Decay()
    return Loop(blocks={"what": block, "decay": decay}, wires=[(block.y, decay.u), (decay.x, block.u)])


OPEN = compile(decay_loop(), backend="python", parameters=["decay.a"])


@pytest.mark.parametrize(
    ("attempt", "words"),
    [
        (lambda: compile(hardware_loop(), backend="python"), r"what \(Hardware\) is not pure.*simulate"),
        (lambda: compile(decay_loop(), parameters=["decay.c"]), r"has no field 'c'; fields: .*a, b"),
        (lambda: compile(decay_loop(), backend="fortran"), "valid: auto, python, c"),  # type: ignore[arg-type]
        (
            lambda: compile(decay_loop().with_block("decay", Derived()), parameters=["decay.a"]),
            "computes twice when it is built",
        ),
        (lambda: OPEN.run(1.0, parameters={"decay.b": 1.0}), "was not left open"),
        (lambda: OPEN.run(1.0, batch=3, parameters={"decay.a": np.ones(2)}), "different numbers of cars"),
        (lambda: OPEN.run(math.nan), "duration"),
    ],
)
def test_errors_name_the_block_and_the_way_out(attempt: Any, words: str) -> None:
    with pytest.raises((TraceError, ValueError), match=words):
        attempt()


def test_parameters_that_bound_each_other_are_set_at_once() -> None:
    """Both ways: above what the other was, and below."""
    loop = Loop(blocks={"driver": SpeedDriver(v_min=4.0, v_max=8.0)}, wires=[])
    for values in ({"v_min": 9.0, "v_max": 9.5}, {"v_max": 2.0, "v_min": 1.0}):
        changed: Any = with_parameters(loop, {f"driver.{name}": v for name, v in values.items()}).blocks["driver"]
        assert (changed.v_min, changed.v_max) == (values["v_min"], values["v_max"])
    with pytest.raises(ValueError, match=r"v_max = 3.0 .*expected 5 to"):
        with_parameters(loop, {"driver.v_min": 5.0, "driver.v_max": 3.0})
