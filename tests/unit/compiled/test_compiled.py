"""Compiled loops: closed forms, continuation, parameters, errors, cache, gradients."""

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from steerkit import compiled
from steerkit._support import native
from steerkit.compiled import compile
from steerkit.diagram.simulation import NonFiniteError, simulate
from tests.support.places import ROOT
from tests.support.traced_blocks import decay_loop, mixed_loop, worst

BACKENDS = [
    "python",
    pytest.param("c", marks=pytest.mark.skipif(native.compiler() is None, reason="needs a C compiler")),
]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("dt", [0.05, 0.025])
def test_every_operation_agrees_with_simulate(backend: Any, dt: float) -> None:
    loop = mixed_loop(dt)
    log = compile(loop, backend=backend).run(5.0)
    assert worst(log, simulate(loop, 5.0)) <= 1e-13
    assert log["mixed.row"].shape == (len(log.t), 2)
    many = compile(loop, backend=backend).run(2.0, batch=11)
    batch = simulate(loop, 2.0, batch=11)
    assert many["mixed.row"].shape == (len(many.t), 2, 11)
    assert worst(many, batch) <= 1e-13
    assert np.ptp(many["mixed.noise"][5]) > 0.1  # each car draws its own noise


@pytest.mark.parametrize("batch", [None, 5])
@pytest.mark.parametrize("backend", BACKENDS)
def test_runs_go_on_from_any_tick_with_any_decimation(backend: Any, batch: int | None) -> None:
    loop = mixed_loop(0.025)
    c = compile(loop, backend=backend, every=3, record=["mixed.y", "decay.x"])
    first = c.run(0.325, batch=batch)
    first_ref = simulate(loop, 0.325, batch=batch, every=3, record=["mixed.y", "decay.x"])
    assert worst(first, first_ref) <= 1e-13
    second = c.run(0.7, state=first.state)
    assert worst(second, simulate(loop, 0.7, state=first_ref.state, every=3, record=["mixed.y", "decay.x"])) <= 1e-13
    assert second.t[0] == pytest.approx(0.375)
    assert type(second.state.y[2]) is type(first_ref.state.y[2])


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_car_has_its_parameters_and_start(backend: Any) -> None:
    c = compile(decay_loop(), backend=backend, parameters=["decay.a", "decay.x0"])
    a, x0 = np.linspace(0.5, 0.95, 10), np.linspace(1.0, 2.0, 10)
    log = c.run(1.0, parameters={"decay.a": a, "decay.x0": x0})
    np.testing.assert_allclose(log["decay.x"], x0 * a ** np.arange(20)[:, None], rtol=1e-13)
    one = c.run(1.0, parameters={"decay.a": 0.5})
    np.testing.assert_allclose(one["decay.x"], 0.5 ** np.arange(20), rtol=1e-14)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_signal_that_is_not_finite_is_an_error_with_the_log(backend: Any) -> None:
    c = compile(decay_loop(a=1e200), backend=backend)
    with pytest.raises(NonFiniteError, match=r"decay\.x \[1\] is inf at t = 0\.1 s") as caught:
        c.run(1.0)
    assert len(caught.value.log.t) == 20
    assert np.isinf(c.run(1.0, allow_nonfinite=True)["decay.x"][-1])


def test_without_a_compiler_generated_python_runs_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    with pytest.warns(UserWarning, match="no C compiler found: the loop runs in generated Python"):
        c = compile(decay_loop())
    assert c.backend == "python"
    assert c.run(1.0)["decay.x"][-1] == pytest.approx(0.9**19)
    with pytest.raises(compiled.NoCompilerError, match="install gcc or set CC"):
        compile(decay_loop(), backend="c")


@pytest.mark.skipif(native.compiler() is None, reason="needs a C compiler")
def test_a_second_process_finds_the_library_in_the_cache(tmp_path: Path) -> None:
    code = (
        "from steerkit.compiled import compile\nfrom tests.support.traced_blocks import decay_loop\n"
        "c = compile(decay_loop(a=0.75), backend='c')\n"
        "log = c.run(1.0); print(log['decay.x'][-1], log.state.y)"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    root = ROOT
    outputs, stamps = [], []
    for _ in range(2):
        done = subprocess.run([sys.executable, "-c", code], env=environment, cwd=root, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        outputs.append(done.stdout)
        stamps.append([(file.name, file.stat().st_mtime_ns) for file in (tmp_path / "steerkit").iterdir()])
    assert outputs[0] == outputs[1]
    assert stamps[0] == stamps[1]
    assert [name.endswith(".so") for name, _ in stamps[0]] == [True]


@pytest.mark.parametrize("batch", [0, -1, 2.5, "3"])
def test_a_batch_that_is_no_number_of_cars_is_told_wherever_the_run_begins(batch: Any) -> None:
    c = compile(decay_loop(), backend="python")
    for state in (None, c.run(1.0).state):
        with pytest.raises(ValueError, match=re.escape(f"run: batch = {batch!r}, expected a number of cars >= 1")):
            c.run(1.0, batch=batch, state=state)
