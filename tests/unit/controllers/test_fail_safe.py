"""A filter that raises, is late or answers nothing leaves the wheel to the recovery controller, and it is said why."""

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import casadi
import numpy as np
import pytest

from steerkit.controllers.fail_safe import FAULTS, LATE, NOTHING, RAISED, FailSafe, said
from steerkit.controllers.safety_filter import SafetyFilter
from steerkit.controllers.stanley import Stanley
from steerkit.controllers.supervisor import ExceptionGuard
from steerkit.diagram.block import Block, Wrapper
from steerkit.scenario.assembly import bare
from steerkit.vehicles import VW_PASSAT as PASSAT

FILTER = SafetyFilter.of(PASSAT)
HERE: dict[str, Any] = dict(
    command=0.1, e=0.0, psi_e=0.0, preview=(0.0,) * 16, v=6.0, r=0.0, delta_sw_meas=0.0, recovery=-0.2
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Broken(Wrapper):
    """A filter in which something goes wrong."""

    answer: Callable[[Any], Any]
    remember: Callable[[], None] = lambda: None

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.answer(self.inner_output(t, x, u))

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        self.remember()
        return super().update(t, x, u, y)


def raising(*_: Any) -> Any:
    raise ZeroDivisionError("float division by zero")


def asked(block: Block, **values: float) -> Any:
    u = block.D(**{**HERE, **values})
    return block.output(0.0, block.settle(0.0, block.init(), u), u)


def test_a_good_answer_passes_to_the_bit() -> None:
    for leaving in ({}, {"e": 0.3, "psi_e": 0.03, "command": 0.3}):
        u = {**HERE, **leaving}
        plain = FILTER.D(**{name: value for name, value in u.items() if name != "recovery"})
        assert asked(FailSafe(block=FILTER), **leaving) == FILTER.output(0.0, FILTER.settle(0.0, (), plain), plain)


@pytest.mark.parametrize(
    ("answer", "reason", "words"),
    [
        (raising, RAISED, "the filter raised an exception"),
        (lambda y: y._replace(delta_sw=math.nan), NOTHING, "the filter's answer is not finite"),
        (lambda y: y._replace(delta_sw=math.inf), NOTHING, "the filter's answer is not finite"),
    ],
)
def test_what_is_no_answer_is_recoverys(
    answer: Any, reason: float, words: str, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.ERROR, logger="steerkit"):
        y = asked(FailSafe(block=Broken(block=FILTER, answer=answer)))
    assert (y.delta_sw, y.correction, y.share, y.reason) == (-0.2, -0.2 - 0.1, 1.0, reason)
    assert ("Broken.output failed at t = 0.0 s" if answer is raising else words) in caplog.text
    assert words in said(y.reason) == FAULTS[reason]
    assert ("ZeroDivisionError" in caplog.text) is (answer is raising)


@pytest.mark.parametrize(("taken", "reason"), [(0.03, 0.0), (0.031, LATE)])
def test_a_late_answer_is_not_used(taken: float, reason: float, caplog: pytest.LogCaptureFixture) -> None:
    times = iter((1e3, 1e3 + taken))
    with caplog.at_level(logging.ERROR, logger="steerkit"):
        y = asked(FailSafe(block=FILTER, budget=0.03, clock=lambda: next(times)))
    assert (y.delta_sw, y.reason) == ((0.1, 0.0) if reason == 0.0 else (-0.2, reason))
    assert ("late, 31.0 ms of 30.0 ms" in caplog.text) is (reason == LATE)


def test_it_goes_on_from_what_was_sent_and_stays_as_it_was_where_remembering_raises() -> None:
    block = FailSafe(block=Broken(block=FILTER, answer=raising))
    u: Any = block.U(**HERE)
    x = block.settle(0.0, block.init(), u)
    after = block.update(0.0, x, u, block.output(0.0, x, block.D(**HERE)))
    assert after[-1] == -0.2
    forgetful = FailSafe(block=Broken(block=FILTER, answer=raising, remember=raising))
    assert forgetful.update(0.0, after, u, forgetful.output(0.0, after, block.D(**HERE))) is after


def test_a_batch_has_its_own_fault_each() -> None:
    broken = Broken(block=FILTER, answer=lambda y: y._replace(delta_sw=np.array([0.1, math.nan])))
    block = FailSafe(block=broken)
    two = {n: (v if isinstance(v, tuple) else np.full(2, v)) for n, v in HERE.items()}
    y = block.output(0.0, block.settle(0.0, block.init((2,)), block.D(**two)), block.D(**two))
    assert y.delta_sw.tolist() == [0.1, -0.2]
    assert y.reason.tolist() == [0.0, NOTHING]


def test_what_raises_while_a_loop_is_traced_goes_through() -> None:
    block = FailSafe(block=Broken(block=FILTER, answer=raising, remember=raising))
    u: Any = block.U(**HERE)
    x = block.settle(0.0, block.init(), u)
    for traced in (lambda t: block.output(t, x, u), lambda t: block.update(t, x, u, block.Y(*[0.0] * 7))):
        with pytest.raises(ZeroDivisionError):
            traced(casadi.SX.sym("t"))


def test_what_cannot_be_is_refused_and_it_stands_for_its_filter() -> None:
    for block in (Stanley.of(PASSAT), ExceptionGuard(block=Stanley.of(PASSAT))):
        with pytest.raises(ValueError, match="block with outputs delta_sw, expected a SafetyFilter"):
            replace(FailSafe(block=FILTER), block=block)
    assert bare(FailSafe(block=FILTER)) is FILTER
