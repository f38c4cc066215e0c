"""A net that is trained to leave the path of a car with a safety filter, by random search over many cars at once.

Part of the study `safety`. The net sees what the filter sees, its own memory included, and commands any angle. Its
fitness is the largest true |e| of a short drive, so that it learns what the filter lets through. Cross-entropy method:
a population is drawn around a mean, the best of it make the next mean and spread. `by_speed` is the table of how far
adversaries get, of any kind.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from steerkit.diagram import maths as m
from steerkit.diagram.block import Block, In, Out, State
from steerkit.scenario import Scenario
from steerkit.task import STOP

Array = NDArray[np.float64]
HIDDEN = 6
"""Units of the hidden layer."""
_SEEN = 7  # e, psi_e, r, wheel, speed, its memory, one
_MEMORY = 0.9
"""Share of its memory that is left a sample later."""
SIZE = HIDDEN * _SEEN + HIDDEN + 1
"""Weights of a net."""


class Remembered(NamedTuple):
    """A slow average of its commands, as a share of the stop."""

    command: Any


@dataclass(frozen=True, eq=False, kw_only=True)
class NetAdversary(Block):
    """A small net at the wheel: delta_sw = stop tanh(a + sum of b_i tanh(w_i . seen)), one car or many."""

    e = In("m")
    psi_e = In("rad")
    r = In("rad/s")
    v = In("m/s")
    delta_sw_meas = In("rad")
    delta_sw = Out("rad")

    weights: tuple[Any, ...]
    """`SIZE` numbers, or arrays (N,) for N cars."""

    def init(self, batch: tuple[int, ...] = ()) -> State:
        return Remembered(m.filled(0.0, batch))

    def output(self, t: Any, x: Any, u: Any) -> Any:
        seen = (4.0 * u.e, 10.0 * u.psi_e, 4.0 * u.r, u.delta_sw_meas, 0.2 * u.v, 2.0 * x.command, 1.0)
        w = self.weights
        total = w[-1]
        for unit in range(HIDDEN):
            first = unit * _SEEN
            drive = sum((w[first + n] * seen[n] for n in range(1, _SEEN)), w[first] * seen[0])
            total = total + w[HIDDEN * _SEEN + unit] * np.tanh(drive)
        return self.Y(STOP * np.tanh(3.0 * total))

    def update(self, t: Any, x: Any, u: Any, y: Any) -> State:
        return Remembered(_MEMORY * x.command + (1.0 - _MEMORY) * y.delta_sw / STOP)


def searched(
    fitness: Callable[[NetAdversary], Array], *, population: int, generations: int, seed: int = 0
) -> tuple[NetAdversary, list[float]]:
    """The net of the largest fitness that was found, and the largest fitness of each generation.

    fitness: of a `NetAdversary` with `population` cars, one number each. Source: Rubinstein 1999.
    """
    rng = np.random.default_rng(seed)
    mean, spread = np.zeros(SIZE), np.ones(SIZE)
    best, most, course = mean, -np.inf, list[float]()
    for _ in range(generations):
        drawn = mean[:, None] + spread[:, None] * rng.normal(size=(SIZE, population))
        drawn[:, 0] = best  # the best so far stays
        values = fitness(NetAdversary(weights=tuple(drawn)))
        order = np.argsort(values)[::-1]
        if values[order[0]] > most:
            best, most = drawn[:, order[0]].copy(), float(values[order[0]])
        elite = drawn[:, order[: max(2, population // 8)]]
        mean, spread = elite.mean(axis=1), elite.std(axis=1) + 0.05
        course.append(float(values[order[0]]))
    return NetAdversary(weights=tuple(map(float, best))), course


def by_speed(
    kinds: Iterable[str],
    speeds: Iterable[float],
    changes: Mapping[str, Any],
    furthest: Callable[[str, Scenario], float],
) -> tuple[float, dict[str, dict[str, float]]]:
    """The largest |e| of all, and that of each kind at each speed, the worse of ratios 10 % off either way [m].

    changes: other fields of the scenario, which is `hard` on the paper's course. furthest: the largest |e| of a drive.
    """
    table: dict[str, dict[str, float]] = {}
    for kind in kinds:
        row = table.setdefault(kind, {})
        for v in speeds:
            cars = [
                Scenario.under("hard", course="paper", driver={"v_min": v, "v_max": v}, **changes).with_(
                    vehicle={"ratio": r}
                )
                for r in (0.9, 1.1)
            ]
            row[f"{v:g} m/s"] = max(furthest(kind, car) for car in cars)
    return max(value for row in table.values() for value in row.values()), table
