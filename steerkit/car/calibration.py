"""The guided drive that ends in a vehicle file: its waves on top of a controller, and the file of what was found."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path as FilePath
from typing import Any

from steerkit._support.errors import known, require
from steerkit._support.files import read_bytes, read_text, write_text
from steerkit.car import loop as loops
from steerkit.car import recording as recordings
from steerkit.car import replay as replays
from steerkit.car import session as sessions
from steerkit.car.client import CarClient
from steerkit.car.config import CarConfig
from steerkit.car.estimates import DOUBTED, DROVE, EARLIER, QUANTITIES, changes, earlier, known_in, report
from steerkit.car.loop import Follow
from steerkit.car.protocol import ESTIMATES, Remark
from steerkit.car.state_machine import Mode
from steerkit.diagram import realtime
from steerkit.estimators.estimate import Estimated
from steerkit.scenario.catalogue import CONTROLLERS
from steerkit.task import DT
from steerkit.vehicles import vehicle_text

SHARES = {"sine": 0.25, "steps": 0.25, "bends": 0.5}
"""Of the driving time, by wave, in this order."""
SLOWEST = 3.0
"""Speed from which on time counts, as estimators learn nothing below [m/s]."""
WARNING = 5.0
"""How long before its end the operator is warned [s]."""
_ABOUT = {"sine": "the wheel swings slowly", "steps": "it steps to and fro", "bends": "the course alone moves it"}
DATA_SHEET = "data sheet"
"""Source of what no drive has found."""
NAMED = "-calibrated"
"""End of the name of a car that was calibrated."""


@dataclass(kw_only=True)
class Guided:
    """Which wave is on top while a car is calibrated: each for its share of the time that the car is driven engaged.

    A driver who takes the wheel stops the clock; the wave begins anew when the car is engaged again. All else is as in
    an ordinary drive: gate, checks, watchdogs and keys.
    """

    config: CarConfig
    link: CarClient
    base: str = "stanley"
    """The controller that keeps the car on its course."""
    minutes: float = 4.0
    """Of driving, engaged."""
    say: bool = False
    """Print a line at each wave's beginning."""
    driven: float = 0.0
    """Of this wave [s]."""
    place: int = 0
    """Number of the wave; one more than the last when all are over."""
    follow: Follow = field(init=False)

    def __post_init__(self) -> None:
        first = loops.controller_named(f"{self.base}+{self.wave}", self.config)
        self.follow = Follow.of(self._loop(first), self.link)
        self._announce(first)

    @property
    def wave(self) -> str:
        """The wave of now; "" when all are over."""
        return [*SHARES, ""][self.place]

    @property
    def left(self) -> float:
        """Driving that is left of this wave [s]."""
        return 60.0 * self.minutes * SHARES.get(self.wave, 0.0) - self.driven

    def step(self, run: realtime.Run) -> bool:
        """After every sample; True when all waves are over."""
        self.follow.begin(run)
        if self.follow.engaged and run.sample["car.v"] >= SLOWEST:
            self.driven += DT
        if self.left < 0.5 * DT:
            self.place, self.driven = self.place + 1, 0.0
            if not self.wave:
                return True
            controller = loops.controller_named(f"{self.base}+{self.wave}", self.config)
            self.follow.exchange(run, self._loop(controller))
            self._announce(controller)
        self.follow.choose(run)
        return False

    def _loop(self, controller: loops.Controller) -> Any:
        return loops.car_loop(self.config, self.link, controller.block)

    def _announce(self, controller: loops.Controller) -> None:
        self.link.note(Remark(controller.steers.text()))
        if self.say:
            print(self.status(), flush=True)

    def status(self) -> str:
        """One line for the panel: what comes, and what stands against it."""
        if not self.wave:
            return "all is driven: take the wheel"
        after = [*SHARES, "the end"][self.place + 1]
        text = f"{self.wave}, {_ABOUT[self.wave]}: {self.left:.0f} s of driving left, then {after}"
        last = self.link.last
        if last is None or last.mode is not Mode.ENGAGED:
            return f"{text}; the clock stands until you engage"
        if not last.v >= SLOWEST:
            return f"{text}; the clock stands below {SLOWEST:g} m/s: nothing is learned there"
        return f"{text}: HANDS ON THE WHEEL" if after == "the end" and self.left < WARNING else text


def check(base: str, minutes: float) -> None:
    """Raise ValueError unless a car can be calibrated like that."""
    require(0.1 <= minutes <= 60.0, "calibrate", f"minutes = {minutes:g}, expected 0.1 to 60 of driving")
    known(base, CONTROLLERS, "calibrate: controller")


@dataclass(frozen=True, kw_only=True)
class Calibrated:
    """What is known of a car after a drive."""

    config: CarConfig
    found: Mapping[str, Estimated]
    """By the names of `protocol.ESTIMATES`."""
    before: Mapping[str, Estimated]
    """What an earlier drive found: kept where this one did not find it."""
    log: str
    digest: str
    """SHA-256 of the recording."""
    notes: tuple[str, ...] = ()

    @property
    def known(self) -> dict[str, tuple[Estimated, str]]:
        """Each quantity that a drive has found, and which one."""
        rows = {name: (self.before[name], EARLIER) for name in ESTIMATES if name in self.before}
        rows |= {name: (self.found[name], DROVE) for name in ESTIMATES if self.found[name].valid > 0.5}
        return {name: rows[name] for name in ESTIMATES if name in rows}

    @property
    def learned(self) -> int:
        """How many quantities this drive has found."""
        return sum(source == DROVE for _, source in self.known.values())

    @property
    def steering(self) -> dict[str, float]:
        """Dead time, lag [s] and offset [rad]: dead time and lag as a pair, whose sum is known best."""
        known, times = self.known, {"delay": self.config.delay, "lag": self.config.lag}
        if self.found["delay_lag"].valid > 0.5:
            times = {name: self.found[name].value for name in times}
        else:
            times = {name: known[name][0].value if name in known else value for name, value in times.items()}
        offset = known["offset"][0].value if "offset" in known else 0.0
        return {name: max(value, 0.0) for name, value in times.items()} | {"offset": offset}

    def text(self) -> str:
        """The vehicle file: `vehicle(file)` reads its car, `steering_of(file)` its steering."""
        car, known = self.config.vehicle, self.known
        ratio = known["steer_ratio"][0].value if "steer_ratio" in known else car.steer_ratio
        sheet = {"delay": self.config.delay, "lag": self.config.lag, "offset": 0.0, "rate_zero": 0.0}
        sheet |= {"steer_ratio": float(car.steer_ratio), "understeer": float(car.understeer_gradient)}
        rows: dict[str, dict[str, Any]] = {}
        for name in ESTIMATES:
            unit = QUANTITIES[name].si
            if name in known:
                q, source = known[name]
                rows[name] = {"value": q.value, "low": q.low, "high": q.high, "unit": unit, "source": source}
            elif name in sheet:
                rows[name] = {"value": sheet[name], "unit": unit, "source": DATA_SHEET}
        unknown = [name for name in ESTIMATES if name not in known]
        notes = [f"{', '.join(unknown)}: not found by this drive"] if unknown else []
        provenance = {
            "log": self.log,
            "sha256": self.digest,
            "base": f"{car.name}: m, i_z, l_f, l_r, c_f, c_r, mu are given, not found",
            "notes": [*self.notes, *notes],
            "changes": changes(self.before, self.found),
        }
        named = replace(car, name=f"{car.name.removesuffix(NAMED)}{NAMED}", steer_ratio=ratio)
        return vehicle_text(named, steering=self.steering, estimates=rows, provenance=provenance)


class NothingLearned(ValueError):
    """A drive in which nothing was found: too slow, too straight, or never engaged."""


def check_place(out: FilePath) -> None:
    """Raise ValueError unless a vehicle file can be written there: a new one, or in the place of one."""
    require(out.suffix == ".toml", f"--out {out}", "a vehicle file ends in .toml")
    require(out.absolute().parent.is_dir(), f"--out {out}", f"there is no folder {out.absolute().parent}")
    if out.exists():
        known_in(read_text(out, "vehicle"), f"--out {out}")


def of_recording(recording: FilePath) -> Calibrated:
    """What is found in the longest drive of a recording; raises ValueError when there is none."""
    recorded = recordings.read(recording)
    config = recordings.config_of(recorded)
    drives = list(replays.drives(recorded))
    require(bool(drives), f"{recording}", "there is no drive in it: no request")
    drive = max(drives, key=lambda drive: len(drive.requests))
    estimators, _ = replays.replayed_estimates(drive, config)
    notes = [] if recorded.whole else [f"the recording is damaged or cut short: {recorded.kept()}"]
    notes += [DOUBTED] if estimators.doubted else []
    digest = hashlib.sha256(read_bytes(recording)).hexdigest()
    found = estimators.found()
    source: dict[str, Any] = {"log": recording.name, "digest": digest, "notes": tuple(notes)}
    return Calibrated(config=config, found=found, before=earlier(config), **source)


def from_recording(recording: FilePath, out: FilePath, *, say: bool = True) -> dict[str, Any]:
    """Write the vehicle file that a recording makes, and say what is known and what has changed; returns the same.

    A file that is there already is the earlier drive: what this one does not find is kept. Raises NothingLearned, and
    writes nothing, when this drive has found nothing.
    """
    made = of_recording(recording)
    if out.exists():
        made = replace(made, before=known_in(read_text(out, "vehicle"), f"{out}"))
    if say:
        print("\n".join(report(made.found, made.before)))
    if not made.learned:
        needed = "the wheel has to move to and fro while the car is ENGAGED and drives 3 m/s or faster"
        needed = DOUBTED if DOUBTED in made.notes else needed
        raise NothingLearned(f"{recording}: nothing was learned, no vehicle file is written; {needed}")
    try:
        write_text(out, made.text())
    except OSError as error:
        error.add_note(f"the drive is in {recording}: steerkit car calibrate --from {recording} --out FILE")
        raise
    print(f'{made.learned} of {len(ESTIMATES)} quantities in {out}; to drive with it: [vehicle] name = "{out.name}"')
    times = ", ".join(f"{name} = {value:.3f}" for name, value in made.steering.items() if name != "offset")
    print(f"and for controllers that predict: [kit] {times}")
    rows = {
        name: {"value": q.value, "low": q.low, "high": q.high, "valid": q.valid > 0.5} for name, q in made.found.items()
    }
    return {"vehicle_file": str(out), "estimates": rows, "changes": changes(made.before, made.found)}


def calibrate(options: sessions.Options, out: FilePath, *, base: str, minutes: float) -> dict[str, Any]:
    """`steerkit car calibrate`: drive, then write the vehicle file `out`; returns figures and estimates.

    Nothing is lost when a drive is cut short: the file can be made from its recording. Raises ValueError, before
    anything starts, for an `out` that is no vehicle file and for what `check` refuses, and NothingLearned, before
    anything moves, where a car server is running: its recording is its own.
    """
    check(base, minutes)
    check_place(out)
    with sessions.session(options) as here:
        if not here.recording:
            hint = f"drive with it and use its recording: steerkit car calibrate --from RECORDING --out {out}"
            raise NothingLearned(
                f"{here.socket}: no vehicle file: the car server there was not ours; end it, or {hint}"
            )
        here.link.wait(timeout=10.0)
        guided = Guided(config=here.config, link=here.link, base=base, minutes=minutes, say=not here.live)
        run = sessions.guided(here, f"calibration, {base}", guided, "guide")
    figures = sessions.finished(here, run)
    return figures | from_recording(FilePath(here.recording), out, say=not options.quiet)
