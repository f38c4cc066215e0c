"""opendbc's safety code, the C that a panda runs between computer and car, as the judge of every frame of a drive."""

import importlib.util
import os
from importlib.metadata import version
from pathlib import Path
from unittest import mock

from steerkit._support import native
from steerkit.car.production.platforms import Platform

SOURCE = Path(__file__).with_suffix(".c")


class SafetyJudge:
    """The safety code for one platform: `receive` what the car sends, and ask of each frame to it whether it may pass.

    Its state is that of a loaded library: one judge at a time in a process. Raises ValueError without opendbc,
    NoCompilerError without a compiler.
    """

    def __init__(self, platform: Platform):
        found = importlib.util.find_spec("opendbc")
        if found is None or found.origin is None:
            raise ValueError("the judge is the C of the library opendbc, which is not installed")
        with mock.patch.dict(os.environ, {"CPATH": str(Path(found.origin).parent.parent)}):
            self._c = native.load(f"// opendbc {version('opendbc')}\n{SOURCE.read_text(encoding='utf-8')}")
        self.platform = platform
        self.begin()

    def begin(self) -> None:
        """As after the ignition was switched on."""
        for config in self.platform.params.safetyConfigs:
            if self._c.judge_begin(config.safetyModel.raw, config.safetyParam) != 0:
                raise ValueError(f"{self.platform.name}: the safety code has no mode {config.safetyModel}")
        self._ticked = 0.0

    def tick(self, t: float) -> None:
        """Time has passed, until t [s]: once a second it looks for frames that are late."""
        if t - self._ticked >= 1.0:
            self._ticked = t
            self._c.judge_tick(_micro(t))

    def receive(self, t: float, frame_id: int, data: bytes, bus: int) -> bool:
        """A frame of the car at time t [s]; is it in order?"""
        return bool(self._c.judge_receive(_micro(t), frame_id, bus, data, len(data)))

    def may_pass(self, t: float, frame_id: int, data: bytes, bus: int) -> bool:
        """May this frame go to the car?"""
        return bool(self._c.judge_send(_micro(t), frame_id, bus, data, len(data)))

    def would_pass(self, t: float, frame_id: int, data: bytes, bus: int, *, allowed: bool = True) -> bool:
        """Would it pass, if it were sent now; allowed: as things stand, else as if the computer might not steer."""
        return bool(self._c.judge_would_send(_micro(t), frame_id, bus, data, len(data), allowed))

    @property
    def allowed(self) -> bool:
        """May the computer steer?"""
        return bool(self._c.judge_allowed())

    @property
    def relay_malfunction(self) -> bool:
        """Does somebody else send what only the computer may?"""
        return bool(self._c.judge_relay())

    @property
    def invalid(self) -> bool:
        """Are frames of the car late, or wrong?"""
        return bool(self._c.judge_invalid())


def _micro(t: float) -> int:
    return round(t * 1e6) & 0xFFFFFFFF
