"""What an estimator says of a quantity: a value, how well it is known, and whether it is to be used."""

from typing import Any, NamedTuple

from steerkit.diagram.block import Out
from steerkit.diagram.maths import Scalar

NORMAL_95 = 1.96
"""Standard deviations to either side that hold 95 % of a normal distribution."""


class Estimated(NamedTuple):
    """A quantity as an estimator has it, for whoever acts on it or shows it; read with `estimated`.

    The 95 % interval is value -+ 1.96 deviation (normal). Fields are floats, `(N,)` arrays in a batch, or symbols.
    """

    value: Scalar
    """The best value [the quantity's unit]; the prior's until something was learned."""
    deviation: Scalar
    """Its standard deviation [the same], the prior's until something was learned."""
    valid: Scalar
    """1 where the value is known well enough to act on, else 0 [1]."""

    @property
    def low(self) -> Scalar:
        """Lower end of the 95 % interval."""
        return self.value - NORMAL_95 * self.deviation

    @property
    def high(self) -> Scalar:
        """Upper end of the 95 % interval."""
        return self.value + NORMAL_95 * self.deviation


def estimate_ports(unit: str) -> tuple[Out, Out, Out]:
    """The outputs of an estimate, of state only: its value and its deviation [unit], and whether it is valid [1]."""
    return Out(unit, direct=()), Out(unit, direct=()), Out("1", direct=())


def estimated(y: Any, name: str) -> Estimated:
    """One quantity out of a block's outputs `y`: its ports `name`, `name_deviation` and `name_valid`."""
    return Estimated(getattr(y, name), getattr(y, f"{name}_deviation"), getattr(y, f"{name}_valid"))
