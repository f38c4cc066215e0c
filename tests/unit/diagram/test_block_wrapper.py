"""A wrapper is the block inside, but for what it changes."""

from dataclasses import dataclass
from typing import Any

import pytest

from steerkit.diagram.block import Block, In, Out, Wrapper, require_ports


@dataclass(frozen=True, eq=False, kw_only=True)
class Counts(Block):
    """A block with a port of each kind: it adds up what it sees, and notes what it settled and waited with."""

    given = In("rad")
    ahead = In("1/m", size="points")
    late = In("m", direct=False)
    sum = Out("rad")

    points: int = 2

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (1.0, 0.0)

    def settle(self, t: Any, x: Any, u: Any) -> Any:
        return (x[0] + u.given, x[1])

    def on_standby(self, x: Any, settled: Any) -> Any:
        return (settled[0], x[1] + 100.0)

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.Y(x[0] + u.given + sum(u.ahead))

    def update(self, t: Any, x: Any, u: Any, y: Any) -> Any:
        return (x[0] + 10.0 * u.given + u.late, x[1] + y.sum)


@dataclass(frozen=True, eq=False, kw_only=True)
class Plain(Wrapper):
    """Changes nothing."""

    def output(self, t: Any, x: Any, u: Any) -> Any:
        return self.inner_output(t, x, u)


@dataclass(frozen=True, eq=False, kw_only=True)
class Counted(Plain):
    """Adds an input, which it takes from what the block sees, and an entry of state."""

    more = In("rad")
    needs = ("given",)
    changes = ("sum",)

    def init(self, batch: tuple[int, ...] = ()) -> Any:
        return (*super().init(batch), 7.0)

    def seen(self, u: Any) -> Any:
        ports = self.block.U if "late" in u._fields else self.block.D
        return ports(*u[:-1])._replace(given=u.given + u.more)


def driven(block: Block, **more: float) -> list[Any]:
    seen = block.D(given=2.0, ahead=(3.0, 4.0), **more)
    x = block.settle(0.0, block.init(), seen)
    y = block.output(0.0, x, seen)
    after = block.update(0.0, x, block.U(given=2.0, ahead=(3.0, 4.0), late=5.0, **more), y)
    return [x, y, after, block.on_standby(after, x)]


def test_one_that_changes_nothing_is_the_block() -> None:
    block = Counts(dt=0.1)
    wrapper: Any = Plain(block=block)
    assert driven(wrapper) == driven(block)
    assert (wrapper.dt, wrapper.points, wrapper.ahead.size, wrapper.pure) == (0.1, 2, 2, True)
    assert (wrapper.inputs, wrapper.outputs, wrapper.given.block) == (block.inputs, block.outputs, wrapper)


def test_added_inputs_come_last_and_added_state_behind_the_blocks() -> None:
    wrapper = Counted(block=Counts())
    assert [port.name for port in wrapper.inputs] == ["given", "ahead", "late", "more"]
    assert wrapper.D._fields == ("given", "ahead", "more")
    x, y, after, waited = driven(wrapper, more=0.5)
    assert (x, y.sum, after, waited) == ((3.5, 0.0, 7.0), 13.0, (33.5, 13.0, 7.0), (3.5, 113.0, 7.0))
    assert (wrapper.inner(after), wrapper.own(after)) == ((33.5, 13.0), (7.0,))


def test_a_block_without_what_is_needed_is_refused() -> None:
    @dataclass(frozen=True, eq=False, kw_only=True)
    class Empty(Block):
        """A block without ports."""

    with pytest.raises(ValueError, match="Counted: Empty with outputs none; expected among them sum"):
        Counted(block=Empty())
    with pytest.raises(ValueError, match="here: Counts with inputs given, ahead, late; expected among them e, v"):
        require_ports("here", Counts(), inputs=("e", "v"), outputs=("sum",))
