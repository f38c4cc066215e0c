"""opendbc's safety code, the C that runs in a panda between computer and car, as a judge of many commands at once."""

import ctypes
import importlib.util
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest

from steerkit._support import native

SOURCE = Path(__file__).with_suffix(".c").read_text(encoding="utf-8")


class Judge:
    """The functions of SOURCE, with arrays; `per` is how many codes a degree or a 1/m has."""

    def __init__(self, library: ctypes.CDLL):
        self.library = library

    @staticmethod
    def _codes(values: np.ndarray, per: float) -> np.ndarray:
        return np.round(values * per).astype(np.int32)

    def model(
        self, angle_deg: np.ndarray, last_deg: np.ndarray, v: np.ndarray, *, frequency: int, car: tuple[float, ...]
    ) -> np.ndarray:
        """Rejected by `steer_angle_cmd_checks_vm`? car: slip factor [s^2/m^2], steering ratio, wheelbase [m]."""
        per, wrong = 10.0, np.zeros(len(v), np.uint8)
        angle, last = self._codes(angle_deg, per), self._codes(last_deg, per)
        numbers = [ctypes.c_double(x) for x in (per, *car)]
        self.library.judge_model(len(v), _at(angle), _at(last), _at(v), frequency, *numbers, _at(wrong))
        return wrong.astype(bool)

    def table(
        self, x: np.ndarray, last: np.ndarray, v: np.ndarray, rate: np.ndarray, *, per: float, most: float, kappa: bool
    ) -> np.ndarray:
        """Rejected by `steer_angle_cmd_checks`? x, last: degrees or curvatures [1/m]; rate: the most a frame."""
        wrong, code, before = np.zeros(len(v), np.uint8), self._codes(x, per), self._codes(last, per)
        limit = round(most * per)
        arrays = (_at(code), _at(before), _at(v), _at(rate))
        self.library.judge_table(len(v), *arrays, ctypes.c_double(per), limit, int(kappa), _at(wrong))
        return wrong.astype(bool)

    def too_often(self, when: np.ndarray, frequency: int) -> int:
        """How many of the frames at these times [s] come too often for a car of that frequency [Hz]."""
        micro = np.round(when * 1e6).astype(np.uint32)
        return int(self.library.judge_rate(len(micro), _at(micro), frequency))


def _at(array: np.ndarray) -> ctypes.c_void_p:
    assert array.flags.c_contiguous
    return ctypes.c_void_p(array.ctypes.data)


def judge() -> Judge:
    """The judge, compiled; skips a test where opendbc or a compiler is not there."""
    found = importlib.util.find_spec("opendbc")
    if found is None or found.origin is None:
        pytest.skip("opendbc is not installed")
    if native.compiler() is None:
        pytest.skip("opendbc's safety code is C, and there is no compiler")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CPATH", str(Path(found.origin).parent.parent))
        return Judge(native.load(f"// opendbc {version('opendbc')}{SOURCE}"))
