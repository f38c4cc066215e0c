"""A CasADi function on arrays in place: the same as C and by CasADi's virtual machine."""

from __future__ import annotations

import casadi
import numpy as np
import pytest

from steerkit.controllers.mpc.bound import Bound


@pytest.mark.parametrize("in_c", [True, False])
def test_it_reads_and_writes_its_arrays(in_c: bool) -> None:
    x, y = casadi.MX.sym("x", 3), casadi.MX.sym("y", 2)
    function = casadi.Function("f", [x, y], [casadi.sin(x) * y[0], casadi.vertcat(x, y)])
    inputs, outputs = [np.zeros(3), np.zeros(2)], [np.zeros(3), np.zeros(5)]
    bound = Bound(function, inputs, outputs, in_c=in_c)
    assert (bound.c is not None) == in_c
    for values in ((0.1, 0.2, 0.3), (1.0, -2.0, 3.0)):
        inputs[0][:], inputs[1][:] = values, values[:2]
        bound()
        np.testing.assert_allclose(outputs[0], np.sin(values) * values[0], rtol=1e-14)
        np.testing.assert_array_equal(outputs[1], [*values, *values[:2]])


@pytest.mark.parametrize("in_c", [True, False])
def test_an_input_can_be_read_from_elsewhere(in_c: bool) -> None:
    x = casadi.MX.sym("x", 2)
    result = np.zeros(2)
    bound = Bound(casadi.Function("g", [x], [2.0 * x]), [np.ones(2)], [result], in_c=in_c)
    rows = np.arange(6.0).reshape(3, 2)
    for row in rows:
        bound.point(0, row)
        bound()
        np.testing.assert_array_equal(result, 2.0 * row)
