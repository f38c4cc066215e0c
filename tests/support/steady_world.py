"""A world in which nothing is left to chance."""

from dataclasses import dataclass

from steerkit.diagram.block import Block
from steerkit.paths.path import Path
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class SteadyWorld(Scenario):
    """Driven at 6 m/s."""

    def blocks(self, path: Path, s: float = 0.0, seed: int = 0) -> dict[str, Block | None]:
        return super().blocks(path, s, seed) | {"driver": ConstantSpeed(speed=6.0)}
