"""A controller as a user would write it, in a file of its own."""

from pathlib import Path

TEXT = """
from dataclasses import dataclass
from steerkit import Block, In, Out

@dataclass(frozen=True, eq=False, kw_only=True)
class Mine(Block):
    e = In("m")
    psi_e = In("rad")
    v = In("m/s")
    delta_sw = Out("rad")
    gain: float = 2.5
    steer_ratio: float = 15.6
    reference: float = 1.2

    def output(self, t, x, u):
        return self.Y(-self.steer_ratio * (u.psi_e + self.gain * u.e / (1.0 + u.v)))

def make(belief):
    return Mine(steer_ratio=belief.vehicle.steer_ratio, reference=belief.vehicle.l_f)

def nothing(belief):
    return None

def kind(belief):
    return Mine

def unlucky(belief):
    return belief.colour

def element(belief):
    from steerkit import PathTracker
    return PathTracker(path=belief.path)

def agent(belief):
    from steerkit.controllers.network_policy import PolicyBlock
    from steerkit.doe import Integrator
    return PolicyBlock(policy=lenient, actions=(-0.15, 0.0, 0.15)), Integrator(limit=belief.vehicle.delta_sw_max)

def lenient(x):
    # of scaled states (n, 6): a step of the wheel towards where it should be
    import numpy as np
    e, e_dot, v, psi_e, r_e, doe = (x * HALF + MID).T
    want = -15.6 * (psi_e + e / (1.0 + v)) - doe
    return 1 + np.sign(want) * (np.abs(want) > 0.1)

from steerkit.controllers.policy import StateDescription
MID, HALF = StateDescription().mid, StateDescription().half

number = 3
"""


def own_controller(place: Path) -> str:
    """Write it into `place`; its name."""
    (place / "my_file.py").write_text(TEXT)
    return f"{place}/my_file.py:make"
