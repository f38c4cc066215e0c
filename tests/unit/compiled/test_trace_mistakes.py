"""What a block may do wrong while it is traced: compile and export_c say the same, with the line."""

import math
import re
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import steerkit
from steerkit._support.errors import WiringError
from steerkit.compiled import TraceError
from steerkit.controllers.supervisor import ExceptionGuard
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.export.c import export_c
from tests.support.straight_road import ROAD, looped

HEAD = """
@dataclass(frozen=True, eq=False, kw_only=True)
class Mine(Block):
    e = In("m")
    psi_e = In("rad")
    delta_sw = Out("rad")
    gain: Any = 1.0

    def init(self, batch=()):
        return (m.filled(0.0, batch),)

"""
TRUE, PLAIN, NUMPY, CHOICE = "asks if a signal is true", "plain number of a signal", "gives a signal to", "m.where("
MATHS = "m.atan"
OUTPUT = {
    "a function of math": ("self.Y(math.atan(u.e))", PLAIN, MATHS),
    "int": ("self.Y(1.0 * int(u.e))", PLAIN, MATHS),
    "round": ("self.Y(1.0 * round(u.e))", PLAIN, MATHS),
    "math.ceil": ("self.Y(1.0 * math.ceil(u.e))", PLAIN, MATHS),
    "if": ("self.Y(1.0) if u.e > 0.5 else self.Y(u.e)", TRUE, CHOICE),
    "and": ("self.Y(m.where(u.e < 1.0 and u.psi_e < 1.0, 1.0, 0.0))", TRUE, CHOICE),
    "a comparison of three": ("self.Y(m.where(-1.0 < u.e < 1.0, 1.0, 0.0))", TRUE, CHOICE),
    "&": ("self.Y(m.where((u.e < 1.0) & (u.psi_e < 1.0), 1.0, 0.0))", "uses &", "m.both"),
    "%": ("self.Y(u.e % 1.0)", "uses %", "m.wrap"),
    "**": ("self.Y(u.e**3)", "to the power of 3", "valid: 2"),
    "np.clip": ("self.Y(np.clip(u.e, -1.0, 1.0))", "gives a signal to np.clip", "m.clip"),
    "np.interp": ("self.Y(float(np.interp(u.e, (0.0, 1.0), (0.0, 2.0))))", "gives a signal to np.interp", MATHS),
    "np.arctan": ("self.Y(np.arctan(u.e))", NUMPY, MATHS),
    "an index": ("self.Y((0.0, 1.0)[u.e])", "indices must be integers", "steerkit.diagram.maths"),
    "a key": ("self.Y({0.0: 1.0}.get(u.e, 0.0))", "for a key of a dictionary", "m.where"),
    "a method of an array": ("self.Y(u.e.clip(-1.0, 1.0))", "no attribute 'clip'", "steerkit.diagram.maths"),
    "print": ("print(u.e) or self.Y(u.e)", "prints or formats", "look at the log"),
    "a text": ("self.Y(u.e) if f'{u.e:.1f}' else None", "prints or formats", "look at the log"),
    "an array returned": ("self.Y(u.e * np.array([1.0, 2.0]))", "a ndarray, expected a number", "output: line"),
    "an input that is not there": ("self.Y(u.v)", "read 'v', which is not one of its inputs", "(e, psi_e)"),
}
STATE = {
    "a state under `while`": ("z = x[0]\nwhile z > 1.0:\n    z = z - 1.0\nreturn (z,)", TRUE, CHOICE),
    "a text in a state": ("return ('left',)", "'left', a str, in its state", "expected a number"),
    "an error caught by the block": (
        "try:\n    return (math.sin(u.e),)\nexcept TypeError:\n    return (math.nan,)",
        PLAIN,
        MATHS,
    ),
}
MISTAKES = {
    **{what: (f"def output(self, t, x, u):\n    return {code}", *says) for what, (code, *says) in OUTPUT.items()},
    **{
        what: (
            "def output(self, t, x, u):\n    return self.Y(x[0])\ndef update(self, t, x, u, y):\n"
            + textwrap.indent(code, "    "),
            *says,
        )
        for what, (code, *says) in STATE.items()
    },
}


def block_of(body: str, **parameters: Any) -> Block:
    names = {"dataclass": dataclass, "Block": Block, "In": In, "Out": Out, "Any": Any, "math": math, "np": np, "m": m}
    exec(compile(HEAD + textwrap.indent(body, "    "), "mine.py", "exec"), names | {"__name__": "mine"}, names)
    return names["Mine"](**parameters)


def ways(block: Block, folder: Path) -> dict[str, Any]:
    loop = looped(block, ROAD, 5.0, 0.0)
    return {"compile": lambda: steerkit.compile(loop, backend="python"), "export_c": lambda: export_c(block, folder)}


@pytest.mark.parametrize("what", MISTAKES)
def test_a_mistake_names_block_line_and_cure_in_every_way_of_tracing(what: str, tmp_path: Path) -> None:
    body, *says = MISTAKES[what]
    block = block_of(body)
    for way, trace in ways(block, tmp_path).items():
        with pytest.raises((TraceError, WiringError)) as caught:
            trace()
        answer = str(caught.value)
        asked = re.search(r"(\w+)\.(output|update) \(Mine\)|(\w+)\.delta_sw", answer)
        assert asked, answer
        assert (asked[1] or asked[3]) == ("block" if way == "export_c" else "controller")
        line = int(re.search(r"line (\d+) of mine\.py", answer)[1])  # type: ignore[index]
        assert line > HEAD.count("\n"), answer
        assert not [words for words in says if words not in answer], answer
        assert len(answer) < 420
        assert "\n" not in answer
    assert not list(tmp_path.iterdir())


def test_an_array_as_a_gain_is_refused_with_the_way_to_a_number_a_car() -> None:
    block = block_of("def output(self, t, x, u):\n    return self.Y(-self.gain * u.e)", gain=np.array([1.0, 2.0]))
    with pytest.raises(
        TraceError, match=r"line 13 of mine\.py: computes with .* of shape \(2,\).*compile\(parameters="
    ):
        steerkit.compile(looped(block, ROAD, 5.0, 0.0), backend="python")


def test_a_guard_around_the_block_hides_nothing() -> None:
    guard = ExceptionGuard(block=block_of("def output(self, t, x, u):\n    return self.Y(math.atan(u.e))"))
    with pytest.raises(TraceError, match=rf"controller\.output \(Mine\).*line 13 of mine\.py.*{PLAIN}"):
        steerkit.compile(looped(guard, ROAD, 5.0, 0.0), backend="python")
