"""The study's loop under other engines: the equations they get; and, where they are installed, what they answer."""

from __future__ import annotations

import math

import numpy as np
import pytest

from benchmarks.peers import engines
from benchmarks.studies.throughput import DT, closed_loop
from steerkit.compiled.graph import FUNCTIONS
from steerkit.diagram.simulation import simulate

STEPS = 40


def test_the_equations_in_straight_lines_are_the_loop() -> None:
    loop = closed_loop()
    start = loop.init()
    told, state = engines._equations(loop, start)
    names = {name: getattr(math, name) for name in FUNCTIONS} | {"select": lambda c, a, b: a if c else b, "whole": int}
    tick, tables = engines._made(told, names), tuple(table.rows for table in told.tables)
    errors, s = [], tuple(state)
    for k in range(STEPS):
        s, e = tick(float(k), s, tables)
        errors.append(e)
    np.testing.assert_allclose(errors, simulate(loop, STEPS * DT, state=start)["path.e"], rtol=0.0, atol=1e-13)


@pytest.mark.parametrize("name", list(engines.ENGINES))
def test_an_engine_that_is_there_drives_the_same(name: str) -> None:
    package, make, _ = engines.ENGINES[name]
    if not engines.installed(package):
        pytest.skip(f"{package} comes with the extra peers")
    loop = closed_loop()
    start = loop.init()
    run, expected = make(loop, start), simulate(loop, STEPS * DT, state=start)["path.e"]
    for _ in range(2):  # each run begins at the start
        np.testing.assert_allclose(run(STEPS), expected, rtol=0.0, atol=1e-12)


def test_a_package_that_nobody_has_is_not_installed() -> None:
    assert not engines.installed("no_such_engine_of_that_name")
    assert engines.installed("numpy")
