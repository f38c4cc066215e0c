"""Who is compared: analytic controllers, learned ones and outside peers, by name."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

from steerkit._support.errors import known
from steerkit._support.plugins import fingerprint, is_outside
from steerkit.diagram.block import Block
from steerkit.plants.single_track import LinearSingleTrack
from steerkit.scenario import Scenario, catalogue
from steerkit.scenario.catalogue import OWN, make_controller

Make = Callable[[Scenario], Block]
ORACLE = "-oracle"
"""Suffix of a controller that knows the true parameters, whatever the scenario lets controllers believe."""
WRONG, TOO_LONG = "-told-wrong", 1.5
"""Suffix of one that is told a dead time so many times too long, and all else truly."""
TELLABLE = ("stanley-delay", "lqr", "mpc")
"""Analytic controllers that make use of all that the truth tells."""


@dataclass(frozen=True, kw_only=True)
class Controller:
    """One row of the table of controllers."""

    name: str
    """What it is called in results."""
    kind: str
    """`analytic`, `learned`, `peer`, or `own`: a user's, by its file or module."""
    about: str
    """One line for the report."""
    make: Make | None = None
    """Makes the block from what a scenario tells; None for one that is learned."""
    setting: str = ""
    """How it learns: a name of `steerkit.learning.settings` or `peers.SETTINGS`; empty for one that does not."""
    training: str = "clean"
    """Where it learns: a name of `trainings.TRAININGS`."""
    oracle: bool = False
    """It knows the true parameters of car and steering; else what the scenario lets controllers believe."""
    wrong: float = 1.0
    """What it is told of the dead time over the truth, if not 1 [1]."""
    needs: str = ""
    """Package that it cannot do without."""

    @property
    def learns(self) -> bool:
        """Does it drive a net that a training of its own made?"""
        return bool(self.setting)

    @property
    def missing(self) -> str:
        """What has to be installed before it can drive, as a sentence; empty if nothing."""
        if not self.needs or find_spec(self.needs) is not None:
            return ""
        name = self.needs.replace("_", "-")
        return f"{name} is not installed: pip install 'steerkit-control[peers]'"

    def as_believed(self, scenario: Scenario) -> Scenario:
        """The scenario with what this controller believes of it."""
        if not self.oracle and self.wrong == 1.0:
            return scenario
        truth = scenario.with_(knowledge={"oracle": self.oracle, "delay": None, "lag": None})
        late = self.wrong * truth.believed_dead_time
        return truth if self.oracle else truth.with_(knowledge={"delay": round(min(late, 2.0), 3)})


def _catalogued(name: str) -> Make:
    """What makes the library's controller of that name for a scenario."""
    return lambda scenario: make_controller(name, scenario.design_model())


def _do_mpc(scenario: Scenario) -> Block:
    from benchmarks.peers.agents import DoMpc

    car = scenario.nominal
    return DoMpc(
        matrices=LinearSingleTrack(vehicle=car).matrices,
        steer_ratio=car.steer_ratio,
        reference=float(car.l_f),
        lag=scenario.design_model().lag,
    )


def _learned(name: str, about: str, setting: str = "default", training: str = "clean") -> Controller:
    return Controller(name=name, kind="learned", about=about, setting=setting, training=training)


def _agent(name: str, about: str) -> Controller:
    """An agent of Stable-Baselines3."""
    return Controller(name=name, kind="peer", about=about, setting=name, training="agent", needs="stable_baselines3")


_TOLD: tuple[tuple[str, str, dict[str, Any]], ...] = (
    (ORACLE, "given the true parameters of car and steering", {"oracle": True}),
    (WRONG, f"told {TOO_LONG:g} times the true dead time", {"wrong": TOO_LONG}),
)
"""Suffixes, and what such a controller knows."""
_TABLE = (
    *(
        Controller(name=name, kind="analytic", about=recipe.about, make=_catalogued(name))
        for name, recipe in catalogue.CONTROLLERS.items()
    ),
    *(
        Controller(name=f"{name}{suffix}", kind="analytic", about=f"{name}, {knows}", make=_catalogued(name), **told)
        for suffix, knows, told in _TOLD
        for name in TELLABLE
    ),
    _learned("nfq-idoe", "NFQ, integrating output element, our best setting"),
    _learned("nfq-low-pass", "NFQ, low-pass output element", "low-pass"),
    _learned("nfq-bang-bang", "NFQ, bang-bang, +-520 degrees", "bang-bang"),
    _learned("nfq-paper-idoe", "NFQ as published, integrating output element", "paper", "published"),
    _learned("nfq-paper-bang-bang", "NFQ as published, bang-bang, +-360 degrees", "paper-bang-bang", "published"),
    _learned("nfq-idoe-quick", "nfq-idoe after 3 minutes of driving", training="quick"),
    _learned("nfq-bang-bang-quick", "nfq-bang-bang after 3 minutes of driving", "bang-bang", "quick"),
    _learned("nfq-idoe-genesis", "nfq-idoe, trained on the recorded lap", training="genesis"),
    _learned("nfq-idoe-linear", "nfq-idoe, trained on the linear car", training="linear"),
    _learned("nfq-idoe-hard", "nfq-idoe, trained with noise, latency and more lag", training="hard"),
    *(
        _learned(
            f"nfq-same-car-{minutes}",
            f"nfq-idoe, trained {minutes} min on that very car and course, without prior knowledge of it",
            training=f"same-car-{minutes}",
        )
        for minutes in (1, 5)
    ),
    _learned("nfq-paper-120", "NFQ as published, integrating, episodes of 200 m at most", "paper", "episodes-120"),
    _learned("nfq-idoe-offline", "nfq-idoe: 2 minutes of driving, then trained offline", training="offline"),
    _agent("sb3-dqn", "DQN of Stable-Baselines3, 30 minutes of driving"),
    _agent("sb3-sac", "SAC of Stable-Baselines3, 30 minutes of driving"),
    Controller(
        name="do-mpc",
        kind="peer",
        about="nonlinear MPC of do-mpc (IPOPT), which knows no dead time",
        make=_do_mpc,
        needs="do_mpc",
    ),
)

CONTROLLERS: Mapping[str, Controller] = {c.name: c for c in _TABLE}
"""All controllers by name, in the order in which reports show them."""


def controller(name: str) -> Controller:
    """The controller of that name, or a user's own, such as `my_file.py:make` (`steerkit.scenario.catalogue.OWN`).

    Raises ValueError with the nearest and the valid names, and for a file or module that is not there.
    """
    if is_outside(name):
        about = f"{name}, SHA-256 {fingerprint(name, 'controller')}"
        return Controller(name=name, kind="own", about=about, make=_catalogued(name))
    return CONTROLLERS[known(name, CONTROLLERS, "controller", also=OWN)]
