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


def test_errors_name_the_block_and_the_way_out() -> None:
    block, decay = Hardware(), Decay()
    loop = Loop(blocks={"what": block, "decay": decay}, wires=[(block.y, decay.u), (decay.x, block.u)])
    with pytest.raises(TraceError, match=r"what \(Hardware\) is not pure.*simulate"):
        compile(loop, backend="python")
    loop = decay_loop()
    with pytest.raises(KeyError, match=r"did you mean 'decay\.x'"):
        compile(loop, backend="python", record=["decay.z"])
    with pytest.raises(TraceError, match=r"has no field 'c'; fields: .*a, b"):
        compile(loop, backend="python", parameters=["decay.c"])
    with pytest.raises(ValueError, match="was not left open"):
        compile(loop, backend="python").run(1.0, parameters={"decay.a": 1.0})
    with pytest.raises(ValueError, match="different numbers of cars"):
        compile(loop, backend="python", parameters=["decay.a"]).run(1.0, batch=3, parameters={"decay.a": np.ones(2)})
    with pytest.raises(ValueError, match="duration"):
        compile(loop, backend="python").run(math.nan)
    with pytest.raises(ValueError, match="valid: auto, python, c"):
        compile(loop, backend="fortran")  # type: ignore[arg-type]
    derived = Derived()
    with pytest.raises(TraceError, match=r"computes twice when it is built"):
        compile(loop.with_block("decay", derived), backend="python", parameters=["decay.a"])


def test_parameters_that_bound_each_other_are_set_at_once() -> None:
    """Both ways: above what the other was, and below."""
    loop = Loop(blocks={"driver": SpeedDriver(v_min=4.0, v_max=8.0)}, wires=[])
    for values in ({"v_min": 9.0, "v_max": 9.5}, {"v_max": 2.0, "v_min": 1.0}):
        changed: Any = with_parameters(loop, {f"driver.{name}": v for name, v in values.items()}).blocks["driver"]
        assert (changed.v_min, changed.v_max) == (values["v_min"], values["v_max"])
    with pytest.raises(ValueError, match=r"v_max = 3.0 .*expected 5 to"):
        with_parameters(loop, {"driver.v_min": 5.0, "driver.v_max": 3.0})
