"""How a learner learns: settings by name, `paper` as published and `default`, the best we know."""

import json
import math
from collections.abc import Iterable
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cached_property
from typing import Any

from steerkit._support.errors import check_numbers, known, number, require
from steerkit.controllers.policy import StateDescription
from steerkit.diagram.units import radians_of
from steerkit.doe import OutputElement
from steerkit.learning.costs import BandCost, Cost, IdoeCost, SmoothCost, TanhCost
from steerkit.learning.nfq.iterate import FitSetting, Problem
from steerkit.scenario.catalogue import DesignModel, element_kind, make_element
from steerkit.task import DT, STOP_DEG
from steerkit.vehicles import Vehicle

AFTER_FAILURE = ("recovery", "reset")
GOAL = (0.02,) * 2 + (1.0,) + (0.02,) * 3
"""Half-widths of the hints' region. A last one of 1 would mean that any steering angle may be held at psi_e = 0, which
is wrong where e is measured at the front axle."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Actions, dynamic output element, cost, fit and rhythm of a learner."""

    name: str = "default"
    """What to call it in tables."""
    actions_deg: tuple[float, ...] = (-25.0, -10.0, -3.0, 0.0, 3.0, 10.0, 25.0)
    """The actions [deg]: steps a sample for the integrator, angles for `plain` and `low-pass`."""
    doe: str = "integrator"
    """Output element: `integrator`, `low-pass` or `plain`; or one of your own, `my_file.py:Class`: see
    `steerkit.scenario.catalogue.make_element`."""
    cost: Cost = field(
        default_factory=lambda: TanhCost(goal=0.15, goal_least=0.05, action_cost=0.025, action_unit=radians_of(25.0))
    )
    """Cost of a transition: see `steerkit.learning.costs`."""
    fit: FitSetting = field(
        default_factory=lambda: FitSetting(
            mirror=True,
            symmetric=True,
            hints=0,
            n_step=3,
            nets=4,
            iterations=3,
            imagined=3000,
            horizon=5,
            window=5000,
            dead_time=0.6,
        )
    )
    """How the Q-net is fitted: see `steerkit.learning.nfq.iterate`."""
    continuous: bool = True
    """Take actions between those of the set too (see `NfqPolicy.continuous`)? A calmer wheel at no cost in training."""
    scaled_from: float = 8.0
    """Speed above which the same action turns the wheel the less, the faster the car is [m/s]: see
    `StateDescription.scaled`. Without it (infinity) nets hardly learn above 12 m/s."""
    retrain_every_m: float = number(50.0, "m", low=0.0)
    """Distance driven by the learner after which it is trained anew while it drives on [m]; 0: at failures only."""
    fit_seconds: float = number(2.0, "s", low=0.0)
    """Driving time charged for one training [s]: its net can steer that much later."""
    warm_up_seconds: float = number(4.0, "s", low=0.0)
    """Driving of the recovery controller that the first net is learned from, where a model of the car is learned: time
    in which the wheel turns, or five times as much of any [s]. 0: nets drawn at random steer first, as in 2007, and a
    fast car leaves its path by metres."""
    calm: float = number(0.3, "m/s", above=0.0)
    """|e_dot| below which a new net takes the wheel over from the recovery controller [m/s]: |e| < 0.1 m may be a fast
    crossing, and then it fails at once."""
    after_failure: str = "recovery"
    """`recovery`: the analytic controller steers until the new net takes over. `reset`: the car stops and is put back
    on the path where it failed, in `reset_seconds`; then the recovery controller steers until the net is ready."""
    reset_seconds: float = number(20.0, "s", low=0.0)
    """Driving time charged for a reset [s]."""
    safe: bool = False
    """Is there a `SafetyFilter` between learner and wheel while it learns (never in test drives)? Then it fails within
    the bound: a policy that had to be corrected for `corrected_seconds` is taken from the wheel and trained anew."""
    corrected_seconds: float = number(0.5, "s", above=0.0)
    """Time for which a policy may be corrected until then [s], in one piece or in several."""

    def __post_init__(self) -> None:
        check_numbers(self, "Setting")
        known(self.after_failure, AFTER_FAILURE, "Setting: after_failure")
        require(len(self.actions_deg) >= 2, "Setting", f"actions_deg = {self.actions_deg}, expected at least two")
        no_filter = f"after_failure = {self.after_failure!r} with safe, expected recovery"
        require(not self.safe or self.after_failure == "recovery", "Setting", no_filter)
        expected = "expected an element with a method action_for (see steerkit.doe.OutputElement)"
        not_invertible = f"doe = {self.doe!r} with safe, {expected}"
        require(self._invertible or not self.safe, "Setting", not_invertible)

    @property
    def warms_up(self) -> bool:
        """Does the recovery controller steer first?"""
        return self.models_recovery and self.warm_up_seconds > 0.0

    @cached_property
    def models_recovery(self) -> bool:
        """Does it learn a model of the car, also from what another than the learner steers?"""
        return self.fit.imagined > 0 and self._invertible

    @property
    def _invertible(self) -> bool:
        return element_kind(self.doe).action_for is not OutputElement.action_for

    @property
    def actions(self) -> tuple[float, ...]:
        """The actions [rad]."""
        return tuple(radians_of(a) for a in self.actions_deg)

    @property
    def problem(self) -> Problem:
        """What is learned, and how."""
        return Problem(
            actions=self.actions,
            cost=self.cost,
            fit=self.fit,
            description=self.description(),
            continuous=self.continuous,
        )

    def element(self, vehicle: Vehicle | None = None) -> OutputElement:
        """The dynamic output element, within the stops of `vehicle`'s steering wheel (None: 520 degrees)."""
        return make_element(self.doe, vehicle)

    def suited(self, design_model: DesignModel) -> "Setting":
        """This setting for that car: where torque steers it, no action asks for more than its slew lets happen.

        The largest action turns the wheel by a/x^2 in a sample (`StateDescription.scaled`), and the slew lets it turn
        by steer_ratio L slew dt/v^2 and more: `scaled_from` is at most sqrt(steer_ratio L slew dt/a). The same turn of
        the wheel is a larger action then, and costs no more than it would (`TanhCost.dear_from`).
        """
        if design_model.slew is None or not math.isfinite(self.scaled_from):
            return self
        car = design_model.vehicle
        latest = math.sqrt(car.steer_ratio * car.wheelbase * design_model.slew * DT / max(map(abs, self.actions)))
        if latest >= self.scaled_from:
            return self
        cost = self.cost
        if isinstance(cost, TanhCost):
            cost = replace(cost, dear_from=(cost.dear_from or 1.0) * (self.scaled_from / latest) ** 2)
        return replace(self, scaled_from=latest, cost=cost)

    def recorded(self) -> tuple[str, ...]:
        """The columns of recorded states: what the net sees, and the curvature where a dead time is looked for."""
        names = self.description().names
        return (*names, "kappa") if self.fit.dead_time else names

    def description(self) -> StateDescription:
        """What the net sees, and in which ranges."""
        return StateDescription(action_scale=max(map(abs, self.actions)), goal=GOAL, scaled_from=self.scaled_from)


MODEL_FREE = Setting(
    name="model-free",
    actions_deg=(-60.0, -10.0, 0.0, 10.0, 60.0),
    cost=TanhCost(),
    fit=FitSetting(mirror=True, hints=0, n_step=3, nets=3),
    continuous=False,
    scaled_from=math.inf,
    retrain_every_m=20.0,
    fit_seconds=0.5,
)
"""NFQ on recorded transitions alone, with all that helps it there."""
DEFAULT = Setting()
"""The best known: NFQ on recorded and imagined transitions."""
PAPER = Setting(
    name="paper",
    actions_deg=(-60.0, -10.0, 0.0, 10.0, 60.0),
    cost=IdoeCost(),
    fit=FitSetting(),
    continuous=False,
    scaled_from=math.inf,
    retrain_every_m=0.0,
    fit_seconds=0.5,  # the cost measured here; the machine of 2007 needed 30 s
    calm=math.inf,
)
BANG_BANG = replace(  # the 800 m course needs up to 430 degrees in motion: 360 cannot drive it, whatever is learned
    MODEL_FREE, name="bang-bang", actions_deg=(-STOP_DEG, STOP_DEG), doe="plain", cost=TanhCost(action_cost=0.0)
)
_ANGLES = (10.0, 25.0, 50.0, 80.0, 120.0, 180.0, 260.0, 390.0, STOP_DEG)
LOW_PASS = replace(
    DEFAULT,
    name="low-pass",
    actions_deg=(*(-a for a in reversed(_ANGLES)), 0.0, *_ANGLES),
    doe="low-pass",
    cost=TanhCost(goal=0.15, action_cost=0.0),  # its actions are angles: a price on them would pull the wheel straight
)
SMOOTH = replace(DEFAULT, name="smooth", cost=SmoothCost(cost=TanhCost(goal=0.15, action_cost=0.0)))
"""Jerk and turning of the wheel cost, not the mere taking of an action."""
PAPER_BANG_BANG = replace(PAPER, name="paper-bang-bang", actions_deg=(-360.0, 360.0), doe="plain", cost=BandCost())

SETTINGS = {s.name: s for s in (DEFAULT, PAPER, MODEL_FREE, BANG_BANG, LOW_PASS, SMOOTH, PAPER_BANG_BANG)}


def changed(setting: Setting, changes: Iterable[str]) -> Setting:
    """The setting with some values changed, each written as `name=value` or `fit.name=value`, the value as in JSON.

    `changed(DEFAULT, ["fit.nets=3", "after_failure=reset"])`; `cost.goal=0.1` and deeper names work alike. Raises
    ValueError for a name that is not there, with the valid ones, and for a value that the setting does not take.
    """
    for change in changes:
        name, equals, text = change.partition("=")
        require(equals == "=", "setting", f"'{change}', expected name=value, such as fit.nets=3")
        try:
            value = json.loads(text)
        except ValueError:
            value = text  # a word
        setting = _with(setting, name.split("."), tuple(value) if isinstance(value, list) else value, change)
    return setting


def _with(part: Any, names: list[str], value: Any, change: str) -> Any:
    valid = [f.name for f in fields(part)]
    require(names[0] in valid, "setting", f"'{change}': no '{names[0]}' there; valid: {', '.join(valid)}")
    old = getattr(part, names[0])
    if len(names) > 1:
        require(is_dataclass(old), "setting", f"'{change}': '{names[0]}' has no parts")
        value = _with(old, names[1:], value, change)
    else:
        kind = float if old is None else type(old)  # a number that may be left out
        fits = isinstance(value, kind) or (kind is float and isinstance(value, int))
        expected = kind.__name__ + (", or its parts by their names" if is_dataclass(old) else "")
        require(fits and not is_dataclass(old), "setting", f"'{change}': expected {expected}")
    return replace(part, **{names[0]: value})


def setting(name: str) -> Setting:
    """The setting of that name; raises ValueError with the valid names."""
    return SETTINGS[known(name, SETTINGS, "setting")]
