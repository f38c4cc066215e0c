"""How a learner learns: settings by name, `paper` as published and `default`, the best we know."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from steerkit.block import Block, require
from steerkit.doe import Direct, Integrator, LowPass
from steerkit.learning.costs import BandCost, Cost, IdoeCost, TanhCost
from steerkit.learning.nfq import FitSetting
from steerkit.learning.state import StateDescription
from steerkit.units import radians_of

ELEMENTS = {"integrator": Integrator, "low-pass": LowPass, "direct": Direct}


@dataclass(frozen=True, kw_only=True)
class Setting:
    """Actions, dynamic output element, cost, fit and rhythm of a learner."""

    name: str = "default"
    """What to call it in tables."""
    actions_deg: tuple[float, ...] = (-60.0, -10.0, 0.0, 10.0, 60.0)
    """The actions [deg]: steps a sample for the integrator, angles for `direct` and `low-pass`."""
    doe: str = "integrator"
    """Dynamic output element: `integrator`, `low-pass` or `direct`."""
    cost: Cost = field(default_factory=TanhCost)
    """Cost of a transition: see `steerkit.learning.costs`."""
    fit: FitSetting = field(default_factory=lambda: FitSetting(mirror=True, n_step=3, nets=3, iterations=2))
    """How the Q-net is fitted: see `steerkit.learning.nfq`."""
    retrain_every_m: float = 60.0
    """Distance driven by the learner after which it is trained anew while it drives on [m]; 0: at failures only."""
    fit_seconds: float = 1.0
    """Driving time charged for one training [s]: its net can steer that much later."""

    def __post_init__(self) -> None:
        require(len(self.actions_deg) >= 2, "Setting", f"actions_deg = {self.actions_deg}, expected at least two")
        require(self.doe in ELEMENTS, "Setting", f"doe '{self.doe}'; valid: {', '.join(ELEMENTS)}")
        require(self.retrain_every_m >= 0.0, "Setting", f"retrain_every_m = {self.retrain_every_m} m, expected >= 0")
        require(self.fit_seconds >= 0.0, "Setting", f"fit_seconds = {self.fit_seconds} s, expected >= 0")

    @property
    def actions(self) -> tuple[float, ...]:
        """The actions [rad]."""
        return tuple(radians_of(a) for a in self.actions_deg)

    def element(self) -> Block:
        """The dynamic output element."""
        return ELEMENTS[self.doe]()

    def description(self) -> StateDescription:
        """What the net sees, and in which ranges."""
        return StateDescription(action_scale=max(abs(a) for a in self.actions))


DEFAULT = Setting()
PAPER = Setting(
    name="paper",
    cost=IdoeCost(),
    fit=FitSetting(),
    retrain_every_m=0.0,
    fit_seconds=0.5,  # the cost measured here; the machine of 2007 needed 30 s
)
BANG_BANG = replace(  # the 800 m course needs up to 430 degrees in motion: 360 cannot drive it, whatever is learned
    DEFAULT, name="bang-bang", actions_deg=(-520.0, 520.0), doe="direct", cost=TanhCost(action_cost=0.0)
)
PAPER_BANG_BANG = replace(PAPER, name="paper-bang-bang", actions_deg=(-360.0, 360.0), doe="direct", cost=BandCost())
PAPER_WARM = replace(PAPER, name="paper-warm", fit=replace(PAPER.fit, init="warm"))

SETTINGS = {s.name: s for s in (DEFAULT, PAPER, PAPER_WARM, BANG_BANG, PAPER_BANG_BANG)}


def setting(name: str) -> Setting:
    """The setting of that name; raises ValueError with the valid names."""
    if name not in SETTINGS:
        raise ValueError(f"setting '{name}' is not known; valid: {', '.join(SETTINGS)}")
    return SETTINGS[name]
