"""Loops: what they answer, how they settle; ticks, rates and states are exact."""

import re
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import pytest

from steerkit._support.errors import WiringError
from steerkit.controllers.supervisor import ExceptionGuard
from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out
from steerkit.diagram.loop import Loop
from steerkit.diagram.simulation import simulate
from steerkit.doe import Integrator
from tests.support.parts import Count, Delay, Gain, Pair, Sum, Wave, chain

# ---- the first sample ---------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class Picker(Block):
    """Steps towards an angle of 1 rad: needs the DOE's state at once."""

    state = In("rad")
    action = Out("rad")

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(0.5 * (1.0 - u.state))


@pytest.mark.parametrize("order", [("doe", "picker"), ("picker", "doe")])
def test_a_loop_of_blocks_but_not_of_ports_runs(order: tuple[str, str]) -> None:
    """Integrator.state -> policy -> Integrator.action: state does not see action within a sample."""
    doe, picker = Integrator(), Picker()
    blocks = {"doe": doe, "picker": picker}
    wires = [(doe.state, picker.state), (picker.action, doe.action), (doe.delta_sw, doe.applied)]
    log = simulate(Loop(blocks={name: blocks[name] for name in order}, wires=wires), 0.25)
    np.testing.assert_array_equal(log["doe.state"], [0.0, 0.5, 0.75, 0.875, 0.9375])
    np.testing.assert_array_equal(log["picker.action"], [0.5, 0.25, 0.125, 0.0625, 0.03125])


@dataclass(frozen=True, eq=False, kw_only=True)
class Cheat(Delay):
    """Says that it does not see u at once, and reads it."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(u.u)


def test_a_false_direct_declaration_fails_on_the_first_sample() -> None:
    count, cheat = Count(), Cheat()
    loop = Loop(blocks={"count": count, "cheat": cheat}, wires=[(count.n, cheat.u)])
    with pytest.raises(
        WiringError, match=r"cheat\.output \(Cheat\).*: read 'u', which is not one of its direct inputs \(n"
    ):
        loop.init()


@dataclass(frozen=True, eq=False, kw_only=True)
class FalseOut(Block):
    """Says that `state` does not depend on `action`."""

    action = In("rad")
    state = Out("rad", direct=())

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(u.action)


def test_a_false_direct_declaration_of_an_output_fails_where_it_matters() -> None:
    false, picker = FalseOut(), Picker()
    wires = [(false.state, picker.state), (picker.action, false.action)]
    loop = Loop(blocks={"false": false, "picker": picker}, wires=wires)
    with pytest.raises(WiringError, match=r"false.state is declared independent of action, but is NaN without it"):
        loop.init()


def test_entries_are_counted_on_the_first_sample() -> None:
    count, pair = Count(), Pair(entries=3)
    with pytest.raises(WiringError, match=re.escape("pair.both [m] has 2 entries, expected 3")):
        Loop(blocks={"count": count, "pair": pair}, wires=[(count.n, pair.u)]).init()


# ---- ticks --------------------------------------------------------------------------------------------------------


def test_held_outputs_and_no_sample_is_off_by_one() -> None:
    count, slow, total, late = Count(dt=0.1), Gain(dt=0.3), Sum(dt=0.1), Delay(dt=0.3, first=-1.0)
    fast = Delay(dt=0.1, first=-1.0)
    loop = Loop(
        blocks={"total": total, "slow": slow, "late": late, "fast": fast, "count": count},
        wires=[(count.n, slow.u), (slow.y, total.u), (count.n, late.u), (late.y, fast.u)],
    )
    log = simulate(loop, 0.8)
    np.testing.assert_allclose(log.t, 0.1 * np.arange(8), rtol=1e-15)
    assert log["count.n"].tolist() == [0, 1, 2, 3, 4, 5, 6, 7]
    assert log["slow.y"].tolist() == [0, 0, 0, 3, 3, 3, 6, 6]  # taken at its own sample, then held
    assert log["total.total"].tolist() == [0, 0, 0, 0, 3, 6, 9, 15]  # what was held, one sample later
    assert log["late.y"].tolist() == [-1, -1, -1, 0, 0, 0, 3, 3]  # one slow sample late
    assert log["fast.y"].tolist() == [-1, -1, -1, -1, 0, 0, 0, 3]  # and one fast one more


def test_a_finer_base_step_changes_nothing() -> None:
    coarse, fine = simulate(chain(), 1.0), simulate(chain(dt=0.01), 1.0)
    for name in coarse:
        np.testing.assert_array_equal(coarse[name], fine[name][::5])
        np.testing.assert_array_equal(coarse[name], fine[name][4::5])  # held


def test_every_block_has_the_same_t() -> None:
    @dataclass(frozen=True, eq=False, kw_only=True)
    class Clock(Block):
        """t in output and in the update before."""

        now = Out("s", direct=())
        before = Out("s", direct=())

        def init(self, batch: tuple[int, ...] = ()) -> Any:
            return (-1.0,)

        def output(self, t: Any, x: Any, u: Any) -> Any:
            return self.Y(t, x[0])

        def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
            return (t,)

    log = simulate(Loop(blocks={"clock": Clock(dt=0.1), "slow": Clock(dt=0.2)}, wires=[]), 0.5)
    assert log["clock.now"].tolist() == log.t.tolist()
    assert log["clock.before"].tolist() == [-1.0, *log.t[:-1].tolist()]
    assert log["slow.now"].tolist() == [log.t[k] for k in (0, 0, 2, 2, 4)]
    assert log["slow.before"].tolist() == [-1.0, -1.0, 0.0, 0.0, log.t[2]]


@dataclass(frozen=True, eq=False, kw_only=True)
class Rolling(Block):
    """Settles on what pulls it, and shows its state before it knows that pull."""

    pull = In("m")
    place = Out("m", direct=())
    share: float = 1.0

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (m.filled(0.0, batch),)

    def settle(self, t: Any, x: Any, u: Any) -> Any:
        return (self.share * u.pull,)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0])


@dataclass(frozen=True, eq=False, kw_only=True)
class Hill(Block):
    """Pulls by 1 m and a part of the place; remembers the place that it settled on."""

    place = In("m")
    pull = Out("m")

    part: float = 0.0

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (np.zeros(batch) if batch else 0.0,)

    def settle(self, t: Any, x: Any, u: Any) -> Any:
        return (u.place,)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(1.0 + self.part * u.place)


def rolling(part: float) -> Loop:
    ball, hill = Rolling(), Hill(part=part)
    return Loop(blocks={"ball": ball, "hill": hill}, wires=[(ball.place, hill.place), (hill.pull, ball.pull)])


@pytest.mark.parametrize("batch", [None, 3])
def test_blocks_settle_on_outputs_as_they_are_once_settled(batch: int | None) -> None:
    loop = rolling(part=0.0)
    state = loop.init(batch=batch)
    assert np.all(np.array(state.x) == 1.0), "the hill has settled on where the ball was before it rolled"
    assert np.all(np.array(loop.step(state)[1]["hill.pull"]) == 1.0)


def test_settling_without_end_is_an_error() -> None:
    with pytest.raises(WiringError, match=r"ball\.place is needed before its block can settle, and is another one"):
        rolling(part=1.0).init()


# ---- what it answers ------------------------------------------------------------------------------------------------


def test_a_block_and_its_state_can_be_replaced() -> None:
    loop = chain()
    state = simulate(loop, 0.5).state
    assert state is not None
    faster = loop.with_block("count", Count(step=10.0))
    assert simulate(faster, 0.1, state=state)["count.n"].tolist() == [10.0, 20.0]
    moved = loop.with_block_state(state, "count", (100.0,))
    assert moved.x[loop.names.index("count")] == (100.0,)
    assert state.x[loop.names.index("count")] == (10.0,)
    assert simulate(loop, 0.1, state=moved)["count.n"].tolist() == [100.0, 101.0]
    with pytest.raises(KeyError, match=r"no block 'cont' \(did you mean 'count'"):
        loop.with_block("cont", Count())
    with pytest.raises(AttributeError, match="Wave has no port or parameter 'n'"):
        loop.with_block("count", Wave())


# ---- asking -------------------------------------------------------------------------------------------------------


def test_signals_are_found_by_name_and_by_port() -> None:
    loop = chain()
    count, gain = loop.blocks["count"], loop.blocks["gain"]
    assert loop.port_name(gain.y) == "gain.y"
    assert loop.locate("gain.y") == loop.locate(gain.y) == (1, 0)
    assert loop.units["gain.y"] == "m"
    sample = loop.sample(loop.init())
    assert "gain.y" in sample
    assert gain.y in sample
    assert not any(key in sample for key in ("gain.z", "gain", Count().n))
    assert repr(count.n) == "Count.n [m]"
    assert repr(loop) == "Loop(count, gain, total, late; 3 wires; dt = 0.05 s)"
    with pytest.raises(KeyError, match=r"no signal 'gain.z' \(did you mean 'gain.y'"):
        loop.locate("gain.z")
    with pytest.raises(KeyError, match=re.escape("Count.n [m] belongs to a block that is not in this loop")):
        loop.locate(Count().n)


def test_a_loop_says_what_drives_a_block_and_in_which_order_blocks_compute() -> None:
    doe, picker = Integrator(), Picker()
    wires = [(doe.state, picker.state), (picker.action, doe.action), (doe.delta_sw, doe.applied)]
    loop = Loop(blocks={"doe": doe, "picker": picker}, wires=wires)
    assert loop.inputs_of("doe") == {"action": "picker.action", "applied": "doe.delta_sw"}
    assert list(loop.inputs_of("doe")) == [port.name for port in doe.inputs]
    assert loop.inputs_of("picker") == {"state": "doe.state"}
    assert loop.order == ("picker", "doe")  # doe's state is known earlier, its angle is not
    assert Loop(blocks={"count": Count()}, wires=[]).inputs_of("count") == {}
    with pytest.raises(KeyError, match=r"no block 'dow' \(did you mean 'doe'"):
        loop.inputs_of("dow")


def test_a_state_shows_the_outputs_that_it_holds() -> None:
    loop = chain()
    state = loop.init()
    assert dict(loop.sample(state)) == {"count.n": 0.0, "gain.y": 0.0, "total.total": 0.0, "late.y": -1.0}
    assert loop.sample(state).t == 0.0
    for _ in range(3):
        state, sample = loop.step(state)
        assert dict(loop.sample(state)) == dict(sample)
        assert loop.sample(state).t == sample.t


def test_a_block_settles_as_if_a_sample_were_the_first() -> None:
    """Whatever it remembers: `settled` begins with the block's own `init`."""
    loop = rolling(part=0.0)
    state = loop.init()
    assert loop.settled("ball", state.y) == (1.0,)
    assert loop.settled("hill", [(7.0,), (0.0,)]) == (7.0,)
    with pytest.raises(KeyError, match=r"no block 'bell' \(did you mean 'ball'"):
        loop.settled("bell", state.y)


@dataclass(frozen=True, eq=False, kw_only=True)
class Hardware(Count):
    """A block that is not pure."""

    pure: ClassVar[bool] = False


@pytest.mark.parametrize("car", [Hardware(), ExceptionGuard(block=Hardware())])
def test_what_is_not_pure_is_stepped_but_not_batched(car: Block) -> None:
    loop = Loop(blocks={"car": car}, wires=[])
    assert simulate(loop, 0.1)["car.n"].tolist() == [0.0, 1.0]
    with pytest.raises(TypeError, match=r"car \(\w+\) is not pure: it cannot be batched, only stepped"):
        loop.init(batch=2)
