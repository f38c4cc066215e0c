"""Parts of an experiment as a user writes them: a place, a way to learn, a cost, an output element."""

from dataclasses import dataclass
from typing import Any

from steerkit.diagram import maths as m
from steerkit.doe import OutputElement
from steerkit.learning.costs import TanhCost
from steerkit.learning.settings import Setting
from steerkit.paths.courses import circle
from steerkit.paths.path import Path
from steerkit.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class Yard(Scenario):
    """A circle of one's own."""

    radius: float = 25.0

    def path(self) -> Path:
        return circle(self.radius)


@dataclass(frozen=True, kw_only=True)
class Patient(Setting):
    """Trains seldom."""

    patience: float = 2.0


@dataclass(frozen=True, kw_only=True)
class Dear(TanhCost):
    """A cost of one's own."""

    price: float = 3.0


@dataclass(frozen=True, eq=False, kw_only=True)
class Geared(OutputElement):
    """Steps that grow with the angle: delta_sw(t) = sat(z + action (1 + |z|/soft)), z = applied(t - dt)."""

    soft: float = 2.0

    def output(self, t: Any, x: Any, u: Any) -> Any:
        z = x.delta_sw
        return self.Y(m.clip(z + u.action * (1.0 + m.absolute(z) / self.soft), -self.limit, self.limit), z)
