"""A manoeuvre of vehicle testing on a car: what must hold, the human's consent, its runs, and what ends them."""

import json
import math
from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path as FilePath
from typing import Any

import numpy as np

from steerkit._support.errors import known, require
from steerkit.car import loop as loops
from steerkit.car import recording as recordings
from steerkit.car import session as sessions
from steerkit.car.client import CarClient
from steerkit.car.config import CarConfig, load
from steerkit.car.loop import Follow, Steers
from steerkit.car.panel import line_of, ring
from steerkit.car.production.platforms import platform
from steerkit.car.protocol import Remark, Snapshot
from steerkit.car.state_machine import Mode, Order
from steerkit.diagram import realtime
from steerkit.paths.path import Path
from steerkit.proving.manoeuvre import SIDES, SPACING, Manoeuvre
from steerkit.scenario.catalogue import CONTROLLERS
from steerkit.task import DT

LONG = 6.0
"""Waves that last longer are steered on top of the controller [s]."""
CONSENT = 5.0
"""So soon after the human's consent a run begins, or it takes another [s]."""
WARNING = 2.0
"""Between consent and run [s]."""
NEAR = 0.25
"""|e| before a run [m]."""
SHARE = 0.7
"""Of what the state machine allows, a wave may ask for that much: its run does not begin exactly on the course."""
EARLY = 0.8
"""Of the |e| at which the car lets go, that much ends a run: then the controller takes over."""
SPARE = 1.0
"""Of straight course more than a run takes, to ask for consent [s]."""
TRIES = 3
"""For each run that has to be valid, at the most."""
ENDING = 5.0
"""The controller steers on for so long after the last run [s]."""
KEY = "g"
NOTED = ("number", "side", "v", "a_y", "manoeuvre")
"""What is noted of a run's beginning."""
RECORDING_ENDS = "recording ends"
"""Cause of a run whose end was not recorded."""


def on_course(manoeuvre: Manoeuvre) -> bool:
    """Does the controller drive the car's own course in it? A steady circle, too, is made of that course's bends."""
    return manoeuvre.input is None or manoeuvre.evaluation == "steady"


def straight(path: Path, kappa: float) -> Any:
    """How far ahead of each metre of a course |kappa| stays below that [m], at most a round."""
    bends = np.abs(path.kappa(np.arange(math.ceil(path.length), dtype=float))) > kappa
    free, left = np.zeros(len(bends)), 0.0 if bends.any() or not path.closed else path.length
    for k in [*range(len(bends) - 1, -1, -1)] * (1 + path.closed):
        left = 0.0 if bends[k] else min(left + 1.0, path.length)
        free[k] = left
    return free


def most(manoeuvre: Manoeuvre, config: CarConfig, v: float) -> dict[str, float]:
    """The largest a_y [m/s^2] of a manoeuvre's input that each limit of a car allows at v [m/s].

    For a car that turns as its linear model does, from the angle that drives straight on: v_y' = a_y w(t), e' = v_y.
    Limits on e, psi_e and r are for waves instead of the controller's steering; rate and jerk are not asked where the
    car's answer, with all its limits, is what is judged (`request`).
    """
    gate, states, abort, car = config.gate, config.states, manoeuvre.abort, config.vehicle
    wave = manoeuvre.required.wave[:-1]  # then the controller steers, within the same limits
    change, size = np.diff(wave, prepend=0.0) / SPACING, float(np.abs(wave).max())
    per_a_y = float(car.wheel_per_a_y(v))
    felt = gate.length(v) / (car.wheelbase + car.understeer_gradient * v**2)  # the gate may doubt the understeer
    found = {
        "delta_sw_max": min(gate.delta_sw_max, states.delta_sw_max) / (per_a_y * size),
        "a_y_max": gate.a_y_max * felt / float(np.abs(wave + gate.arm / v * change).max()),
        "abort.a_y": abort.a_y / size,
        "abort.r": abort.r * v / size,
    }
    if manoeuvre.evaluation != "request":
        slew = config.port_limits.slew if config.port_limits and config.port_limits.slew else math.inf
        fastest = float(np.abs(change).max())
        found["rate_max"] = gate.rate(v) / (per_a_y * fastest)
        found["jerk_max"] = min(gate.jerk_max, slew) * felt / fastest
    else:
        found["a_y_max"] = gate.a_y_max * felt / size
    if manoeuvre.seconds <= LONG:
        sideways = np.cumsum(wave) * SPACING
        e, second = np.abs(np.cumsum(sideways) * SPACING), round(1.0 / SPACING)
        e_max = "e_max" if states.e_max <= abort.e else "abort.e"
        found[e_max] = SHARE * min(states.e_max, abort.e) / float(e.max())
        found["e_growth"] = SHARE * states.e_growth / float((e - np.pad(e, (second, 0))[: len(e)]).max())
        found["psi_e_max"] = SHARE * states.psi_e_max * v / float(np.abs(sideways).max())
    return {name: float(value) for name, value in found.items()}


def check(manoeuvre: Manoeuvre, config: CarConfig, base: str = "stanley") -> None:
    """Raise ValueError, naming all that does not fit and what would, for what cannot be driven with this car."""
    where = f"prove {manoeuvre.name}"
    known(base, CONTROLLERS, f"{where}: controller")
    v, low, high = manoeuvre.conditions.v, config.states.v_engage_min, config.states.v_engage_max
    low = max(low, platform(config.port).slowest) if config.port else low
    wrong, at = list[str](), min(max(v, low), high)
    if not low <= v <= high:
        wrong.append(f"v = {v:g} m/s, its file and port allow {low:g} to {high:g} (v_engage_max): --speed {at:g}")
    if not on_course(manoeuvre):
        asked = manoeuvre.required.angle(config.vehicle, at) / float(config.vehicle.wheel_per_a_y(at))
        limits = most(manoeuvre, config, at)
        fits = math.floor(100.0 * min(limits.values())) / 100.0
        tight = ", ".join(f"{name} {a_y:.2f}" for name, a_y in limits.items() if a_y < asked)
        hint = f"--a-y {fits:g}" if fits > 0.0 else "none fits"
        if tight:
            wrong.append(f"a_y = {asked:.3g} m/s^2, at {at:g} m/s its limits allow: {tight}: {hint}")
        needed = at * (WARNING + SPARE + manoeuvre.seconds)
        longest = float(straight(config.course, manoeuvre.conditions.r_max / at).max())
        if needed > longest:
            slower = f"--speed {longest / needed * at:.2g}, or " if longest > 0.0 else ""
            wrong.append(
                f"it takes {needed:.0f} m straight on, the course has {longest:.0f} m: {slower}another [course]"
            )
    require(not wrong, where, "cannot be driven with this car; " + "; ".join(wrong))


@dataclass(kw_only=True)
class Proving:
    """Drives the runs of a manoeuvre, each with the human's consent: ask `step` after every sample.

    Between runs, and from the sample on after which anything ends one, the controller `base` steers; all else is as in
    an ordinary drive. Raises ValueError as `check` does.
    """

    config: CarConfig
    link: CarClient
    manoeuvre: Manoeuvre
    base: str = "stanley"
    minutes: float = 0.0
    """Of a run on the course; 0: a round."""
    yes: bool = False
    """Engage and consent without the human: for simulated cars alone."""
    say: bool = False
    """Print what the panel would show, when it changes."""
    runs: list[dict[str, Any]] = field(default_factory=list)
    """As of `runs_in`; `end` is None while it lasts."""
    pressed: bool = False
    """Has the human consented since the last sample?"""
    lacking: str = "nothing is known yet"
    """What stands against a run; "" when all is well."""
    follow: Follow = field(init=False)

    def __post_init__(self) -> None:
        check(self.manoeuvre, self.config, self.base)
        self._controller = loops.controller_named(self.base, self.config)
        self._recent: deque[Snapshot] = deque(maxlen=round(self.manoeuvre.conditions.settle / DT))
        self._consent = self._warned = self._ended = self._ordered = -math.inf
        self._told = self._aborted = ""
        m, self._progress = self.manoeuvre, 0.0
        self._free = straight(self.config.course, m.conditions.r_max / m.conditions.v)
        self._seconds = math.nan if on_course(m) else m.seconds
        self._sides = ("course",) if on_course(m) else m.sides
        self._loops = {side: self._loop(side) for side in (*self._sides, "")}  # before a sample waits for one
        self._note({"event": "drive"})
        self.follow = Follow.of(self._loops[""], self.link)

    def _loop(self, side: str) -> Any:
        block = loops.with_run(self._controller.block, json.dumps(self._run(0, side)), self.config)
        return loops.car_loop(self.config, self.link, block)

    @property
    def side(self) -> str:
        """Of the next valid run that is wanted; "" when there are enough."""
        done = Counter(run["side"] for run in self.runs if run["cause"] == "")
        planned = [(n, side) for n in range(self.manoeuvre.repeats) for side in self._sides]
        over = len(self.runs) >= TRIES * len(planned)
        return "" if over else next((side for n, side in planned if done[side] <= n), "")

    @property
    def driving(self) -> dict[str, Any] | None:
        """The run of now."""
        return self.runs[-1] if self.runs and self.runs[-1]["end"] is None else None

    def step(self, live: realtime.Run) -> bool:
        """After every sample; True when all is driven."""
        self.follow.begin(live)
        s = self.link.last
        assert s is not None
        pressed, self.pressed = self.pressed or self.yes, False
        if self.driving:
            self._watch(live, s)
        elif self.side:
            self._prepare(live, s, pressed)
        if self.yes and s.t - self._ordered > 1.0 and s.mode not in (Mode.OFF, Mode.ENGAGED):
            self.link.order(Order.ENGAGE if s.mode is Mode.READY else Order.ACKNOWLEDGE)
            self._ordered = s.t
        self.follow.choose(live)
        told = self.status()
        if self.say and told.partition(":")[0] != self._told.partition(":")[0]:
            print(told, flush=True)
        self._told = told
        over = not self.driving and not self.side
        return over and (not self.follow.engaged or s.t - self._ended > ENDING)

    def _prepare(self, live: realtime.Run, s: Snapshot, pressed: bool) -> None:
        """Before a run: first what must hold, then the consent that is asked for, then the warning, then the run."""
        asked = not self.lacking
        self._recent.append(s)
        if not self.follow.engaged:
            self._recent.clear()
            self._consent = -math.inf
        self.lacking = next(self._against(live, s), "")
        if self.lacking:
            self._warned = -math.inf
            return
        if on_course(self.manoeuvre):
            self._begin(live, s)
            return
        if s.t - self._consent > CONSENT:
            self._warned = -math.inf
            if not asked:
                ring()
            if not (asked and pressed):
                return
            self._consent = s.t
        if self._warned == -math.inf:
            self._warned = s.t
            ring()
        elif s.t - self._warned >= WARNING:
            self._begin(live, s)

    def _against(self, live: realtime.Run, s: Snapshot) -> Iterator[str]:
        """What stands against a run, the human's part first."""
        c, recent = self.manoeuvre.conditions, self._recent
        if not self.follow.engaged:
            yield "engage (e) to begin"
        if not on_course(self.manoeuvre):
            if not all(abs(one.v - c.v) <= self._v_off for one in recent):
                yield f"drive at {c.v:g} m/s within {self._v_off:g} m/s for {c.settle:g} s: it is {s.v:.1f} m/s"
            if not abs(sum(one.r for one in recent)) < c.r_max * max(len(recent), 1):
                yield f"drive straight on for {c.settle:g} s, |r| below {c.r_max:g} rad/s in the mean"
            left = WARNING + SPARE if self._warned == -math.inf else WARNING - (s.t - self._warned)
            needed = s.v * (left + self._seconds)
            free = float(self._free[int(live.sample["path.s"]) % len(self._free)])
            if not needed <= free:
                yield f"the course bends in {free:.0f} m, the run takes {needed:.0f} m"
        if not all(abs(one.e) <= NEAR for one in recent):
            yield f"stay within {NEAR:g} m of the course for {c.settle:g} s: e = {s.e:.2f} m"
        if len(recent) < (recent.maxlen or 0):
            yield f"go on so for {c.settle:g} s"

    @property
    def _v_off(self) -> float:
        return min(self.manoeuvre.conditions.v_tolerance, self.manoeuvre.abort.v)

    def _begin(self, live: realtime.Run, s: Snapshot) -> None:
        told = self._run(len(self.runs) + 1, self.side)
        self.runs.append({key: told[key] for key in NOTED} | {"begin": s.t, "end": None, "cause": None})
        self._note(told)
        self._consent, self._progress = -math.inf, live.sample["path.progress"]
        self.follow.exchange(live, self._loops[told["side"]])

    def _watch(self, live: realtime.Run, s: Snapshot) -> None:
        """Within a run: its end, or what aborts it."""
        run = self.runs[-1]
        cause = next(self._broken(s), "")
        if on_course(self.manoeuvre):
            gone = live.sample["path.progress"] - self._progress
            over = s.t - run["begin"] >= 60.0 * self.minutes if self.minutes else gone >= self.config.course.length
            if "end of the course" in cause:
                over, cause = True, ""
        else:
            over = s.t - run["begin"] >= self._seconds + DT
        if not (cause or over):
            return
        run.update(end=s.t, cause=cause)
        self._recent.clear()
        self._aborted, self._ended, self.lacking = cause, s.t, "a run has ended"
        self._note({"event": "end", "number": run["number"], "cause": cause})
        self.follow.exchange(live, self._loops[""])
        if cause or not self.side:
            ring()

    def _broken(self, s: Snapshot) -> Iterator[str]:
        """What aborts a run."""
        abort, c = self.manoeuvre.abort, self.manoeuvre.conditions
        if not self.follow.engaged:
            yield line_of(s)
        rows = [("a_y", s.a_y, abort.a_y, "m/s^2"), ("r", s.r, abort.r, "rad/s")]
        rows.append(("e", s.e, min(abort.e, EARLY * self.config.states.e_max), "m"))
        if not on_course(self.manoeuvre):
            rows.append((f"v - {c.v:g} m/s", s.v - c.v, self._v_off, "m/s"))
        for name, value, limit, unit in rows:
            if not abs(value) <= limit:
                yield f"{name}: {value:.2f} {unit}, limit {limit:g}"

    def _run(self, number: int, side: str) -> dict[str, Any]:
        """What is noted of a run's beginning: enough to steer it again."""
        m, size = self.manoeuvre, None if on_course(self.manoeuvre) or not side else self.manoeuvre.required
        run = {"event": "begin", "number": number, "side": side, "v": m.conditions.v, "a_y": size.a_y if size else 0.0}
        wave = {"input": asdict(size) if size else None, "on_top": self._seconds > LONG}
        return run | {"manoeuvre": m.name} | wave

    def _note(self, told: dict[str, Any]) -> None:
        """Who steers from the next sample on, for the recording."""
        name = self.base
        if told.get("input"):
            name += f"+{told['manoeuvre']}@{told['v']:g},{told['a_y']:g},{told['side']},{told['number']}"
        self.link.note(Remark(replace(self._controller.steers, name=name, run=json.dumps(told)).text()))

    def status(self) -> str:
        """One line for the panel: what is wanted, asked or driven."""
        m, run, last = self.manoeuvre, self.driving, self.link.last
        now = last.t if last else -math.inf
        if run:
            return f"{m.name}, run {run['number']} {run['side']}: {now - run['begin']:.1f} s; any key lets go"
        if not self.side:
            return f"all is driven, {self.valid} of {len(self.runs)} runs valid: HANDS ON THE WHEEL, it lets go soon"
        text = f"{m.name}, next {self.side}, {self.valid} valid of {len(self.runs)} runs"
        if self._aborted:
            text += f", the last one ended by {self._aborted.replace(':', '')}"
        if self.lacking:
            return f"{text}: {self.lacking}"
        if self._warned > -math.inf:
            return f"{text}, HANDS ON THE WHEEL: it begins in {WARNING - (now - self._warned):.1f} s"
        return f"{text}, READY: press {KEY} to consent to this run; any other key lets go"

    @property
    def valid(self) -> int:
        """Runs that were valid."""
        return sum(run["cause"] == "" for run in self.runs)

    def consent(self) -> None:
        """The human's key."""
        self.pressed = True


def runs_in(recording: str | FilePath | recordings.Recorded) -> list[dict[str, Any]]:
    """The runs in a recording, also in one that is cut short: number, side, begin, end [s], cause, v, a_y, manoeuvre.

    recording: its file, or what was read of it. Times are those of its `t`; cause is "" for a valid run. One whose end
    is not recorded ends where the car let go, with that cause, or with the recording. Raises ValueError for
    what is no recording.
    """
    recorded = recording if isinstance(recording, recordings.Recorded) else recordings.read(recording)
    runs = list[dict[str, Any]]()
    for message in recorded.messages:
        t, values, on = message.values["t"], message.values, runs and runs[-1]["end"] is None
        if message.topic == "/state" and on and values.get("from") == Mode.ENGAGED:
            runs[-1]["left"] = runs[-1].get("left", (t, f"{values.get('to')}: {values.get('cause')}"))
        if message.topic != "/steers" or not (text := Steers.read(values["what"]).run):
            continue
        told = _read(text)
        if told["event"] == "begin":
            runs.append({key: told[key] for key in NOTED} | {"begin": t, "end": None, "cause": None})
        elif told["event"] == "end" and on:
            runs[-1].update(end=t, cause=told["cause"])
    last = recorded.messages[-1].values["t"] if recorded.messages else math.nan
    for run in runs:
        left = run.pop("left", (last, RECORDING_ENDS))
        if run["end"] is None:
            run["end"], run["cause"] = left
    return runs


def _read(text: str) -> dict[str, Any]:
    """What `Proving` noted of a run; raises ValueError for anything else."""
    try:
        told = json.loads(text)
        keys = {"begin": NOTED, "end": ("cause",), "drive": ()}[told["event"]]
        for key in keys:
            words = key in ("side", "manoeuvre", "cause")
            require(isinstance(told[key], str if words else int | float), key, f"{told[key]!r:.60}")
        require(told.get("side", "course") in (*SIDES, "course"), "side", f"{told.get('side')!r:.60}")
        return dict(told)
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError) as error:
        raise ValueError(f"the recording: {text[:200]!r} is no note of a run ({error})") from error


def drive(
    options: sessions.Options,
    manoeuvre: Manoeuvre,
    *,
    base: str = "stanley",
    repeats: int | None = None,
    yes: bool = False,
    minutes: float = 0.0,
) -> dict[str, Any]:
    """`steerkit prove --car`: drive the runs of a manoeuvre; returns figures, the recording and its `runs`.

    Raises ValueError, before anything starts, for what `check` refuses and for `yes` without a simulated car; and
    before anything moves, where a car server is running: its recording is its own. repeats: valid runs to each side, in
    place of the manoeuvre's; minutes: as of `Proving`.
    """
    alone = "--yes consents for simulated cars alone: leave it, or --simulated; on a real one a person consents"
    require(options.simulated or not yes, "prove", alone)
    require(minutes >= 0.0, "prove", f"minutes = {minutes:g}, expected 0 or more")
    manoeuvre = replace(manoeuvre, repeats=repeats) if repeats is not None else manoeuvre
    config = load(options.config, "-" if options.simulated else options.channel)
    check(manoeuvre, config, base)
    v, off = manoeuvre.conditions.v, 0.25 * manoeuvre.conditions.v_tolerance
    simulate = {"v_min": v - off, "v_max": v + off, **options.simulate} if options.simulated else {}
    with sessions.session(replace(options, simulate=simulate)) as here:
        require(here.recording, f"{here.socket}", "the car server there was not ours; end it first")
        here.link.wait(timeout=10.0)
        how: dict[str, Any] = {"base": base, "minutes": minutes, "yes": yes, "say": not here.live}
        proving = Proving(config=here.config, link=here.link, manoeuvre=manoeuvre, **how)
        run = sessions.guided(here, f"{manoeuvre.name}, {base}", proving, "prove", {KEY: proving.consent})
    figures = sessions.finished(here, run)
    return figures | {"runs": runs_in(here.recording), "valid": proving.valid}
