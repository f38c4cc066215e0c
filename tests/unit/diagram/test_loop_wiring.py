"""Every mistake in the wiring is told when the loop is built."""

import re
from typing import Any

import pytest

from steerkit._support.errors import WiringError
from steerkit.diagram.loop import Loop
from steerkit.doe import Integrator
from tests.support.parts import Angle, Count, Gain, Pair

COUNT, OTHER, GAIN, SECOND, PAIR, ANGLE, DOE = Count(), Count(), Gain(), Gain(), Pair(), Angle(), Integrator()
BOTH = {"count": COUNT, "gain": GAIN}
NO_PAIR = "expected a pair of ports such as (car.v, stanley.v)"

MISTAKES: list[tuple[str, dict[Any, Any], list[Any]]] = [
    (
        "wire pair.both [m] -> gain.u [m]: sizes differ (2 and scalar)",
        BOTH | {"pair": PAIR},
        [(COUNT.n, PAIR.u), (PAIR.both, GAIN.u)],
    ),
    (
        "gain.u [m] is not driven; outputs with that unit: count.n, gain.y",
        BOTH | {"angle": ANGLE},
        [(COUNT.n, ANGLE.u)],
    ),
    (
        "gain.u [m] has two sources: count.n [m] and other.n [m]",
        BOTH | {"other": OTHER},
        [(COUNT.n, GAIN.u), (OTHER.n, GAIN.u)],
    ),
    ("wire Count.n [m] -> Gain.u [m]: Count is not in the loop; blocks: count, gain", BOTH, [(OTHER.n, GAIN.u)]),
    ("'a' and 'b' are the same block object; make a second one", {"a": COUNT, "b": COUNT}, []),
    ("a wire goes from an output to an input, here input to output", BOTH, [(GAIN.u, COUNT.n)]),
    ("a wire goes from an output to an input, here output to output", BOTH, [(GAIN.y, COUNT.n)]),
    *((NO_PAIR, BOTH, [wire]) for wire in ("count.n", (COUNT.n,), (Count.n, GAIN.u), [COUNT.n, GAIN.u], COUNT.n)),
    ("a loop needs at least one block", {}, []),
    ("block 'count' is a type, expected a Block", {"count": Count}, []),
    ("block name 'my count': expected a Python identifier", {"my count": COUNT}, []),
    (
        "algebraic loop: b.u -> b.y -> a.u -> a.y -> b.u; make one of these inputs direct=False",
        {"a": GAIN, "b": SECOND},
        [(GAIN.y, SECOND.u), (SECOND.y, GAIN.u)],
    ),
]


@pytest.mark.parametrize(("message", "blocks", "wires"), MISTAKES)
def test_a_mistake_is_named(message: str, blocks: Any, wires: Any) -> None:
    with pytest.raises(WiringError, match=re.escape(message)):
        Loop(blocks=blocks, wires=wires)


def test_an_unknown_port_is_answered_with_the_nearest_name() -> None:
    with pytest.raises(
        AttributeError, match=r"Integrator has no port or parameter 'aplied' \(did you mean 'applied'\?"
    ):
        _ = DOE.aplied
    with pytest.raises(AttributeError, match=r"; inputs: none; outputs: n$"):
        _ = COUNT.qqq


def test_sample_times_have_to_divide() -> None:
    two = {"fast": Count(dt=0.02), "slow": Count(dt=0.05)}
    with pytest.raises(WiringError, match=r"sample time of slow is 0.05 s, not a whole multiple of the base step 0.02"):
        Loop(blocks=two, wires=[])
    for bad in (0.0, -0.01, float("nan"), float("inf")):
        with pytest.raises(WiringError, match="expected a finite number > 0"):
            Loop(blocks={"count": COUNT}, wires=[], dt=bad)
    assert Loop(blocks=two, wires=[], dt=0.01).every == (2, 5)
