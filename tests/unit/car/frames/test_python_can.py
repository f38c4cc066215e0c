"""python-can comes without what nobody on a car asks it for."""

from __future__ import annotations

import subprocess
import sys


def test_it_does_not_load_asammdf_which_stays_there_for_who_asks_for_it() -> None:
    text = """
import sys, types
asked = []
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "asammdf":
            asked.append(name)
sys.meta_path.insert(0, Finder())
from steerkit.car.frames.python_can import python_can
can = python_can()
assert can.Message(arbitration_id=3, data=b"ab").dlc == 2
import cantools
assert not asked and "asammdf" not in sys.modules, asked
try:
    import asammdf
except ImportError:
    pass
assert asked == ["asammdf"]
assert python_can() is can
"""
    subprocess.run([sys.executable, "-c", text], check=True)
