"""A world in which nothing is left to chance."""

from __future__ import annotations

from dataclasses import dataclass

from steerkit.diagram.block import Block
from steerkit.plants.speed_driver import ConstantSpeed
from steerkit.scenario import Scenario


@dataclass(frozen=True, kw_only=True)
class SteadyWorld(Scenario):
    """A human of 6 m/s."""

    def driver(self, seed: int) -> Block:
        return ConstantSpeed(speed=6.0)
