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

number = 3
"""


def own_controller(place: Path) -> str:
    """Write it into `place`; its name."""
    (place / "my_file.py").write_text(TEXT)
    return f"{place}/my_file.py:make"
