"""What the frames say: values, how old they are, and what was wrong with them."""

import math
from collections import deque
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np

from steerkit.car.config import CarConfig
from steerkit.car.estimates import earlier
from steerkit.car.motion import MotionCheck
from steerkit.car.ports import FrameReader
from steerkit.diagram.units import degrees_of
from steerkit.estimators.steering_sign import SteeringSigns
from steerkit.paths.tracker import PathTracker
from steerkit.vehicles.rollout import Rollout

WHEEL_RATE = 25.0
"""Faster than any hand turns a wheel [rad/s]."""
EPS = 1e-9
"""An age counts as reached a nanosecond early [s], so that a wake at the very moment finds it."""
FOLLOW = 0.35
"""The wheel has to be where the commands of so long ago, and later ones, sent it [s]."""
AHEAD = 0.3
"""A pose that seems to come so much quicker than the quickest so far has a wrong time stamp [s]."""
AHEAD_TIME = np.linspace(0.0, 4.0, 41)
"""In the tightest bend of so long ahead [s], a lie does most."""
FAST, FAST_TIME = 0.04, 3.0
"""The quickest pose may not become quicker by so much within so long [s]: the clock of the time stamps runs fast."""
_STAMP_DRIFT = 2e-4  # by how much the clock of the pose may run differently
BEHIND, BEHIND_TIME = 0.12, 0.5
"""So much later than its counter says, the quickest of them, a frame may not come for so long [s]: they queue up."""
ACTS = 0.1
"""The last command counts for so long as the one that the wheel answers [s]."""
_COUNT_DRIFT = 1e-3  # by how much a sender's period may differ from the file's


class Punctuality:
    """How much later frames come than their own counter says: a queue on the way that fills slows no counter.

    period [s] between two frames, modulus of the counter. Frames that are lost are counted, also those of whole turns
    of the counter: the time since the last one says how many. After a pause of more than `patience` [s] it begins anew.
    """

    def __init__(self, period: float, modulus: int, patience: float):
        self.period, self.modulus, self.patience = period, modulus, patience
        self._last: tuple[float, int] | None = None
        self._offset = self._least = self._on_time = 0.0

    def forget(self) -> None:
        """Take the next frame for one in time."""
        self._last = None

    def behind(self, arrived: float, counter: int) -> float:
        """How much later than the quickest so far this one came [s], if all those of `BEHIND_TIME` did; else 0."""
        if self._last is None or arrived - self._last[0] > self.patience:
            self._last, self._offset, self._least, self._on_time = (arrived, counter), 0.0, 0.0, arrived
            return 0.0
        dt, steps = arrived - self._last[0], (counter - self._last[1]) % self.modulus
        steps += self.modulus * max(0, round((dt / self.period - steps) / self.modulus))
        self._last = arrived, counter
        self._offset += dt - steps * self.period
        self._least = min(self._least + _COUNT_DRIFT * dt, self._offset)
        late = self._offset - self._least
        if late < BEHIND:
            self._on_time = arrived
        return late if arrived - self._on_time > BEHIND_TIME else 0.0


def witness(config: CarConfig) -> MotionCheck:
    """What checks the pose of that car, which has not driven yet."""
    return MotionCheck(config.motion, Rollout.of(config.vehicle), earlier(config))


class Senses:
    """The last good value of each quantity [SI], kept by `frame`; a bad frame leaves it as it was, and is counted.

    config: the car and its course; e and psi_e are tracked here, at the front axle, for the checks.
    """

    def __init__(self, config: CarConfig):
        self.config = config
        self._readers = {r.frame_id: r for r in config.readers}
        self._counter: dict[int, int | None] = dict.fromkeys(self._readers)
        self.arrived = dict.fromkeys(self._readers, -math.inf)
        self.values: dict[str, float] = {}
        self.errors: deque[tuple[float, str]] = deque(maxlen=1000)
        self.error_count = 0
        self.torque_reports = 0.0
        self._punctual = {
            r.frame_id: Punctuality(r.period, r.modulus, config.states.pose_age)
            for r in config.readers
            if r.period and r.counter
        }
        self._times: dict[int, deque[float]] = {i: deque(maxlen=1000) for i in self._readers}
        self.foreign: tuple[float, str] = (-math.inf, "")
        self._errors_of_path: deque[tuple[float, float]] = deque()  # (t, |e|), each the least from then on
        self.moving = -math.inf
        self.enabled_since: float | None = None
        self.enabled_at = -math.inf  # the last report of it
        car = config.vehicle
        self._tracker = PathTracker(path=config.course, reference=car.l_f)
        self._motion = witness(config)
        self.signs = SteeringSigns(Rollout.of(car))
        self._astray, self._asked = math.nan, -math.inf
        self._place: Any = None
        self.places = 0
        self.e = self.psi_e = math.nan
        self.remaining = math.inf
        self._pose_frame = next(r.frame_id for r in config.readers if {"x", "lat"} & r.mappings.keys())
        self._stamp: tuple[float, float, float] | None = None  # first offset, least offset since, when
        self._stamped, self._quickest = 0.0, deque[tuple[float, float]]()
        self.ahead = False  # do the time stamps say that poses come quicker than can be?
        self.delay = 0.0
        self.echo_ok = self.follow_ok = 0.0

    def frame(
        self, t: float, arrived: float, frame_id: int, data: bytes, sent: Sequence[tuple[float, float]], kind: str = ""
    ) -> None:
        """A frame that arrived at `arrived` is looked at; `sent`: the commands of late (t, delta_sw), oldest first.

        kind: "" for 11 bits, "x" for 29, "fd" for CAN FD, as the recording has it.
        """
        writer = self.config.writer
        if kind == "bad":
            self.error(t, f"the adapter sent what is no frame: {data[:40]!r}")
            return
        if frame_id == writer.message.frame_id and kind != (
            "" if writer.message.is_extended_frame else "x"
        ):  # CAN FD does not say which it is
            self.foreign = (t, f"somebody else sends {writer.message.name} (0x{frame_id:X}), which only we may")
            return
        reader = self._readers.get(frame_id)
        if reader is None or kind != reader.kind:
            return
        self._check_rate(t, reader)
        checked = reader.read(data, self._counter[frame_id])
        self._counter[frame_id] = checked.counter
        absent = ", ".join([name for name, value in checked.values.items() if not math.isfinite(value)])
        if checked.error or absent:
            self.error(t, checked.error or f"{reader.name}: {absent} not available")
            return
        arrived = min(arrived, t)
        punctual, counter = self._punctual.get(frame_id), checked.counter
        if punctual and counter is not None and (late := punctual.behind(arrived, counter)):
            after = f"{1e3 * late:.0f} ms later than its counter says: frames queue up on the way"
            self._grave(t, f"{reader.name} comes {after}, or come less often than every {1e3 * reader.period:g} ms")
        gap = arrived - self.arrived[frame_id]
        self.arrived[frame_id] = arrived
        values = checked.values
        if "lat" in values:
            values = self._local(values)
        if "x" in values:
            if gap > self.config.states.pose_age:
                self._motion.forget()
            if what := self._motion.pose(arrived, values["x"], values["y"]):  # it is wrong, whatever its CRC says
                self._grave(t, what)
        if "delta_sw" in values and "delta_sw" in self.values and gap < 1.0:
            turned = abs(values["delta_sw"] - self.values["delta_sw"])
            if turned > WHEEL_RATE * gap + 0.2:
                self._grave(t, f"the wheel jumped by {degrees_of(turned):.0f} deg")
        self.values |= values
        if "r" in values and {"psi", "v", "delta_sw", "v_kit"} <= self.values.keys():
            moved = {name: self.values[name] for name in ("psi", "v", "r", "delta_sw", "v_kit")}
            self._motion.moves(arrived, **moved)  # dead reckoning
        if "stamp" in values:
            self._track_delay(t, arrived, values["stamp"], gap)
        if "torque" in values:  # a weak one takes a third off: reports of another sender in between do not hide a hand
            strong = abs(values["torque"]) > self.config.states.torque_max
            self.torque_reports = self.torque_reports + 1.0 if strong else max(0.0, self.torque_reports - 1.0 / 3.0)
        if "v" in values and abs(values["v"]) >= self.config.states.v_still:
            self.moving = arrived
        if values.get("enabled"):
            self.enabled_since = arrived if self.enabled_since is None else self.enabled_since
            self.enabled_at = arrived
        elif "enabled" in values and arrived - self.enabled_at > self.config.states.foreign_enable:
            self.enabled_since = None
        if "delta_sw" in values and sent:
            self._check_wheel(arrived, sent)
        if "delta_sw" in values:
            self._check_signs(arrived, sent)
        if "x" in values or "psi" in values:
            self._locate(gap)

    def error(self, t: float, text: str, weight: int = 1) -> None:
        """Count an error, `weight` times."""
        self.error_count += 1
        self.errors.extend([(t, text)] * weight)

    def _grave(self, t: float, text: str) -> None:
        """An error that is enough to end driving."""
        self.error(t, text, self.config.states.integrity_errors)

    def _check_rate(self, t: float, reader: FrameReader) -> None:
        """Frames that come oftener than they should have a second sender."""
        if not reader.period:
            return
        times = self._times[reader.frame_id]
        times.append(t)
        while times[0] < t - 0.5:
            times.popleft()
        allowed = 1.4 * 0.5 / reader.period + 3.0  # three may have waited for the computer
        if len(times) > allowed:
            self.foreign = (t, f"{reader.name} comes {2 * len(times)} times a second, expected {1 / reader.period:.0f}")

    def _local(self, values: dict[str, float]) -> dict[str, float]:
        import pymap3d

        origin = self.config.origin_deg
        assert origin is not None
        x, y, _ = pymap3d.geodetic2enu(values["lat"], values["lon"], 0.0, *map(math.radians, origin), 0.0, deg=False)
        return {**values, "x": float(x), "y": float(y)}

    def astray(self, t: float) -> float:
        """The time in which a pose that lies unnoticed could lead the car half a metre off [s], of the last second."""
        v = self.values.get("v_kit", math.nan)
        if t - self._asked >= 1.0 and math.isfinite(v):
            s = self._place.s if self._place else 0.0
            bends = abs(self._tracker.path.kappa(s + abs(v) * AHEAD_TIME))
            self._asked, self._astray = t, self._motion.astray(v, float(bends.max()))
        return self._astray

    @property
    def beta(self) -> float:
        """Sideslip, measured, or that of a car whose rear wheels roll where they point [rad]."""
        known = self.values
        if "beta" in known:
            return known["beta"]
        l_r = float(self.config.vehicle.l_r)
        return math.atan2(known.get("r", math.nan) * l_r, max(known.get("v", math.nan), 1.0))

    @cached_property
    def _stamp_wrap(self) -> float:
        """Where the time stamp begins anew [s]."""
        mapping = self.config.quantities["stamp"]
        message = next(r.message for r in self.config.readers if r.name == mapping.frame)
        length, gain = message.get_signal_by_name(mapping.signal).length, mapping.gain
        return gain * float(1 << length)

    def _track_delay(self, t: float, arrived: float, stamp: float, gap: float) -> None:
        """How much later than the quickest so far the pose comes; its clock is only known up to a constant."""
        offset = arrived - stamp
        if self._stamp is None or gap > 1.0:
            self._stamp = (offset, 0.0, arrived)
            self._stamped = arrived
            self._quickest.clear()
        first, least, when = self._stamp
        now = math.remainder(offset - first, self._stamp_wrap)
        self.ahead = now < least - AHEAD
        if self.ahead:  # not believed, so that it is forgotten when it comes back
            self._motion.forget()  # what came before may have waited somewhere
            self._grave(t, f"the time stamp is {least - now:.2f} s ahead: acknowledge (a) to believe it from then on")
            return
        least = min(least + _STAMP_DRIFT * (arrived - when), now)
        self._quickest.append((arrived, least))
        while self._quickest[0][0] < arrived - FAST_TIME:
            self._quickest.popleft()
        begun, then = self._quickest[0]
        if arrived - self._stamped > FAST_TIME and least < then - FAST:
            self._grave(t, f"the time stamps run ahead by {1e3 * (then - least):.0f} ms in {arrived - begun:.1f} s")
        self._stamp = (first, least, arrived)
        self.delay = now - least

    def _check_wheel(self, arrived: float, sent: Sequence[tuple[float, float]]) -> None:
        """Does the kit report one of the commands sent lately, and does the wheel follow them?"""
        close, echo = 1.5 * self.config.writer.quantum, self.values.get("echo")
        superseded = arrived
        for t, delta_sw in reversed(sent):
            if echo is None or abs(echo - delta_sw) <= close:
                self.echo_ok = max(self.echo_ok, superseded)
                break
            superseded = t
        late = [delta_sw for t, delta_sw in sent if t >= arrived - FOLLOW] or [sent[-1][1]]
        slack = self.config.states.follow_angle
        if min(late) - slack <= self.values["delta_sw"] <= max(late) + slack:
            self.follow_ok = arrived

    def _check_signs(self, arrived: float, sent: Sequence[tuple[float, float]]) -> None:
        known, names = self.values, ("v", "r", "psi")
        if all([name in known for name in names]):
            command = sent[-1][1] if sent and arrived - sent[-1][0] < ACTS else math.nan
            self.signs.add(arrived, command=command, wheel=known["delta_sw"], **{name: known[name] for name in names})

    def _locate(self, gap: float) -> None:
        v = self.values
        if not {"x", "y", "psi", "v", "r"} <= v.keys():
            return
        if gap > self.config.states.pose_age:
            self._place = None
        tracker, errors, arrived = self._tracker, self._errors_of_path, self.arrived[self._pose_frame]
        u = tracker.U(x=v["x"], y=v["y"], psi=v["psi"], v=v["v"], beta=0.0, r=v["r"])
        if self._place is None:
            self._place, self.places = tracker.settle(0.0, tracker.init(), u), self.places + 1
        y = tracker.output(0.0, self._place, u)
        self._place = tracker.X(y.s, y.progress)
        self.e, self.psi_e = y.e, y.psi_e
        self.remaining = math.inf if tracker.path.closed else tracker.path.length - y.s
        error = abs(y.e)
        while errors and errors[-1][1] >= error:  # a smaller one that is newer stays longer
            errors.pop()
        errors.append((arrived, error))
        while errors[0][0] < arrived - 1.0:
            errors.popleft()

    def e_growth(self, since: float) -> float:
        """By how much |e| has grown within the last second, counted from `since` [s] at the earliest [m]."""
        errors = self._errors_of_path
        least = next((e for t, e in errors if t >= since), errors[-1][1] if errors else 0.0)
        return errors[-1][1] - least if errors else 0.0

    def age(self, t: float, frames: frozenset[int]) -> float:
        """Age of the oldest of some frames [s]."""
        return t - self.oldest(frames) + EPS

    def oldest(self, frames: frozenset[int]) -> float:
        """When the frame of some that has not come for longest came last [s]."""
        return min(map(self.arrived.__getitem__, frames))

    def forget_delay(self) -> None:
        """Take the next time stamp for an undelayed one, and the next frame of each kind for one in time."""
        self._stamp, self.delay, self.ahead = None, 0.0, False
        for frames in self._punctual.values():
            frames.forget()
