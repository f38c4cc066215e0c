"""Every mistake in the wiring is told when the loop is built."""

import re
from itertools import pairwise
from typing import Any

import pytest

from steerkit._support.errors import WiringError
from steerkit.diagram.loop import Loop
from steerkit.doe import Integrator
from tests.support.parts import Angle, Count, Gain, Pair, Sum


def refused(message: str, **loop: Any) -> None:
    with pytest.raises(WiringError, match=re.escape(message)):
        Loop(**loop)


def test_sizes_differ() -> None:
    count, pair, gain = Count(), Pair(), Gain()
    refused(
        "wire pair.both [m] -> gain.u [m]: sizes differ (2 and scalar)",
        blocks={"count": count, "pair": pair, "gain": gain},
        wires=[(count.n, pair.u), (pair.both, gain.u)],
    )


def test_an_input_is_not_driven_and_the_candidates_are_named() -> None:
    count, gain, angle = Count(), Gain(), Angle()
    refused(
        "gain.u [m] is not driven; outputs with that unit: count.n, gain.y",
        blocks={"count": count, "gain": gain, "angle": angle},
        wires=[(count.n, angle.u)],
    )
    refused(
        "doe.action [rad] is not driven; outputs with that unit: doe.delta_sw, doe.state",
        blocks={"doe": Integrator()},
        wires=[],
    )
    refused("gain.u [m] is not driven; outputs with that unit: gain.y", blocks={"gain": Gain()}, wires=[])


def test_an_input_has_two_sources() -> None:
    count, other, gain = Count(), Count(), Gain()
    refused(
        "gain.u [m] has two sources: count.n [m] and other.n [m]",
        blocks={"count": count, "other": other, "gain": gain},
        wires=[(count.n, gain.u), (other.n, gain.u)],
    )


def test_an_unknown_port_is_answered_with_the_nearest_name() -> None:
    with pytest.raises(
        AttributeError, match=r"Integrator has no port or parameter 'aplied' \(did you mean 'applied'\?"
    ):
        _ = Integrator().aplied
    with pytest.raises(AttributeError, match=r"; inputs: none; outputs: n$"):
        _ = Count().qqq


def test_a_block_is_not_in_the_loop() -> None:
    count, gain, stranger = Count(), Gain(), Count()
    refused(
        "wire Count.n [m] -> Gain.u [m]: Count is not in the loop; blocks: count, gain",
        blocks={"count": count, "gain": gain},
        wires=[(stranger.n, gain.u)],
    )


def test_the_same_block_twice() -> None:
    count = Count()
    refused("'a' and 'b' are the same block object; make a second one", blocks={"a": count, "b": count}, wires=[])


def test_a_wire_runs_the_wrong_way_or_is_no_wire() -> None:
    count, gain = Count(), Gain()
    both: dict[str, Any] = {"blocks": {"count": count, "gain": gain}}
    refused("a wire goes from an output to an input, here input to output", wires=[(gain.u, count.n)], **both)
    refused("a wire goes from an output to an input, here output to output", wires=[(gain.y, count.n)], **both)
    for nonsense in ("count.n", (count.n,), (Count.n, gain.u), [count.n, gain.u], count.n):
        refused("expected a pair of ports such as (car.v, stanley.v)", wires=[nonsense], **both)


def test_blocks_are_blocks_with_names() -> None:
    refused("a loop needs at least one block", blocks={}, wires=[])
    refused("block 'count' is a type, expected a Block", blocks={"count": Count}, wires=[])
    refused("block name 'my count': expected a Python identifier", blocks={"my count": Count()}, wires=[])


def test_an_algebraic_loop_is_printed() -> None:
    a, b = Gain(), Gain()
    with pytest.raises(WiringError, match="algebraic loop: ") as caught:
        Loop(blocks={"a": a, "b": b}, wires=[(a.y, b.u), (b.y, a.u)])
    path = str(caught.value).removeprefix("algebraic loop: ").split(";")[0].split(" -> ")
    assert path[0] == path[-1]
    ring = ["a.y", "a.u", "b.y", "b.u"]
    assert sorted(path[1:]) == sorted(ring)
    steps = set(pairwise(path))
    assert steps in ({*zip(ring, ring[1:] + ring[:1])}, {*zip(ring[1:] + ring[:1], ring)})
    assert "direct=False" in str(caught.value)


def test_a_block_that_feeds_itself() -> None:
    gain, total = Gain(), Sum()
    refused("algebraic loop: ", blocks={"gain": gain}, wires=[(gain.y, gain.u)])
    Loop(blocks={"total": total}, wires=[(total.total, total.u)])


def test_sample_times_have_to_divide() -> None:
    with pytest.raises(WiringError, match=r"sample time of slow is 0.05 s, not a whole multiple of the base step 0.02"):
        Loop(blocks={"fast": Count(dt=0.02), "slow": Count(dt=0.05)}, wires=[])
    for bad in (0.0, -0.01, float("nan"), float("inf")):
        refused("expected a finite number > 0", blocks={"count": Count()}, wires=[], dt=bad)
    assert Loop(blocks={"fast": Count(dt=0.02), "slow": Count(dt=0.05)}, wires=[], dt=0.01).every == (2, 5)
