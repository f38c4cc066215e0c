"""The base of blocks around another block, which they change in part and leave as it is in all else."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from steerkit._support.errors import require
from steerkit.diagram.block import Block, In, Out, State, entries_of, take_ports


@dataclass(frozen=True, eq=False, kw_only=True)
class Wrapper(Block):
    """Abstract base of a block around another one, `block`, with its ports, units, sample time and purity.

    A subclass defines `output`, by `inner_output`; the other methods ask `block`, unless it overrides them. State: that
    of `block`, and behind it the entries that a subclass's `init` adds: `inner(x)` and `own(x)`. Inputs that the
    subclass declares come after those of `block`; then it says in `seen` what `block` sees.
    Raises ValueError for a block without the ports that a subclass names in `needs` and `changes`.
    """

    needs: ClassVar[tuple[str, ...]] = ()
    """Inputs that `block` has to have."""
    changes: ClassVar[tuple[str, ...]] = ()
    """Outputs that it has to have."""

    block: Block
    """The block inside."""

    def __post_init__(self) -> None:
        super().__post_init__()
        require_ports(type(self).__name__, self.block, inputs=self.needs, outputs=self.changes)
        take_ports(self, self.block)

    @cached_property
    def _entries(self) -> Any:
        return entries_of(self.block)

    def inner(self, x: State) -> State:
        """The state of `block`."""
        make, count = self._entries
        return make(x[:count]) if len(x) > count else x

    def own(self, x: State) -> State:
        """The entries of the state that are not those of `block`."""
        return x[self._entries[1] :]

    def seen(self, u: Any) -> Any:
        """What `block` sees of the inputs."""
        return u

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return self.block.init(batch)

    def settle(self, t: float, x: State, u: Any) -> State:
        return self._with_own(self.block.settle(t, self.inner(x), self.seen(u)), x)

    def on_standby(self, x: State, settled: State) -> State:
        return self._with_own(self.block.on_standby(self.inner(x), self.inner(settled)), settled)

    def inner_output(self, t: Any, x: State, u: Any) -> Any:
        """The outputs of `block`."""
        return self.block.output(t, self.inner(x), self.seen(u))

    def update(self, t: Any, x: State, u: Any, y: Any) -> State:
        return self._with_own(self.block.update(t, self.inner(x), self.seen(u), y), x)

    def _with_own(self, inner: State, x: State) -> State:
        own = self.own(x)
        return (*inner, *own) if own else inner


def require_ports(where: str, block: Block, *, inputs: Sequence[str] = (), outputs: Sequence[str] = ()) -> None:
    """Raise ValueError, in the name of `where`, for a block that lacks one of these ports."""
    kinds: tuple[tuple[str, Sequence[In | Out], Sequence[str]], ...]
    kinds = (("outputs", block.outputs, outputs), ("inputs", block.inputs, inputs))
    for kind, ports, wanted in kinds:
        have = [port.name for port in ports]
        what = f"{type(block).__name__} with {kind} {', '.join(have) or 'none'}"
        require(set(wanted) <= set(have), where, f"{what}; expected among them {', '.join(wanted)}")
