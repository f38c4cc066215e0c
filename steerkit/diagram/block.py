"""Blocks: small immutable objects with typed ports and two pure functions over explicit state; and wrappers of one."""

import dataclasses
import functools
from collections import namedtuple
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self, overload

import numpy as np

from steerkit._support.errors import check_numbers, nearest, number, require
from steerkit.diagram.units import UNITS
from steerkit.task import DT

_CHANGEABLE = (list, dict, set, bytearray, np.ndarray)

State = tuple[Any, ...]
"""A block's state: a flat tuple (often a NamedTuple) of scalars: floats, `(N,)` arrays or symbols."""


class _Spec:
    """What input and output ports have in common."""

    def __init__(self, unit: str, *, direct: Any, size: int | str | None = None):
        if unit not in UNITS:
            valid = ", ".join(sorted(UNITS))
            raise ValueError(f"port: unit {unit!r} is not known; SI and radians only, one of {valid}")
        self.unit, self.direct, self.size, self.name = unit, direct, size, ""

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, block: "Port | None", owner: type) -> Self: ...
    @overload
    def __get__(self, block: "Block", owner: type) -> "Port": ...
    def __get__(self, block: "Block | Port | None", owner: type) -> "Self | Port":
        return Port(block, self) if isinstance(block, Block) else self  # type: ignore[arg-type]


class In(_Spec):
    """An input port: a class attribute of a block.

    unit: one of `steerkit.diagram.units.UNITS`. direct: does `output` see it? `update` always does. size: None for a
    scalar, else the number of entries, or the name of the block's field that holds it.
    """

    kind = "input"
    direct: bool

    def __init__(self, unit: str, *, direct: bool = True, size: int | str | None = None):
        super().__init__(unit, direct=direct, size=size)


class Out(_Spec):
    """An output port: a class attribute of a block.

    unit: as for `In`. direct: the inputs that it depends on in the same sample, as a tuple of the class's `In`
    ports; None (the safe default) means all of the block's direct inputs, `()` means state only.
    """

    kind = "output"
    direct: tuple[In, ...] | None

    def __init__(self, unit: str, *, direct: tuple[In, ...] | None = None, size: int | str | None = None):
        super().__init__(unit, direct=direct, size=size)


class Port(NamedTuple):
    """A port of one block object: what a wire joins, and a key of a `Log`."""

    block: "Block"
    spec: In | Out

    @property
    def size(self) -> int | None:
        """Entries of a vector port, None for a scalar."""
        size = self.spec.size
        return getattr(self.block, size) if isinstance(size, str) else size

    def __repr__(self) -> str:
        return f"{type(self.block).__name__}.{self.spec.name} [{self.spec.unit}]"


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class Block:
    """Abstract base of every part of a loop: parameters in fields, ports as class attributes, state outside.

    A subclass is a frozen keyword-only dataclass with `In` and `Out` attributes, a field `dt` [s] (sample time) and

    * `init(batch)`: the state at t = 0: a flat tuple of scalars, each a float, or an `(N,)` array for `batch=(N,)`;
    * `output(t, x, u)`: the outputs `y` at time t [s]; `u` holds the direct inputs only;
    * `update(t, x, u, y)`: the state one sample time later; `u` holds all inputs;
    * `settle(t, x, u)` (optional): called once, before the first sample, with the first direct inputs; returns the
      state to start from (a path tracker finds its place here);
    * `on_standby(x, settled)` (optional): called after each sample in which another controller or the driver steered
      a real car; returns the state to continue from, `settled` with what of `x` is to be kept (estimates of the car).

    `u` and `y` are named tuples: `u.rate`, `self.Y(delta_sw=...)`. All of them are pure: equal arguments give equal
    results, the object keeps nothing. A parameter declared as `gain: float = number(2.0, "1/s", low=0.0)` has its range
    checked when the block is made (ValueError). Equations use `steerkit.diagram.maths`, so that they serve floats,
    batches and CasADi symbols. A block whose `pure` is False (a real car) can be simulated, not traced or batched.

    Raises TypeError for a class that could remember: with an `__init__` of its own or a list, dictionary, set or array
    as a class attribute, when the class is made; without `@dataclass(frozen=True, ...)`, when its first object is.
    """

    dt: float = number(DT, "s", above=0.0, high=3600.0)

    inputs: ClassVar[tuple[In, ...]] = ()
    outputs: ClassVar[tuple[Out, ...]] = ()
    pure: ClassVar[bool] = True
    U: ClassVar[type[Any]]
    """Named tuple of all inputs, in the order declared."""
    D: ClassVar[type[Any]]
    """Named tuple of the direct inputs."""
    Y: ClassVar[type[Any]]
    """Named tuple of the outputs."""

    def __new__(cls, *args: Any, **kwargs: Any) -> Self:
        parameters = vars(cls).get("__dataclass_params__")  # the decorator comes after __init_subclass__
        if parameters is None or not parameters.frozen:
            raise TypeError(f"{cls.__name__} is no frozen dataclass, and could keep state in itself; {_DECORATE}")
        valid = [field.name for field in dataclasses.fields(cls) if field.init]
        if args:
            what = f"{len(args)} argument{'s' * (len(args) > 1)} without a name, expected parameters by name"
            raise TypeError(f"{cls.__name__}: {what}: {', '.join(valid)}")
        for name in kwargs:
            if name not in valid:
                what = f"has no parameter '{name}'{nearest(name, valid)}; parameters: {', '.join(valid)}"
                raise TypeError(f"{cls.__name__} {what}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        check_numbers(self, type(self).__name__)

    def __init_subclass__(cls, **kwargs: Any) -> None:
        super().__init_subclass__(**kwargs)
        _check_forgetful(cls)
        if "__repr__" not in vars(cls):
            cls.__repr__ = Block.__repr__  # type: ignore[method-assign]  # the decorator leaves it alone then
        ports = {name: port for base in reversed(cls.__mro__) for name, port in vars(base).items()}
        cls.inputs = tuple(p for p in ports.values() if isinstance(p, In))
        cls.outputs = tuple(p for p in ports.values() if isinstance(p, Out))
        for name, kind in _tuples(cls.inputs, cls.outputs).items():
            setattr(cls, name, kind)
        for port in cls.outputs:
            _check_direct(cls, port)

    def init(self, batch: tuple[int, ...] = ()) -> State:
        """The state at t = 0."""
        return ()

    def settle(self, t: float, x: Any, u: Any) -> State:
        """The state to start from, given the first direct inputs."""
        return x

    def on_standby(self, x: Any, settled: Any) -> State:
        """The state while another controller or the driver steers: `settled` anew, with what of `x` is to be kept."""
        return settled

    def output(self, t: Any, x: Any, u: Any) -> Any:
        """The outputs at time t."""
        raise NotImplementedError(f"{type(self).__name__}.output is not defined")

    def update(self, t: Any, x: Any, u: Any, y: Any) -> State:
        """The state one sample time after t."""
        return x

    @property
    def update_reads_inputs(self) -> bool:
        """Whether `update` reads any input: a wrapper that has to predict them need not where it does not."""
        return True

    def __repr__(self) -> str:
        """Its parameters in a line or two, however many numbers they hold."""
        values = (
            f"{field.name}={_brief(getattr(self, field.name))}" for field in dataclasses.fields(self) if field.repr
        )
        return f"{type(self).__name__}({', '.join(values)})"

    if not TYPE_CHECKING:  # a checker should see unknown names as errors

        def __getattr__(self, name: str) -> Any:
            if name.startswith("__"):
                raise AttributeError(name)
            ports = [p.name for p in (*self.inputs, *self.outputs)]
            fields = [f.name for f in dataclasses.fields(self)]
            what = f"{type(self).__name__} has no port or parameter '{name}'{nearest(name, ports + fields)}"
            inputs, outputs = (", ".join(p.name for p in of) or "none" for of in (self.inputs, self.outputs))
            raise AttributeError(f"{what}; inputs: {inputs}; outputs: {outputs}")


_SHOWN = 8
"""Entries of a tuple that are printed."""


def _brief(value: Any, *, inside: bool = False) -> str:
    """A parameter as it is printed: arrays by their shape, long tuples by their first entries."""
    if isinstance(value, np.ndarray) and value.size > _SHOWN:
        return f"<array {value.shape}>"
    if type(value) is not tuple or not value:
        return repr(value)
    if inside and not all(isinstance(entry, float | int | str) for entry in value):
        return f"<{len(value)} entries>"
    shown = [_brief(entry, inside=True) for entry in value[:_SHOWN]]
    more = [f"... {len(value)} in all"] if len(value) > _SHOWN else [""] * (len(value) == 1)
    return f"({', '.join([*shown, *more]).strip()})"


_DECORATE = "write @dataclass(frozen=True, eq=False, kw_only=True) above the class; what changes goes into its state"


def _check_forgetful(cls: type) -> None:
    """Raise TypeError for a class whose objects would remember, as far as it can be known before it is decorated."""
    if "__init__" in vars(cls):
        what = "a block's parameters are fields, such as `gain: float = 2.0`, and checked in __post_init__"
        raise TypeError(f"{cls.__name__}.__init__: {what}; {_DECORATE}")
    for name, value in vars(cls).items():
        if isinstance(value, _CHANGEABLE) and not name.startswith("__"):
            what = f"is a {type(value).__name__} of the class, which all its objects would share"
            expected = f"expected a tuple, or a field: `{name}: tuple[float, ...] = ()`"
            raise TypeError(f"{cls.__name__}.{name} {what}; {expected}")


def _check_direct(cls: type[Block], port: Out) -> None:
    """Raise TypeError where `direct` holds something else than the class's own input ports."""
    own = [spec.name for spec in cls.inputs]
    given: Any = port.direct
    if given is None or (isinstance(given, tuple) and all(isinstance(spec, In) and spec.name in own for spec in given)):
        return
    expected = f"expected a tuple of the class's own In ports, not their names: direct=({own[0] + ',' if own else ''})"
    inputs = f"(inputs: {', '.join(own) or 'none'})"
    raise TypeError(f"{cls.__name__}.{port.name}: direct = {given!r}, {expected} {inputs}")


def take_ports(wrapper: Block, block: Block) -> None:
    """Give one wrapper object the ports of the block inside it, its sample time, and whether it is pure.

    Inputs that the wrapper's class declares come after those of the block.
    """
    for name in ("dt", "pure"):
        object.__setattr__(wrapper, name, getattr(block, name))
    for spec in (*block.inputs, *block.outputs):
        if isinstance(spec.size, str):
            object.__setattr__(wrapper, spec.size, getattr(block, spec.size))
    set_ports(wrapper, (*block.inputs, *type(wrapper).inputs), block.outputs)


def without_port(block: Block, name: str) -> None:
    """Take an input from one block object, whose parameters leave nothing for it to do."""
    set_ports(block, tuple(port for port in block.inputs if port.name != name), block.outputs)


def set_ports(block: Block, inputs: tuple[In, ...], outputs: tuple[Out, ...]) -> None:
    """Give one block object ports of its own."""
    values: dict[str, Any] = {"inputs": inputs, "outputs": outputs, **_tuples(inputs, outputs)}
    ports: tuple[In | Out, ...] = (*inputs, *outputs)
    values |= {port.name: Port(block, port) for port in ports}
    for name, value in values.items():
        object.__setattr__(block, name, value)


def _tuples(inputs: Sequence[In], outputs: Sequence[Out]) -> dict[str, Any]:
    """The named tuples of all inputs, of the direct ones and of the outputs."""
    kinds: dict[str, Sequence[In | Out]] = {"U": inputs, "D": [p for p in inputs if p.direct], "Y": outputs}
    return {name: namedtuple(name, [p.name for p in ports]) for name, ports in kinds.items()}


def entries_of(block: Block) -> tuple[Callable[[Sequence[Any]], State], int]:
    """What makes a block's state from its entries, and how many these are: for those that keep others' among theirs."""
    like = block.init()
    return functools.partial(state_like, like), len(like)


def state_like(like: Any, values: Iterable[Any]) -> Any:
    """A state (or outputs) of the kind of another one, of these entries."""
    return type(like)(*values) if hasattr(like, "_fields") else tuple(values)


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
