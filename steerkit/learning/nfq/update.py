"""An update of the Q-function, as a learning run makes it: the dead time first, where it is looked for; then nets."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from steerkit._support.errors import require
from steerkit.controllers.delay_compensator import DelayCompensator
from steerkit.controllers.state_description import StateDescription
from steerkit.learning.costs import Cost
from steerkit.learning.data.transitions import Transitions
from steerkit.learning.nfq.dead_time import process_of
from steerkit.learning.nfq.iterate import FitSetting, Nets, iterate


class Learned(NamedTuple):
    """What an update of the Q-function gives a policy."""

    nets: Nets = ()
    forecast: DelayCompensator | None = None
    """Of a setting with `dead_time`."""


NOTHING = Learned()
"""Before the first update."""


def update(
    transitions: Transitions,
    actions: Sequence[float],
    cost: Cost,
    setting: FitSetting,
    description: StateDescription,
    before: Learned = NOTHING,
    seed: int = 0,
) -> Learned:
    """One update: `iterate`, and before it the search for the dead time, where the setting has it; see there."""
    if not setting.dead_time:
        return Learned(iterate(transitions, actions, cost, setting, description, before.nets, seed))
    require(len(transitions) > 0, "nfq.update", "no transitions, expected at least one")
    process = process_of(transitions, description, setting.dead_time)
    nets = iterate(process.record, actions, cost, setting, description, before.nets, seed, model=process.model)
    return Learned(nets, process.forecast)
