"""The law that steers when predictive steering has no plan: which ports it may have, and what it is asked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from steerkit._support.errors import require
from steerkit.diagram.block import Block

SEES = {"e", "psi_e", "kappa", "v", "r", "delta_sw_meas"}
"""Inputs that it may have."""


def check_ports(fallback: Block, where: str) -> None:
    """Raise ValueError, in the name of `where`, for a block that cannot be asked."""
    asks, gives = {p.name for p in fallback.inputs}, [p.name for p in fallback.outputs]
    more = f"{', '.join(sorted(asks - SEES))}; it may ask for {', '.join(sorted(SEES))}"
    require(asks <= SEES, where, f"fallback {type(fallback).__name__} needs {more}")
    require(gives == ["delta_sw"], where, f"fallback with outputs {gives}, expected delta_sw only")


def asked(fallback: Block, reference: float, x: Sequence[Any], kappa: Any, v: Any) -> Any:
    """What the fallback commands [rad], as if its drive began in this sample.

    x (6,): the state of a stage, with e and psi_e at `reference` [m]; kappa [1/m] there; v [m/s].
    """
    e, psi_e, _, r, wheel, _ = x
    lead = getattr(fallback, "reference", reference) - reference
    seen = dict(
        e=e + lead * (psi_e - 0.5 * kappa * lead),
        psi_e=psi_e - kappa * lead,
        kappa=kappa,
        v=v,
        r=r,
        delta_sw_meas=wheel,
    )
    inputs = fallback.D(**{name: seen[name] for name in fallback.D._fields})
    fresh = fallback.settle(0.0, fallback.init(), inputs)
    return fallback.output(0.0, fresh, inputs).delta_sw
