"""Whose code went wrong, and where; the messages themselves are a table of tests/contract/test_wrong_inputs.py."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from steerkit._support.errors import WiringError, in_one_line
from steerkit.controllers.supervisor import ExceptionGuard
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.diagnostics import check_outputs, check_state, explained, place_of
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from tests.support.parts import Count, Gain


def half(x: float) -> float:
    return x / 0.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Fragile(Block):
    """Fails in a function that it calls, from `late` on."""

    u = In("m")
    y = Out("m")
    late: float = 0.0

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(half(u.u) if t >= self.late else u.u)


def caught(late: float) -> tuple[Loop, Exception]:
    count, fragile = Count(), Fragile(late=late)
    loop = Loop(blocks={"count": count, "fragile": fragile}, wires=[(count.n, fragile.u)])
    with pytest.raises(ZeroDivisionError) as error:
        simulate(loop, 1.0)
    return loop, error.value


@pytest.mark.parametrize("late", [0.0, 0.3])
def test_the_block_and_its_line_are_found_at_the_start_and_later(late: float) -> None:
    loop, error = caught(late)
    place = place_of(error, loop.blocks)
    assert place is not None
    assert (place.block, place.method, place.called) == (loop.blocks["fragile"], "output", False)
    line = half.__code__.co_firstlineno + 1
    assert (place.text, place.line) == ("fragile.output (Fragile)", f"line {line} of test_diagnostics.py")
    assert f"in {place.text}, {place.line}" in error.__notes__
    assert in_one_line(error, foreign=True).startswith("ZeroDivisionError: float division by zero; ")


def test_an_error_of_no_block_is_left_as_it_is() -> None:
    with pytest.raises(ZeroDivisionError) as error:
        half(1.0)
    assert place_of(error.value, {"gain": Gain()}) is None
    assert explained(error.value, {"gain": Gain()}) is None
    assert in_one_line(error.value, foreign=True) == "ZeroDivisionError: float division by zero"


def test_a_block_is_named_as_the_loop_names_it() -> None:
    gain = Gain(k="two")
    with pytest.raises(TypeError) as error:
        gain.output(0.0, (), gain.D(1.0))
    assert place_of(error.value, {"controller": ExceptionGuard(block=gain)}) is None  # the guard was not asked
    place = place_of(error.value, {"controller": gain})
    assert place is not None
    assert place.text == "controller.output (Gain)"


@pytest.mark.parametrize("value", [1.0, 1, True, np.float32(1.0), np.array(1.0), np.array([1.0]), np.ones(3)])
def test_numbers_of_every_kind_pass_in_a_batch_of_three(value: Any) -> None:
    check_outputs("gain", Gain(), (value,), (3,))
    check_state("gain", Gain(), (value,), "init", (3,))


@pytest.mark.parametrize("value", ["1", None, np.ones(2), np.ones((3, 3)), np.array(["a"]), [1.0, 2.0, 3.0]])
def test_others_do_not(value: Any) -> None:
    with pytest.raises(WiringError, match=r"gain\.y \[m\] is .*expected a number, or an array of 3 for 3 cars"):
        check_outputs("gain", Gain(), (value,), (3,))
    with pytest.raises(WiringError, match=r"gain\.init \(Gain\) gave .*, expected a number, or an array of 3"):
        check_state("gain", Gain(), (value,), "init", (3,))
