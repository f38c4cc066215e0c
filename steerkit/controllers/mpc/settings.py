"""Settings of model predictive steering: whether they can be steered with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from steerkit._support.errors import require
from steerkit.controllers.mpc.fallback import check_ports
from steerkit.controllers.mpc.qp import SOLVERS

if TYPE_CHECKING:
    from steerkit.controllers.mpc.block import PredictiveSteering


def check(block: PredictiveSteering) -> None:
    """Raise ValueError, in the block's name, for the first setting that is out of its range."""
    where = type(block).__name__
    require(callable(block.rhs), where, f"rhs = {block.rhs!r}, expected a function, such as a plant's rhs")
    for name in ("horizon", "soft_first", "soft_every", "patience"):
        value = getattr(block, name)
        require(isinstance(value, int) and value >= 1, where, f"{name} = {value!r}, expected a whole number >= 1")
    require(block.horizon >= 2, where, f"horizon = {block.horizon}, expected at least 2 samples")
    require(block.solver in SOLVERS, where, f"solver = {block.solver!r}; valid: {', '.join(SOLVERS)}")
    units = {
        "dt": "s",
        "steer_ratio": "1",
        "q_e": "1/m^2",
        "q_rate": "s^2",
        "limit": "rad",
        "rate_limit": "rad/s",
        "e_limit": "m",
        "e_reach": "m",
        "a_y_limit": "m/s^2",
        "tolerance": "1",
        "v_stop": "m/s",
    }
    for name, unit in units.items():
        require(getattr(block, name) > 0.0, where, f"{name} = {getattr(block, name)} [{unit}], expected > 0")
    for name in ("delay", "lag", "q_psi", "q_r", "q_e_limit", "q_a_y_limit", "a_y_room"):
        value = getattr(block, name)
        require(0.0 <= value < 1e6, where, f"{name} = {value}, expected >= 0 and finite")
    require(block.delay <= 2.0, where, f"delay = {block.delay} [s], expected at most 2 s")
    require(-5.0 <= block.reference <= 5.0, where, f"reference = {block.reference} [m], expected -5 to 5")
    require(block.slew is None or block.slew > 0.0, where, f"slew = {block.slew} [m/s^3], expected > 0, or None")
    if block.budget is not None:
        require(block.budget > 0.0, where, f"budget = {block.budget} [s], expected > 0, or None for no limit")
        require(block.clock is not None, where, f"budget = {block.budget} [s] needs a clock")
    check_ports(block.fallback, where)
