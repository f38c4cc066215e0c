"""One formula for floats, arrays and symbols."""

import math
from typing import Any

import casadi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from steerkit.diagram import maths as m

VALUES = (-7.0, -math.pi, -1.0, -0.25, 0.0, 0.25, 1.0, math.pi, 7.0, 1e6)


def everywhere(function: Any, *arguments: float) -> list[float]:
    """The answer for floats, for arrays and for symbols."""
    symbols = [casadi.SX.sym("x") for _ in arguments]
    traced = casadi.Function("f", symbols, [function(*symbols)])
    return [
        float(function(*arguments)),
        float(function(*[np.array([a, a]) for a in arguments])[1]),
        float(traced(*arguments)),
    ]


ONE_CAR = [float, np.float64, np.array]
BATCH = [*ONE_CAR, lambda value: np.array([value, value])]


@pytest.mark.parametrize("condition", [True, np.True_, np.array(True)])
@pytest.mark.parametrize("kind", ONE_CAR)
def test_of_one_cars_numbers_one_is_chosen_as_it_is(condition: Any, kind: Any) -> None:
    yes = kind(1.0)
    assert m.where(condition, yes, 2.0) is yes
    assert m.where(m.both(condition, np.array(False)), 2.0, yes) is yes


@pytest.mark.parametrize("yes", BATCH)
@pytest.mark.parametrize("no", BATCH)
def test_for_a_batch_each_car_has_its_own(yes: Any, no: Any) -> None:
    np.testing.assert_array_equal(m.where(np.array([True, False]), yes(1.0), no(2.0)), [1.0, 2.0])
    np.testing.assert_array_equal(m.maximum(np.array([1.0, math.nan]), no(0.5)), [1.0, math.nan])


@pytest.mark.parametrize("x", VALUES)
def test_signs_and_wrapped_angles(x: float) -> None:
    assert everywhere(m.sign, x) == [np.sign(x)] * 3
    for angle in everywhere(m.wrap, x):
        assert -math.pi <= angle < math.pi + 1e-9
        assert math.remainder(angle - x, math.tau) == pytest.approx(0.0, abs=1e-9)


def number(condition: Any) -> Any:
    return m.where(condition, 1.0, 0.0)


def summed(a: Any, b: Any, c: Any, d: Any) -> Any:
    """Of two numbers that are chosen together, the first and ten times the second."""
    first, second = m.chosen(a < b, (a, c), (b, d))
    return first + 10.0 * second


BEYOND = (math.nan, math.inf, -math.inf, 2e300, -2e300)


@pytest.mark.parametrize(
    ("function", "arguments", "answer"),
    [
        *((lambda x, y: number(m.both(x > 0.5, y > 0.5)), (a, b), a * b) for a in (0.0, 1.0) for b in (0.0, 1.0)),
        *((lambda x, y: number(m.either(x > 0.5, y > 0.5)), (a, b), max(a, b)) for a in (0.0, 1.0) for b in (0.0, 1.0)),
        *((lambda x: m.clip(x, -1.0, 2.0), (x,), y) for x, y in ((-3, -1), (0.5, 0.5), (3, 2), (math.nan, math.nan))),
        *((lambda x: number(m.is_finite(x)), (x,), float(math.isfinite(x))) for x in (1e12, -1e299, *BEYOND[:3])),
        (lambda *x: number(m.all_finite(x)), (-1e300, 0.0, 1e300), 1.0),
        *((lambda *x: number(m.all_finite(x)), (1.0, x, 0.0), 0.0) for x in BEYOND),
        *((lambda *x: number(m.all_finite(x)), x, 0.0) for x in ((math.nan, 0.0, 1.0), (0.0, 1.0, math.inf))),
        (summed, (1.0, 2.0, 3.0, 4.0), 31.0),
        (summed, (1.0, 0.0, 3.0, 4.0), 40.0),
    ],
)
def test_conditions_limits_and_choices(function: Any, arguments: tuple[float, ...], answer: float) -> None:
    assert everywhere(function, *arguments) == pytest.approx([answer] * 3, nan_ok=True)


@given(rate=st.floats(-2.0, 2.0), start=st.floats(-5.0, 5.0))
def test_runge_kutta_is_the_exponential_to_fifth_order(rate: float, start: float) -> None:
    """One step for x' = rate x is the Taylor polynomial of fourth degree; a second state that turns with it."""
    h = 0.1
    (x,) = m.rk4(lambda x: (rate * x[0],), (start,), h)
    z = rate * h
    assert x == pytest.approx(start * (1.0 + z + z**2 / 2.0 + z**3 / 6.0 + z**4 / 24.0), rel=1e-13, abs=1e-15)


def test_a_routine_is_called_on_floats_and_refuses_symbols_outside_of_a_trace() -> None:
    routine = m.Routine(name="Twice", size=1, call=lambda a: (2.0 * a,))
    assert routine(1.5) == (3.0,)
    with pytest.raises(TypeError, match="Twice runs code of its own, which has no symbolic form"):
        routine(casadi.SX.sym("x"))
