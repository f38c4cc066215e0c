"""What the frames say: values, how old they are, and what was wrong with them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

from steerkit.path import Path
from steerkit.plants.real_car.file.config import CarConfig
from steerkit.tracker import PathTracker
from steerkit.units import degrees_of

MOTION_TIME = 0.2
"""Time over which the position is compared with the speed [s]."""
WHEEL_RATE = 25.0
"""Faster than any hand turns a wheel [rad/s]."""
EPS = 1e-9
"""An age counts as reached a nanosecond early [s], so that a wake at the very moment finds it."""
_STAMP_DRIFT = 2e-4  # by how much the clock of the pose may run differently


class Senses:
    """The last good value of each quantity [SI], kept by `frame`; a bad frame leaves it as it was, and is counted.

    config: the car. path: where it drives; e and psi_e are tracked here, at the front axle, for the checks.
    """

    def __init__(self, config: CarConfig, path: Path):
        self.config = config
        self._readers = {r.frame_id: r for r in config.readers}
        self._counter: dict[int, int | None] = dict.fromkeys(self._readers)
        self.arrived = dict.fromkeys(self._readers, -math.inf)
        self.values: dict[str, float] = {}
        self.errors: deque[tuple[float, str]] = deque(maxlen=1000)
        self.error_count = 0
        self.torque_reports = 0
        self._tracker = PathTracker(path=path, reference=config.vehicle.l_f)
        self._anchor: tuple[float, tuple[float, float]] | None = None
        self._place: Any = None
        self.places = 0
        self.e = self.psi_e = math.nan
        self._stamp: tuple[float, float, float] | None = None  # first offset, least offset since, when
        self.delay = 0.0
        self.echo_ok = self.follow_ok = 0.0

    def frame(self, t: float, arrived: float, frame_id: int, data: bytes, sent: Sequence[tuple[float, float]]) -> None:
        """A frame that arrived at `arrived` is looked at; `sent`: the commands of late (t, delta_sw), oldest first."""
        reader = self._readers.get(frame_id)
        if reader is None:
            return
        checked = reader.read(data, self._counter[frame_id])
        self._counter[frame_id] = checked.counter
        missing = [name for name, value in checked.values.items() if not math.isfinite(value)]
        if checked.error or missing:
            self.error(t, checked.error or f"{reader.name}: {', '.join(missing)} not available")
            return
        arrived = min(arrived, t)
        gap = arrived - self.arrived[frame_id]
        self.arrived[frame_id] = arrived
        values = checked.values
        if "lat" in values:
            values = self._local(values)
        if "x" in values:
            self._check_motion(t, arrived, values, gap)
        if "delta_sw" in values and "delta_sw" in self.values and gap < 1.0:
            turned = abs(values["delta_sw"] - self.values["delta_sw"])
            if turned > WHEEL_RATE * gap + 0.2:
                self.error(t, f"the wheel jumped by {degrees_of(turned):.0f} deg", self.config.states.integrity_errors)
        self.values |= values
        if "stamp" in values:
            self._track_delay(arrived, values["stamp"], reader.mappings["stamp"].gain, gap)
        if "torque" in values:
            strong = abs(values["torque"]) > self.config.states.torque_max
            self.torque_reports = self.torque_reports + 1 if strong else 0
        if "delta_sw" in values:
            self._check_wheel(arrived, sent)
        if {"x", "psi"} & values.keys():
            self._locate(gap)

    def error(self, t: float, text: str, weight: int = 1) -> None:
        """Count an error, `weight` times."""
        self.error_count += 1
        self.errors.extend([(t, text)] * weight)

    def _local(self, values: dict[str, float]) -> dict[str, float]:
        import pymap3d

        origin = self.config.origin_deg
        assert origin is not None
        x, y, _ = pymap3d.geodetic2enu(values["lat"], values["lon"], 0.0, *map(math.radians, origin), 0.0, deg=False)
        return {**values, "x": float(x), "y": float(y)}

    def _check_motion(self, t: float, arrived: float, values: dict[str, float], gap: float) -> None:
        """A position that jumps, or that does not move with the speed, is wrong, whatever its CRC says."""
        here, weight = (values["x"], values["y"]), self.config.states.integrity_errors
        v, limit = self.values.get("v", math.nan), self.config.states.pose_jump
        if gap < 1.0 and "x" in self.values:
            moved = math.dist(here, (self.values["x"], self.values["y"]))
            if moved > max(abs(v), abs(self.values.get("v_kit", 0.0))) * gap + limit:
                self.error(t, f"the position jumped by {moved:.2f} m", weight)
        if self._anchor is None or gap >= 1.0:
            self._anchor = (arrived, here)
        since = arrived - self._anchor[0]
        if since >= MOTION_TIME:
            moved = math.dist(here, self._anchor[1])
            if abs(moved - abs(v) * since) > limit:
                self.error(t, f"the position moved by {moved:.2f} m in {since:.2f} s at {v:.1f} m/s", weight)
            self._anchor = (arrived, here)

    def _track_delay(self, arrived: float, stamp: float, gain: float, gap: float) -> None:
        """How much later than the quickest so far the pose comes; its clock is only known up to a constant."""
        length = self._readers_signal_length("stamp")
        wrap = gain * float(1 << length)
        offset = arrived - stamp
        if self._stamp is None or gap > 1.0:
            self._stamp = (offset, 0.0, arrived)
        first, least, when = self._stamp
        now = math.remainder(offset - first, wrap)
        least = min(least + _STAMP_DRIFT * (arrived - when), now)
        self._stamp = (first, least, arrived)
        self.delay = now - least

    def _readers_signal_length(self, quantity: str) -> int:
        mapping = self.config.quantities[quantity]
        message = next(r.message for r in self.config.readers if r.name == mapping.frame)
        return int(message.get_signal_by_name(mapping.signal).length)

    def _check_wheel(self, arrived: float, sent: Sequence[tuple[float, float]]) -> None:
        """Does the kit report one of the commands sent lately, and does the wheel follow them?"""
        close, echo = 1.5 * self.config.writer.quantum, self.values.get("echo")
        superseded = arrived
        for t, delta_sw in reversed(sent):
            if echo is None or abs(echo - delta_sw) <= close:
                self.echo_ok = max(self.echo_ok, superseded)
                break
            superseded = t
        if sent and abs(sent[-1][1] - self.values["delta_sw"]) <= self.config.states.follow_angle:
            self.follow_ok = arrived

    def _locate(self, gap: float) -> None:
        v = self.values
        if not {"x", "y", "psi", "v", "r"} <= v.keys():
            return
        if gap > self.config.states.pose_age:
            self._place = None
        u = self._tracker.U(x=v["x"], y=v["y"], psi=v["psi"], v=v["v"], beta=0.0, r=v["r"])
        if self._place is None:
            self._place, self.places = self._tracker.settle(0.0, self._tracker.init(), u), self.places + 1
        y = self._tracker.output(0.0, self._place, u)
        self._place = self._tracker.X(y.s, y.progress)
        self.e, self.psi_e = y.e, y.psi_e

    def age(self, t: float, frames: frozenset[int]) -> float:
        """Age of the oldest of some frames [s]."""
        return t - min(self.arrived[i] for i in frames) + EPS

    def forget_delay(self) -> None:
        """Take the next time stamp for an undelayed one."""
        self._stamp, self.delay = None, 0.0
